//! The loop between a device and its line: one thread that sleeps until the next frame or byte.

use std::io;
use std::io::Write;
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use super::{BaudLimiter, LatencyTimer, Line, LineError};
use crate::device::{LineDevice, SentLog};

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
    /// Destination of the frame log, one CSV row per frame produced: a [`SentFrame`](crate::device::SentFrame), or with
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
/// waits until the host has read all bytes sent, or has read nothing for one second.
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
    server.run(options.once, stop)?;
    server.drain()?;
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

impl Server<'_> {
    fn failed(&self, action: &'static str) -> impl FnOnce(io::Error) -> LineError + use<> {
        let line = self.line.name();
        move |source| LineError::Line { line, action, source }
    }

    fn run(&mut self, once: bool, stop: &AtomicBool) -> Result<(), LineError> {
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
                return Ok(());
            }
            let idle = sleep.min(until(wake_ns)).min(SLEEP_MAX);
            let ready = if is_full { self.line.wait_for_room(idle) } else { self.line.wait(idle) };
            if ready.map_err(self.failed("waiting"))? {
                self.read()?;
            }
            self.maintain()?;
        }
        Ok(())
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
        let mut drain = Drain::default();
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

    fn drain(&mut self) -> Result<(), LineError> {
        let mut drain = Drain::default();
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

/// A host that reads nothing for this long counts as gone.
const HOST_IDLE_TIMEOUT_NS: u64 = 1_000_000_000;

/// Time between two polls of the unread bytes.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Consecutive polls without unread bytes after which the host has all: a tenth of a second.
const EMPTY_POLLS: u32 = 20;

/// Watches the number of bytes that the host still has to read.
#[derive(Debug, Default)]
struct Drain {
    remaining: Option<u64>,
    progress_ns: u64,
    empty_polls: u32,
}

impl Drain {
    /// Takes the number of bytes between device and host; `true` at 0, or when the host has stopped reading.
    fn is_over(&mut self, remaining: u64, now_ns: u64) -> bool {
        if self.remaining != Some(remaining) {
            self.remaining = Some(remaining);
            self.progress_ns = now_ns;
        }
        // The kernel moves bytes between its buffers asynchronously and counts only the last one. On a busy machine its
        // worker can be late by tens of milliseconds, and a hang-up discards what it has not moved.
        self.empty_polls = if remaining == 0 { self.empty_polls + 1 } else { 0 };
        self.empty_polls > EMPTY_POLLS || now_ns.saturating_sub(self.progress_ns) > HOST_IDLE_TIMEOUT_NS
    }
}
