//! Signs of life: every thread of the data plane says that it moved, and one that says nothing for too long has hung.
//!
//! A thread's sign is a store of one atomic number: no lock, no clock, no allocation. Who looks reads the clock.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU8, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::bail;

/// A recording has a reader, a writer and at most eight workers; a second one that ends meanwhile, and the service's
/// own threads, fit beside it.
const BEATS_MAX: usize = 64;

/// Coded stretches wait in memory while a disk stalls for 32 s, and what a longer stall costs stands on the ledger: a
/// restart mends no disk. After twice that the writer counts as hung all the same.
const DISK_PATIENCE: Duration = Duration::from_secs(64);

/// Whose sign it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Who {
    /// The thread that decides what the service does.
    Supervisor = 1,
    /// Reads the device.
    Reader = 2,
    /// Resamples.
    Worker = 3,
    /// Writes the take.
    Writer = 4,
}

impl Who {
    fn of(number: u8) -> Option<Self> {
        [Self::Supervisor, Self::Reader, Self::Worker, Self::Writer]
            .into_iter()
            .find(|&who| who as u8 == number)
    }
}

impl fmt::Display for Who {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Supervisor => "supervisor",
            Self::Reader => "reader",
            Self::Worker => "worker",
            Self::Writer => "writer",
        })
    }
}

/// What a thread is at: how long it may say nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Working = 0,
    Idle = 1,
    AtDisk = 2,
}

/// Room for one sign.
#[derive(Debug, Default)]
struct Slot {
    /// 0: free.
    owner: AtomicU8,
    /// How often it moved, times four, and its state. Goes on where a slot changes hands.
    pulse: AtomicU64,
}

/// Where threads register. Clones are the same place.
#[derive(Debug, Clone)]
pub struct Heartbeat {
    slots: Arc<[Slot]>,
}

impl Default for Heartbeat {
    fn default() -> Self {
        Self { slots: (0..BEATS_MAX).map(|_| Slot::default()).collect() }
    }
}

impl Heartbeat {
    /// A sign for the thread that will hold it. It counts as working from now on, and is forgotten when dropped.
    ///
    /// # Errors
    /// When there are more threads than anybody starts.
    pub fn beat(&self, who: Who) -> anyhow::Result<Beat> {
        for (index, slot) in self.slots.iter().enumerate() {
            let claim =
                slot.owner.compare_exchange(0, who as u8, Ordering::AcqRel, Ordering::Relaxed);
            if claim.is_ok() {
                let beat = Beat { slots: Arc::clone(&self.slots), index };
                beat.say(State::Working);
                return Ok(beat);
            }
        }
        bail!("more than {BEATS_MAX} threads are to be watched: start fewer workers");
    }

    /// Whoever looks whether all of them move.
    #[must_use]
    pub fn watch(&self, now: Instant) -> Watch {
        Watch { slots: Arc::clone(&self.slots), seen: vec![(0, now); BEATS_MAX] }
    }
}

/// A thread's sign of life.
#[derive(Debug)]
pub struct Beat {
    slots: Arc<[Slot]>,
    index: usize,
}

impl Beat {
    /// It works, and will say so again soon.
    pub fn moved(&self) {
        self.say(State::Working);
        #[cfg(feature = "fault-hooks")]
        fault_hooks::hang_if_told(self.who());
    }

    /// It waits for work, for as long as there is none.
    pub fn idle(&self) {
        self.say(State::Idle);
    }

    /// It writes or syncs, which may take as long as a disk stalls.
    pub fn at_disk(&self) {
        self.say(State::AtDisk);
    }

    fn say(&self, state: State) {
        // Only the holder stores here.
        let pulse = &self.slots[self.index].pulse;
        let count = (pulse.load(Ordering::Relaxed) >> 2).wrapping_add(1);
        pulse.store(count << 2 | state as u64, Ordering::Relaxed);
    }

    #[cfg(feature = "fault-hooks")]
    fn who(&self) -> Option<Who> {
        Who::of(self.slots[self.index].owner.load(Ordering::Relaxed))
    }
}

impl Drop for Beat {
    fn drop(&mut self) {
        self.slots[self.index].owner.store(0, Ordering::Release);
    }
}

/// A thread that said nothing for too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Overdue {
    /// Whose thread.
    pub who: Who,
    /// Since when nobody has heard of it.
    pub silent_for: Duration,
}

impl fmt::Display for Overdue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the {} has not moved for {:.1} s", self.who, self.silent_for.as_secs_f64())
    }
}

/// Looks at the signs. Only changes between two looks are seen: look more often than the limit.
#[derive(Debug)]
pub struct Watch {
    slots: Arc<[Slot]>,
    /// Each slot's pulse as it was last, and when it was seen to change.
    seen: Vec<(u64, Instant)>,
}

