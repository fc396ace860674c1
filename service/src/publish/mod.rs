//! What is received, published live to programs on this machine or the network, by their own protocols.
//!
//! Each publisher has a thread and a tap of its own (`acquire/src/pipeline/publish_tap.rs`). Frames and samples reach it
//! through rings beside those of the recording; what waits for its clients is bounded. A publisher that is too slow, or a
//! client, misses some, which is counted, and nothing waits for it.
//!
//! A protocol implements `LivePublisher`: what to do with frames, samples and sockets. `runner` does the rest for all of
//! them: it opens the port until that succeeds, follows the device, takes what waits in the tap, reports clients, and ends.
//! `clients` says who may connect. To add one: its section of the configuration with `enabled`, a module here with a
//! [`PublisherName`] and a function that calls `runner::start`, and its lines in [`names`] and [`open_all`].

mod clients;
#[cfg(feature = "full")]
mod foxglove;
mod host_time;
mod lsl;
mod markers;
mod natnet;
mod qtm;
mod runner;

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, Mutex},
    time::Duration,
};

use mocapd_acquire::pipeline::{PipelineProgress, PublishTap, TappedBatch, TappedFrame, lock};
use mocapd_drivers::device::{BodyInfo, ForcePlateInfo, SampledChannelInfo, SampledGroupInfo};
use mocapd_take::{
    interchange::output_names,
    record::{Header, SampledChannel, SampledGroup, Subject},
};

#[cfg(feature = "full")]
pub use self::foxglove::{FOXGLOVE, open as open_foxglove};
pub use self::{
    lsl::{LSL, open as open_lsl},
    natnet::{NATNET, open as open_natnet},
    qtm::{QTM, open as open_qtm},
    runner::RunningPublisher,
};
use crate::{config::Config, control::Control, status::PublishStatus};

/// What a protocol is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublisherName {
    /// In the configuration, where `[publish.ID]` is its section, in the status and in metrics: lower-case letters.
    pub id: &'static str,
    /// In messages.
    pub title: &'static str,
}

/// The publishers that a configuration enables. They have their taps from when the service starts to its end.
#[must_use]
pub fn names(config: &Config) -> Vec<PublisherName> {
    [
        (config.publish_qtm.enabled, QTM),
        (config.publish_natnet.enabled, NATNET),
        (config.publish_lsl.enabled, LSL),
        #[cfg(feature = "full")]
        (config.publish_foxglove.enabled, FOXGLOVE),
    ]
    .into_iter()
    .filter_map(|(is_enabled, name)| is_enabled.then_some(name))
    .collect()
}

/// Opens the publishers that the engine was started with: those that `published` has a feed for.
///
/// # Errors
/// A file that the configuration names cannot be used; the message says what to do. A port that cannot be opened is a
/// warning.
pub fn open_all(
    config: &Config,
    published: impl Fn(PublisherName) -> Option<PublishedFeed>,
    control: &Arc<dyn Control>,
) -> anyhow::Result<Vec<RunningPublisher>> {
    let mut running = Vec::new();
    if let Some(feed) = published(QTM) {
        running.push(open_qtm(&config.publish_qtm, feed, control)?);
    }
    if let Some(feed) = published(NATNET) {
        running.push(open_natnet(&config.publish_natnet, feed, control)?);
    }
    if let Some(feed) = published(LSL) {
        running.push(open_lsl(&config.publish_lsl, feed, control)?);
    }
    #[cfg(feature = "full")]
    if let Some(feed) = published(FOXGLOVE) {
        running.push(open_foxglove(&config.publish_foxglove, feed, control)?);
    }
    Ok(running)
}

/// A device that is armed: what publishers say about it.
#[derive(Debug, Clone)]
pub struct PublishedDevice {
    /// The template of its takes' headers: rate, axis, device and the markers known at the start.
    pub header: Header,
    /// Has the channels of all markers so far.
    pub progress: Arc<PipelineProgress>,
    /// Its rigid bodies, in the order of the poses.
    pub bodies: Vec<BodyInfo>,
    /// Its groups of sampled channels.
    pub sampled: Vec<SampledGroupInfo>,
    /// Its force plates.
    pub plates: Vec<ForcePlateInfo>,
    /// The subject of the configuration.
    pub subject: Option<Arc<Subject>>,
}

impl PublishedDevice {
    /// The names of its rigid bodies, as exports of its takes have them.
    fn body_names(&self) -> Vec<String> {
        output_names(self.bodies.iter().map(|body| (body.id.into(), &body.name)))
    }
}

