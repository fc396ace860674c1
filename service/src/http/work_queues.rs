//! Queues for work that blocks, with a limited number of threads and waiting requests; further requests are rejected.
//!
//! Commands and reads of files take a moment, and run on the threads of the listener's runtime. Verifications, windows of takes
//! and exports keep a core busy, and a recording that is being stopped needs it: they run on threads of their own, at the
//! lowest priority.

use std::{io, sync::Arc, time::Duration};

use tokio::{
    runtime::{Builder, Handle, Runtime},
    sync::{OwnedSemaphorePermit, Semaphore},
};

use super::body::Problem;
use crate::process;

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

/// Threads that a listener's runtime may have for commands and files.
pub(super) const THREADS: usize = COMMANDS.running + FILES.running;

/// Threads of a listener for everything that computes.
const COMPUTING_THREADS: usize = CHECKS.running + DECODES.running + EXPORTS.running;

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

/// Threads for the queues that compute. Nothing asynchronous runs on this runtime; it has its threads, which end when they
/// are idle, and the end of jobs when the server stops. With `beside_recording` they run at the lowest priority, and so do
/// threads that a job starts.
///
/// # Errors
/// The system refuses what a runtime needs.
pub(super) fn computing_threads(beside_recording: bool) -> io::Result<Runtime> {
    Builder::new_current_thread()
        .max_blocking_threads(COMPUTING_THREADS)
        .thread_name("mocapd-compute")
        .on_thread_start(move || {
            if beside_recording {
                process::lower_thread_priority();
            }
        })
        .build()
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
    /// `computing` is the handle of [`computing_threads`].
    pub(super) fn new(work_max: Duration, computing: &Handle) -> Self {
        let short = |busy_with, size| WorkQueue::new(busy_with, size, Work::Short(work_max));
        let computes =
            |busy_with, size| WorkQueue::new(busy_with, size, Work::Computes(computing.clone()));
        Self {
            commands: short("too many requests are being executed", COMMANDS),
            files: short("too many files are being read", FILES),
            checks: computes("another take is being verified", CHECKS),
            decodes: computes("too many players are reading takes", DECODES),
            exports: computes("too many takes are being converted", EXPORTS),
        }
    }
}

/// What the jobs of a queue do.
#[derive(Debug)]
enum Work {
    /// They take a moment, unless a disk or a device stalls: a request waits no longer than this.
    Short(Duration),
    /// They keep a core busy until they are done, on the threads of this runtime.
    Computes(Handle),
}

/// A queue for one kind of work.
#[derive(Debug)]
pub(super) struct WorkQueue {
    busy_with: &'static str,
    slots: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    work: Work,
}

impl WorkQueue {
    fn new(busy_with: &'static str, size: Size, work: Work) -> Self {
        Self {
            busy_with,
            slots: Arc::new(Semaphore::new(size.all())),
            workers: Arc::new(Semaphore::new(size.running)),
            work,
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
        let Work::Short(time_max) = self.work else { return done.await };
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
        let job = move || {
            let done = work();
            drop(held);
            done
        };
        let job = match &self.work {
            Work::Short(_) => tokio::task::spawn_blocking(job),
            Work::Computes(threads) => threads.spawn_blocking(job),
        };
        job.await.map_err(|_| Problem::internal("a job panicked: please report this bug"))
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::mpsc::{Sender, channel, sync_channel},
        thread::current,
    };

    use mocapd_acquire::threads;

    use super::*;
    use crate::http::ProblemKind;

    fn runtime() -> Runtime {
        Builder::new_current_thread().enable_time().build().unwrap()
    }

    fn of_one(work: Work) -> WorkQueue {
        WorkQueue::new("x", Size { running: 1, waiting: 0 }, work)
    }

    #[test]
    fn a_full_queue_refuses_and_a_gone_client_keeps_its_slot_until_the_work_is_done() {
        let runtime = runtime();
        let _inside = runtime.enter();
        let work = Work::Short(Duration::from_millis(50));
        let queue = WorkQueue::new("x", Size { running: 1, waiting: 1 }, work);
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
        let computing = computing_threads(true).unwrap();
        for work in
            [Work::Short(Duration::from_secs(20)), Work::Computes(computing.handle().clone())]
        {
            let queue = of_one(work);
            let problem = runtime().block_on(queue.run(|| panic!("planted"))).unwrap_err();
            assert_eq!(problem.status, 500);
            // Its slot is free, and so is its thread.
            assert_eq!(runtime().block_on(queue.run(|| 7)).unwrap(), 7);
        }
    }

    /// The name and the nice value of a job's thread, and of a thread that the job starts.
    fn priorities(queue: &WorkQueue) -> (String, i32, i32) {
        let nice = || rustix::process::getpriority_process(None).unwrap();
        let job = move || {
            let name = current().name().unwrap_or_default().to_owned();
            (name, nice(), threads::spawn("started", nice).unwrap().join().unwrap())
        };
        runtime().block_on(queue.run(job)).unwrap()
    }

    #[test]
    fn only_what_computes_beside_a_recording_has_the_lowest_priority() {
        let own = rustix::process::getpriority_process(None).unwrap();
        let lowered = computing_threads(true).unwrap();
        let computes = of_one(Work::Computes(lowered.handle().clone()));
        assert_eq!(priorities(&computes), ("mocapd-compute".to_owned(), 19, 19));
        let viewer = computing_threads(false).unwrap();
        let computes = of_one(Work::Computes(viewer.handle().clone()));
        assert_eq!(priorities(&computes), ("mocapd-compute".to_owned(), own, own));
        let (_, job, started) = priorities(&of_one(Work::Short(Duration::from_secs(20))));
        assert_eq!((job, started), (own, own));
        assert_eq!(rustix::process::getpriority_process(None), Ok(own), "the thread that waits");
    }

    #[test]
    fn jobs_that_compute_leave_the_threads_of_commands_free() {
        let computing = computing_threads(true).unwrap();
        let queues = WorkQueues::new(Duration::from_secs(20), computing.handle());
        let runtime = Builder::new_current_thread()
            .enable_time()
            .max_blocking_threads(THREADS)
            .build()
            .unwrap();
        let (begun, begins) = channel();
        let mut releases = Vec::new();
        let mut hold = |begun: Sender<()>| {
            let (release, released) = sync_channel::<()>(0);
            releases.push(release);
            move || {
                begun.send(()).unwrap();
                released.recv().ok();
            }
        };
        let check = queues.checks.run(hold(begun.clone()));
        let decode = queues.decodes.run(hold(begun.clone()));
        let exports = [queues.exports.run(hold(begun.clone())), queues.exports.run(hold(begun))];
        let commands = async {
            // All of them run at once, each on a thread.
            let all =
                tokio::task::spawn_blocking(move || begins.iter().take(COMPUTING_THREADS).count());
            assert_eq!(all.await.unwrap(), COMPUTING_THREADS);
            assert_eq!(queues.commands.run(|| 7).await, Ok(7));
            releases.clear();
        };
        let [first, second] = exports;
        let done = async { tokio::join!(check, decode, first, second, commands) };
        let (check, decode, first, second, ()) = runtime.block_on(done);
        assert_eq!([check, decode, first, second], [Ok(()), Ok(()), Ok(()), Ok(())]);
    }
}
