//! Lines and the devices on them: the traits [`Line`] and [`LineDevice`], limits on when a line hands bytes over, and the
//! loop that serves one over the other: one thread that sleeps until the next frame or byte.

use std::{
    io::{self, Write},
    num::NonZeroU64,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use rustix::time::{ClockId, clock_gettime};

use crate::device::{SentBatch, SentFrame, SentLog};

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

/// The longest sleep, which bounds the reaction time to a stop.
const SLEEP_MAX: Duration = Duration::from_millis(20);

/// How long to wait when the host's buffer is full: 64 KiB at the pty's 75 MB/s.
const RETRY_INTERVAL: Duration = Duration::from_millis(1);

/// Size of one read: many times the longest command.
const READ_BYTES: usize = 4096;

/// Maximum number of consecutive reads before frames are served again.
const READS_MAX: usize = 16;

/// How to serve a line.
#[derive(Default)]
pub struct ServeOptions {
    /// Limit the throughput to a line of this speed; `None` for as fast as the host reads.
    pub baud: Option<u32>,
    /// Hand waiting bytes over once per this period, as a latency timer does; `None` to hand them over immediately.
    pub batch: Option<Duration>,
    /// Return when a run has ended and the host has read all of it.
    pub once: bool,
    /// Destination of the frame log, one CSV row per frame produced: a [`SentFrame`], or with
    /// faults a [`FrameFate`](crate::faults::FrameFate).
    pub log: Option<Box<dyn Write + Send>>,
    /// Destination of the log of batches of samples, one CSV row per batch.
    pub batch_log: Option<Box<dyn Write + Send>>,
}

impl std::fmt::Debug for ServeOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServeOptions")
            .field("baud", &self.baud)
            .field("batch", &self.batch)
            .field("once", &self.once)
            .field("log", &self.log.is_some())
            .field("batch_log", &self.batch_log.is_some())
            .finish()
    }
}

/// Serves a device on a line until `stop` is set or the device is [gone](LineDevice::is_gone). Before it returns, it
/// waits until the host has read all bytes sent, or has read nothing for one second; for five, if no stop was requested.
///
/// # Errors
/// When the line or the log fails.
pub fn serve(
    line: &mut dyn Line,
    device: &mut dyn LineDevice,
    options: ServeOptions,
    stop: &AtomicBool,
) -> Result<SentLog, LineError> {
    // Default timer slack makes a sleep up to 50 us late, unlike a device's timer. If the kernel refuses, it stays.
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
    if options.log.is_some() || options.batch_log.is_some() {
        device.keep_frame_log();
    }
    let mut server = Server {
        line,
        device,
        pace: None,
        baud: options.baud,
        timer: options.batch.map(|period| LatencyTimer::new(period.as_nanos() as u64, host_ns())),
        log: options.log,
        batch_log: options.batch_log,
        open_again_ns: 0,
        plugged: true,
    };
    server.log_line(server.device.log_header())?;
    server.log_batch(server.device.batch_log_header())?;
    let end = server.run(options.once, stop)?;
    server.drain(end)?;
    server.device.close();
    server.log_frames()?;
    for log in server.log.iter_mut().chain(&mut server.batch_log) {
        log.flush().map_err(LineError::Log)?;
    }
    Ok(device.log())
}

/// The system's monotonic clock, which a host on the same machine also reads; nanoseconds.
pub(crate) fn host_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

struct Server<'a> {
    line: &'a mut dyn Line,
    device: &'a mut dyn LineDevice,
    pace: Option<BaudLimiter>,
    timer: Option<LatencyTimer>,
    /// Speed limit of the line; a device may run its own end slower.
    baud: Option<u32>,
    log: Option<Box<dyn Write + Send>>,
    batch_log: Option<Box<dyn Write + Send>>,
    open_again_ns: u64,
    /// Whether the cable is plugged in.
    plugged: bool,
}

/// Outcome of a write.
enum Progress {
    /// Everything is written.
    All,
    /// The line takes more at this time, nanoseconds.
    Until(u64),
    /// The host's buffer is full.
    Full,
}

/// Why serving has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The run is over, or the device has gone.
    Over,
    /// The caller stopped it, and waits.
    Stopped,
}