impl Watch {
    /// The thread that is silent for longest among those that are so for longer than they may be: `limit`, and more
    /// where they are at the disk.
    pub fn overdue(&mut self, now: Instant, limit: Duration) -> Option<Overdue> {
        let mut worst: Option<Overdue> = None;
        for (slot, seen) in self.slots.iter().zip(&mut self.seen) {
            let pulse = slot.pulse.load(Ordering::Relaxed);
            let who = Who::of(slot.owner.load(Ordering::Acquire));
            let state = pulse & 3;
            if who.is_none() || state == State::Idle as u64 || pulse != seen.0 {
                *seen = (pulse, now);
                continue;
            }
            let patience = match state == State::AtDisk as u64 {
                true => limit.max(DISK_PATIENCE),
                false => limit,
            };
            let silent_for = now.saturating_duration_since(seen.1);
            if let Some(who) = who
                && silent_for > patience
                && worst.is_none_or(|worst| worst.silent_for < silent_for)
            {
                worst = Some(Overdue { who, silent_for });
            }
        }
        worst
    }
}

#[cfg(feature = "fault-hooks")]
pub mod fault_hooks {
    //! Threads that hang on command: for tests of the watchdog and of stalls, in builds with the feature `fault-hooks` alone.
    //!
    //! SIGUSR2 hangs the thread that `MOCAPD_HANG` names (`reader`, `worker` or `writer`), and every one of these when it
    //! names none. SIGUSR1 lets them go on.

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

    use super::Who;

    /// How soon a thread goes on after SIGUSR1.
    const LOOK_EVERY: Duration = Duration::from_millis(20);

    static HANGS: OnceLock<Arc<AtomicUsize>> = OnceLock::new();
    static WHOM: OnceLock<String> = OnceLock::new();

    /// Listens for both signals from now on.
    ///
    /// # Errors
    /// When the system lets nobody listen.
    pub fn install() -> anyhow::Result<()> {
        WHOM.get_or_init(|| std::env::var("MOCAPD_HANG").unwrap_or_default());
        for (signal, hangs) in [(SIGUSR2, 1), (SIGUSR1, 0)] {
            let flag = Arc::clone(HANGS.get_or_init(Arc::default));
            register_usize(signal, flag, hangs).context("cannot listen for signals")?;
        }
        Ok(())
    }

    pub(crate) fn hang_if_told(who: Option<Who>) {
        let hangs = || HANGS.get().is_some_and(|hangs| hangs.load(Ordering::Relaxed) != 0);
        let is_meant = |who: Who| {
            let whom = WHOM.get().map_or("", String::as_str);
            who != Who::Supervisor && (whom.is_empty() || whom == who.to_string())
        };
        while hangs() && who.is_some_and(is_meant) {
            std::thread::sleep(LOOK_EVERY);
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
    fn a_thread_that_stops_moving_is_named_and_forgiven_when_it_moves() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watch(start);
        let reader = heartbeat.beat(Who::Reader).unwrap();
        let worker = heartbeat.beat(Who::Worker).unwrap();
        for s in 1..8 {
            worker.moved();
            reader.moved();
            assert_eq!(watch.overdue(after(start, s), LIMIT), None);
        }
        for s in 8..18 {
            worker.moved();
            assert_eq!(watch.overdue(after(start, s), LIMIT), None, "{s}");
        }
        worker.moved();
        let overdue = watch.overdue(after(start, 18), LIMIT).unwrap();
        assert_eq!(overdue, Overdue { who: Who::Reader, silent_for: Duration::from_secs(11) });
        let said = overdue.to_string();
        assert!(said.contains(&Who::Reader.to_string()) && said.contains("11.0 s"), "{said}");
        reader.moved();
        assert_eq!(watch.overdue(after(start, 19), LIMIT), None);
    }

    #[test]
    fn who_waits_for_work_may_be_silent_and_who_is_at_the_disk_for_a_while() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watch(start);
        let worker = heartbeat.beat(Who::Worker).unwrap();
        let writer = heartbeat.beat(Who::Writer).unwrap();
        worker.idle();
        writer.at_disk();
        assert_eq!(watch.overdue(start, LIMIT), None);
        assert_eq!(watch.overdue(after(start, 64), LIMIT), None);
        let hung = watch.overdue(after(start, 65), LIMIT).unwrap();
        assert_eq!(hung.who, Who::Writer);
        // Work that comes is looked at from then on.
        writer.moved();
        worker.moved();
        assert_eq!(watch.overdue(after(start, 70), LIMIT), None);
        assert!(watch.overdue(after(start, 81), LIMIT).is_some());
    }

    #[test]
    fn a_thread_that_ends_is_forgotten_and_its_place_is_used_again() {
        let (heartbeat, start) = (Heartbeat::default(), Instant::now());
        let mut watch = heartbeat.watch(start);
        for take in 0..1000 {
            let beats: Vec<_> = (0..10).map(|_| heartbeat.beat(Who::Worker).unwrap()).collect();
            assert_eq!(watch.overdue(after(start, 60 * take), LIMIT), None);
            drop(beats);
        }
        assert_eq!(watch.overdue(after(start, 100_000), LIMIT), None);
        let all: Vec<_> = (0..BEATS_MAX).map(|_| heartbeat.beat(Who::Worker)).collect();
        assert!(all.iter().all(Result::is_ok));
        let full = heartbeat.beat(Who::Reader).unwrap_err().to_string();
        assert!(full.contains(&BEATS_MAX.to_string()), "{full}");
    }
}
