//! What happens, from one feed of the service to everybody who listens, with what happened lately.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use crossbeam_channel::select;
use mocapd_acquire::threads::Stopped;
use tokio::sync::broadcast;

use super::counts::Counts;
use crate::{control::EventFeed, status::ServiceEvent};

/// Events that are kept for those who come back: an hour of a busy session, some hundred kilobytes.
const KEPT_MAX: usize = 512;

/// Events that a listener may be behind before it loses the oldest.
const BEHIND_MAX: usize = 128;

/// The hub. Events are told apart by their numbers: a gap in them is what somebody missed, wherever it was lost.
#[derive(Debug)]
pub(super) struct Happenings {
    /// Which run of the service it is: numbers begin again with each.
    pub(super) run: String,
    kept: Mutex<VecDeque<Arc<ServiceEvent>>>,
    sender: broadcast::Sender<Arc<ServiceEvent>>,
    counts: Arc<Counts>,
}

impl Happenings {
    pub(super) fn new(run: String, counts: Arc<Counts>) -> Self {
        let kept = Mutex::new(VecDeque::with_capacity(KEPT_MAX));
        Self { run, kept, sender: broadcast::Sender::new(BEHIND_MAX), counts }
    }

    /// Listens until it is stopped, or the feed ends: the work of a thread of its own. The feed was opened before, so that
    /// nothing is missed.
    pub(super) fn listen(&self, feed: &EventFeed, stopped: &Stopped) {
        loop {
            select! {
                recv(feed.events) -> event => match event {
                    Ok(event) => self.tell(event),
                    Err(_) => return,
                },
                recv(stopped.channel()) -> _ => return,
            }
            Counts::add(&self.counts.events_missed, feed.missed());
        }
    }

    fn tell(&self, event: Arc<ServiceEvent>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == KEPT_MAX {
            kept.pop_front();
        }
        kept.push_back(Arc::clone(&event));
        // Under the lock, so that `follow` gets each event once. Nobody may listen.
        self.sender.send(event).ok();
    }

    /// What was kept since event `after`, and what comes from now on. Without a number only the latter.
    pub(super) fn follow(&self, after: Option<u64>) -> Following {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let last = kept.back().map_or(0, |event| event.number);
        let since = after.unwrap_or(last);
        let backlog = kept.iter().filter(|event| event.number > since).cloned().collect();
        Following { backlog, coming: self.sender.subscribe(), told: since }
    }
}

/// One listener.
#[derive(Debug)]
pub(super) struct Following {
    backlog: VecDeque<Arc<ServiceEvent>>,
    coming: broadcast::Receiver<Arc<ServiceEvent>>,
    told: u64,
}

/// An event, and how many before it are gone.
#[derive(Debug)]
pub(super) struct Told {
    pub(super) event: Arc<ServiceEvent>,
    pub(super) missed: u64,
}

impl Following {
    /// The next event. `None`: there will be none.
    pub(super) async fn next(&mut self) -> Option<Told> {
        let event = match self.backlog.pop_front() {
            Some(event) => event,
            None => loop {
                match self.coming.recv().await {
                    Ok(event) => break event,
                    // The numbers tell how many.
                    Err(broadcast::error::RecvError::Lagged(_)) => {}
                    Err(broadcast::error::RecvError::Closed) => return None,
                }
            },
        };
        let missed = event.number.saturating_sub(self.told + 1);
        self.told = event.number;
        Some(Told { event, missed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::State;

    fn event(number: u64) -> Arc<ServiceEvent> {
        Arc::new(ServiceEvent {
            number,
            unix_ms: 0,
            kind: crate::status::ServiceEventKind::Mark,
            message: String::new(),
            state: State::Idle,
            take: None,
            notes: None,
        })
    }

    fn next(following: &mut Following) -> (u64, u64) {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let told = runtime.block_on(following.next()).unwrap();
        (told.event.number, told.missed)
    }

    #[test]
    fn history_is_bounded_and_gaps_are_told() {
        let hub = Happenings::new("r".to_owned(), Arc::default());
        let total = KEPT_MAX as u64 + 10;
        (1..=total).for_each(|number| hub.tell(event(number)));
        let mut resumed = hub.follow(Some(3));
        assert_eq!(next(&mut resumed), (11, 7), "4 to 10 are gone");
        assert_eq!(next(&mut resumed), (12, 0));
        let mut new = hub.follow(None);
        // Lost before it came here, by a feed that was not read.
        hub.tell(event(total + 3));
        assert_eq!(next(&mut new), (total + 3, 2));
        // Behind by more than is held for one: the oldest are gone.
        (total + 4..total + 4 + 2 * BEHIND_MAX as u64).for_each(|number| hub.tell(event(number)));
        let (number, missed) = next(&mut new);
        assert_eq!((number, missed), (total + 4 + BEHIND_MAX as u64, BEHIND_MAX as u64));
        assert_eq!(next(&mut hub.follow(Some(total))).0, total + 3);
    }
}
