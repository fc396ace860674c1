//! Lines and the devices on them: the traits [`Line`] and [`LineDevice`], limits on when
//! a line hands bytes over, and the loop that serves one over the other.

mod serve;

use std::{io, time::Duration};

use crate::device::{SentBatch, SentFrame, SentLog};

pub(crate) use serve::host_ns;
pub use serve::{ServeOptions, serve};

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

    /// The header of a log file of batches of samples.
    fn batch_log_header(&self) -> &'static str {
        SentBatch::CSV_HEADER
    }

    /// Takes the rows of the logged batches out of the device.
    fn take_batch_lines(&mut self) -> Vec<String> {
        Vec::new()
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

/// Bits per byte on an 8N1 line.
const BITS_PER_BYTE: u64 = 10;

/// How far ahead of the line bytes are handed over: about a UART's FIFO at the common speeds.
const FIFO_NS: u64 = 1_000_000;

/// Idle time that a burst may make up for, so that a late wake-up does not cost throughput.
const CREDIT_NS: u64 = 5_000_000;

const SECOND_NS: u128 = 1_000_000_000;

/// Limits the throughput to a speed in baud.
#[derive(Debug)]
struct BaudLimiter {
    baud: u64,
    /// When the last byte handed over has left the line.
    free_ns: u64,
}

impl BaudLimiter {
    fn new(baud: u32) -> Self {
        Self { baud: u64::from(baud.max(1)), free_ns: 0 }
    }

    fn baud(&self) -> u32 {
        u32::try_from(self.baud).unwrap_or(u32::MAX)
    }

    /// The number of bytes that may be handed over now.
    fn allowed(&mut self, now_ns: u64) -> usize {
        self.free_ns = self.free_ns.max(now_ns.saturating_sub(CREDIT_NS));
        let ahead_ns = (now_ns + FIFO_NS).saturating_sub(self.free_ns);
        let bytes =
            u128::from(ahead_ns) * u128::from(self.baud) / u128::from(BITS_PER_BYTE) / SECOND_NS;
        // A slow line takes less than a byte in that time; one byte goes as soon as the line is free.
        let one = usize::from(self.free_ns <= now_ns);
        usize::try_from(bytes).unwrap_or(usize::MAX).max(one)
    }

    fn sent(&mut self, bytes: usize) {
        let ns = bytes as u128 * u128::from(BITS_PER_BYTE) * SECOND_NS / u128::from(self.baud);
        self.free_ns = self.free_ns.saturating_add(u64::try_from(ns).unwrap_or(u64::MAX));
    }

    /// When the line is free again.
    fn next_ns(&self) -> u64 {
        self.free_ns
    }
}

/// The latency timer of a USB serial adapter: it releases the waiting bytes once per period. It runs even when nothing
/// waits.
#[derive(Debug)]
pub(crate) struct LatencyTimer {
    period_ns: u64,
    /// When it expires next.
    pub(crate) next_ns: u64,
    /// Bytes released at the last expiry and not handed over yet.
    pub(crate) released: usize,
}

impl LatencyTimer {
    pub(crate) fn new(period_ns: u64, now_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        Self { period_ns, next_ns: now_ns + period_ns, released: 0 }
    }

    /// Advances the time. `waiting` bytes were there before it; newer ones wait for the next expiry.
    pub(crate) fn tick(&mut self, now_ns: u64, waiting: usize) {
        if now_ns >= self.next_ns {
            // A late wake-up does not move the timer.
            self.next_ns +=
                (now_ns - self.next_ns) / self.period_ns * self.period_ns + self.period_ns;
            self.released = waiting;
        }
    }

    pub(crate) fn sent(&mut self, bytes: usize) {
        self.released = self.released.saturating_sub(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_line_carries_a_tenth_of_its_baud_rate() {
        for baud in [300, 9_600, 115_200, 3_000_000] {
            let mut pace = BaudLimiter::new(baud);
            let (mut now_ns, mut bytes) = (10 * CREDIT_NS, 0);
            let start_ns = now_ns;
            while now_ns < start_ns + 10_000_000_000 {
                let n = pace.allowed(now_ns);
                pace.sent(n);
                bytes += n;
                // Always woken 0.3 ms late.
                now_ns = pace.next_ns().max(now_ns) + 300_000;
            }
            let expected = baud as f64;
            assert!((bytes as f64 / expected - 1.0).abs() < 0.01, "{baud}: {bytes}");
        }
    }

    #[test]
    fn bytes_after_an_expiry_wait_for_the_next() {
        let mut timer = LatencyTimer::new(16, 100);
        let mut allowed = |now_ns, waiting, sent| {
            timer.sent(sent);
            timer.tick(now_ns, waiting);
            (timer.released, timer.next_ns)
        };
        assert_eq!(allowed(115, 50, 0), (0, 116));
        assert_eq!(allowed(117, 50, 0), (50, 132));
        assert_eq!(allowed(118, 90, 30), (20, 132));
        assert_eq!(allowed(131, 70, 20), (0, 132));
        // A late wake-up does not shift the timer.
        assert_eq!(allowed(170, 70, 0), (70, 180));
        // It expires even when nothing waits, and later bytes wait for the next expiry.
        assert_eq!(allowed(200, 0, 70), (0, 212));
        assert_eq!(allowed(201, 10, 0), (0, 212));
    }
}
