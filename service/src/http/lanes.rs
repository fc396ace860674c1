//! Work that waits, on threads that may: a few at work, a few in line, and everybody else is told to come again.

use std::{sync::Arc, time::Duration};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::problem::Problem;

/// Requests to the service that are carried out at once: a start, a stop, a mark and one more.
const COMMANDS: Size = Size { at_work: 4, in_line: 16 };

/// Looks into files: listings and pieces of downloads. One disk serves two at once about as well as four.
const FILES: Size = Size { at_work: 2, in_line: 32 };

/// Takes that are read to the end and decoded: a core's work for as long as it takes.
const CHECKS: Size = Size { at_work: 1, in_line: 0 };

/// Threads that the runtime of a listener may have for all of these.
pub(super) const THREADS: usize = COMMANDS.at_work + FILES.at_work + CHECKS.at_work;

/// Requests that can be at work or in line at once; others are answered as soon as they have arrived.
pub(super) const REQUESTS_MAX: usize = COMMANDS.all() + FILES.all() + CHECKS.all();

#[derive(Debug, Clone, Copy)]
struct Size {
    at_work: usize,
    in_line: usize,
}

impl Size {
    const fn all(self) -> usize {
        self.at_work + self.in_line
    }
}

/// The lanes of one listener. What fills one keeps nobody from the others, and nobody from those of another listener.
#[derive(Debug)]
pub(super) struct Lanes {
    /// What changes something.
    pub(super) commands: Lane,
    /// What looks into files.
    pub(super) files: Lane,
    /// What reads a take to its end.
    pub(super) checks: Lane,
}

impl Lanes {
    pub(super) fn new(work_max: Duration) -> Self {
        Self {
            commands: Lane::new(
                "too many requests are being carried out",
                COMMANDS,
                Some(work_max),
            ),
            files: Lane::new("too many files are being read", FILES, Some(work_max)),
            checks: Lane::new("another take is being checked", CHECKS, None),
        }
    }
}

/// One kind of work.
#[derive(Debug)]
pub(super) struct Lane {
    busy_with: &'static str,
    places: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    time_max: Option<Duration>,
}

impl Lane {
    fn new(busy_with: &'static str, size: Size, time_max: Option<Duration>) -> Self {
        Self {
            busy_with,
            places: Arc::new(Semaphore::new(size.all())),
            workers: Arc::new(Semaphore::new(size.at_work)),
            time_max,
        }
    }

    /// Does it, in its turn.
    ///
    /// # Errors
    /// 503 when too many are in line, and when it takes longer than anybody waits: it is carried out all the same.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let Ok(place) = Arc::clone(&self.places).try_acquire_owned() else {
            let words = format!("{}: try again in a second", self.busy_with);
            return Err(Problem::unavailable(words));
        };
        let done = self.in_turn(place, work);
        let Some(time_max) = self.time_max else { return done.await };
        tokio::time::timeout(time_max, done).await.unwrap_or_else(|_| {
            Err(Problem::unavailable(format!(
                "it was not done within {} s and goes on: ask /v1/status what came of it",
                time_max.as_secs()
            )))
        })
    }

    /// Does it in its turn, and waits for a place in line as long as it takes: for the pieces of an answer that was
    /// begun, of which there is one at a time for each connection.
    ///
    /// # Errors
    /// When it panicked.
    pub(super) async fn run_patiently<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let place = Arc::clone(&self.places).acquire_owned().await;
        let place = place.map_err(|_| Problem::unavailable("the service is stopping"))?;
        self.in_turn(place, work).await
    }

    async fn in_turn<T: Send + 'static>(
        &self,
        place: OwnedSemaphorePermit,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let worker = Arc::clone(&self.workers).acquire_owned().await;
        let worker = worker.map_err(|_| Problem::unavailable("the service is stopping"))?;
        // The place is held for as long as the thread is, though the client may be gone by then.
        let held = (place, worker);
        let job = tokio::task::spawn_blocking(move || {
            let done = work();
            drop(held);
            done
        });
        job.await.map_err(|_| Problem::internal("a job panicked: this is a bug in mocapd"))
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
    fn a_full_lane_says_so_and_a_gone_client_keeps_its_place_until_the_work_is_done() {
        let runtime = runtime();
        let _inside = runtime.enter();
        let lane = Lane::new("x", Size { at_work: 1, in_line: 1 }, Some(Duration::from_millis(50)));
        let (release, released) = sync_channel::<()>(0);
        let slow = runtime.block_on(lane.run(move || released.recv().is_ok())).unwrap_err();
        assert_eq!((slow.status, slow.kind), (503, ProblemKind::Unavailable));
        assert!(slow.message.contains("/v1/status"), "it goes on: {}", slow.message);
        // One is at work still, and one more may wait; it waits in vain, and leaves its place.
        assert_eq!(runtime.block_on(lane.run(|| ())), Err(slow.clone()));
        let place = Arc::clone(&lane.places).try_acquire_owned().unwrap();
        let full = runtime.block_on(lane.run(|| ())).unwrap_err();
        assert_eq!((full.status, full.kind), (503, ProblemKind::Unavailable));
        assert!(full.message.starts_with("x:") && full.message != slow.message, "{}", full.message);
        drop(place);
        release.send(()).unwrap();
        assert_eq!(runtime.block_on(lane.run(|| 7)).unwrap(), 7);
    }

    #[test]
    fn a_panic_is_an_answer() {
        let lane = Lane::new("x", Size { at_work: 1, in_line: 0 }, None);
        let problem = runtime().block_on(lane.run(|| panic!("planted"))).unwrap_err();
        assert_eq!(problem.status, 500);
    }
}
