//! What a device sends, for one publisher: frames with their markers and poses, and batches of sampled channels, copied into
//! rings beside those of the recording, without waiting. What does not fit is left out and counted.
//!
//! Frames and batches have separate rings, so that neither takes room from the other. Nothing is copied of what nobody
//! wants, and the memory of a ring is not used before something is.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use mocapd_codec::poses::{POSE_CHANNELS, PoseRow};
use mocapd_drivers::{
    device::{SampleBatch, SampleForm},
    link::SAMPLE_VALUES_MAX,
};
use mocapd_take::{
    motion::{GAP, Position},
    poses::{Pose, PoseReader},
    record::SampledGroup,
};

use super::{
    PipelineConfig,
    plan::POSES_WAIT_NS,
    ring::{RingConsumer, RingProducer, Sample, ring},
};
use crate::host_clock::monotonic_ns;

/// Time of what the rings hold, in seconds: many times what a thread waits for a processor.
const HELD_S: f64 = 0.5;

/// Frames that they hold at least.
const HELD_FRAMES_MIN: usize = 64;

/// Memory of the markers and poses, and that of the samples: beyond it the rings hold them for a shorter time. 200 markers at
/// 1000 Hz need 2 MB, as do 64 channels at 10 kHz.
const HELD_BYTES_MAX: usize = 16 << 20;

/// Batches that the rings hold at least and at most: half a second of groups of 1 kHz that come one sample at a time needs 500
/// each, of which there are 16 at most; faster ones come in longer batches.
const HELD_BATCHES_MIN: usize = 64;
const HELD_BATCHES_MAX: usize = 1 << 14;

/// A marker of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TappedMarker {
    /// Its position; NaN if it was not seen.
    pub position_mm: Position,
    /// The device's residual in units of 10 micrometres; 0 if it reports none.
    pub residual_10um: u8,
}

/// A frame. Kept from one to the next, it is filled without allocation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TappedFrame {
    /// Its row, counted from the start of the pipeline. A row that is skipped is a frame that did not arrive, or was left out.
    pub row: u64,
    /// Time by the device's clock.
    pub device_ticks: u64,
    /// Arrival of its last byte, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// Its markers, by slot.
    pub markers: Vec<TappedMarker>,
    /// The poses of all bodies, in the order in which the device announced them, as the device sent them; empty if none came
    /// with the frame.
    pub poses: Vec<Pose>,
    /// Whether poses were wanted when it arrived: where they were not, `poses` is empty.
    pub wants_poses: bool,
    /// Frames before it that arrived and were left out here, because the rings were full.
    pub frames_left_out: u64,
}

/// A batch of a group of sampled channels. Kept from one to the next, it is filled without allocation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TappedBatch {
    /// The number of the group.
    pub group: u8,
    /// Number of its first sample, counted from the start of the pipeline. Numbers that are skipped are samples that did not
    /// arrive, or were left out.
    pub first: u64,
    /// Time of its first sample by the device's clock.
    pub device_ticks: u64,
    /// The form in which it was sent.
    pub form: SampleForm,
    /// Number of channels.
    pub n_channels: u8,
    /// The samples as the device sent them, one after another; of each, all channels in order.
    pub samples: Vec<f32>,
    /// Batches before it, of any group, that were left out here, because the rings were full.
    pub batches_left_out: u64,
}

/// What a tap has left out of what was wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOut {
    /// Frames, because the rings were full.
    pub frames: u64,
    /// Frames whose poses were left out, because the rings were full, or they came without their frame or long after it.
    pub poses: u64,
    /// Batches of samples, because the rings were full.
    pub batches: u64,
}

/// What both ends know: what a publisher wants at present, and what it has not got.
#[derive(Debug, Default)]
struct TapState {
    wants_frames: AtomicBool,
    wants_poses: AtomicBool,
    wants_samples: AtomicBool,
    frames_left_out: AtomicU64,
    poses_left_out: AtomicU64,
    batches_left_out: AtomicU64,
}

#[derive(Debug, Clone, Copy)]
struct FrameHead {
    row: u64,
    device_ticks: u64,
    arrival_ns: u64,
    n_channels: usize,
    left_out: u64,
    /// Whether its poses are wanted.
    wants_poses: bool,
    /// Whether they are wanted and expected.
    awaits_poses: bool,
}

