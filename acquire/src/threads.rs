//! Named threads, stop signals, and panics turned into errors; and heartbeats of the data plane's threads, with a watchdog
//! that finds the thread that hangs.
//!
//! A heartbeat is one relaxed store of an atomic number: no lock, no clock, no allocation. Only the watchdog reads a
//! clock.

use std::{
    convert::Infallible,
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU8, AtomicU64, Ordering},
    },
    thread::{Builder, JoinHandle, scope},
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow, bail};
use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded};

/// A resampler thread panicked: a bug in mocapd.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a resampler thread failed")]
pub struct ResamplerFailed;

/// Stops threads when it is dropped.
#[derive(Debug)]
pub struct StopSender(
    #[expect(dead_code, reason = "that it is gone is the message")] Sender<Infallible>,
);

/// Reports that its [`StopSender`] was dropped.
#[derive(Debug, Clone)]
pub struct StopReceiver(Receiver<Infallible>);

/// A stop signal that threads can select on together with other channels.
#[must_use]
pub fn stop_channel() -> (StopSender, StopReceiver) {
    let (stopper, stopped) = bounded(0);
    (StopSender(stopper), StopReceiver(stopped))
}

impl StopReceiver {
    /// Whether to stop.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.0.try_recv() == Err(TryRecvError::Disconnected)
    }

    /// A channel to select on: it carries no message and is closed when it is time to stop.
    #[must_use]
    pub fn channel(&self) -> &Receiver<Infallible> {
        &self.0
    }
}

/// Starts a named thread.
///
/// # Errors
/// When the system refuses it.
pub fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<JoinHandle<T>> {
    let thread = Builder::new().name(name.to_owned()).spawn(work);
    thread.with_context(|| format!("cannot start the thread {name}"))
}

/// Runs `work` on a named thread and `meanwhile` on this one, and returns when both are done. When the system refuses a
/// thread, they run one after the other.
pub fn run_alongside(name: &str, work: impl FnOnce() + Send + Copy, meanwhile: impl FnOnce()) {
    scope(|scope| {
        if Builder::new().name(name.to_owned()).spawn_scoped(scope, work).is_err() {
            work();
        }
        meanwhile();
    });
}

/// Waits for a thread to finish.
///
/// # Errors
/// When it panicked.
pub fn join<T>(handle: JoinHandle<T>) -> anyhow::Result<T> {
    let name = handle.thread().name().unwrap_or("?").to_owned();
    handle.join().map_err(|_| anyhow!("the thread {name} panicked: please report this bug"))
}

/// The default number of worker threads: one per core, at most eight, since one core resamples
/// more than any bus carries.
#[must_use]
pub fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(8)
}

/// Threads that can register. A recording has a reader, a writer and at most eight workers; there is room for a second
/// recording that is just ending, and for the service's own threads.
const THREADS_MAX: usize = 64;

/// Time that the writer may spend in one disk operation. Coded stretches wait in memory while a disk stalls for 32 s;
/// beyond that the ledger counts the loss, and a restart would not repair the disk. After twice that time the writer
/// counts as hung.
const DISK_TIMEOUT: Duration = Duration::from_secs(64);

/// What a registered thread does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ThreadRole {
    /// Decides what the service does.
    Supervisor = 1,
    /// Reads the device.
    Reader = 2,
    /// Resamples.
    Worker = 3,
    /// Writes the take.
    Writer = 4,
}

impl ThreadRole {
    fn of(number: u8) -> Option<Self> {
        let all = [Self::Supervisor, Self::Reader, Self::Worker, Self::Writer];
        all.into_iter().find(|&role| role as u8 == number)
    }
}

impl fmt::Display for ThreadRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Supervisor => "supervisor",
            Self::Reader => "reader",
            Self::Worker => "worker",
            Self::Writer => "writer",
        })
    }
}

/// What a thread is busy with, which decides how long it may stay silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Activity {
    Working = 0,
    Idle = 1,
    AtDisk = 2,
}

/// The heartbeat of one thread.
#[derive(Debug, Default)]
struct HeartbeatSlot {
    /// The thread's role as a number; 0: the slot is free.
    owner: AtomicU8,
    /// Number of heartbeats times four, plus the activity. Continues when another thread takes the slot.
    pulse: AtomicU64,
}

/// The registry of heartbeats. Clones share it.
#[derive(Debug, Clone)]
pub struct Heartbeat {
    slots: Arc<[HeartbeatSlot]>,
}

impl Default for Heartbeat {
    fn default() -> Self {
        Self { slots: (0..THREADS_MAX).map(|_| HeartbeatSlot::default()).collect() }
    }
}

