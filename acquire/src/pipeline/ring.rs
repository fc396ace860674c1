//! The rings: single producer, single consumer, lock-free, allocated once.
//!
//! Items are `Copy`, so that no bookkeeping bug could free one twice; the crate behind them is named
//! here and nowhere else.
//!
//! The tap is two of them, for people's eyes: some thirty frames a second go past the channels' rings into it, and now and
//! then some that follow each other, out of which noise is estimated. What does not fit is not shown.

use std::fmt;

use mocapd_take::{
    motion::{GAP, Position},
    timeline::{Causes, RowTime},
};
use ringbuf::{
    HeapCons, HeapProd, HeapRb,
    traits::{Consumer, Observer, Producer, Split},
};

/// One channel's row. 16 bytes, four to a cache line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sample {
    pub(super) position_mm: [f32; 3],
    pub(super) present: bool,
}

const _: () = assert!(size_of::<Sample>() == 16);

/// One thing on the time line, in order of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimelineItem {
    Recorded(RowTime),
    Lost { rows: u64, causes: Causes },
}

/// The end that the reader holds.
pub(super) struct RingIn<T>(HeapProd<T>);

/// The end that a group holds.
pub(super) struct RingOut<T>(HeapCons<T>);

/// A ring of `capacity` items.
pub(super) fn ring<T: Copy>(capacity: usize) -> (RingIn<T>, RingOut<T>) {
    let (producer, consumer) = HeapRb::new(capacity).split();
    (RingIn(producer), RingOut(consumer))
}

impl<T: Copy> RingIn<T> {
    /// Items that are sure to fit: never more than really do.
    pub(super) fn room(&self) -> usize {
        self.0.vacant_len()
    }

    /// How full it is, of a thousand.
    pub(super) fn fill_permille(&self) -> u64 {
        (self.0.occupied_len() * 1000 / self.0.capacity().get()) as u64
    }

    /// After [`room`](Self::room) said that it fits.
    pub(super) fn push(&mut self, item: T) {
        let pushed = self.0.try_push(item).is_ok();
        debug_assert!(pushed, "pushed into a full ring");
    }
}

impl<T: Copy> RingOut<T> {
    pub(super) fn pop(&mut self) -> Option<T> {
        self.0.try_pop()
    }

    /// Whether nothing comes any more: the other end is gone, and what it pushed was taken.
    pub(super) fn is_over(&self) -> bool {
        !self.0.write_is_held() && self.0.is_empty()
    }

    /// Fills the front of `items`; gives how many there were.
    pub(super) fn pop_slice(&mut self, items: &mut [T]) -> usize {
        self.0.pop_slice(items)
    }
}

impl<T> fmt::Debug for RingIn<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RingIn({} of {})", self.0.occupied_len(), self.0.capacity())
    }
}

impl<T> fmt::Debug for RingOut<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RingOut({} of {})", self.0.occupied_len(), self.0.capacity())
    }
}

/// Time between two frames that are shown: 30 a second, and a little less than that, so that no beat with the
/// device's rate makes it 20.
const EVERY_NS: u64 = 32_000_000;

/// Frames of a burst, one after the other: 12 fourth differences and 10 sixth ones.
const BURST_FRAMES: u32 = 16;

/// Time from the beginning of a burst to the next one.
const BURST_EVERY_NS: u64 = 250_000_000;

/// Frames that wait: two bursts, and so a quarter of a second at least. A viewer's thread looks every few milliseconds.
const FRAMES_MAX: usize = 2 * BURST_FRAMES as usize;

/// What is known of a frame beside its positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TapHead {
    /// Its row, counted since the pipeline was started.
    pub row: u64,
    /// By the device's clock.
    pub device_ticks: u64,
    /// When its last byte arrived, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// Channels.
    pub n_channels: usize,
    /// Whether it is for people's eyes; else it is one of a burst.
    pub is_shown: bool,
}

/// The reader's end.
#[derive(Debug)]
pub(super) struct TapIn {
    heads: RingIn<TapHead>,
    positions: RingIn<Position>,
    last_ns: u64,
    burst_ns: u64,
    burst_left: u32,
}

/// The end of whoever shows them.
#[derive(Debug)]
pub struct TapOut {
    heads: RingOut<TapHead>,
    positions: RingOut<Position>,
}

pub(super) fn tap(n_slots: usize) -> (TapIn, TapOut) {
    let (heads, heads_out) = ring(FRAMES_MAX);
    let (positions, positions_out) = ring(FRAMES_MAX * n_slots.max(1));
    let out = TapOut { heads: heads_out, positions: positions_out };
    (TapIn { heads, positions, last_ns: 0, burst_ns: 0, burst_left: 0 }, out)
}

impl TapIn {
    /// A frame, which is shown when it is time for one.
    pub(super) fn offer(&mut self, head: TapHead, row: &[Sample]) {
        let is_shown = head.arrival_ns.saturating_sub(self.last_ns) >= EVERY_NS;
        if is_shown {
            self.last_ns = head.arrival_ns;
        }
        if head.arrival_ns.saturating_sub(self.burst_ns) >= BURST_EVERY_NS {
            self.burst_ns = head.arrival_ns;
            self.burst_left = BURST_FRAMES;
        }
        if !is_shown && self.burst_left == 0 {
            return;
        }
        self.burst_left = self.burst_left.saturating_sub(1);
        if self.heads.room() == 0 || self.positions.room() < row.len() {
            return;
        }
        for sample in row {
            self.positions.push(if sample.present { sample.position_mm } else { GAP });
        }
        self.heads.push(TapHead { is_shown, ..head });
    }
}

impl TapOut {
    /// The next frame; its positions by slot, NaN where a marker was not seen.
    pub fn next(&mut self, positions: &mut Vec<Position>) -> Option<TapHead> {
        let head = self.heads.pop()?;
        positions.clear();
        positions.resize(head.n_channels, GAP);
        self.positions.pop_slice(positions);
        Some(head)
    }

    /// Whether no frame comes any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.heads.is_over()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirty_frames_a_second_are_shown_and_bursts_follow_each_other() {
        let (mut tap_in, mut tap_out) = tap(1);
        let (mut shown, mut rows, mut positions) = (0, Vec::new(), Vec::new());
        for row in 0..2000 {
            let head =
                TapHead { row, arrival_ns: 1_000_000_000 + row * 2_000_000, ..TapHead::default() };
            tap_in.offer(TapHead { n_channels: 1, ..head }, &[Sample::default()]);
            while let Some(head) = tap_out.next(&mut positions) {
                shown += u32::from(head.is_shown);
                rows.push(head.row);
            }
        }
        // 4 s at 500 Hz: one each 32 ms, and a burst each 250 ms.
        assert_eq!(shown, 125);
        let consecutive = rows.windows(2).filter(|pair| pair[1] == pair[0] + 1).count();
        let in_bursts = 16 * (BURST_FRAMES as usize - 1);
        // One that is shown may stand right beside a burst.
        assert!((in_bursts..in_bursts + 16).contains(&consecutive), "{consecutive}");
    }

    #[test]
    fn what_nobody_takes_away_is_not_kept() {
        let (mut tap_in, mut tap_out) = tap(1);
        for row in 0..2000 {
            let head =
                TapHead { row, arrival_ns: row * 2_000_000, n_channels: 1, ..TapHead::default() };
            tap_in.offer(head, &[Sample::default()]);
        }
        let mut positions = Vec::new();
        let n = std::iter::from_fn(|| tap_out.next(&mut positions)).count();
        assert!((1..=64).contains(&n), "{n}");
    }
}