#[derive(Debug, Clone, Copy)]
struct PosesHead {
    row: u64,
}

#[derive(Debug, Clone, Copy)]
struct BatchHead {
    group: u8,
    n_channels: u8,
    form: SampleForm,
    n_values: u32,
    first: u64,
    device_ticks: u64,
    left_out: u64,
}

/// The last frame.
#[derive(Debug, Clone, Copy)]
struct LastFrame {
    seq: u32,
    row: u64,
    /// Whether its poses are to be copied: it was, and they were not.
    wants_poses: bool,
}

/// Where and when a frame arrived.
#[derive(Debug, Clone, Copy)]
pub(super) struct FramePlace {
    pub(super) seq: u32,
    pub(super) row: u64,
    pub(super) device_ticks: u64,
    pub(super) arrival_ns: u64,
}

/// The reader's end.
#[derive(Debug)]
pub(super) struct PublishTapSender {
    frames: RingProducer<FrameHead>,
    markers: RingProducer<Sample>,
    poses: RingProducer<PosesHead>,
    pose_rows: RingProducer<PoseRow>,
    batches: RingProducer<BatchHead>,
    samples: RingProducer<f32>,
    state: Arc<TapState>,
    n_bodies: usize,
    last: Option<LastFrame>,
    /// Frames without poses up to the last one, and after how many of them none are expected any more: those of a second.
    misses: u32,
    misses_max: u32,
    /// Frames and batches left out since the last that was not.
    frames_left_out: u64,
    batches_left_out: u64,
}

/// The publisher's end.
#[derive(Debug)]
pub struct PublishTap {
    frames: RingConsumer<FrameHead>,
    markers: RingConsumer<Sample>,
    poses: RingConsumer<PosesHead>,
    pose_rows: RingConsumer<PoseRow>,
    batches: RingConsumer<BatchHead>,
    samples: RingConsumer<f32>,
    state: Arc<TapState>,
    /// The bodies of every frame that has poses.
    n_bodies: usize,
    reader: PoseReader,
    /// A frame that waits for its poses, and poses of a later frame.
    waiting_frame: Option<FrameHead>,
    /// When the frame that waits was first looked at.
    waits_since_ns: u64,
    waiting_poses: Option<PosesHead>,
    row: Vec<Sample>,
    bodies: Vec<PoseRow>,
}

/// The ends of a tap for frames of up to `n_slots` channels.
pub(super) fn publish_tap(
    config: &PipelineConfig,
    n_slots: usize,
) -> (PublishTapSender, PublishTap) {
    let n_bodies = config.recorded_bodies().len();
    let frame_bytes = n_slots * size_of::<Sample>()
        + n_bodies * size_of::<PoseRow>()
        + size_of::<FrameHead>()
        + size_of::<PosesHead>();
    let n_frames =
        ((config.rate_hz * HELD_S) as usize).min(HELD_BYTES_MAX / frame_bytes).max(HELD_FRAMES_MIN);
    let (mut n_batches, mut n_values) = (0.0, 0.0);
    for group in &config.sampled {
        let n_samples = f64::from(group.rate_millihertz) / 1000.0 * HELD_S;
        n_batches += n_samples;
        n_values += n_samples * group.channels.len() as f64;
    }
    let n_batches = (n_batches as usize).clamp(HELD_BATCHES_MIN, HELD_BATCHES_MAX);
    let n_values = (n_values as usize).min(HELD_BYTES_MAX / size_of::<f32>());
    // The longest batch fits while another is read.
    let n_values = if config.sampled.is_empty() { 1 } else { n_values.max(2 * SAMPLE_VALUES_MAX) };
    let (frames, frames_out) = ring(n_frames);
    let (markers, markers_out) = ring(n_frames * n_slots.max(1));
    let (poses, poses_out) = ring(n_frames);
    let (pose_rows, pose_rows_out) = ring(n_frames * n_bodies.max(1));
    let (batches, batches_out) = ring(n_batches);
    let (samples, samples_out) = ring(n_values);
    let state = Arc::new(TapState::default());
    let sender = PublishTapSender {
        frames,
        markers,
        poses,
        pose_rows,
        batches,
        samples,
        state: Arc::clone(&state),
        n_bodies,
        last: None,
        misses: 0,
        misses_max: (config.rate_hz.ceil() as u32).max(1),
        frames_left_out: 0,
        batches_left_out: 0,
    };
    let tap = PublishTap {
        frames: frames_out,
        markers: markers_out,
        poses: poses_out,
        pose_rows: pose_rows_out,
        batches: batches_out,
        samples: samples_out,
        state,
        n_bodies,
        // The rows are not rounded.
        reader: PoseReader::new(&SampledGroup::default()),
        waiting_frame: None,
        waits_since_ns: 0,
        waiting_poses: None,
        row: Vec::new(),
        bodies: Vec::new(),
    };
    (sender, tap)
}

