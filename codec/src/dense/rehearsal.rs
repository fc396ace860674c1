//! Rehearsals of planned spans: their rows are coded as the encoder will code them, but only counted.

use super::{
    choice::{LevelSamples, SpanPlan},
    lattice::{Grid, Point, Points},
    level::{ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout},
    model::CostCounter,
};
use crate::{Position, Rows};

/// Codes the rows of a span by their plans. The model learns, so that it is the one after the span.
#[derive(Debug)]
pub(super) struct Rehearsal<'a> {
    channels: &'a [Rows<'a>],
    plans: &'a [SpanPlan],
    samples: LevelSamples,
    coder: CostCounter<true>,
    /// The channel of the current level, and the slot of its first row.
    channel: usize,
    slot: usize,
}

impl<'a> Rehearsal<'a> {
    pub(super) fn new(channels: &'a [Rows<'a>], plans: &'a [SpanPlan], grid: Grid) -> Self {
        let samples = LevelSamples::new(grid);
        Self { channels, plans, samples, coder: CostCounter::default(), channel: 0, slot: 0 }
    }

    /// The cost so far, in 2^-10 bits.
    pub(super) fn cost(&self) -> u64 {
        self.coder.cost
    }
}

impl RowCodec for Rehearsal<'_> {
    type Coder = CostCounter<true>;

    fn coder(&mut self) -> &mut CostCounter<true> {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let slot = self.slot + inputs.place;
        let planned = self.plans[self.channel].fitting(slot, &inputs, &self.samples);
        planned.unwrap_or_else(|| self.samples.choose(&inputs))
    }

    fn position(&self, channel: usize, row: usize) -> Option<Position> {
        Some(self.channels[channel].positions()[row])
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        (self.channel, self.slot) = (layout.run.channel, layout.slot);
        self.samples.begin(self.channels[self.channel].positions(), layout);
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let planned = self.plans[batch.channel].decided_from(batch.slot) as u32;
        self.samples.outside(batch, predictions) | planned
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, _: Batch, _: &Points<N>, _: u32) {}
}
