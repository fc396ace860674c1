//! A take in, a device out: replays recorded or generated motion as a real device.
//!
//! [`generator`] makes motion, [`replay`] gives it another rate, [`device`] says it in the link protocol or
//! [`ndi`] in NDI's, [`faults`] damage it, [`logged`] says again what a raw log holds, and [`pty`] or, on a machine that can be a USB device, [`gadget`] is the [line](mod@line). None of them
//! starts a thread; only a line reads a clock.

pub mod device;
pub mod faults;
#[cfg(target_os = "linux")]
pub mod gadget;
pub mod generator;
pub mod line;
pub mod logged;
pub mod ndi;
pub mod pty;
pub mod replay;
pub mod source;
