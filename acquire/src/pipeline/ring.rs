//! Lock-free rings with a single producer and a single consumer, allocated once.
//!
//! Items are `Copy`, so that no accounting bug can free one twice. Only this module names the crate behind the
//! rings.
//!
//! The preview uses two rings: about thirty frames per second for display, and from time to time a burst of consecutive
//! frames from which noise is estimated. Frames that do not fit are left out of the preview.

use std::fmt;

use mocapd_codec::poses::{POSE_CHANNELS, PoseRow};
use mocapd_take::{
    motion::{GAP, Position},
    poses::{Pose, PoseReader},
    record::SampledGroup,
    timeline::{LossCauses, RowTime},
};
use ringbuf::{
    HeapCons, HeapProd, HeapRb,
    traits::{Consumer, Observer, Producer, Split},
};

/// One channel's row: 16 bytes, four per cache line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sample {
    pub(super) position_mm: [f32; 3],
    pub(super) present: bool,
    pub(super) residual_10um: u8,
}

const _: () = assert!(size_of::<Sample>() == 16);

/// An entry of the timeline, in the order of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimelineItem {
    Recorded(RowTime),
    Lost { rows: u64, causes: LossCauses },
}

/// The reader's end.
pub(super) struct RingProducer<T>(HeapProd<T>);

/// The group's end.
pub(super) struct RingConsumer<T>(HeapCons<T>);

/// A ring of `capacity` items.
pub(super) fn ring<T: Copy>(capacity: usize) -> (RingProducer<T>, RingConsumer<T>) {
    let (producer, consumer) = HeapRb::new(capacity).split();
    (RingProducer(producer), RingConsumer(consumer))
}

impl<T: Copy> RingProducer<T> {
    /// Number of items that certainly fit: never more than really do.
    pub(super) fn vacant(&self) -> usize {
        self.0.vacant_len()
    }

    /// Fill level in thousandths.
    pub(super) fn fill_permille(&self) -> u64 {
        (self.0.occupied_len() * 1000 / self.0.capacity().get()) as u64
    }

    /// Pushes an item. [`vacant`](Self::vacant) must have shown that it fits.
    pub(super) fn push(&mut self, item: T) {
        let pushed = self.0.try_push(item).is_ok();
        debug_assert!(pushed, "pushed into a full ring");
    }
}

impl<T: Copy> RingProducer<T> {
    /// Pushes items. [`vacant`](Self::vacant) must have shown that they fit.
    pub(super) fn push_slice(&mut self, items: &[T]) {
        let n = self.0.push_slice(items);
        debug_assert_eq!(n, items.len(), "pushed into a full ring");
    }
}

impl<T: Copy> RingConsumer<T> {
    pub(super) fn pop(&mut self) -> Option<T> {
        self.0.try_pop()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether no more items will come: the producer is gone, and the ring is empty.
    pub(super) fn is_over(&self) -> bool {
        !self.0.write_is_held() && self.0.is_empty()
    }

    /// Fills the front of `items`, and returns how many items there were.
    pub(super) fn pop_slice(&mut self, items: &mut [T]) -> usize {
        self.0.pop_slice(items)
    }
}

impl<T> fmt::Debug for RingProducer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RingProducer({} of {})", self.0.occupied_len(), self.0.capacity())
    }
}

impl<T> fmt::Debug for RingConsumer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RingConsumer({} of {})", self.0.occupied_len(), self.0.capacity())
    }
}

/// Interval between displayed frames: a little shorter than 1/30 s, so that aliasing with the
/// device's rate does not reduce them to 20 per second.
const DISPLAY_INTERVAL_NS: u64 = 32_000_000;

/// Consecutive frames of a burst: enough for 12 fourth differences and 10 sixth ones.
const BURST_FRAMES: u32 = 16;

/// Time between the starts of two bursts.
const BURST_INTERVAL_NS: u64 = 250_000_000;

/// Frames in the queue: two bursts, at least a quarter of a second. A viewer's thread polls every few milliseconds.
const QUEUED_FRAMES_MAX: usize = 2 * BURST_FRAMES as usize;

/// The data of a previewed frame besides its positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PreviewFrame {
    /// Its row, counted from the start of the pipeline.
    pub row: u64,
    /// Time by the device's clock.
    pub device_ticks: u64,
    /// Arrival of its last byte, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// Number of channels.
    pub n_channels: usize,
    /// Whether to display it; otherwise it belongs to a burst only.
    pub is_displayed: bool,
}

