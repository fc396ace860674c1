//! The thread that passes frames from the pipeline's tap to viewers and to the marker statistics.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, Weak,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, SystemTime},
};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use mocapd_acquire::{
    host_clock::monotonic_ns,
    pipeline::{
        PipelineProgress, PreviewBody, PreviewFrame, PreviewPoses, PreviewReceiver, SampleColumn,
        SampleRange, SampleTapReceiver, lock,
    },
};
use mocapd_drivers::device::{BodyInfo, SampledGroupInfo};
use mocapd_report::labels::marker_lines;
use mocapd_take::{
    motion::Position,
    record::{Header, Subject},
};

use super::{Inner, quality::MarkerStatistics};
use crate::{
    live::{
        LiveFeed, LiveFrame, LiveMessage, LivePoses, LiveSamples, LiveTable, live_groups, values_of,
    },
    subject::{FaceOverlay, live_limbs, with_limbs},
};

/// Time between polls of the tap, which holds a quarter of a second.
const POLL_INTERVAL: Duration = Duration::from_millis(8);

/// Maximum number of messages waiting for a viewer, a tenth of a second. Newer ones replace the oldest.
const WAITING_MAX: usize = 4;

/// Columns of sampled channels that wait for a frame: a quarter of a second of sixteen groups, which are all that a device can
/// have. While no frames come, older ones are left out.
const COLUMNS_MAX: usize = 80;

/// Maximum number of viewers. The HTTP server limits its connections to fewer.
const VIEWERS_MAX: usize = 64;

/// A pipeline that has been armed.
#[derive(Debug)]
pub(super) struct NewSession {
    pub(super) tap: PreviewReceiver,
    pub(super) sample_tap: SampleTapReceiver,
    /// The groups of sampled channels.
    pub(super) sampled: Vec<SampledGroupInfo>,
    /// The rigid bodies.
    pub(super) bodies: Vec<BodyInfo>,
    pub(super) progress: Arc<PipelineProgress>,
    pub(super) header: Header,
}

/// The viewers of the live view.
#[derive(Debug, Default)]
pub(super) struct Viewers {
    all: Mutex<VecDeque<Viewer>>,
    closed: Arc<AtomicBool>,
}

#[derive(Debug)]
struct Viewer {
    messages: Sender<LiveMessage>,
    oldest: Receiver<LiveMessage>,
    /// The viewer's end of the feed: gone when the viewer is.
    feed: Weak<()>,
    table: Option<Arc<LiveTable>>,
}

/// The state of the hub's thread.
#[derive(Debug)]
pub(super) struct Hub {
    inner: Arc<Inner>,
    sessions: Receiver<NewSession>,
    session: Option<NewSession>,
    table: Arc<LiveTable>,
    face: Option<FaceOverlay>,
    positions: Vec<Position>,
    /// Columns of sampled channels that wait for the next frame.
    samples: VecDeque<LiveSamples>,
    ranges: Vec<SampleRange>,
    /// Poses of which the frame was not displayed yet.
    poses: Option<PreviewPoses>,
    bodies: Vec<PreviewBody>,
}

impl Viewers {
    pub(super) fn add(&self) -> LiveFeed {
        let (messages, feed) = bounded(WAITING_MAX);
        let alive = Arc::new(());
        let viewer =
            Viewer { messages, oldest: feed.clone(), feed: Arc::downgrade(&alive), table: None };
        let mut all = lock(&self.all);
        if all.len() == VIEWERS_MAX {
            all.pop_front();
        }
        all.push_back(viewer);
        LiveFeed { messages: feed, closed: Arc::clone(&self.closed), _alive: alive }
    }

    pub(super) fn close(&self) {
        self.closed.store(true, Ordering::Relaxed);
        lock(&self.all).clear();
    }

    fn send(&self, table: &Arc<LiveTable>, frame: &Arc<LiveFrame>) {
        lock(&self.all).retain_mut(|viewer| viewer.send(table, frame));
    }

    fn is_empty(&self) -> bool {
        lock(&self.all).is_empty()
    }
}

impl Viewer {
    /// Sends a frame, and the table if needed. Returns `false` if the viewer is gone.
    fn send(&mut self, table: &Arc<LiveTable>, frame: &Arc<LiveFrame>) -> bool {
        if self.feed.strong_count() == 0 {
            return false;
        }
        let knows = self.table.as_ref().is_some_and(|known| Arc::ptr_eq(known, table));
        if !knows {
            // Frames of the previous table are of no use to it.
            while self.oldest.try_recv().is_ok() {}
            if self.messages.try_send(LiveMessage::Table(Arc::clone(table))).is_ok() {
                self.table = Some(Arc::clone(table));
            }
        }
        let frame = LiveMessage::Frame(Arc::clone(frame));
        if let Err(TrySendError::Full(frame)) = self.messages.try_send(frame) {
            // If the table is still waiting, the viewer has not started to read.
            match self.oldest.try_recv() {
                Ok(LiveMessage::Table(_)) => self.table = None,
                _ => drop(self.messages.try_send(frame)),
            }
        }
        true
    }
}

