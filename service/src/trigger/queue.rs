//! Accepted triggers on their way from the thread that hears them to the one that carries them out, in real time.

use std::{
    net::SocketAddr,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::{Received, Refusal, Waiting};

/// See the module.
#[derive(Debug, Clone)]
pub struct Queue {
    waiting: Arc<Mutex<Waiting>>,
    /// One message at most: that the first deadline may be another one.
    wake: Sender<()>,
    woken: Receiver<()>,
    begin: Instant,
}

impl Default for Queue {
    fn default() -> Self {
        let (wake, woken) = bounded(1);
        Self { waiting: Arc::default(), wake, woken, begin: Instant::now() }
    }
}

impl Queue {
    /// The time that deadlines are compared with.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    /// Accepts one that has just come.
    ///
    /// # Errors
    /// Too many wait already.
    pub fn push(&self, received: Received) -> Result<(), Refusal> {
        self.lock().push(received, self.now())?;
        // A message that is there already wakes as well.
        self.wake.try_send(()).ok();
        Ok(())
    }

    /// The next one that is due now.
    #[must_use]
    pub fn take_due(&self) -> Option<Received> {
        self.lock().take_due(self.now())
    }

    /// How long until the next one that waits is due; `None` when none waits.
    #[must_use]
    pub fn due_in(&self) -> Option<Duration> {
        Some(self.lock().next_due()?.saturating_sub(self.now()))
    }

    /// Something comes when what is due next may be something else.
    #[must_use]
    pub fn woken(&self) -> &Receiver<()> {
        &self.woken
    }

    /// As [`Waiting::cancel_starts`].
    #[must_use]
    pub fn cancel_starts(&self, from: SocketAddr, name: Option<&str>) -> usize {
        self.lock().cancel_starts(from, name)
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
