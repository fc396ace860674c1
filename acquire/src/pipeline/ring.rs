//! The rings: single producer, single consumer, lock-free, allocated once.
//!
//! Items are `Copy`, so that no bookkeeping bug could free one twice; the crate behind them is named
//! here and nowhere else.

use std::fmt;

use mocapd_take::timeline::{Causes, RowTime};
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