impl Hub {
    pub(super) fn new(inner: &Arc<Inner>) -> (Self, Sender<NewSession>) {
        // At most two wait: a session that is over, and its successor.
        let (sessions_in, sessions) = bounded(2);
        let hub = Self {
            inner: Arc::clone(inner),
            sessions,
            session: None,
            table: Arc::default(),
            face: None,
            positions: Vec::new(),
            samples: VecDeque::with_capacity(COLUMNS_MAX),
            ranges: Vec::new(),
            poses: None,
            bodies: Vec::new(),
        };
        (hub, sessions_in)
    }

    pub(super) fn run(mut self) {
        // Without a session there is nothing to poll. The sender is dropped when the service stops.
        while let Ok(session) = self.sessions.recv() {
            self.begin(session);
            while self.session.as_ref().is_some_and(|session| !session.tap.is_over()) {
                if self.inner.is_stopping() {
                    return;
                }
                if let Ok(session) = self.sessions.try_recv() {
                    self.begin(session);
                }
                self.collect_samples();
                self.publish_frames();
                std::thread::sleep(POLL_INTERVAL);
            }
            self.session = None;
        }
    }

    fn begin(&mut self, session: NewSession) {
        *lock(&self.inner.statistics) = MarkerStatistics::new(session.header.rate_hz);
        let subject = self.inner.core().options.subject.clone();
        let mut table = table(&session, subject.as_deref());
        self.face = FaceOverlay::new(subject.as_deref(), &table.labels);
        table.face = self.face.as_ref().map(FaceOverlay::wireframe);
        self.table = Arc::new(table);
        self.session = Some(session);
        self.samples.clear();
        self.poses = None;
    }

    /// Takes what the sampled channels did.
    fn collect_samples(&mut self) {
        let Some(session) = &mut self.session else { return };
        while let Some(SampleColumn { group: number, first, n, .. }) =
            session.sample_tap.next(&mut self.ranges)
        {
            let mut groups = session.sampled.iter().enumerate();
            let Some((index, group)) = groups.find(|(_, group)| group.id == number) else {
                continue;
            };
            if self.inner.viewers.is_empty() {
                continue;
            }
            if self.samples.len() == COLUMNS_MAX {
                self.samples.pop_front();
            }
            let ranges = values_of(group, &self.ranges);
            self.samples.push_back(LiveSamples { group: index as u8, first, n, ranges });
        }
    }

    fn publish_frames(&mut self) {
        let Some(session) = &mut self.session else { return };
        // Converts the host's monotonic clock to microseconds since 1970.
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let offset_us = since_1970.unwrap_or_default().as_micros() as u64 - monotonic_ns() / 1000;
        while let Some(head) = session.tap.next(&mut self.positions) {
            if self.table.labels.len() != head.n_channels {
                let subject = self.inner.core().options.subject.clone();
                let mut table = table(session, subject.as_deref());
                // A marker that has just appeared has no label until the writer has seen it, and is shown then.
                if table.labels.len() != self.table.labels.len() {
                    self.face = FaceOverlay::new(subject.as_deref(), &table.labels);
                    table.face = self.face.as_ref().map(FaceOverlay::wireframe);
                    self.table = Arc::new(table);
                }
                self.positions.truncate(self.table.labels.len());
            }
            lock(&self.inner.statistics).frame(&head, &self.positions);
            if !head.is_displayed {
                continue;
            }
            if self.inner.viewers.is_empty() {
                // The first viewer gets no old poses.
                while session.tap.next_poses(&mut self.bodies).is_some() {}
                self.poses = None;
                continue;
            }
            let PreviewFrame { row, device_ticks, arrival_ns, .. } = head;
            let arrival_unix_us = offset_us + arrival_ns / 1000;
            let positions_mm = self.positions.clone();
            let face = self.face.as_ref().and_then(|face| face.pose(&positions_mm));
            let samples = self.samples.drain(..).collect();
            // If the poses of this frame have not come yet, they are shown with the next one.
            let mut poses = None;
            while let Some(of) =
                self.poses.take().or_else(|| session.tap.next_poses(&mut self.bodies))
            {
                if of.row > row {
                    self.poses = Some(of);
                    break;
                }
                poses = Some(LivePoses { n_frames: of.n_frames, bodies: self.bodies.clone() });
            }
            let frame = LiveFrame {
                row,
                device_ticks,
                arrival_unix_us,
                positions_mm,
                face,
                samples,
                poses,
            };
            self.inner.viewers.send(&self.table, &Arc::new(frame));
        }
    }
}

fn table(session: &NewSession, subject: Option<&Subject>) -> LiveTable {
    let channels = lock(&session.progress.channels).clone();
    let labels: Vec<String> = channels.iter().map(|channel| channel.label.clone()).collect();
    let limbs = live_limbs(subject, &labels);
    LiveTable {
        bones: with_limbs(marker_lines(&labels), &limbs),
        limbs,
        face: None,
        groups: live_groups(&session.sampled),
        bodies: session.bodies.iter().map(|body| body.name.clone()).collect(),
        labels,
        labelled: channels.iter().map(|channel| channel.labelled).collect(),
        up_axis: session.header.up_axis.code(),
        rate_hz: session.header.rate_hz,
    }
}
