//! The resampler threads. A group of channels is an object held by one worker at a time. Its ownership moves through
//! channels: there is no lock, and no worker waits for a group.
//!
//! A group is woken when a stretch closes and when one of its buffers returns. The worker that receives the wake-up
//! takes the group from its place, does all its jobs and puts it back. A worker that finds the place empty leaves the
//! jobs to the group's holder, which checks for more after putting it back.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::{
    Counts, PipelineProgress,
    group::Group,
    messages::{EncodeJob, PartBuffer, StretchEnd},
    plan::Plan,
};
use crate::{
    heartbeat::{Heartbeat, HeartbeatHandle, ThreadRole},
    threads,
};

/// The place where a group waits for work.
#[derive(Debug)]
struct ParkedGroup {
    park: Sender<Group>,
    unpark: Receiver<Group>,
    jobs: Receiver<EncodeJob>,
    buffers: Receiver<PartBuffer>,
    /// Whether a wake-up for this group is queued.
    woken: AtomicBool,
}

impl ParkedGroup {
    fn has_work(&self) -> bool {
        !self.jobs.is_empty() && !self.buffers.is_empty()
    }
}

/// Wakes groups. At most one wake-up per group is queued, so the queue needs one place per group.
#[derive(Debug, Clone)]
pub(super) struct WakeQueue {
    parked: Arc<[ParkedGroup]>,
    queue: Sender<Option<usize>>,
}

impl WakeQueue {
    pub(super) fn wake(&self, group: usize) {
        if !self.parked[group].woken.swap(true, Ordering::AcqRel) {
            // Disconnected only after the workers have stopped.
            self.queue.try_send(Some(group)).ok();
        }
    }
}

/// Sends the reader's jobs to the pool.
#[derive(Debug)]
pub(super) struct Feed {
    /// One sender per group; the last is the timeline's.
    jobs: Vec<Sender<EncodeJob>>,
    wakes: WakeQueue,
    plan: Plan,
    next_stretch: u64,
}

impl Feed {
    /// Number of the open stretch.
    pub(super) fn next_stretch(&self) -> u64 {
        self.next_stretch
    }

    /// Sends a job to every group with active channels and to the timeline's. Returns `false` when a queue was full,
    /// which its bound rules out while the workers live.
    pub(super) fn end_stretch(&mut self, end: StretchEnd, counts: Counts) -> bool {
        let stretch = self.next_stretch;
        self.next_stretch += 1;
        let timeline = self.jobs.len() - 1;
        let active = self.plan.groups_of(end.n_channels);
        let mut all_sent = true;
        for group in (0..active).chain([timeline]) {
            let counts = (group == timeline).then_some(counts);
            all_sent &= self.jobs[group].try_send(EncodeJob { stretch, end, counts }).is_ok();
            self.wakes.wake(group);
        }
        all_sent
    }
}

/// The worker threads.
#[derive(Debug)]
pub(super) struct Pool {
    workers: Vec<JoinHandle<()>>,
    wakes: WakeQueue,
}

impl Pool {
    pub(super) fn start(
        plan: &Plan,
        groups: Vec<Group>,
        progress: &Arc<PipelineProgress>,
        heartbeat: &Heartbeat,
    ) -> anyhow::Result<(Self, Feed)> {
        let n_groups = groups.len();
        let mut jobs = Vec::with_capacity(n_groups);
        let mut parked = Vec::with_capacity(n_groups);
        for group in groups {
            jobs.push(group.jobs_in.clone());
            let (waiting, buffers) = (group.jobs.clone(), group.buffers.clone());
            let (park, unpark) = bounded(1);
            drop(park.send(group));
            let woken = AtomicBool::new(false);
            parked.push(ParkedGroup { park, unpark, jobs: waiting, buffers, woken });
        }
        // One wake-up per group, and one stop per worker.
        let (queue, wakes_out) = bounded(n_groups + plan.workers);
        let wakes = WakeQueue { parked: parked.into(), queue };
        let mut workers = Vec::with_capacity(plan.workers);
        for index in 0..plan.workers {
            let (parked, queue) = (Arc::clone(&wakes.parked), wakes_out.clone());
            let guard = FailOnPanic(Arc::clone(progress));
            let worker_heartbeat = heartbeat.register(ThreadRole::Worker)?;
            workers.push(threads::spawn(&format!("mocapd-work-{index}"), move || {
                run_worker(&parked, &queue, &worker_heartbeat);
                drop(guard);
            })?);
        }
        let feed = Feed { jobs, wakes: wakes.clone(), plan: plan.clone(), next_stretch: 0 };
        Ok((Self { workers, wakes }, feed))
    }

    pub(super) fn wakes(&self) -> WakeQueue {
        self.wakes.clone()
    }

    /// Ends the workers after the jobs that are queued.
    pub(super) fn stop(self) {
        for _ in &self.workers {
            self.wakes.queue.send(None).ok();
        }
        for worker in self.workers {
            // A panic was already reported through `PipelineProgress::failed`.
            drop(worker.join());
        }
    }
}

fn run_worker(
    parked: &[ParkedGroup],
    queue: &Receiver<Option<usize>>,
    heartbeat: &HeartbeatHandle,
) {
    let next = || {
        heartbeat.idle();
        queue.recv()
    };
    while let Ok(Some(index)) = next() {
        let place = &parked[index];
        // A swap, not a store: a thread that found the flag set had sent its job before, and that job must be
        // visible below. A plain store could move past the check of the jobs, and the wake-up would be lost.
        place.woken.swap(false, Ordering::AcqRel);
        while let Ok(mut group) = place.unpark.try_recv() {
            group.run_jobs(heartbeat);
            drop(place.park.try_send(group));
            if !place.has_work() {
                break;
            }
        }
    }
}

/// Marks the pipeline as failed when a thread panics: a panicking worker loses its group, a panicking writer loses
/// the file, so the recording must stop.
#[derive(Debug)]
pub(super) struct FailOnPanic(pub(super) Arc<PipelineProgress>);

impl Drop for FailOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Relaxed);
        }
    }
}