impl Heartbeat {
    /// Registers a thread of this role. It counts as working from now on; dropping the handle removes it.
    ///
    /// # Errors
    /// When more threads register than there are slots.
    pub fn register(&self, role: ThreadRole) -> anyhow::Result<HeartbeatHandle> {
        for (index, slot) in self.slots.iter().enumerate() {
            let claim =
                slot.owner.compare_exchange(0, role as u8, Ordering::AcqRel, Ordering::Relaxed);
            if claim.is_ok() {
                let beat = HeartbeatHandle { slots: Arc::clone(&self.slots), index };
                beat.set(Activity::Working);
                return Ok(beat);
            }
        }
        bail!("cannot watch more than {THREADS_MAX} threads: use fewer workers");
    }

    /// A watchdog over all registered threads.
    #[must_use]
    pub fn watchdog(&self, now: Instant) -> Watchdog {
        Watchdog { slots: Arc::clone(&self.slots), seen: vec![(0, now); THREADS_MAX] }
    }
}

/// One thread's handle on its heartbeat.
#[derive(Debug)]
pub struct HeartbeatHandle {
    slots: Arc<[HeartbeatSlot]>,
    index: usize,
}

impl HeartbeatHandle {
    /// The thread is working and will report again soon.
    pub fn beat(&self) {
        self.set(Activity::Working);
        #[cfg(feature = "fault-hooks")]
        fault_hooks::hang_if_requested(self.role());
    }

    /// The thread waits for work, and may do so for any time.
    pub fn idle(&self) {
        self.set(Activity::Idle);
    }

    /// The thread writes or syncs, which can take as long as a disk stalls.
    pub fn at_disk(&self) {
        self.set(Activity::AtDisk);
    }

    fn set(&self, activity: Activity) {
        // This thread alone stores here.
        let pulse = &self.slots[self.index].pulse;
        let count = (pulse.load(Ordering::Relaxed) >> 2).wrapping_add(1);
        pulse.store(count << 2 | activity as u64, Ordering::Relaxed);
    }

    #[cfg(feature = "fault-hooks")]
    fn role(&self) -> Option<ThreadRole> {
        ThreadRole::of(self.slots[self.index].owner.load(Ordering::Relaxed))
    }
}

impl Drop for HeartbeatHandle {
    fn drop(&mut self) {
        self.slots[self.index].owner.store(0, Ordering::Release);
    }
}

/// A thread that has been silent for too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HungThread {
    /// The thread's role.
    pub role: ThreadRole,
    /// Time since its last heartbeat.
    pub silent_for: Duration,
}

impl fmt::Display for HungThread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the {} has been stuck for {:.1} s", self.role, self.silent_for.as_secs_f64())
    }
}

/// Finds silent threads. It sees only changes between two calls, so it must be called more often than the limit.
#[derive(Debug)]
pub struct Watchdog {
    slots: Arc<[HeartbeatSlot]>,
    /// For each slot, the last heartbeat and the time at which it changed.
    seen: Vec<(u64, Instant)>,
}

impl Watchdog {
    /// The thread that has been silent longest, of those that exceed their limit: `limit`, or more for a thread at the
    /// disk.
    pub fn overdue(&mut self, now: Instant, limit: Duration) -> Option<HungThread> {
        let mut worst: Option<HungThread> = None;
        for (slot, seen) in self.slots.iter().zip(&mut self.seen) {
            let pulse = slot.pulse.load(Ordering::Relaxed);
            let role = ThreadRole::of(slot.owner.load(Ordering::Acquire));
            let state = pulse & 3;
            if role.is_none() || state == Activity::Idle as u64 || pulse != seen.0 {
                *seen = (pulse, now);
                continue;
            }
            let is_at_disk = state == Activity::AtDisk as u64;
            let allowed = if is_at_disk { limit.max(DISK_TIMEOUT) } else { limit };
            let silent_for = now.saturating_duration_since(seen.1);
            if let Some(role) = role
                && silent_for > allowed
                && worst.is_none_or(|worst| worst.silent_for < silent_for)
            {
                worst = Some(HungThread { role, silent_for });
            }
        }
        worst
    }
}

/// Makes threads hang on command, to test the watchdog and stalls: SIGUSR2 hangs them, SIGUSR1 resumes them. Does nothing
/// without the feature `fault-hooks`, which no installed program has.
///
/// # Errors
/// When the system refuses a signal handler.
pub fn install_fault_hooks() -> anyhow::Result<()> {
    #[cfg(feature = "fault-hooks")]
    fault_hooks::install()?;
    Ok(())
}