/// A rigid body in a previewed frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreviewBody {
    /// Its pose, as the device sent it.
    pub pose: Pose,
    /// Frames with poses in which it was tracked, up to this one, since the pipeline began.
    pub n_tracked: u64,
}

/// A body as it is stored in the ring.
#[derive(Debug, Clone, Copy)]
struct BodyItem {
    row: PoseRow,
    n_tracked: u64,
}

/// The poses of a displayed frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PreviewPoses {
    /// The row of their frame.
    pub row: u64,
    /// Frames with poses, up to this one, since the pipeline began.
    pub n_frames: u64,
}

/// The reader's end of the preview.
#[derive(Debug)]
pub(super) struct PreviewSender {
    heads: RingProducer<PreviewFrame>,
    positions: RingProducer<Position>,
    poses: RingProducer<PreviewPoses>,
    bodies: RingProducer<BodyItem>,
    /// Number and row of the last frame, if it is displayed and its poses have not come.
    awaits_poses: Option<(u32, u64)>,
    last_display_ns: u64,
    last_burst_ns: u64,
    burst_left: u32,
}

/// The viewer's end of the preview.
#[derive(Debug)]
pub struct PreviewReceiver {
    heads: RingConsumer<PreviewFrame>,
    positions: RingConsumer<Position>,
    poses: RingConsumer<PreviewPoses>,
    bodies: RingConsumer<BodyItem>,
    n_bodies: usize,
    reader: PoseReader,
    items: Vec<BodyItem>,
}

pub(super) fn tap(n_slots: usize, n_bodies: usize) -> (PreviewSender, PreviewReceiver) {
    let (heads, heads_out) = ring(QUEUED_FRAMES_MAX);
    let (positions, positions_out) = ring(QUEUED_FRAMES_MAX * n_slots.max(1));
    let (poses, poses_out) = ring(QUEUED_FRAMES_MAX);
    let (bodies, bodies_out) = ring(QUEUED_FRAMES_MAX * n_bodies.max(1));
    let out = PreviewReceiver {
        heads: heads_out,
        positions: positions_out,
        poses: poses_out,
        bodies: bodies_out,
        n_bodies,
        // The rows are not rounded.
        reader: PoseReader::new(&SampledGroup::default()),
        items: Vec::new(),
    };
    let sender = PreviewSender {
        heads,
        positions,
        poses,
        bodies,
        awaits_poses: None,
        last_display_ns: 0,
        last_burst_ns: 0,
        burst_left: 0,
    };
    (sender, out)
}

impl PreviewSender {
    /// Offers a frame with this number, which is queued if it is due for display or part of a burst.
    pub(super) fn offer(&mut self, seq: u32, head: PreviewFrame, row: &[Sample]) {
        self.awaits_poses = None;
        let is_displayed =
            head.arrival_ns.saturating_sub(self.last_display_ns) >= DISPLAY_INTERVAL_NS;
        if is_displayed {
            self.last_display_ns = head.arrival_ns;
        }
        if head.arrival_ns.saturating_sub(self.last_burst_ns) >= BURST_INTERVAL_NS {
            self.last_burst_ns = head.arrival_ns;
            self.burst_left = BURST_FRAMES;
        }
        if !is_displayed && self.burst_left == 0 {
            return;
        }
        self.burst_left = self.burst_left.saturating_sub(1);
        if self.heads.vacant() == 0 || self.positions.vacant() < row.len() {
            return;
        }
        for sample in row {
            self.positions.push(if sample.present { sample.position_mm } else { GAP });
        }
        self.heads.push(PreviewFrame { is_displayed, ..head });
        self.awaits_poses = is_displayed.then_some((seq, head.row));
    }

    /// The device was away or starts again, and its numbers with it: no poses belong to the last frame.
    pub(super) fn forget_frame(&mut self) {
        self.awaits_poses = None;
    }

    /// Offers the poses of a frame, of which `n_frames` have come: by body its row, and in how many of these frames it was
    /// tracked. They are queued if their frame is displayed.
    pub(super) fn offer_poses(
        &mut self,
        seq: u32,
        n_frames: u64,
        (rows, n_tracked): (&[PoseRow], &[u64]),
    ) {
        let Some((_, row)) = self.awaits_poses.take_if(|(of, _)| *of == seq) else { return };
        if self.poses.vacant() == 0 || self.bodies.vacant() < rows.len() {
            return;
        }
        for (&row, &n_tracked) in rows.iter().zip(n_tracked) {
            self.bodies.push(BodyItem { row, n_tracked });
        }
        self.poses.push(PreviewPoses { row, n_frames });
    }
}

