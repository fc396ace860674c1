//! Trial coding: prices the rows that the encoder would code, with points that are decided in advance.

use super::{
    SPAN,
    cost::CostCounter,
    level::{ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout},
    level_samples::{BallPoints, LevelSamples},
    points::{Grid, Point, Points},
};
use crate::{Position, Rows};

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

/// Prices the rows of a span: the points of a plan, greedy choices elsewhere.
#[derive(Debug)]
pub(super) struct Trial<'a> {
    channels: &'a [Rows<'a>],
    samples: LevelSamples,
    pub(super) coder: CostCounter,
    /// The cost at which a trial is abandoned.
    pub(super) limit: u64,
    pub(super) plan: SpanPlan,
    /// The slot of the row whose points are all collected; [`SPAN`] for none.
    pub(super) wanted: usize,
    /// The points of that row, and the greedy choice.
    pub(super) points: BallPoints,
    pub(super) greedy: Point,
    /// The slot of the first row of the current level.
    slot: usize,
}

impl<'a> Trial<'a> {
    pub(super) fn new(channels: &'a [Rows<'a>], grid: Grid) -> Self {
        Self {
            channels,
            samples: LevelSamples::new(grid),
            coder: CostCounter::default(),
            limit: u64::MAX,
            plan: SpanPlan::NONE,
            wanted: SPAN,
            points: BallPoints::NONE,
            greedy: [0; 3],
            slot: 0,
        }
    }
}

impl RowCodec for Trial<'_> {
    type Coder = CostCounter;

    fn coder(&mut self) -> &mut CostCounter {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let slot = self.slot + inputs.place;
        if let Some(steps) = self.plan.steps(slot) {
            return steps;
        }
        if slot != self.wanted {
            return self.samples.choose(&inputs);
        }
        self.points = self.samples.ball_points(&inputs);
        let stays = self.samples.is_inside(&inputs, [0.0; 3]);
        self.greedy = if stays { [0; 3] } else { self.samples.choose(&inputs) };
        self.greedy
    }

    fn position(&self, channel: usize, row: usize) -> Option<Position> {
        Some(self.channels[channel].positions()[row])
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        self.slot = layout.slot;
        self.samples.begin(self.channels[layout.run.channel].positions(), layout);
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let wanted = if self.wanted < SPAN { 1 << self.wanted >> batch.slot } else { 0_u64 };
        let asked = self.plan.decided_from(batch.slot) | wanted;
        self.samples.outside(batch, predictions) | asked as u32
    }

    #[inline(always)]
    fn gives_up(&self) -> bool {
        self.coder.cost >= self.limit
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, _: Batch, _: &Points<N>, _: u32) {}
}