impl End {
    /// A host that reads nothing for this long counts as gone.
    const fn host_idle_max_ns(self) -> u64 {
        match self {
            Self::Over => HOST_LATE_MAX_NS,
            Self::Stopped => HOST_IDLE_TIMEOUT_NS,
        }
    }
}

impl Server<'_> {
    fn failed(&self, action: &'static str) -> impl FnOnce(io::Error) -> LineError + use<> {
        let line = self.line.name();
        move |source| LineError::Line { line, action, source }
    }

    fn run(&mut self, once: bool, stop: &AtomicBool) -> Result<End, LineError> {
        let until = |at_ns: u64| Duration::from_nanos(at_ns.saturating_sub(host_ns()));
        while !stop.load(Ordering::Relaxed) {
            let now_ns = host_ns();
            self.tick(now_ns);
            let wake_ns = self.device.poll(now_ns);
            self.update_cable()?;
            let (sleep, is_full) = match self.write()? {
                Progress::All => (SLEEP_MAX, false),
                Progress::Until(at_ns) => (until(at_ns), false),
                Progress::Full => (RETRY_INTERVAL, true),
            };
            self.log_frames()?;
            // A host's first Stop ends no run: there was none yet.
            let has_ended = self.device.has_ended() && self.device.log().starts > 0;
            let is_over = self.device.is_gone() || (once && has_ended);
            if is_over && self.device.pending().is_empty() {
                return Ok(End::Over);
            }
            let idle = sleep.min(until(wake_ns)).min(SLEEP_MAX);
            let ready = if is_full { self.line.wait_for_room(idle) } else { self.line.wait(idle) };
            if ready.map_err(self.failed("waiting"))? {
                self.read()?;
            }
            self.maintain()?;
        }
        Ok(End::Stopped)
    }

    /// Unplugs the line or plugs it in, when the device's state has changed.
    fn update_cable(&mut self) -> Result<(), LineError> {
        let plugged = self.device.is_plugged();
        if plugged == self.plugged {
            return Ok(());
        }
        self.plugged = plugged;
        if plugged {
            return self.line.plug_in().map_err(self.failed("plugging in"));
        }
        // The log knows only sent and unsent frames, so everything sent must have reached the host.
        let mut drain = Drain::new(HOST_IDLE_TIMEOUT_NS);
        loop {
            let unread = self.line.unread().map_err(self.failed("counting bytes"))?;
            if drain.is_over(unread, host_ns()) {
                return self.line.unplug().map_err(self.failed("unplugging"));
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    /// Advances the latency timer: bytes that the device queues from now on wait for its next expiry.
    fn tick(&mut self, now_ns: u64) {
        let waiting = self.device.pending().len();
        if let Some(timer) = &mut self.timer {
            timer.tick(now_ns, waiting);
        }
    }

    /// Writes as many bytes as the line takes now.
    fn write(&mut self) -> Result<Progress, LineError> {
        let baud = self.device.baud().into_iter().chain(self.baud).min();
        if baud != self.pace.as_ref().map(BaudLimiter::baud) {
            self.pace = baud.map(BaudLimiter::new);
        }
        loop {
            let now_ns = host_ns();
            let pending = self.device.pending();
            if pending.is_empty() {
                return Ok(Progress::All);
            }
            let mut allowed = self.pace.as_mut().map_or(usize::MAX, |pace| pace.allowed(now_ns));
            if let Some(timer) = &mut self.timer {
                timer.tick(now_ns, pending.len());
                if timer.released == 0 {
                    return Ok(Progress::Until(timer.next_ns));
                }
                allowed = allowed.min(timer.released);
            }
            let bytes = pending.get(..allowed.min(pending.len())).unwrap_or_default();
            if bytes.is_empty() {
                let at_ns = self.pace.as_ref().map_or(now_ns, BaudLimiter::next_ns);
                return Ok(Progress::Until(at_ns));
            }
            let n = self.line.write(bytes).map_err(self.failed("writing"))?;
            if n == 0 {
                return Ok(Progress::Full);
            }
            self.device.sent(n);
            if let Some(timer) = &mut self.timer {
                timer.sent(n);
            }
            if let Some(pace) = &mut self.pace {
                pace.sent(n);
                let rest = !self.device.pending().is_empty();
                return Ok(if rest { Progress::Until(pace.next_ns()) } else { Progress::All });
            }
        }
    }

    fn read(&mut self) -> Result<(), LineError> {
        let mut buffer = [0; READ_BYTES];
        for _ in 0..READS_MAX {
            let n = self.line.read(&mut buffer).map_err(self.failed("reading"))?;
            if n == 0 {
                break;
            }
            let now_ns = host_ns();
            self.tick(now_ns);
            self.device.on_bytes(buffer.get(..n).unwrap_or_default(), now_ns);
        }
        Ok(())
    }

    /// Housekeeping, ten times a second: lets a new host open the line after one was killed, and flushes the log.
    fn maintain(&mut self) -> Result<(), LineError> {
        let now_ns = host_ns();
        if now_ns >= self.open_again_ns {
            self.open_again_ns = now_ns + 100_000_000;
            self.line.maintain().map_err(self.failed("maintaining"))?;
            self.log.as_mut().map_or(Ok(()), Write::flush).map_err(LineError::Log)?;
        }
        Ok(())
    }

    fn drain(&mut self, end: End) -> Result<(), LineError> {
        let mut drain = Drain::new(end.host_idle_max_ns());
        loop {
            self.write()?;
            let unread = self.line.unread().map_err(self.failed("counting bytes"))?;
            let remaining = self.device.pending().len() as u64 + unread;
            if drain.is_over(remaining, host_ns()) {
                return Ok(());
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    fn log_line(&mut self, text: &str) -> Result<(), LineError> {
        self.log.as_mut().map_or(Ok(()), |log| writeln!(log, "{text}")).map_err(LineError::Log)
    }

    fn log_batch(&mut self, text: &str) -> Result<(), LineError> {
        let log = self.batch_log.as_mut();
        log.map_or(Ok(()), |log| writeln!(log, "{text}")).map_err(LineError::Log)
    }

    fn log_frames(&mut self) -> Result<(), LineError> {
        // Both are taken, also if only one is written: the device keeps both.
        if self.log.is_some() || self.batch_log.is_some() {
            for line in self.device.take_batch_lines() {
                self.log_batch(&line)?;
            }
            for line in self.device.take_log_lines() {
                self.log_line(&line)?;
            }
        }
        Ok(())
    }
}

/// A host that reads nothing for this long counts as gone, if somebody waits for the end.
const HOST_IDLE_TIMEOUT_NS: u64 = 1_000_000_000;

/// The same after a run that has ended by itself, when nobody waits: on a machine that does much else, a host may get no
/// processor for seconds, and a hang-up would discard what it has not read.
const HOST_LATE_MAX_NS: u64 = 5_000_000_000;

/// Time between two polls of the unread bytes.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Consecutive polls without unread bytes after which the host has all: a tenth of a second.
const EMPTY_POLLS: u32 = 20;

/// Watches the number of bytes that the host still has to read.
#[derive(Debug)]
struct Drain {
    host_idle_max_ns: u64,
    remaining: Option<u64>,
    progress_ns: u64,
    empty_polls: u32,
}

impl Drain {
    fn new(host_idle_max_ns: u64) -> Self {
        Self { host_idle_max_ns, remaining: None, progress_ns: 0, empty_polls: 0 }
    }

    /// Takes the number of bytes between device and host; `true` at 0, or when the host has stopped reading.
    fn is_over(&mut self, remaining: u64, now_ns: u64) -> bool {
        if self.remaining != Some(remaining) {
            self.remaining = Some(remaining);
            self.progress_ns = now_ns;
        }
        // The kernel moves bytes between its buffers asynchronously, and some lines count only the last one. On a busy machine
        // its worker can be late by tens of milliseconds, and a hang-up discards what it has not moved.
        self.empty_polls = if remaining == 0 { self.empty_polls + 1 } else { 0 };
        self.empty_polls > EMPTY_POLLS
            || now_ns.saturating_sub(self.progress_ns) > self.host_idle_max_ns
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