impl PreviewReceiver {
    /// The next frame. Fills `positions` by slot, with NaN where a marker was not seen.
    pub fn next(&mut self, positions: &mut Vec<Position>) -> Option<PreviewFrame> {
        let head = self.heads.pop()?;
        positions.clear();
        positions.resize(head.n_channels, GAP);
        self.positions.pop_slice(positions);
        Some(head)
    }

    /// The poses of the next displayed frame that had any. Fills `bodies` in the order in which the device announced them.
    pub fn next_poses(&mut self, bodies: &mut Vec<PreviewBody>) -> Option<PreviewPoses> {
        let head = self.poses.pop()?;
        self.items.clear();
        let empty = BodyItem { row: [f32::NAN; POSE_CHANNELS], n_tracked: 0 };
        self.items.resize(self.n_bodies, empty);
        self.bodies.pop_slice(&mut self.items);
        bodies.clear();
        bodies.extend(self.items.iter().map(|item| PreviewBody {
            pose: self.reader.pose(&item.row),
            n_tracked: item.n_tracked,
        }));
        Some(head)
    }

    /// Whether no more frames will come.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.heads.is_over()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirty_frames_a_second_are_displayed_with_bursts_of_consecutive_ones() {
        let (mut tap_in, mut tap_out) = tap(1, 0);
        let (mut shown, mut rows, mut positions) = (0, Vec::new(), Vec::new());
        for row in 0..2000 {
            let head = PreviewFrame {
                row,
                arrival_ns: 1_000_000_000 + row * 2_000_000,
                ..PreviewFrame::default()
            };
            tap_in.offer(row as u32, PreviewFrame { n_channels: 1, ..head }, &[Sample::default()]);
            while let Some(head) = tap_out.next(&mut positions) {
                shown += u32::from(head.is_displayed);
                rows.push(head.row);
            }
        }
        // 4 s at 500 Hz: one every 32 ms, and a burst every 250 ms.
        assert_eq!(shown, 125);
        let consecutive = rows.windows(2).filter(|pair| pair[1] == pair[0] + 1).count();
        let in_bursts = 16 * (BURST_FRAMES as usize - 1);
        // A displayed frame may be next to a burst.
        assert!((in_bursts..in_bursts + 16).contains(&consecutive), "{consecutive}");
    }

    #[test]
    fn frames_without_a_viewer_are_left_out() {
        let (mut tap_in, mut tap_out) = tap(1, 0);
        for row in 0..2000 {
            let head = PreviewFrame {
                row,
                arrival_ns: row * 2_000_000,
                n_channels: 1,
                ..PreviewFrame::default()
            };
            tap_in.offer(row as u32, head, &[Sample::default()]);
        }
        let mut positions = Vec::new();
        let n = std::iter::from_fn(|| tap_out.next(&mut positions)).count();
        assert!((1..=64).contains(&n), "{n}");
    }

    #[test]
    fn displayed_frames_have_their_poses() {
        let (mut tap_in, mut tap_out) = tap(1, 2);
        let tracked = [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.5];
        let rows = (&[tracked, mocapd_codec::poses::without_pose(&tracked, 1)][..], &[3, 1][..]);
        for row in 0..40_u64 {
            let arrival_ns = 1_000_000_000 + row * 10_000_000;
            let head = PreviewFrame { row, arrival_ns, n_channels: 1, ..PreviewFrame::default() };
            // Those of the frame before come too late.
            tap_in.offer(row as u32, head, &[Sample::default()]);
            tap_in.offer_poses(row.wrapping_sub(1) as u32, row, rows);
            tap_in.offer_poses(row as u32, row + 1, rows);
        }
        let (mut positions, mut bodies) = (Vec::new(), Vec::new());
        let frames = std::iter::from_fn(|| tap_out.next(&mut positions));
        let displayed: Vec<u64> =
            frames.filter(|head| head.is_displayed).map(|head| head.row).collect();
        assert_eq!(displayed, [0, 4, 8, 12, 16, 20, 24, 28, 32, 36]);
        for row in displayed {
            let found = tap_out.next_poses(&mut bodies);
            assert_eq!(found, Some(PreviewPoses { row, n_frames: row + 1 }));
            assert_eq!(bodies[0].pose.position_mm, [1.0, 2.0, 3.0]);
            assert_eq!(bodies[1].pose.state, mocapd_take::poses::PoseState::Lost);
            assert_eq!((bodies[0].n_tracked, bodies[1].n_tracked), (3, 1));
        }
        assert_eq!(tap_out.next_poses(&mut bodies), None);
    }
}
