//! Simulated motion-capture devices that play recorded or generated motion to a real host.
//!
//! [`source`] reads a motion, [`generator`] makes one, and [`source::Replay`] resamples it to another rate; [`sampled`]
//! makes the samples of force plates and electrodes, and [`source::read_signals`] reads those of a take, and its rigid
//! bodies. [`device`] plays it over the link protocol, [`ndi`] over that of NDI, and on the network [`qtm`], [`natnet`] and
//! [`lsl`] over those of QTM, of OptiTrack and of the Lab Streaming Layer. [`faults`] injects faults by a script, and
//! [`log_device`] replays a raw log. A [line](mod@line) connects a device to its host: [`pty`], or [`gadget`] on a machine
//! with a USB device controller. None of them starts a thread, and only a line reads a clock.

pub mod device;
pub mod faults;
#[cfg(target_os = "linux")]
pub mod gadget;
pub mod generator;
pub mod line;
pub mod log_device;
pub mod lsl;
pub mod natnet;
pub mod ndi;
pub mod pty;
pub mod qtm;
pub mod sampled;
pub mod source;

pub use device::NetworkOptions;
