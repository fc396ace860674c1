//! What is recorded, published live to programs on this machine or the network, by their own protocols.
//!
//! A publisher has a thread of its own. Frames reach it through rings beside those of the recording, and wait for each client
//! in a bounded queue; a publisher that is too slow, or a client, misses frames, which are counted, and nothing waits for it.

mod markers;
mod qtm;

use std::sync::{Arc, Mutex};

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_acquire::pipeline::{FrameTap, PipelineProgress, lock};
use mocapd_take::record::Header;

pub use self::qtm::QtmPublisher;
use crate::status::PublishStatus;

/// Devices that were armed and wait for the publisher: one that is over, and its successor.
const SOURCES_MAX: usize = 2;

/// The frames of a device from when it is armed until it is disarmed.
#[derive(Debug)]
pub(crate) struct PublishedSource {
    pub(crate) frames: FrameTap,
    pub(crate) progress: Arc<PipelineProgress>,
    pub(crate) header: Header,
}

/// The end of a publication that the engine has.
#[derive(Debug)]
pub(crate) struct Publication {
    sources: Sender<PublishedSource>,
    feed: PublishedFeed,
}

/// The end of a publication that a publisher has.
#[derive(Debug, Clone)]
pub struct PublishedFeed {
    sources: Receiver<PublishedSource>,
    status: Arc<Mutex<Option<PublishStatus>>>,
}

impl Default for Publication {
    fn default() -> Self {
        let (sender, sources) = bounded(SOURCES_MAX);
        Self { sources: sender, feed: PublishedFeed { sources, status: Arc::default() } }
    }
}

impl Publication {
    /// Passes a device on that was armed. If nobody takes the earlier ones, its frames are not published.
    pub(crate) fn add(&self, source: PublishedSource) {
        self.sources.try_send(source).ok();
    }

    /// What the publisher reports, if there is one.
    pub(crate) fn status(&self) -> Option<PublishStatus> {
        lock(&self.feed.status).clone()
    }

    pub(crate) fn feed(&self) -> PublishedFeed {
        self.feed.clone()
    }
}

impl PublishedFeed {
    fn report(&self, status: Option<PublishStatus>) {
        *lock(&self.status) = status;
    }
}
