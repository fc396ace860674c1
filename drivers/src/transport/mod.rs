//! How bytes reach a device: serial lines, USB bulk endpoints, and an in-process pair for tests.

mod access;
mod descriptor;
mod error;
mod low_latency;
pub mod memory;
pub mod serial;
pub mod turns;
pub mod usb;

use std::{fmt::Debug, time::Duration};

pub use access::{Access, access};
pub use error::TransportError;

/// How long a read waits for the first byte.
///
/// Short enough that a reader thread sees a request to stop within one frame at 60 Hz and a bit.
pub const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// How long a write waits for a device that takes no bytes. Commands are 16 bytes: a device that
/// has no room for them for a whole second does not read.
pub const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// A byte stream to a device and back.
pub trait Transport: Send + Debug {
    /// Reads what there is, up to `buf.len()` bytes, waiting [`READ_TIMEOUT`] for the first.
    /// `Ok(0)`: nothing yet.
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Io`.
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError>;

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Stuck` when it took no bytes for [`WRITE_TIMEOUT`]; `Io`.
    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError>;

    /// Holds the line in the break state for a moment, which some devices take as a reset.
    /// `false`: this line has no break (a pty, USB), and nothing was done.
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Io`.
    fn send_break(&mut self) -> Result<bool, TransportError> {
        Ok(false)
    }

    /// Changes the line's speed, once what was written has left. A line without one takes any.
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Io` when the port cannot run at that speed.
    fn set_baud(&mut self, _baud: u32) -> Result<(), TransportError> {
        Ok(())
    }

    /// What the line carries, in bytes a second and each direction; `None` when it is not limited.
    fn line_bytes_per_s(&self) -> Option<u64>;

    /// The device and the line's settings, for people.
    fn describe(&self) -> String;

    /// How often the device stalled and was cleared; what was on its way then may be lost.
    fn stalls_cleared(&self) -> u64 {
        0
    }
}
