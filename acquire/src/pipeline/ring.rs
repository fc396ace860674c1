//! Lock-free rings with a single producer and a single consumer, allocated once.
//!
//! Items are `Copy`, so that no accounting bug can free one twice. Only this module names the crate behind the
//! rings.
//!
//! The preview uses two rings: about thirty frames per second for display, and from time to time a burst of consecutive
//! frames from which noise is estimated. Frames that do not fit are left out of the preview.

use std::fmt;

use mocapd_take::{
    motion::{GAP, Position},
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

/// The reader's end of the preview.
#[derive(Debug)]
pub(super) struct PreviewSender {
    heads: RingProducer<PreviewFrame>,
    positions: RingProducer<Position>,
    last_display_ns: u64,
    last_burst_ns: u64,
    burst_left: u32,
}

/// The viewer's end of the preview.
#[derive(Debug)]
pub struct PreviewReceiver {
    heads: RingConsumer<PreviewFrame>,
    positions: RingConsumer<Position>,
}

pub(super) fn tap(n_slots: usize) -> (PreviewSender, PreviewReceiver) {
    let (heads, heads_out) = ring(QUEUED_FRAMES_MAX);
    let (positions, positions_out) = ring(QUEUED_FRAMES_MAX * n_slots.max(1));
    let out = PreviewReceiver { heads: heads_out, positions: positions_out };
    (PreviewSender { heads, positions, last_display_ns: 0, last_burst_ns: 0, burst_left: 0 }, out)
}

impl PreviewSender {
    /// Offers a frame, which is queued if it is due for display or part of a burst.
    pub(super) fn offer(&mut self, head: PreviewFrame, row: &[Sample]) {
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
        let (mut tap_in, mut tap_out) = tap(1);
        let (mut shown, mut rows, mut positions) = (0, Vec::new(), Vec::new());
        for row in 0..2000 {
            let head = PreviewFrame {
                row,
                arrival_ns: 1_000_000_000 + row * 2_000_000,
                ..PreviewFrame::default()
            };
            tap_in.offer(PreviewFrame { n_channels: 1, ..head }, &[Sample::default()]);
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
        let (mut tap_in, mut tap_out) = tap(1);
        for row in 0..2000 {
            let head = PreviewFrame {
                row,
                arrival_ns: row * 2_000_000,
                n_channels: 1,
                ..PreviewFrame::default()
            };
            tap_in.offer(head, &[Sample::default()]);
        }
        let mut positions = Vec::new();
        let n = std::iter::from_fn(|| tap_out.next(&mut positions)).count();
        assert!((1..=64).contains(&n), "{n}");
    }
}
