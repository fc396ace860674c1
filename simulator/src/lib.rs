//! A take in, a device out: replays recorded or generated motion as a real device.
//!
//! [`generator`] makes motion, [`replay`] gives it another rate, [`device`] says it in the link protocol or
//! [`ndi`] in NDI's, and [`pty`] is the line. None of them starts a thread; only [`pty`] reads a clock.

pub mod device;
pub mod generator;
pub mod ndi;
pub mod pty;
pub mod replay;
pub mod source;
