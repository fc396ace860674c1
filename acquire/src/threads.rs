//! Named threads, stop signals, and panics turned into errors.

use std::{
    convert::Infallible,
    thread::{Builder, JoinHandle, scope},
};

use anyhow::{Context, anyhow};
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
