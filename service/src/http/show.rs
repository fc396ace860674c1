//! Frames from one feed of the service to every viewer: coded once, and the newest few for whoever is slow.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use axum::body::Bytes;
use crossbeam_channel::{Receiver, Sender, bounded, select};
use mocapd_acquire::threads::Stopped;
use tokio::sync::broadcast;

use super::counts::Counts;
use crate::{
    control::Control,
    live::{LiveFeed, LiveMessage},
};

/// Messages that a viewer may be behind: a quarter of a second. A frame of 200 markers has 2.4 KB, and is held once
/// for all viewers.
const BEHIND_MAX: usize = 8;

/// Between looks whether there still are viewers, and whether the server ends, where no frame comes.
const LOOK: Duration = Duration::from_millis(100);

/// Markers, as they go to a viewer.
#[derive(Debug)]
pub(super) struct Table {
    number: u64,
    bytes: Bytes,
}

/// What viewers are sent.
#[derive(Debug, Clone)]
pub(super) enum Shown {
    Table(Arc<Table>),
    /// A frame, and the markers that it has: a viewer that missed the table gets it with the frame.
    Frame(Option<Arc<Table>>, Bytes),
    Over,
}

/// The hub.
#[derive(Debug)]
pub(super) struct Show {
    sender: broadcast::Sender<Shown>,
    table: Mutex<Option<Arc<Table>>>,
    is_over: AtomicBool,
    wake: Sender<()>,
    woken: Receiver<()>,
    counts: Arc<Counts>,
}

impl Show {
    pub(super) fn new(counts: Arc<Counts>) -> Self {
        let (wake, woken) = bounded(1);
        let (table, is_over) = (Mutex::new(None), AtomicBool::new(false));
        Self { sender: broadcast::Sender::new(BEHIND_MAX), table, is_over, wake, woken, counts }
    }

    /// Looks while anybody does, until it is stopped: the work of a thread of its own.
    pub(super) fn run(&self, control: &dyn Control, stopped: &Stopped) {
        while !stopped.is_stopped() && !self.is_over() {
            if self.sender.receiver_count() == 0 {
                select! {
                    recv(self.woken) -> _ => {}
                    recv(stopped.channel()) -> _ => return,
                }
                continue;
            }
            self.show(&control.live(), stopped);
        }
    }

    fn show(&self, feed: &LiveFeed, stopped: &Stopped) {
        while self.sender.receiver_count() > 0 && !stopped.is_stopped() {
            let asked = Instant::now();
            match feed.next(LOOK) {
                Some(message) => self.put(&message),
                None if feed.is_over() => {
                    self.is_over.store(true, Ordering::Relaxed);
                    self.send(Shown::Over);
                    return;
                }
                // A feed that lost its other end answers at once: it is opened again, and not all the time.
                None if asked.elapsed() < LOOK / 2 => {
                    std::thread::sleep(LOOK);
                    return;
                }
                None => {}
            }
        }
    }

    fn put(&self, message: &LiveMessage) {
        let mut bytes = Vec::new();
        message.put(&mut bytes);
        let bytes = Bytes::from(bytes);
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let shown = match message {
            LiveMessage::Table(_) => {
                let number = table.as_ref().map_or(1, |table| table.number + 1);
                let new = Arc::new(Table { number, bytes });
                *table = Some(Arc::clone(&new));
                Shown::Table(new)
            }
            LiveMessage::Frame(_) => Shown::Frame(table.clone(), bytes),
        };
        self.send(shown);
    }

    fn send(&self, shown: Shown) {
        // The last viewer may have left by now.
        self.sender.send(shown).ok();
    }

    /// Whether no more frames will come.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    pub(super) fn view(&self) -> Viewing {
        let table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let coming = self.sender.subscribe();
        let first = table.as_ref().map(|table| Shown::Table(Arc::clone(table)));
        drop(table);
        // Full: it was woken already.
        self.wake.try_send(()).ok();
        Viewing { first, coming, table_seen: 0, counts: Arc::clone(&self.counts) }
    }
}

/// One viewer.
#[derive(Debug)]
pub(super) struct Viewing {
    first: Option<Shown>,
    coming: broadcast::Receiver<Shown>,
    table_seen: u64,
    counts: Arc<Counts>,
}

impl Viewing {
    /// The bytes to send next. `None`: there will be none.
    pub(super) async fn next(&mut self) -> Option<Bytes> {
        loop {
            let shown = match self.first.take() {
                Some(shown) => shown,
                None => match self.coming.recv().await {
                    Ok(shown) => shown,
                    Err(broadcast::error::RecvError::Lagged(skipped)) => {
                        Counts::add(&self.counts.live_frames_skipped, skipped);
                        continue;
                    }
                    Err(broadcast::error::RecvError::Closed) => return None,
                },
            };
            match shown {
                Shown::Over => return None,
                Shown::Table(table) if table.number == self.table_seen => {}
                Shown::Table(table) => {
                    self.table_seen = table.number;
                    return Some(table.bytes.clone());
                }
                Shown::Frame(Some(table), frame) if table.number != self.table_seen => {
                    self.first = Some(Shown::Frame(Some(Arc::clone(&table)), frame));
                    self.table_seen = table.number;
                    return Some(table.bytes.clone());
                }
                Shown::Frame(_, frame) => return Some(frame),
            }
        }
    }
}