/// A device from when it is armed until it is disarmed, for one publisher.
#[derive(Debug)]
pub(crate) struct PublishedSource {
    pub(crate) tap: PublishTap,
    pub(crate) device: PublishedDevice,
}

/// What a publisher wants to be copied for it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct WantedKinds {
    /// Frames with their markers and poses.
    pub(crate) frames: bool,
    /// Batches of sampled channels.
    pub(crate) samples: bool,
}

impl WantedKinds {
    fn any(self) -> bool {
        self.frames || self.samples
    }
}

/// A protocol with its sockets. Its thread calls it in turns: source, samples, frames, exchange; and from time to time status.
///
/// Nothing here may wait except [`exchange`](Self::exchange), and there only for as long as it is allowed to.
pub(crate) trait LivePublisher {
    /// Where clients connect, which is known once a free port was found.
    fn address(&self) -> SocketAddr;

    /// A device was armed, or is not any more. Another one may follow without an end of the one before.
    fn set_device(&mut self, device: Option<&PublishedDevice>);

    /// What clients want at present. What nobody wants is not copied.
    fn wanted(&self) -> WantedKinds;

    /// Whether the poses of these frames are wanted, too: frames of a device with bodies wait for them, up to the next frame.
    fn wants_poses(&self) -> bool;

    /// Passes a frame on to the clients that want frames; some come after none is wanted any more.
    fn frame(&mut self, device: &PublishedDevice, frame: &TappedFrame);

    /// The same for a batch of samples. Batches come before the frames that arrived at the same time.
    fn samples(&mut self, device: &PublishedDevice, batch: &TappedBatch);

    /// Receives from the clients and sends what waits for them, and then waits until more can be done, for at most `timeout`.
    ///
    /// # Errors
    /// The system's; the publisher is called again.
    fn exchange(&mut self, timeout: Duration) -> io::Result<()>;

    /// Messages about clients since the last call, for the events. Few are passed on.
    fn take_news(&mut self) -> Vec<String>;

    /// The clients and what they were sent. What its tap left out is filled in elsewhere.
    fn status(&self) -> PublishStatus;

    /// The service ends: clients get what waits for them, for at most some tenths of a second.
    fn close(self);
}

/// The ends of all publishers that the engine has.
#[derive(Debug, Default)]
pub(crate) struct Publications(Vec<PublishedFeed>);

/// The end that a publisher has.
#[derive(Debug, Clone)]
pub struct PublishedFeed {
    name: PublisherName,
    slot: Arc<PublisherSlot>,
}

#[derive(Debug, Default)]
struct PublisherSlot {
    /// The device that was armed last, until its publisher takes it over. An earlier one is over by then, and nothing was
    /// copied of it.
    source: Mutex<Option<PublishedSource>>,
    status: Mutex<Option<PublishStatus>>,
}

impl Publications {
    /// One for each of these publishers, whether they run or not.
    pub(crate) fn new(names: &[PublisherName]) -> Self {
        let feed = |name: &PublisherName| PublishedFeed { name: *name, slot: Arc::default() };
        Self(names.iter().map(feed).collect())
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Passes a device on that was armed, with a tap for each publisher.
    pub(crate) fn set_device(&self, taps: Vec<PublishTap>, device: &PublishedDevice) {
        for (feed, tap) in self.0.iter().zip(taps) {
            let source = PublishedSource { tap, device: device.clone() };
            *lock(&feed.slot.source) = Some(source);
        }
    }

    /// What the publishers that run report.
    pub(crate) fn status(&self) -> Vec<PublishStatus> {
        self.0.iter().filter_map(|feed| lock(&feed.slot.status).clone()).collect()
    }

    pub(crate) fn feed(&self, name: PublisherName) -> Option<PublishedFeed> {
        self.0.iter().find(|feed| feed.name == name).cloned()
    }
}

impl PublishedFeed {
    /// The device that was armed since the last call.
    fn take_source(&self) -> Option<PublishedSource> {
        lock(&self.slot.source).take()
    }

    fn report(&self, status: Option<PublishStatus>) {
        *lock(&self.slot.status) = status;
    }
}

/// A group as takes describe it, for the units of its plates.
fn group_record(info: &SampledGroupInfo) -> SampledGroup {
    let channel = |channel: &SampledChannelInfo| SampledChannel {
        name: channel.name.clone(),
        unit: channel.unit.clone(),
        scale: channel.scale,
        offset: channel.offset,
        ..SampledChannel::default()
    };
    SampledGroup {
        number: info.id.into(),
        channels: info.channels.iter().map(channel).collect(),
        ..SampledGroup::default()
    }
}