impl PublishTapSender {
    /// Copies a frame, if somebody wants it.
    pub(super) fn frame(&mut self, place: FramePlace, row: &[Sample]) {
        let FramePlace { seq, row: number, device_ticks, arrival_ns } = place;
        self.misses = self.misses.saturating_add(1);
        self.last = Some(LastFrame { seq, row: number, wants_poses: false });
        if !self.state.wants_frames.load(Ordering::Acquire) {
            self.frames_left_out = 0;
            return;
        }
        if self.frames.vacant() == 0 || self.markers.vacant() < row.len() {
            self.frames_left_out += 1;
            self.state.frames_left_out.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let wants_poses = self.state.wants_poses.load(Ordering::Relaxed);
        self.markers.push_slice(row);
        self.frames.push(FrameHead {
            row: number,
            device_ticks,
            arrival_ns,
            n_channels: row.len(),
            left_out: std::mem::take(&mut self.frames_left_out),
            wants_poses,
            awaits_poses: wants_poses && self.n_bodies > 0 && self.misses <= self.misses_max,
        });
        self.last = Some(LastFrame { seq, row: number, wants_poses });
    }

    /// Copies the poses of the last frame, if it was copied.
    pub(super) fn poses(&mut self, seq: u32, rows: &[PoseRow]) {
        self.misses = 0;
        let is_late = || {
            let TapState { wants_frames, wants_poses, .. } = &*self.state;
            wants_frames.load(Ordering::Relaxed) && wants_poses.load(Ordering::Relaxed)
        };
        match &mut self.last {
            Some(last) if last.seq == seq => {
                if !std::mem::take(&mut last.wants_poses) {
                    return;
                }
                if self.poses.vacant() > 0 && self.pose_rows.vacant() >= rows.len() {
                    self.pose_rows.push_slice(rows);
                    self.poses.push(PosesHead { row: last.row });
                    return;
                }
            }
            // Their frame was lost, or another has come since.
            _ if is_late() => {}
            _ => return,
        }
        self.state.poses_left_out.fetch_add(1, Ordering::Relaxed);
    }

    /// The device was away or starts again, and its numbers with it: no poses belong to the last frame.
    pub(super) fn forget_frame(&mut self) {
        self.last = None;
    }

    /// Copies a batch, if somebody wants it; `first` is the number of its first sample since the pipeline began.
    pub(super) fn batch(&mut self, first: u64, batch: &SampleBatch<'_>) {
        if !self.state.wants_samples.load(Ordering::Relaxed) {
            self.batches_left_out = 0;
            return;
        }
        let n_values = batch.samples.len();
        if n_values == 0 {
            return;
        }
        if self.batches.vacant() == 0 || self.samples.vacant() < n_values {
            self.batches_left_out += 1;
            self.state.batches_left_out.fetch_add(1, Ordering::Relaxed);
            return;
        }
        self.samples.push_slice(batch.samples);
        self.batches.push(BatchHead {
            group: batch.group,
            n_channels: batch.n_channels,
            form: batch.form,
            n_values: n_values as u32,
            first,
            device_ticks: batch.device_ticks,
            left_out: std::mem::take(&mut self.batches_left_out),
        });
    }
}

impl PublishTap {
    /// Whether frames, their poses, and batches of samples are wanted from now on. At first none is. Where poses are not wanted,
    /// frames do not wait for them.
    pub fn set_wanted(&self, frames: bool, poses: bool, samples: bool) {
        self.state.wants_poses.store(poses, Ordering::Relaxed);
        // The first frame has its poses, if both are wanted.
        self.state.wants_frames.store(frames, Ordering::Release);
        self.state.wants_samples.store(samples, Ordering::Relaxed);
    }

