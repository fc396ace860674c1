//! The loop between a device and its line: one thread, asleep until the next frame or the next byte.

use std::io::{self, Write};
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use super::pace::{Batch, Pace};
use super::{Line, LineError};
use crate::device::{LineDevice, SentLog};

/// The longest sleep: how soon a stop is seen.
const NAP: Duration = Duration::from_millis(20);

/// How long to wait for room when the host's buffer is full: 64 KiB at the pty's 75 MB/s.
const FULL: Duration = Duration::from_millis(1);

/// Bytes that are read at once: many times the longest command.
const READ_BYTES: usize = 4096;

/// Reads in a row before frames have their turn again.
const READS_MAX: usize = 16;

/// How the line is served.
#[derive(Default)]
pub struct ServeOptions {
    /// Carry no more than a line of this speed would; `None` for as fast as the host reads.
    pub baud: Option<u32>,
    /// Hand over what waits only so often; `None` for at once.
    pub batch: Option<Duration>,
    /// Return when a run has ended and the host has read all of it.
    pub once: bool,
    /// Where a line of CSV goes for every frame whose time came; see
    /// [`SentFrame`](crate::device::SentFrame), and of a line with faults
    /// [`FrameFate`](crate::faults::FrameFate).
    pub log: Option<Box<dyn Write + Send>>,
}

impl std::fmt::Debug for ServeOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServeOptions")
            .field("baud", &self.baud)
            .field("batch", &self.batch)
            .field("once", &self.once)
            .field("log", &self.log.is_some())
            .finish()
    }
}

/// Is the device on a line until `stop`, or until it [went away](LineDevice::is_gone) for good. What was sent by then is drained before it returns, unless the host
/// reads nothing for a second.
///
/// # Errors
/// When the line or the log fails.
pub fn serve(
    line: &mut dyn Line,
    device: &mut dyn LineDevice,
    options: ServeOptions,
    stop: &AtomicBool,
) -> Result<SentLog, LineError> {
    // A device's timer is not 50 us late, as a thread's sleep may be; where the kernel refuses, it is.
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
    if options.log.is_some() {
        device.keep_frame_log();
    }
    let mut server = Server {
        line,
        device,
        pace: None,
        baud: options.baud,
        batch: options.batch.map(|batch| Batch::new(batch.as_nanos() as u64, host_ns())),
        log: options.log,
        open_again_ns: 0,
        plugged: true,
    };
    server.log_line(server.device.log_header())?;
    server.run(options.once, stop)?;
    server.drain()?;
    server.device.close();
    server.log_frames()?;
    if let Some(log) = &mut server.log {
        log.flush().map_err(LineError::Log)?;
    }
    Ok(device.log())
}

/// The system's monotonic clock: the one that a host on the same machine reads, too.
fn host_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

struct Server<'a> {
    line: &'a mut dyn Line,
    device: &'a mut dyn LineDevice,
    pace: Option<Pace>,
    batch: Option<Batch>,
    /// What the line carries at most; a device may run its own end slower.
    baud: Option<u32>,
    log: Option<Box<dyn Write + Send>>,
    open_again_ns: u64,
    /// The cable is in.
    plugged: bool,
}

