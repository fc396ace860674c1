//! Work on a thread of its own, while the interpreter is free and Ctrl-C is answered.

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

/// Between two looks at signals: Ctrl-C is to be answered within 0.3 s, of which a stretch that is being decoded takes most.
const SIGNALS_EVERY: Duration = Duration::from_millis(20);

/// Says that nobody wants what is being worked on any more.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cancel(Arc<AtomicBool>);

impl Cancel {
    fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// An error when nobody wants any more: to be asked every few milliseconds of work.
    pub(crate) fn check(&self) -> io::Result<()> {
        if self.0.load(Ordering::Relaxed) { Err(io::ErrorKind::TimedOut.into()) } else { Ok(()) }
    }
}

/// Runs `work`, which may borrow. Ctrl-C waits until it has noticed that it is cancelled.
pub(crate) fn detached<T: Send>(
    py: Python<'_>,
    path: Option<&Path>,
    work: impl FnOnce(&Cancel) -> Result<T, Failure> + Send,
) -> PyResult<T> {
    let cancel = Cancel::default();
    thread::scope(|scope| {
        let (done, outcome) = channel();
        let cancelled = cancel.clone();
        thread::Builder::new()
            .spawn_scoped(scope, move || done.send(caught(|| work(&cancelled))).ok())
            .map_err(Failure::from)?;
        let (outcome, interrupted) = wait(py, outcome, &cancel);
        let outcome = match interrupted {
            // What it borrows must be let go of first.
            Err(interrupt) => {
                py.detach(move || outcome.map(|outcome| outcome.recv().ok()));
                return Err(interrupt);
            }
            Ok(found) => found,
        };
        outcome.map_err(|failure| failure.of(py, path))
    })
}

/// Runs `work`, which owns what it needs: after Ctrl-C nobody waits for it, and it ends by itself.
pub(crate) fn abandonable<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Cancel) -> Result<T, Failure> + Send + 'static,
) -> PyResult<T> {
    let cancel = Cancel::default();
    let (done, outcome) = channel();
    let cancelled = cancel.clone();
    thread::Builder::new()
        .spawn(move || done.send(caught(|| work(&cancelled))).ok())
        .map_err(Failure::from)?;
    let (_, found) = wait(py, outcome, &cancel);
    found?.map_err(|failure| failure.of(py, None))
}

fn caught<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or(Err(Failure::Internal))
}

type Outcome<T> = Receiver<Result<T, Failure>>;

/// What came of it, or the exception that a signal made, with what to wait for.
fn wait<T: Send>(
    py: Python<'_>,
    mut outcome: Outcome<T>,
    cancel: &Cancel,
) -> (Option<Outcome<T>>, PyResult<Result<T, Failure>>) {
    loop {
        let (found, back) = py.detach(move || (outcome.recv_timeout(SIGNALS_EVERY), outcome));
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
