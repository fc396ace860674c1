//! Waits for streams that are over while others are read: finds, compares and opens them on a thread of its own, so that no
//! sample of the others waits for somebody who does not answer.

use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    thread::Builder,
    time::{Duration, Instant},
};

use super::{
    discovery::{self, FoundStream},
    sockets::{Feed, whole_description},
};
use crate::{lsl::StreamDescription, uri::STREAMS_MAX};

/// Time between two searches.
const INTERVAL: Duration = Duration::from_secs(1);

/// How long streams have to answer in each.
const ANSWERS: Duration = Duration::from_millis(500);

/// Time in which one has to be described and its feed to be open.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);

/// What became of a stream that was over.
#[derive(Debug)]
pub(super) enum Return {
    /// It is read again.
    Back {
        /// Its number.
        number: usize,
        /// What it states now; boxed, as is the feed, to keep the report small.
        found: Box<FoundStream>,
        /// Its open feed.
        feed: Box<Feed>,
    },
    /// It is back with another description, under which its samples must not be stored.
    Changed {
        /// Its number.
        number: usize,
    },
}

/// The thread, until it is dropped.
#[derive(Debug)]
pub(super) struct ReturnWatch {
    lost: SyncSender<(usize, StreamDescription)>,
    returns: Receiver<Return>,
}

impl ReturnWatch {
    /// Starts the thread; `None` if the system has none left.
    pub(super) fn start() -> Option<Self> {
        // Each stream is lost once before it returns.
        let (lost, to_find) = sync_channel(STREAMS_MAX);
        let (found, returns) = sync_channel(STREAMS_MAX);
        let watch = move || watch(&to_find, &found);
        Builder::new().name("mocapd-lsl".to_owned()).spawn(watch).ok()?;
        Some(Self { lost, returns })
    }

    /// Looks for a stream with this description.
    pub(super) fn look_for(&self, number: usize, description: StreamDescription) {
        // There is room for all of them.
        self.lost.try_send((number, description)).ok();
    }

    /// The next one that is back.
    pub(super) fn next_return(&self) -> Option<Return> {
        self.returns.try_recv().ok()
    }
}

fn watch(to_find: &Receiver<(usize, StreamDescription)>, found: &SyncSender<Return>) {
    let mut lost: Vec<(usize, StreamDescription)> = Vec::new();
    loop {
        let next = if lost.is_empty() {
            to_find.recv().map_err(|_| RecvTimeoutError::Disconnected)
        } else {
            to_find.recv_timeout(INTERVAL)
        };
        match next {
            Ok(stream) => lost.push(stream),
            Err(RecvTimeoutError::Timeout) => {}
            // The line is closed.
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let names: Vec<String> = lost.iter().map(|(_, of)| of.name.clone()).collect();
        let all = discovery::named(&names, ANSWERS);
        lost.retain(|(number, of)| match attempt(*number, of, &all) {
            Some(report) => found.try_send(report).is_err(),
            None => true,
        });
    }
}

/// Opens a stream, if it is there and is the only one.
fn attempt(number: usize, lost: &StreamDescription, all: &[FoundStream]) -> Option<Return> {
    let is_same = |found: &&FoundStream| {
        let of = &found.description;
        (&of.name, &of.source_id, &of.kind, &of.hostname)
            == (&lost.name, &lost.source_id, &lost.kind, &lost.hostname)
    };
    let mut same = all.iter().filter(is_same);
    let (Some(found), None) = (same.next(), same.next()) else { return None };
    let (address, until) = (found.data_address()?, Instant::now() + OPEN_TIMEOUT);
    let now = StreamDescription::parse(&whole_description(address, until).ok()?).ok()?;
    if !now.is_recorded_as(lost) {
        return Some(Return::Changed { number });
    }
    let feed = Box::new(Feed::open(&now, address, until).ok()?);
    let found = Box::new(FoundStream { description: now, ..found.clone() });
    Some(Return::Back { number, found, feed })
}
