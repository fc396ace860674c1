//! Drivers for motion-capture devices: device families, the link protocol, and serial, USB and
//! network transports.
//!
//! A [`device::Protocol`] is sans-io: it turns received bytes into events and commands into bytes. A
//! [`transport::Transport`] moves those bytes. [`registry`] pairs the two for a device URI, and
//! [`link`], [`lsl`], [`ndi`], [`qtm`] and [`natnet`] are the families so far.
//!
//! One frame, encoded at the device's end of a link and decoded at the host's:
//!
//! ```
//! use mocapd_drivers::{
//!     device::{DeviceEvent, Frame, MarkerSample, Protocol},
//!     link::{DeviceLink, FrameForm, HostLink},
//! };
//!
//! let markers = [
//!     MarkerSample { id: 0, position_mm: [812.5, -40.25, 1604.0], ..Default::default() },
//!     MarkerSample { id: 1, occluded: true, ..Default::default() },
//! ];
//! let frame = Frame { seq: 7, device_ticks: 70_000, timecode: None, markers: &markers };
//!
//! let mut wire = Vec::new();
//! DeviceLink::new().frame(FrameForm::Float, &frame, &mut wire)?;
//!
//! let mut host = HostLink::new();
//! let mut n_frames = 0;
//! host.push(&wire, &mut |event| {
//!     assert_eq!(event, DeviceEvent::Frame(frame));
//!     n_frames += 1;
//! });
//! assert_eq!(n_frames, 1);
//! assert_eq!(host.counters().bytes_skipped, 0);
//! # Ok::<(), mocapd_drivers::link::EncodeError>(())
//! ```

pub mod axis;
mod bytes;
pub mod device;
pub mod link;
pub mod lsl;
mod marker_ids;
pub mod natnet;
pub mod ndi;
mod outbox;
pub mod plain_file;
pub mod qtm;
pub mod raw_log;
pub mod registry;
pub mod transport;
pub mod uri;