    /// What was left out so far of what was wanted.
    #[must_use]
    pub fn left_out(&self) -> LeftOut {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        LeftOut {
            frames: of(&self.state.frames_left_out),
            poses: of(&self.state.poses_left_out),
            batches: of(&self.state.batches_left_out),
        }
    }

    /// Frees the rings for a publisher that will not take what waits there: it counts as left out. Returns all that was.
    #[must_use]
    pub fn abandon(mut self) -> LeftOut {
        self.set_wanted(false, false, false);
        let mut left_out = self.left_out();
        left_out.frames += u64::from(self.waiting_frame.take().is_some());
        left_out.frames += std::iter::from_fn(|| self.frames.pop()).count() as u64;
        left_out.batches += std::iter::from_fn(|| self.batches.pop()).count() as u64;
        left_out
    }

    /// Fills `frame` with the next one, which has waited for its poses. Returns `false` if there is none yet.
    pub fn next_frame(&mut self, frame: &mut TappedFrame) -> bool {
        self.next_frame_at(monotonic_ns(), frame)
    }

    fn next_frame_at(&mut self, now_ns: u64, frame: &mut TappedFrame) -> bool {
        let head = match self.waiting_frame.take() {
            Some(head) => head,
            None => {
                self.waits_since_ns = now_ns;
                match self.frames.pop() {
                    Some(head) => head,
                    None => return false,
                }
            }
        };
        // Looked at before the poses: those of this frame are in their ring before the next frame is in its own.
        let is_followed = !self.frames.is_empty() || self.frames.is_over();
        frame.poses.clear();
        let is_complete = self.n_bodies == 0 || self.take_poses(head.row, &mut frame.poses);
        let is_late = now_ns.saturating_sub(self.waits_since_ns) >= POSES_WAIT_NS;
        if head.awaits_poses && !(is_complete || is_followed || is_late) {
            self.waiting_frame = Some(head);
            return false;
        }
        self.row.clear();
        self.row.resize(head.n_channels, Sample::default());
        self.markers.pop_slice(&mut self.row);
        frame.markers.clear();
        frame.markers.extend(self.row.iter().map(|sample| TappedMarker {
            position_mm: if sample.present { sample.position_mm } else { GAP },
            residual_10um: sample.residual_10um,
        }));
        frame.row = head.row;
        frame.device_ticks = head.device_ticks;
        frame.arrival_ns = head.arrival_ns;
        frame.frames_left_out = head.left_out;
        frame.wants_poses = head.wants_poses;
        true
    }

    /// Appends the poses of a row. Returns whether they came, or will not come any more.
    fn take_poses(&mut self, row: u64, poses: &mut Vec<Pose>) -> bool {
        while let Some(head) = self.waiting_poses.take().or_else(|| self.poses.pop()) {
            if head.row > row {
                self.waiting_poses = Some(head);
                return true;
            }
            self.bodies.clear();
            self.bodies.resize(self.n_bodies, [f32::NAN; POSE_CHANNELS]);
            self.pose_rows.pop_slice(&mut self.bodies);
            if head.row == row {
                poses.extend(self.bodies.iter().map(|numbers| self.reader.pose(numbers)));
                return true;
            }
            // Their frame did not wait any longer.
            self.state.poses_left_out.fetch_add(1, Ordering::Relaxed);
        }
        false
    }

    /// Fills `batch` with the next one. Returns `false` if there is none yet.
    pub fn next_batch(&mut self, batch: &mut TappedBatch) -> bool {
        let Some(head) = self.batches.pop() else { return false };
        batch.samples.clear();
        batch.samples.resize(head.n_values as usize, 0.0);
        self.samples.pop_slice(&mut batch.samples);
        batch.group = head.group;
        batch.first = head.first;
        batch.device_ticks = head.device_ticks;
        batch.form = head.form;
        batch.n_channels = head.n_channels;
        batch.batches_left_out = head.left_out;
        true
    }

    /// Whether nothing more will come.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.waiting_frame.is_none() && self.frames.is_over() && self.batches.is_over()
    }
}

/// Nothing is copied for a publisher that is gone.
impl Drop for PublishTap {
    fn drop(&mut self) {
        self.set_wanted(false, false, false);
    }
}

