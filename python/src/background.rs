//! Runs work on a background thread, so that other Python threads run meanwhile and Ctrl-C is handled.

use std::{
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, channel},
    },
    thread,
    time::Duration,
};

use pyo3::{PyResult, Python};

use crate::errors::Failure;

/// Interval between checks for signals. Ctrl-C must raise within 0.3 s; most of that is the stretch being decoded.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// A flag that asks running work to stop.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cancel(Arc<AtomicBool>);

impl Cancel {
    fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Fails with `TimedOut` once the work is cancelled. Work checks this every few milliseconds.
    pub(crate) fn check(&self) -> io::Result<()> {
        if self.0.load(Ordering::Relaxed) { Err(io::ErrorKind::TimedOut.into()) } else { Ok(()) }
    }
}

/// Runs `work`, which may borrow. After Ctrl-C this waits until the work has stopped.
pub(crate) fn run_detached<T: Send>(
    py: Python<'_>,
    path: Option<&Path>,
    work: impl FnOnce(&Cancel) -> Result<T, Failure> + Send,
) -> PyResult<T> {
    let cancel = Cancel::default();
    thread::scope(|scope| {
        let (done, outcome) = channel();
        let cancelled = cancel.clone();
        thread::Builder::new()
            .spawn_scoped(scope, move || done.send(catch_panic(|| work(&cancelled))).ok())
            .map_err(Failure::from)?;
        let (outcome, found) = wait(py, outcome, &cancel);
        if found.is_err() {
            // The work must stop before the borrows end.
            py.detach(move || outcome.map(|outcome| outcome.recv().ok()));
        }
        found?.map_err(|failure| failure.into_py_err(py, path))
    })
}

/// Runs `work`, which owns its data. After Ctrl-C this returns at once, and the work stops by itself.
pub(crate) fn run_abandonable<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Cancel) -> Result<T, Failure> + Send + 'static,
) -> PyResult<T> {
    let cancel = Cancel::default();
    let (done, outcome) = channel();
    let cancelled = cancel.clone();
    thread::Builder::new()
        .spawn(move || done.send(catch_panic(|| work(&cancelled))).ok())
        .map_err(Failure::from)?;
    let (_, found) = wait(py, outcome, &cancel);
    found?.map_err(|failure| failure.into_py_err(py, None))
}

fn catch_panic<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or(Err(Failure::Internal))
}

type Outcome<T> = Receiver<Result<T, Failure>>;

/// Waits for the outcome. Returns it, or the exception raised by a signal together with the receiver to wait on.
fn wait<T: Send>(
    py: Python<'_>,
    mut outcome: Outcome<T>,
    cancel: &Cancel,
) -> (Option<Outcome<T>>, PyResult<Result<T, Failure>>) {
    loop {
        let (found, back) = py.detach(move || (outcome.recv_timeout(POLL_INTERVAL), outcome));
        outcome = back;
        match found {
            Ok(found) => return (None, Ok(found)),
            Err(RecvTimeoutError::Disconnected) => return (None, Ok(Err(Failure::Internal))),
            Err(RecvTimeoutError::Timeout) => {
                if let Err(interrupt) = py.check_signals() {
                    cancel.cancel();
                    return (Some(outcome), Err(interrupt));
                }
            }
        }
    }
}
