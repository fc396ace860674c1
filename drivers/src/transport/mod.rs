//! How bytes reach a device: serial lines and USB bulk endpoints.

mod access;
pub mod serial;
mod tty;
pub mod turns;
pub mod usb;

use std::{fmt::Debug, io, time::Duration};

pub use access::{Access, access};

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

    /// The transport that this one wraps, which then answers what follows.
    fn inner(&self) -> Option<&dyn Transport> {
        None
    }

    /// What the line carries, in bytes a second and each direction; `None` when it is not limited.
    fn line_bytes_per_s(&self) -> Option<u64> {
        self.inner()?.line_bytes_per_s()
    }

    /// The device and the line's settings, for people.
    fn describe(&self) -> String {
        self.inner().map_or_else(|| "nothing".to_owned(), Transport::describe)
    }

    /// Whether the kernel gives bytes on as soon as it has them, because it was asked to.
    fn is_low_latency(&self) -> bool {
        self.inner().is_some_and(Transport::is_low_latency)
    }

    /// How often the device stalled and was cleared; what was on its way then may be lost.
    fn stalls_cleared(&self) -> u64 {
        self.inner().map_or(0, Transport::stalls_cleared)
    }
}

/// Why a device cannot be opened, read or written. The message is one line that says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// Nothing is there.
    #[error(
        "{device} does not exist: plug the device in, or list what is attached with `mocapd devices`"
    )]
    NotFound {
        /// A path, or a USB identity.
        device: String,
    },
    /// Somebody else has it open.
    #[error("{device} is in use{}: close the other program", holder.as_ref().map_or_else(String::new, |holder| format!(" by {holder}")))]
    Busy {
        /// A path, or a USB identity.
        device: String,
        /// Who, as `name (process 1234)`, when that could be found out.
        holder: Option<String>,
    },
    /// The user may not open it.
    #[error("no permission for {device}: {remedy}")]
    PermissionDenied {
        /// A path, or a USB identity.
        device: String,
        /// What to type.
        remedy: String,
    },
    /// It was there, and is gone.
    #[error("{device} is gone: plug it in again")]
    Disconnected {
        /// A path, or a USB identity.
        device: String,
    },
    /// The device answers, and says that it cannot do what it was asked.
    #[error("{0}")]
    Refused(String),
    /// It is there, and takes no bytes.
    #[error(
        "{device} takes no commands: check that it is the right device, and switch it off and on again"
    )]
    Stuck {
        /// A path, or a USB identity.
        device: String,
    },
    /// This build cannot do that.
    #[error("{0}")]
    Unsupported(String),
    /// Anything else the system said.
    #[error("{device}: {action} failed")]
    Io {
        /// A path, or a USB identity.
        device: String,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
}