#[cfg(test)]
mod tests {
    use mocapd_codec::{ResamplerKind, Settings, Tolerance, poses::without_pose};
    use mocapd_drivers::device::{BodyInfo, SampledChannelInfo, SampledGroupInfo};
    use mocapd_take::poses::PoseState;

    use super::*;

    fn tap(n_bodies: u16) -> (PublishTapSender, PublishTap) {
        let tolerance = Tolerance::from_mm(1.0).unwrap();
        let lossless = Settings { kind: ResamplerKind::Lossless, tolerance };
        let body = |id| BodyInfo { id, name: id.to_string() };
        let channels = vec![SampledChannelInfo::default(); 2];
        let group = SampledGroupInfo {
            rate_millihertz: 1_000_000,
            channels,
            ..SampledGroupInfo::default()
        };
        let config = PipelineConfig {
            bodies: (0..n_bodies).map(body).collect(),
            sampled: vec![group],
            ..PipelineConfig::new(lossless, 100.0, 1000, Vec::new())
        };
        publish_tap(&config, 2)
    }

    fn place(seq: u32) -> FramePlace {
        FramePlace { seq, row: u64::from(seq) + 100, device_ticks: 7, arrival_ns: 1_000_000 }
    }

    const ROW: [Sample; 2] = [
        Sample { position_mm: [1.0, 2.0, 3.0], present: true, residual_10um: 7 },
        Sample { position_mm: [0.0; 3], present: false, residual_10um: 0 },
    ];

    #[test]
    fn every_frame_comes_through_or_is_counted() {
        let (mut sender, mut tap) = tap(0);
        let mut frame = TappedFrame::default();
        sender.frame(place(0), &ROW);
        assert!(!tap.next_frame(&mut frame), "nobody wanted it");
        tap.set_wanted(true, true, false);
        for seq in 1..=70 {
            sender.frame(place(seq), &ROW);
        }
        for seq in 1..=64 {
            assert!(tap.next_frame(&mut frame));
            assert_eq!((frame.row, frame.frames_left_out), (seq + 100, 0));
        }
        let found = frame.markers[0];
        assert_eq!((found.position_mm, found.residual_10um), ([1.0, 2.0, 3.0], 7));
        assert!(frame.markers[1].position_mm[0].is_nan() && frame.poses.is_empty());
        sender.frame(place(71), &ROW);
        assert!(tap.next_frame(&mut frame) && !tap.is_over());
        assert_eq!((frame.row, frame.frames_left_out), (171, 6));
        drop(sender);
        assert!(tap.is_over());
    }

    #[test]
    fn a_frame_waits_for_its_poses_but_not_for_long() {
        let (mut sender, mut tap) = tap(2);
        tap.set_wanted(true, true, false);
        let (mut frame, now) = (TappedFrame::default(), 1_000_000);
        let tracked = [5.0, 6.0, 7.0, 0.6, 0.0, 0.8, 0.0, 0.25];
        let rows = [tracked, without_pose(&tracked, 1)];
        sender.frame(place(1), &ROW);
        assert!(!tap.next_frame_at(now, &mut frame), "its poses have not come");
        sender.poses(1, &rows);
        sender.poses(1, &rows);
        assert!(tap.next_frame_at(now, &mut frame));
        assert_eq!((frame.row, frame.markers.len(), tap.left_out()), (101, 2, LeftOut::default()));
        let [first, second] = frame.poses[..] else { panic!("two bodies") };
        assert_eq!((first.state, first.position_mm), (PoseState::Tracked, [5.0, 6.0, 7.0]));
        assert_eq!((first.quaternion, first.residual_mm), ([0.6, 0.0, 0.8, 0.0], 0.25));
        assert_eq!(second.state, PoseState::Lost);
        // Without poses: when the next frame is there, or after a while. Those that come then are counted.
        sender.frame(place(2), &ROW);
        sender.frame(place(3), &ROW);
        assert!(tap.next_frame_at(now, &mut frame) && frame.poses.is_empty());
        assert!(!tap.next_frame_at(now, &mut frame));
        assert!(tap.next_frame_at(now + POSES_WAIT_NS, &mut frame) && frame.poses.is_empty());
        sender.poses(3, &rows);
        sender.poses(2, &rows);
        sender.frame(place(4), &ROW);
        sender.poses(4, &rows);
        assert!(tap.next_frame_at(now, &mut frame));
        assert_eq!((frame.row, frame.poses.len(), tap.left_out().poses), (104, 2, 2));
        // Its numbers begin again: these are not the poses of the last frame before.
        sender.forget_frame();
        sender.poses(4, &rows);
        assert_eq!(tap.left_out().poses, 3);
    }

