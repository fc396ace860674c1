//! Queues for work that blocks, with a limited number of threads and waiting requests; further requests are rejected.

use std::{sync::Arc, time::Duration};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::body::Problem;

/// Commands executed at once: a start, a stop, a mark and one more.
const COMMANDS: Size = Size { running: 4, waiting: 16 };

/// File operations at once: listings and chunks of downloads. One disk serves two about as fast as four.
const FILES: Size = Size { running: 2, waiting: 32 };

/// Verifications at once: each keeps a core busy until it is done.
const CHECKS: Size = Size { running: 1, waiting: 0 };

/// Windows of takes decoded at once: one core of a machine that records. A few players with one or two requests each may
/// wait.
const DECODES: Size = Size { running: 1, waiting: 5 };

/// Takes written in another format at once. Each waits while its client is slow, so one slow client alone does not hold up
/// the next.
const EXPORTS: Size = Size { running: 2, waiting: 4 };

/// Threads that a listener's runtime may have for all queues.
pub(super) const THREADS: usize =
    COMMANDS.running + FILES.running + CHECKS.running + DECODES.running + EXPORTS.running;

/// Requests that can be running or waiting at once; all others are replied to immediately.
/// Conversions are downloads, which have a limit of their own.
pub(super) const REQUESTS_MAX: usize = COMMANDS.all() + FILES.all() + CHECKS.all() + DECODES.all();

#[derive(Debug, Clone, Copy)]
struct Size {
    running: usize,
    waiting: usize,
}

impl Size {
    const fn all(self) -> usize {
        self.running + self.waiting
    }
}

/// The queues of one listener. A full queue blocks neither the other queues nor those of the other listener.
#[derive(Debug)]
pub(super) struct WorkQueues {
    /// Commands that change something.
    pub(super) commands: WorkQueue,
    /// Reads files and folders.
    pub(super) files: WorkQueue,
    /// Verifies takes.
    pub(super) checks: WorkQueue,
    /// Decodes parts of takes.
    pub(super) decodes: WorkQueue,
    /// Writes takes in other formats.
    pub(super) exports: WorkQueue,
}

impl WorkQueues {
    pub(super) fn new(work_max: Duration) -> Self {
        let work_max = Some(work_max);
        Self {
            commands: WorkQueue::new("too many requests are being executed", COMMANDS, work_max),
            files: WorkQueue::new("too many files are being read", FILES, work_max),
            checks: WorkQueue::new("another take is being verified", CHECKS, None),
            decodes: WorkQueue::new("too many players are reading takes", DECODES, None),
            exports: WorkQueue::new("too many takes are being converted", EXPORTS, None),
        }
    }
}

/// A queue for one kind of work.
#[derive(Debug)]
pub(super) struct WorkQueue {
    busy_with: &'static str,
    slots: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    time_max: Option<Duration>,
}

impl WorkQueue {
    fn new(busy_with: &'static str, size: Size, time_max: Option<Duration>) -> Self {
        Self {
            busy_with,
            slots: Arc::new(Semaphore::new(size.all())),
            workers: Arc::new(Semaphore::new(size.running)),
            time_max,
        }
    }

    /// Runs the work when it is its turn.
    ///
    /// # Errors
    /// 503 if the queue is full, or if the work takes longer than the time limit; it is then completed nevertheless.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let Ok(permit) = Arc::clone(&self.slots).try_acquire_owned() else {
            let message = format!("{}: try again in a second", self.busy_with);
            return Err(Problem::unavailable(message));
        };
        let done = self.in_turn(permit, work);
        let Some(time_max) = self.time_max else { return done.await };
        tokio::time::timeout(time_max, done).await.unwrap_or_else(|_| {
            Err(Problem::unavailable(format!(
                "not done within {} s, but still running: see /v1/status for the outcome",
                time_max.as_secs()
            )))
        })
    }

    /// Runs the work when it is its turn, and waits for a free slot without a time limit: for the chunks of a started
    /// download; each connection has at most one at a time.
    ///
    /// # Errors
    /// The work panicked.
    pub(super) async fn run_when_free<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let permit = Arc::clone(&self.slots).acquire_owned().await;
        let permit = permit.map_err(|_| Problem::unavailable("the service is stopping"))?;
        self.in_turn(permit, work).await
    }

    async fn in_turn<T: Send + 'static>(
        &self,
        permit: OwnedSemaphorePermit,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let worker = Arc::clone(&self.workers).acquire_owned().await;
        let worker = worker.map_err(|_| Problem::unavailable("the service is stopping"))?;
        // The slot is held as long as the thread is busy, even if the client is gone by then.
        let held = (permit, worker);
        let job = tokio::task::spawn_blocking(move || {
            let done = work();
            drop(held);
            done
        });
        job.await.map_err(|_| Problem::internal("a job panicked: please report this bug"))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;
    use crate::http::ProblemKind;

    fn runtime() -> tokio::runtime::Runtime {
        tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap()
    }

    #[test]
    fn a_full_queue_refuses_and_a_gone_client_keeps_its_slot_until_the_work_is_done() {
        let runtime = runtime();
        let _inside = runtime.enter();
        let time_max = Some(Duration::from_millis(50));
        let queue = WorkQueue::new("x", Size { running: 1, waiting: 1 }, time_max);
        let (release, released) = sync_channel::<()>(0);
        let slow = runtime.block_on(queue.run(move || released.recv().is_ok())).unwrap_err();
        assert_eq!((slow.status, slow.kind), (503, ProblemKind::Unavailable));
        assert!(slow.message.contains("/v1/status"), "it goes on: {}", slow.message);
        // One is still running, and one may wait; it times out and leaves.
        assert_eq!(runtime.block_on(queue.run(|| ())), Err(slow.clone()));
        let permit = Arc::clone(&queue.slots).try_acquire_owned().unwrap();
        let full = runtime.block_on(queue.run(|| ())).unwrap_err();
        assert_eq!((full.status, full.kind), (503, ProblemKind::Unavailable));
        assert!(full.message.starts_with("x:") && full.message != slow.message, "{}", full.message);
        drop(permit);
        release.send(()).unwrap();
        assert_eq!(runtime.block_on(queue.run(|| 7)).unwrap(), 7);
    }

    #[test]
    fn a_panic_gets_a_reply() {
        let queue = WorkQueue::new("x", Size { running: 1, waiting: 0 }, None);
        let problem = runtime().block_on(queue.run(|| panic!("planted"))).unwrap_err();
        assert_eq!(problem.status, 500);
    }
}
