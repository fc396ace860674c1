//! Named threads, and panics that become errors.

use std::{
    convert::Infallible,
    thread::{Builder, JoinHandle, scope},
};

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded};

/// A resampler thread panicked: this is a bug in mocapd.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a resampler thread failed")]
pub struct ResamplerFailed;

/// Tells threads to end, when it is dropped.
#[derive(Debug)]
pub struct Stopper(
    #[expect(dead_code, reason = "that it is gone is the message")] Sender<Infallible>,
);

/// Whether a [`Stopper`] is gone.
#[derive(Debug, Clone)]
pub struct Stopped(Receiver<Infallible>);

/// A stop that threads can wait for beside other things.
#[must_use]
pub fn stop() -> (Stopper, Stopped) {
    let (stopper, stopped) = bounded(0);
    (Stopper(stopper), Stopped(stopped))
}

impl Stopped {
    /// Whether it is time to end.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.0.try_recv() == Err(TryRecvError::Disconnected)
    }

    /// To wait for beside others: nothing ever comes, until it is closed.
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
    Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .with_context(|| format!("cannot start the thread {name}"))
}

/// Does some work on a named thread and something else meanwhile; one after the other where the system refuses a thread.
/// Ends when both are done.
pub fn beside(name: &str, work: impl FnOnce() + Send + Copy, meanwhile: impl FnOnce()) {
    scope(|scope| {
        if Builder::new().name(name.to_owned()).spawn_scoped(scope, work).is_err() {
            work();
        }
        meanwhile();
    });
}

/// Waits for a thread.
///
/// # Errors
/// When it panicked.
pub fn join<T>(handle: JoinHandle<T>) -> anyhow::Result<T> {
    let name = handle.thread().name().unwrap_or("?").to_owned();
    handle.join().map_err(|_| anyhow!("the thread {name} panicked: this is a bug in mocapd"))
}

/// Worker threads when the user does not say: one a core, at most eight, since one core resamples
/// more than any bus carries.
#[must_use]
pub fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(8)
}
