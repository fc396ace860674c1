//! The resampler threads. A group of channels is an object that one worker at a time holds: ownership
//! is handed on through channels, so nothing is locked and nobody waits for a group.
//!
//! A group is woken when a stretch closes and when one of its buffers comes back. Whoever takes the
//! wake picks the group up from its station, works off all it can, and puts it back; whoever finds the
//! station empty leaves it to the holder, who looks again after putting it back.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::{
    Counts, Progress,
    group::Group,
    messages::{Job, StretchEnd},
    plan::Plan,
};
use crate::{
    heartbeat::{Beat, Heartbeat, Who},
    threads,
};

/// Where a group waits for work.
#[derive(Debug)]
struct Station {
    park: Sender<Group>,
    unpark: Receiver<Group>,
    jobs: Receiver<Job>,
    buffers: Receiver<Vec<u8>>,
    /// A wake for this group is in the queue.
    woken: AtomicBool,
}

impl Station {
    fn has_work(&self) -> bool {
        !self.jobs.is_empty() && !self.buffers.is_empty()
    }
}

/// Wakes groups. At most one wake a group is queued, so the queue has room for one a group.
#[derive(Debug, Clone)]
pub(super) struct Wakes {
    stations: Arc<[Station]>,
    queue: Sender<Option<usize>>,
}

impl Wakes {
    pub(super) fn wake(&self, group: usize) {
        if !self.stations[group].woken.swap(true, Ordering::AcqRel) {
            // Disconnected only after the workers were stopped, when nobody needs waking.
            self.queue.try_send(Some(group)).ok();
        }
    }
}

/// The reader's way to the pool.
#[derive(Debug)]
pub(super) struct Feed {
    /// One a group; the last is the time line's.
    jobs: Vec<Sender<Job>>,
    wakes: Wakes,
    plan: Plan,
    next_stretch: u64,
}

impl Feed {
    /// Number of the stretch that is open.
    pub(super) fn next_stretch(&self) -> u64 {
        self.next_stretch
    }

    /// Tells every group with active channels, and the time line's. `false` when a queue was full,
    /// which its bound rules out while the workers live.
    pub(super) fn end_stretch(&mut self, end: StretchEnd, counts: Counts) -> bool {
        let stretch = self.next_stretch;
        self.next_stretch += 1;
        let timeline = self.jobs.len() - 1;
        let active = self.plan.groups_of(end.n_channels);
        let mut all_sent = true;
        for group in (0..active).chain([timeline]) {
            let counts = (group == timeline).then_some(counts);
            all_sent &= self.jobs[group].try_send(Job { stretch, end, counts }).is_ok();
            self.wakes.wake(group);
        }
        all_sent
    }
}

/// The threads.
#[derive(Debug)]
pub(super) struct Pool {
    workers: Vec<JoinHandle<()>>,
    wakes: Wakes,
}

impl Pool {
    pub(super) fn start(
        plan: &Plan,
        groups: Vec<Group>,
        progress: &Arc<Progress>,
        heartbeat: &Heartbeat,
    ) -> anyhow::Result<(Self, Feed)> {
        let n_groups = groups.len();
        let mut jobs = Vec::with_capacity(n_groups);
        let mut stations = Vec::with_capacity(n_groups);
        for group in groups {
            jobs.push(group.jobs_in.clone());
            let (waiting, buffers) = (group.jobs.clone(), group.buffers.clone());
            let (park, unpark) = bounded(1);
            drop(park.send(group));
            let woken = AtomicBool::new(false);
            stations.push(Station { park, unpark, jobs: waiting, buffers, woken });
        }
        // One wake a group, and one stop a worker.
        let (queue, wakes_out) = bounded(n_groups + plan.workers);
        let wakes = Wakes { stations: stations.into(), queue };
        let mut workers = Vec::with_capacity(plan.workers);
        for index in 0..plan.workers {
            let (stations, queue) = (Arc::clone(&wakes.stations), wakes_out.clone());
            let guard = FailOnPanic(Arc::clone(progress));
            let beat = heartbeat.beat(Who::Worker)?;
            workers.push(threads::spawn(&format!("mocapd-work-{index}"), move || {
                work(&stations, &queue, &beat);
                drop(guard);
            })?);
        }
        let feed = Feed { jobs, wakes: wakes.clone(), plan: plan.clone(), next_stretch: 0 };
        Ok((Self { workers, wakes }, feed))
    }

    pub(super) fn wakes(&self) -> Wakes {
        self.wakes.clone()
    }

    /// Ends the workers. What they were told before is done first.
    pub(super) fn stop(self) {
        for _ in &self.workers {
            self.wakes.queue.send(None).ok();
        }
        for worker in self.workers {
            // A panic was already seen through `Progress::failed`.
            drop(worker.join());
        }
    }
}

fn work(stations: &[Station], queue: &Receiver<Option<usize>>, beat: &Beat) {
    let next = || {
        beat.idle();
        queue.recv()
    };
    while let Ok(Some(index)) = next() {
        let station = &stations[index];
        // A swap and not a store: whoever found the flag still set sent its job before, and the group
        // below must see that job. A store could pass the look at the jobs, and the wake would be lost.
        station.woken.swap(false, Ordering::AcqRel);
        while let Ok(mut group) = station.unpark.try_recv() {
            group.work_off(beat);
            drop(station.park.try_send(group));
            if !station.has_work() {
                break;
            }
        }
    }
}

/// A worker that panics took a group with it, a writer the file: the recording cannot go on as if nothing
/// happened.
#[derive(Debug)]
pub(super) struct FailOnPanic(pub(super) Arc<Progress>);

impl Drop for FailOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Relaxed);
        }
    }
}