    #[test]
    fn frames_of_bodies_that_are_never_sent_do_not_wait() {
        let (mut sender, mut tap) = tap(2);
        tap.set_wanted(true, true, false);
        let (mut frame, now) = (TappedFrame::default(), 1_000_000);
        let mut wait = |sender: &mut PublishTapSender, seq, tap: &mut PublishTap| {
            sender.frame(place(seq), &ROW);
            let is_at_once = tap.next_frame_at(now, &mut frame);
            assert_eq!(tap.next_frame_at(now + POSES_WAIT_NS, &mut frame), !is_at_once);
            !is_at_once
        };
        // The first second, a hundred frames.
        assert!((0..100).all(|seq| wait(&mut sender, seq, &mut tap)));
        assert!(!(100..120).any(|seq| wait(&mut sender, seq, &mut tap)));
        sender.poses(119, &[[0.0; POSE_CHANNELS]; 2]);
        assert!(wait(&mut sender, 120, &mut tap), "they are sent again");
        tap.set_wanted(true, false, false);
        assert!(!wait(&mut sender, 121, &mut tap), "nobody wants them");
        sender.poses(121, &[[0.0; POSE_CHANNELS]; 2]);
        sender.frame(place(122), &ROW);
        assert_eq!(tap.abandon(), LeftOut { frames: 1, poses: 1, batches: 0 });
    }

    #[test]
    fn a_frame_says_whether_its_poses_were_wanted() {
        let (mut sender, mut tap) = tap(1);
        let mut frame = TappedFrame::default();
        for (seq, is_wanted) in [(1, false), (2, true), (3, false)] {
            tap.set_wanted(true, is_wanted, false);
            sender.frame(place(seq), &ROW);
            sender.poses(seq, &[[0.0; POSE_CHANNELS]]);
        }
        for is_wanted in [false, true, false] {
            assert!(tap.next_frame(&mut frame));
            assert_eq!((frame.wants_poses, frame.poses.len()), (is_wanted, usize::from(is_wanted)));
        }
        assert_eq!(tap.left_out(), LeftOut::default());
    }

    #[test]
    fn what_nobody_wanted_is_not_left_out() {
        let (mut sender, tap) = tap(1);
        let rows = [[0.0; POSE_CHANNELS]];
        for seq in 0..200 {
            sender.frame(place(seq), &ROW);
            // A client comes between a frame and its poses.
            tap.set_wanted(seq == 150, seq == 150, false);
            sender.poses(seq, &rows);
        }
        assert_eq!(tap.left_out(), LeftOut::default());
    }

    #[test]
    fn every_batch_comes_through_or_is_counted() {
        let (mut sender, mut tap) = tap(0);
        tap.set_wanted(false, false, true);
        let values: Vec<f32> = (0..SAMPLE_VALUES_MAX as u16).map(f32::from).collect();
        let batch = |samples| SampleBatch {
            group: 3,
            number: 0,
            first: 0,
            device_ticks: 9,
            form: SampleForm::Float32,
            n_channels: 2,
            samples,
        };
        for first in [0, 8192, 16384] {
            sender.batch(first, &batch(&values));
        }
        sender.frame(place(1), &ROW);
        let (mut found, mut frame) = (TappedBatch::default(), TappedFrame::default());
        assert!(!tap.next_frame(&mut frame), "only samples are wanted");
        for first in [0, 8192] {
            assert!(tap.next_batch(&mut found));
            assert_eq!((found.group, found.first, found.batches_left_out), (3, first, 0));
            assert_eq!((found.n_channels, found.device_ticks), (2, 9));
            assert!(found.samples == values && found.form == SampleForm::Float32);
        }
        assert!(!tap.next_batch(&mut found));
        sender.batch(24576, &batch(&values[..2]));
        assert!(tap.next_batch(&mut found));
        assert_eq!((found.first, found.batches_left_out, tap.left_out().batches), (24576, 1, 1));
        assert_eq!(found.samples, [0.0, 1.0]);
    }
}
