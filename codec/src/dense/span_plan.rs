//! Points that are decided before the rows of a span are coded.

use super::{SPAN, points::Point};

/// The decided rows of one channel in a span, by slot, and their steps from the prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpanPlan {
    decided: u64,
    steps: [Point; SPAN],
}

const _: () = assert!(SPAN == u64::BITS as usize);

impl SpanPlan {
    pub(super) const NONE: Self = Self { decided: 0, steps: [[0; 3]; SPAN] };

    /// The steps of a row; `None` where they are not decided.
    #[inline(always)]
    pub(super) fn steps(&self, slot: usize) -> Option<Point> {
        let is_decided = self.decided >> (slot % SPAN) & 1 == 1;
        is_decided.then(|| self.steps[slot % SPAN])
    }

    /// One bit per slot from `slot` on: whether it is decided.
    #[inline(always)]
    pub(super) fn decided_from(&self, slot: usize) -> u64 {
        self.decided >> (slot % SPAN)
    }

    pub(super) fn decide(&mut self, slot: usize, steps: Point) {
        self.decided |= 1 << (slot % SPAN);
        self.steps[slot % SPAN] = steps;
    }
}
