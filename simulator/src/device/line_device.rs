//! What a line needs of a device, whatever the device speaks.

use super::{Device, SentFrame, SentLog};

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

impl LineDevice for Device {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        Self::on_bytes(self, bytes, now_ns);
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        Self::poll(self, now_ns)
    }

    fn pending(&self) -> &[u8] {
        Self::pending(self)
    }

    fn sent(&mut self, n: usize) {
        Self::sent(self, n);
    }

    fn has_ended(&self) -> bool {
        Self::has_ended(self)
    }

    fn log(&self) -> SentLog {
        Self::log(self)
    }

    fn keep_frame_log(&mut self) {
        Self::keep_frame_log(self);
    }

    fn take_frames(&mut self) -> Vec<SentFrame> {
        Self::take_frames(self)
    }
}
