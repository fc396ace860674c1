//! The thread that passes frames from the pipeline's tap to viewers and to the marker statistics: noise, and suspected swaps
//! of markers.

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
use mocapd_report::{column::sample, labels::marker_lines, noise::NoiseEstimator};
use mocapd_take::{
    motion::{Position, is_gap},
    record::{Header, Subject},
};

use super::Inner;
use crate::{
    live::{
        LiveFeed, LiveFrame, LiveMessage, LivePoses, LiveSamples, LiveTable, live_groups, values_of,
    },
    status::MarkerQuality,
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

/// Time between two noise estimates in nanoseconds: the median over a window is too expensive for every frame.
const NOISE_EVERY_NS: u64 = 1_000_000_000;

/// Fourth differences used for an estimate, the newest: its standard error is 4 %. At 36 per burst of the tap and four
/// bursts a second they cover the last 11 seconds, and take 12 KB per marker.
const NOISE_DIFFERENCES: usize = 1536;

/// Largest distance in millimetres from another marker's previous position to suspect a swap: the distance a marker
/// moves in a thirtieth of a second of walking.
const SWAP_DISTANCE_MAX_MM: f64 = 40.0;

/// Smallest distance in millimetres between the two previous positions: closer markers cannot be distinguished.
const SEPARATION_MIN_MM: f64 = 120.0;

/// Statistics by slot.
#[derive(Debug, Default)]
pub(super) struct MarkerStatistics {
    rate_hz: f64,
    markers: Vec<MarkerRecord>,
    /// Positions of the latest frame sent to viewers.
    before: Vec<Position>,
    /// Row of the latest frame.
    last_row: Option<u64>,
    noise_ns: u64,
}

#[derive(Debug, Clone)]
struct MarkerRecord {
    noise: NoiseEstimator,
    noise_mm: Option<f64>,
    swaps: u64,
}

impl Default for MarkerRecord {
    fn default() -> Self {
        Self { noise: NoiseEstimator::new(NOISE_DIFFERENCES), noise_mm: None, swaps: 0 }
    }
}

impl MarkerStatistics {
    pub(super) fn new(rate_hz: f64) -> Self {
        Self { rate_hz, ..Self::default() }
    }

    /// Adds a frame of the tap.
    pub(super) fn frame(&mut self, head: &PreviewFrame, positions: &[Position]) {
        self.markers.resize_with(positions.len(), MarkerRecord::default);
        // Samples are not consecutive between two bursts, and where frames were lost.
        if self.last_row.is_none_or(|last| head.row != last + 1) {
            self.markers.iter_mut().for_each(|marker| marker.noise.end_run());
        }
        self.last_row = Some(head.row);
        for (marker, &position) in self.markers.iter_mut().zip(positions) {
            marker.noise.push(sample(position));
        }
        if head.arrival_ns.saturating_sub(self.noise_ns) >= NOISE_EVERY_NS {
            self.noise_ns = head.arrival_ns;
            self.markers.iter_mut().for_each(|marker| marker.noise_mm = marker.noise.noise_mm());
        }
        if head.is_displayed {
            self.find_swaps(positions);
            self.before.clear();
            self.before.extend_from_slice(positions);
        }
    }

    /// Finds pairs of markers that exchanged their positions.
    fn find_swaps(&mut self, positions: &[Position]) {
        if self.before.len() != positions.len() {
            return;
        }
        for (slot, &now) in positions.iter().enumerate() {
            let was = self.before[slot];
            // Ends here for most markers, which moved little.
            if is_gap(now) || is_gap(was) || distance_mm(now, was) < SEPARATION_MIN_MM {
                continue;
            }
            let other = (0..positions.len()).find(|&other| {
                other != slot
                    && distance_mm(now, self.before[other]) < SWAP_DISTANCE_MAX_MM
                    && (is_gap(positions[other])
                        || distance_mm(positions[other], was) < SWAP_DISTANCE_MAX_MM)
            });
            self.markers[slot].swaps += u64::from(other.is_some());
        }
    }
}

/// The distance between two positions; infinite if one is a gap.
fn distance_mm(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    let distance_mm = squares.sum::<f64>().sqrt();
    if distance_mm.is_nan() { f64::INFINITY } else { distance_mm }
}

impl Inner {
    pub(super) fn quality(&self) -> Vec<MarkerQuality> {
        let core = self.core();
        let Some(session) = &core.session else { return Vec::new() };
        let (progress, seen) = (session.progress.clone(), session.seen.clone());
        drop(core);
        let channels = lock(&progress.channels).clone();
        let statistics = lock(&self.statistics);
        let of_slot = |(slot, channel): (usize, mocapd_take::record::Channel)| {
            let seen = seen.get(slot).unwrap_or_default();
            let judged = statistics.markers.get(slot);
            let noise_mm = judged.and_then(|judged| judged.noise_mm);
            MarkerQuality {
                label: channel.label,
                labelled: channel.labelled,
                visible: seen.present as f64 / seen.rows.max(1) as f64,
                gaps: seen.gaps,
                longest_gap_s: seen.longest_gap as f64 / statistics.rate_hz.max(1e-3),
                noise_mm,
                still_sigma_mm: noise_mm,
                swaps_suspected: judged.map_or(0, |judged| judged.swaps),
            }
        };
        channels.into_iter().enumerate().map(of_slot).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: u64 = 240;

    /// Plays bursts of the tap for 12 s, and one frame in eight between them.
    fn judged(position: impl Fn(u64) -> Vec<Position>) -> Vec<MarkerRecord> {
        let mut statistics = MarkerStatistics::new(RATE_HZ as f64);
        for row in 0..12 * RATE_HZ {
            let is_displayed = row % 8 == 0;
            if is_displayed || row % 60 < 16 {
                let arrival_ns = 1_000_000_000 + row * 1_000_000_000 / RATE_HZ;
                let head =
                    PreviewFrame { row, arrival_ns, is_displayed, ..PreviewFrame::default() };
                statistics.frame(&head, &position(row));
            }
        }
        statistics.markers
    }

    /// A pseudo-random normal number: the same for the same arguments.
    fn normal(seed: u64, row: u64) -> f32 {
        let mut state =
            seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ row.wrapping_mul(0xD1B5_4A32_D192_ED03);
        let mut sum = -6.0;
        for _ in 0..12 {
            state ^= state >> 29;
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_041);
            sum += (state >> 40) as f32 / (1_u32 << 24) as f32;
        }
        sum
    }

    #[test]
    fn noise_is_estimated_for_still_and_moving_markers() {
        let noisy = |seed: u64, row: u64, noise_mm: f32, centre: [f32; 3]| {
            let axis = |axis: usize| centre[axis] + noise_mm * normal(3 * seed + axis as u64, row);
            [axis(0), axis(1), axis(2)]
        };
        let markers = judged(|row| {
            let t = row as f32 / RATE_HZ as f32;
            let swings = [800.0 * t, 200.0 * (6.0 * t).sin(), 900.0 + 80.0 * (12.0 * t).cos()];
            vec![
                noisy(1, row, 0.05, [500.0, 5.0, 7.0]),
                noisy(2, row, 0.3, swings),
                [1.0, 2.0, 3.0],
                [f32::NAN; 3],
            ]
        });
        for (marker, noise_mm) in markers.iter().zip([0.05, 0.3]) {
            let found = marker.noise_mm.unwrap();
            assert!((found / noise_mm - 1.0).abs() < 0.1, "{found} of {noise_mm}");
        }
        assert_eq!((markers[2].noise_mm, markers[3].noise_mm), (None, None));
        assert!(markers.iter().all(|marker| marker.swaps == 0));
    }

    #[test]
    fn swapped_markers_are_suspected_and_fast_ones_are_not() {
        let markers = judged(|row| {
            let step = row as f32 / 8.0;
            let (a, b) = ([0.0, step, 0.0], [400.0, 0.0, step]);
            let fast = [step * 150.0, 2000.0, 0.0];
            if row < 320 { vec![a, b, fast] } else { vec![b, a, fast] }
        });
        let swaps: Vec<_> = markers.iter().map(|marker| marker.swaps).collect();
        assert_eq!(swaps, [1, 1, 0]);
    }
}
