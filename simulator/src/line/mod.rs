//! What a device is connected by, and the device, as the loop that serves them sees both.

mod pace;
mod serve;

use std::io;
use std::time::Duration;

pub(crate) use pace::Batch;
pub use serve::{ServeOptions, serve};

use crate::device::{SentFrame, SentLog};

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

/// A simulated device on a line, sans-io: the host's bytes and the time go in, the device's bytes
/// come out. Times are nanoseconds of one monotonic clock.
pub trait LineDevice {
    /// Bytes from the host, in pieces of any size.
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64);

    /// The host held the line in the break state. Most devices do not care.
    fn on_break(&mut self, _now_ns: u64) {}

    /// Does what is due. Gives the time of the next thing that will be; `u64::MAX` when only the
    /// host can cause one.
    fn poll(&mut self, now_ns: u64) -> u64;

    /// The bytes that the line should carry next.
    fn pending(&self) -> &[u8];

    /// The line took the first `n` pending bytes.
    fn sent(&mut self, n: usize);

    /// The speed of the device's end of the line in baud, where the host's commands set it.
    fn baud(&self) -> Option<u32> {
        None
    }

    /// Whether a run has ended and the host was told, with no other begun since.
    fn has_ended(&self) -> bool;

    /// What it sent so far.
    fn log(&self) -> SentLog;

    /// Keeps a [`SentFrame`] for every frame from now on.
    fn keep_frame_log(&mut self);

    /// Takes the logged frames away.
    fn take_frames(&mut self) -> Vec<SentFrame>;

    /// Whether it is on its line. A line follows.
    fn is_plugged(&self) -> bool {
        true
    }

    /// Whether it went away and will not come back: nothing more goes over its line.
    fn is_gone(&self) -> bool {
        false
    }

    /// The first line of a log file.
    fn log_header(&self) -> &'static str {
        SentFrame::CSV_HEADER
    }

    /// Takes the logged frames away, one line each.
    fn take_log_lines(&mut self) -> Vec<String> {
        self.take_frames().into_iter().map(SentFrame::to_csv).collect()
    }

    /// Nothing goes over the line any more: what became of the last frames is known now.
    fn close(&mut self) {}
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
