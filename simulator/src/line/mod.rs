//! Lines and the devices on them: the traits [`Line`] and [`LineDevice`], and the loop that serves one over the other.

mod pace;
mod serve;

use std::io;
use std::time::Duration;

pub(crate) use pace::LatencyTimer;
pub use serve::{ServeOptions, serve};

use crate::device::{SentFrame, SentLog};

/// A byte stream to a host that may come and go.
pub trait Line {
    /// Its name in error messages.
    fn name(&self) -> &'static str;

    /// Writes as many bytes as the line takes now; `Ok(0)` when it is full or has no host.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Reads the host's bytes; `Ok(0)` when there are none.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;

    /// Waits at most this long for bytes from the host; `true` when there are some.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn wait(&mut self, at_most: Duration) -> io::Result<bool>;

    /// Waits at most this long until a full line takes more bytes, or bytes arrive from the host.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        self.wait(at_most)
    }

    /// Bytes written that the host has not read yet; some lines know only whether there are any.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn unread(&mut self) -> io::Result<u64>;

    /// Pulls the cable: the host's end hangs up and disappears.
    ///
    /// # Errors
    /// When this line has no cable to pull, or has failed for good.
    fn unplug(&mut self) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Plugs the cable in again, under the same name.
    ///
    /// # Errors
    /// When this line has no cable to pull, or has failed for good.
    fn plug_in(&mut self) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Housekeeping, called ten times a second.
    ///
    /// # Errors
    /// When the line has failed for good.
    fn maintain(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A simulated device on a line. Sans-io: the host's bytes and the time go in, the device's bytes come out. Times are
/// nanoseconds of one monotonic clock.
pub trait LineDevice {
    /// Takes bytes from the host, in pieces of any size.
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64);

    /// The host held the line in the break state. Most devices ignore it.
    fn on_break(&mut self, _now_ns: u64) {}

    /// Does everything that is due. Returns the time of the next event; `u64::MAX` when only the host can cause one.
    fn poll(&mut self, now_ns: u64) -> u64;

    /// The bytes for the line to send next.
    fn pending(&self) -> &[u8];

    /// The line took the first `n` pending bytes.
    fn sent(&mut self, n: usize);

    /// Speed of the device's end of the line in baud, if the host's commands set it.
    fn baud(&self) -> Option<u32> {
        None
    }

    /// Whether a run has ended, its end was reported to the host, and none has started since.
    fn has_ended(&self) -> bool;

    /// What it has sent so far.
    fn log(&self) -> SentLog;

    /// Keeps a [`SentFrame`] for every frame from now on.
    fn keep_frame_log(&mut self);

    /// Takes the logged frames out of the device.
    fn take_frames(&mut self) -> Vec<SentFrame>;

    /// Whether its cable is plugged in. The line follows this state.
    fn is_plugged(&self) -> bool {
        true
    }

    /// Whether it has gone for good: nothing more goes over its line.
    fn is_gone(&self) -> bool {
        false
    }

    /// The header of a log file.
    fn log_header(&self) -> &'static str {
        SentFrame::CSV_HEADER
    }

    /// Takes the logged frames out of the device, as rows of a log file.
    fn take_log_lines(&mut self) -> Vec<String> {
        self.take_frames().into_iter().map(SentFrame::to_csv).collect()
    }

    /// Nothing goes over the line any more: settles the fates of the last frames.
    fn close(&mut self) {}
}

/// Why serving a line failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// The line failed.
    #[error("{action} failed on the {line}")]
    Line {
        /// The line's name.
        line: &'static str,
        /// The operation that failed.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The log of sent frames could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}