/// What a turn of writing came to.
enum Written {
    All,
    /// The line takes more at that time.
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
        while !stop.load(Ordering::Relaxed) {
            let now_ns = host_ns();
            self.tick(now_ns);
            let wake_ns = self.device.poll(now_ns);
            self.follow_cable()?;
            let (sleep, is_full) = match self.write()? {
                Written::All => (NAP, false),
                Written::Until(at_ns) => {
                    (Duration::from_nanos(at_ns.saturating_sub(host_ns())), false)
                }
                Written::Full => (FULL, true),
            };
            self.log_frames()?;
            // A host's first Stop ends nothing: there was no run yet.
            let has_ended = self.device.has_ended() && self.device.log().starts > 0;
            let is_over = self.device.is_gone() || (once && has_ended);
            if is_over && self.device.pending().is_empty() {
                return Ok(());
            }
            let until_wake = Duration::from_nanos(wake_ns.saturating_sub(host_ns()));
            let nap = sleep.min(until_wake).min(NAP);
            let heard = if is_full { self.line.wait_for_room(nap) } else { self.line.wait(nap) };
            if heard.map_err(self.failed("waiting"))? {
                self.read()?;
            }
            self.admit()?;
        }
        Ok(())
    }

    /// Pulls the line out or puts it in, when the device says so.
    fn follow_cable(&mut self) -> Result<(), LineError> {
        let plugged = self.device.is_plugged();
        if plugged == self.plugged {
            return Ok(());
        }
        self.plugged = plugged;
        if plugged {
            return self.line.plug_in().map_err(self.failed("plugging in"));
        }
        // What left the device has reached the host: the log knows no third.
        let mut drain = Drain::default();
        loop {
            let unread = self.line.unread().map_err(self.failed("counting bytes"))?;
            if drain.is_over(unread, host_ns()) {
                return self.line.unplug().map_err(self.failed("unplugging"));
            }
            std::thread::sleep(LOOK);
        }
    }

    /// What the device says from now on waits for the next batch.
    fn tick(&mut self, now_ns: u64) {
        let waiting = self.device.pending().len();
        if let Some(batch) = &mut self.batch {
            batch.tick(now_ns, waiting);
        }
    }

    /// Writes what the line takes now.
    fn write(&mut self) -> Result<Written, LineError> {
        let baud = self.device.baud().into_iter().chain(self.baud).min();
        if baud != self.pace.as_ref().map(Pace::baud) {
            self.pace = baud.map(Pace::new);
        }
        loop {
            let now_ns = host_ns();
            let pending = self.device.pending();
            if pending.is_empty() {
                return Ok(Written::All);
            }
            let mut allowed = self.pace.as_mut().map_or(usize::MAX, |pace| pace.allowed(now_ns));
            if let Some(batch) = &mut self.batch {
                batch.tick(now_ns, pending.len());
                if batch.released == 0 {
                    return Ok(Written::Until(batch.next_ns));
                }
                allowed = allowed.min(batch.released);
            }
            let Some(bytes) = pending.get(..allowed.min(pending.len())).filter(|b| !b.is_empty())
            else {
                return Ok(Written::Until(self.pace.as_ref().map_or(now_ns, Pace::next_ns)));
            };
            let n = self.line.write(bytes).map_err(self.failed("writing"))?;
            if n == 0 {
                return Ok(Written::Full);
            }
            self.device.sent(n);
            if let Some(batch) = &mut self.batch {
                batch.sent(n);
            }
            if let Some(pace) = &mut self.pace {
                pace.sent(n);
                let rest = !self.device.pending().is_empty();
                return Ok(if rest { Written::Until(pace.next_ns()) } else { Written::All });
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

    /// Ten times a second: a new host may open the line after one that was killed, and the log is on disk.
    fn admit(&mut self) -> Result<(), LineError> {
        let now_ns = host_ns();
        if now_ns >= self.open_again_ns {
            self.open_again_ns = now_ns + 100_000_000;
            self.line.tend().map_err(self.failed("tending"))?;
            self.log.as_mut().map_or(Ok(()), Write::flush).map_err(LineError::Log)?;
        }
        Ok(())
    }

    fn drain(&mut self) -> Result<(), LineError> {
        let mut drain = Drain::default();
        loop {
            self.write()?;
            let unread = self.line.unread().map_err(self.failed("counting bytes"))?;
            let left = self.device.pending().len() as u64 + unread;
            if drain.is_over(left, host_ns()) {
                return Ok(());
            }
            std::thread::sleep(LOOK);
        }
    }

    fn log_line(&mut self, text: &str) -> Result<(), LineError> {
        self.log.as_mut().map_or(Ok(()), |log| writeln!(log, "{text}")).map_err(LineError::Log)
    }

    fn log_frames(&mut self) -> Result<(), LineError> {
        if self.log.is_some() {
            for line in self.device.take_log_lines() {
                self.log_line(&line)?;
            }
        }
        Ok(())
    }
}

/// How long the host may read nothing before it counts as gone.
const PATIENCE_NS: u64 = 1_000_000_000;

/// Between two looks.
const LOOK: Duration = Duration::from_millis(5);

/// Watches the bytes that are left for the host.
#[derive(Debug, Default)]
struct Drain {
    left: Option<u64>,
    progress_ns: u64,
    empty_looks: u32,
}

impl Drain {
    /// `left` are all bytes between the device and the host. `true` when it is time to hang up.
    fn is_over(&mut self, left: u64, now_ns: u64) -> bool {
        if self.left != Some(left) {
            self.left = Some(left);
            self.progress_ns = now_ns;
        }
        // The kernel hands bytes from one buffer to the next on its own time, and counts only the last one:
        // nothing must be there for some looks running.
        self.empty_looks = if left == 0 { self.empty_looks + 1 } else { 0 };
        self.empty_looks > 4 || now_ns.saturating_sub(self.progress_ns) > PATIENCE_NS
    }
}
