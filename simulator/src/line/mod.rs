//! What a device is connected by, as the loop that serves it sees it.

mod batch;
mod drain;
mod pace;
mod serve;

use std::io;
use std::time::Duration;

pub(crate) use batch::Batch;
pub use serve::{ServeOptions, serve};

/// A byte stream to a host, which may come and go.
pub trait Line {
    /// What an error calls it.
    fn name(&self) -> &'static str;

    /// Hands over what it takes now; `Ok(0)` when it is full, or nobody is at the other end.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Takes what the host said; `Ok(0)` when that is nothing.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;

    /// Sleeps, at most so long, until the host says something: `true` then.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn wait(&mut self, at_most: Duration) -> io::Result<bool>;

    /// Sleeps, at most so long, until a line that was full takes more, or the host says something.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        self.wait(at_most)
    }

    /// What was handed over and has not reached the host: 0 when that is nothing.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn unread(&mut self) -> io::Result<u64>;

    /// Pulls the cable: the host's end is hung up, and gone.
    ///
    /// # Errors
    /// When this line cannot be pulled, or is broken for good.
    fn unplug(&mut self) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Puts it in again, under the name that it had.
    ///
    /// # Errors
    /// When this line cannot be pulled, or is broken for good.
    fn plug_in(&mut self) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Called ten times a second.
    ///
    /// # Errors
    /// When the line is broken for good.
    fn tend(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Why a line is no longer served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// The line failed.
    #[error("{action} failed on the {line}")]
    Line {
        /// What the line is.
        line: &'static str,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// The log of what was sent could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}