#[cfg(feature = "fault-hooks")]
mod fault_hooks {
    //! SIGUSR2 hangs the thread named in `MOCAPD_HANG` (`reader`, `worker` or `writer`), or all of them when that is
    //! not set. SIGUSR1 resumes them.

    use std::{
        sync::{
            Arc, OnceLock,
            atomic::{AtomicUsize, Ordering},
        },
        time::Duration,
    };

    use anyhow::Context;
    use signal_hook::{
        consts::{SIGUSR1, SIGUSR2},
        flag::register_usize,
    };

    use super::ThreadRole;

    /// How often a hung thread checks for SIGUSR1.
    const POLL_INTERVAL: Duration = Duration::from_millis(20);

    static HANGS: OnceLock<Arc<AtomicUsize>> = OnceLock::new();
    static TARGET: OnceLock<String> = OnceLock::new();

    /// Installs the handlers of both signals.
    pub(super) fn install() -> anyhow::Result<()> {
        TARGET.get_or_init(|| std::env::var("MOCAPD_HANG").unwrap_or_default());
        for (signal, hangs) in [(SIGUSR2, 1), (SIGUSR1, 0)] {
            let flag = Arc::clone(HANGS.get_or_init(Arc::default));
            register_usize(signal, flag, hangs).context("cannot install a signal handler")?;
        }
        Ok(())
    }

    pub(super) fn hang_if_requested(role: Option<ThreadRole>) {
        let hangs = || HANGS.get().is_some_and(|hangs| hangs.load(Ordering::Relaxed) != 0);
        let is_targeted = |role: ThreadRole| {
            let target = TARGET.get().map_or("", String::as_str);
            role != ThreadRole::Supervisor && (target.is_empty() || target == role.to_string())
        };
        while hangs() && role.is_some_and(is_targeted) {
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_secs(10);

    fn after(start: Instant, s: u64) -> Instant {
        start + Duration::from_secs(s)
    }

    #[test]
    fn a_silent_thread_is_overdue_until_it_moves_again() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watchdog(start);
        let reader = heartbeat.register(ThreadRole::Reader).unwrap();
        let worker = heartbeat.register(ThreadRole::Worker).unwrap();
        for s in 1..8 {
            worker.beat();
            reader.beat();
            assert_eq!(watch.overdue(after(start, s), LIMIT), None);
        }
        for s in 8..18 {
            worker.beat();
            assert_eq!(watch.overdue(after(start, s), LIMIT), None, "{s}");
        }
        worker.beat();
        let overdue = watch.overdue(after(start, 18), LIMIT).unwrap();
        assert_eq!(
            overdue,
            HungThread { role: ThreadRole::Reader, silent_for: Duration::from_secs(11) }
        );
        let text = overdue.to_string();
        assert!(
            text.contains(&ThreadRole::Reader.to_string()) && text.contains("11.0 s"),
            "{text}"
        );
        reader.beat();
        assert_eq!(watch.overdue(after(start, 19), LIMIT), None);
    }

    #[test]
    fn a_thread_may_be_silent_while_idle_and_for_a_while_at_the_disk() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watchdog(start);
        let worker = heartbeat.register(ThreadRole::Worker).unwrap();
        let writer = heartbeat.register(ThreadRole::Writer).unwrap();
        worker.idle();
        writer.at_disk();
        assert_eq!(watch.overdue(start, LIMIT), None);
        assert_eq!(watch.overdue(after(start, 64), LIMIT), None);
        let hung = watch.overdue(after(start, 65), LIMIT).unwrap();
        assert_eq!(hung.role, ThreadRole::Writer);
        // A thread that works again is watched from then on.
        writer.beat();
        worker.beat();
        assert_eq!(watch.overdue(after(start, 70), LIMIT), None);
        assert!(watch.overdue(after(start, 81), LIMIT).is_some());
    }

    #[test]
    fn the_slot_of_an_ended_thread_is_reused() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watchdog(start);
        for take in 0..1000 {
            let beats: Vec<_> =
                (0..10).map(|_| heartbeat.register(ThreadRole::Worker).unwrap()).collect();
            assert_eq!(watch.overdue(after(start, 60 * take), LIMIT), None);
            drop(beats);
        }
        assert_eq!(watch.overdue(after(start, 100_000), LIMIT), None);
        let all: Vec<_> =
            (0..THREADS_MAX).map(|_| heartbeat.register(ThreadRole::Worker)).collect();
        assert!(all.iter().all(Result::is_ok));
        let full = heartbeat.register(ThreadRole::Reader).unwrap_err().to_string();
        assert!(full.contains(&THREADS_MAX.to_string()), "{full}");
    }
}
