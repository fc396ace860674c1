//! The search for the points of a run in a span.
//!
//! For each coarse row, from the anchor down, every lattice point in the tolerance ball is tried: the rest of the run is
//! coded greedily, and its cost counted. The cheapest plans so far continue to the next row.
//!
//! Plans are made channel by channel, but rows are coded level by level: where a run ends between the rows of a whole
//! span, the rows next to its ends have not been decoded in all channels before it, and are hidden.

use std::{ops::RangeInclusive, rc::Rc};

use super::{
    LEVELS, SPAN,
    channel_state::ChannelState,
    effort::SearchDepth,
    level::{Channels, RowCodec},
    level_prediction::{LevelLayout, slot},
    trial::{SpanPlan, Trial},
    walk::{Dense, Run},
};
use crate::Result;

/// A plan of the first rows of a run.
#[derive(Debug, Clone)]
struct Hypothesis {
    plan: SpanPlan,
    /// Cost of the run, with greedy choices after the planned rows.
    total: u64,
    /// Cost of the levels before the current one, and the state after them.
    past: u64,
    state: Rc<ChannelState>,
}

/// The search for the points of one run.
pub(super) struct RunSearch<'s, 'a> {
    pub(super) group: &'s mut Dense,
    pub(super) trial: &'s mut Trial<'a>,
    pub(super) hidden: &'s mut [HiddenRow],
    pub(super) run: Run,
    pub(super) before: usize,
    pub(super) last: usize,
    pub(super) depth: SearchDepth,
    /// The level with which to begin: the stride `1 << first_bit`, or the anchor for [`LEVELS`].
    pub(super) first_bit: usize,
}

impl RunSearch<'_, '_> {
    /// Adds the rows of the run to a plan, and codes them according to it.
    pub(super) fn run(mut self, plan: SpanPlan) -> Result<SpanPlan> {
        let levels: Vec<usize> =
            (0..=self.first_bit).rev().filter(|&bit| self.layout(bit).n > 0).collect();
        let state = Rc::new(ChannelState::of(&self.group.channels, self.run.channel, self.rows()));
        let mut start = Hypothesis { plan, total: 0, past: 0, state };
        start.total = self.rest(&levels, &start, u64::MAX)?.unwrap_or(u64::MAX);
        let mut beam = vec![start];
        let searched = levels.iter().filter(|&&bit| bit >= self.depth.least_bit).count();
        for i in 0..searched {
            let LevelLayout { slot, n, .. } = self.layout(levels[i]);
            for slot in slot..slot + n {
                beam = self.row(&levels[i..], beam, slot)?;
            }
            for hypothesis in &mut beam {
                self.resume(hypothesis);
                self.level(levels[i])?;
                hypothesis.past += self.trial.coder.cost;
                let channels = &self.group.channels;
                let state = ChannelState::of(channels, self.run.channel, self.rows());
                hypothesis.state = Rc::new(state);
            }
        }
        // The cheapest comes first.
        beam.truncate(1);
        for best in &beam {
            self.rest(&levels[searched..], best, u64::MAX)?;
        }
        Ok(self.trial.plan)
    }

    fn rows(&self) -> RangeInclusive<usize> {
        self.before + 1..=self.last
    }

    /// The rows of the stride `1 << bit`; the anchor for the bit that is one more than that of the longest stride.
    fn layout(&self, bit: usize) -> LevelLayout {
        let run = self.group.decoded_run(&self.run, self.before);
        if bit == LEVELS {
            return LevelLayout::anchor(run, self.before);
        }
        LevelLayout::level(1 << bit, run, self.before)
    }

    /// Goes back to the state of a hypothesis.
    fn resume(&mut self, hypothesis: &Hypothesis) {
        let rows = self.rows();
        hypothesis.state.restore(&mut self.group.channels, self.run.channel, rows);
        self.trial.plan = hypothesis.plan;
        self.trial.coder.cost = 0;
        self.trial.limit = u64::MAX;
        self.trial.wanted = SPAN;
    }

    /// Codes the rows of one level.
    fn level(&mut self, bit: usize) -> Result<()> {
        let Self { group, trial, hidden, run, before, .. } = self;
        let (run, before) = (*run, *before);
        HiddenRow::without(hidden, bit, group, |group| match bit {
            LEVELS => group.anchor(*trial, run, before),
            _ => group.level(*trial, &run, before, bit),
        })
    }

    /// Codes the levels from the current one of a hypothesis on; returns its total cost if it is below `limit`.
    fn rest(
        &mut self,
        levels: &[usize],
        hypothesis: &Hypothesis,
        limit: u64,
    ) -> Result<Option<u64>> {
        self.resume(hypothesis);
        self.trial.limit = limit.saturating_sub(hypothesis.past);
        for &bit in levels {
            self.level(bit)?;
            if self.trial.gives_up() {
                return Ok(None);
            }
        }
        Ok(Some(hypothesis.past + self.trial.coder.cost))
    }

    /// Tries all points of the row at `slot`, which is of the first of the levels that are left.
    fn row(
        &mut self,
        levels: &[usize],
        mut beam: Vec<Hypothesis>,
        slot: usize,
    ) -> Result<Vec<Hypothesis>> {
        let width = self.depth.beam;
        let mut points = Vec::with_capacity(beam.len());
        for hypothesis in &mut beam {
            self.resume(hypothesis);
            self.trial.wanted = slot;
            levels.first().map_or(Ok(()), |&bit| self.level(bit))?;
            points.push((self.trial.points, self.trial.greedy));
            hypothesis.plan.decide(slot, self.trial.greedy);
        }
        let mut next = beam.clone();
        for (parent, (points, greedy)) in beam.iter().zip(&points) {
            for &point in points.points().iter().filter(|&point| point != greedy) {
                let limit = match next.last() {
                    Some(worst) if next.len() == width => worst.total,
                    _ => u64::MAX,
                };
                let mut child = parent.clone();
                child.plan.decide(slot, point);
                let Some(total) = self.rest(levels, &child, limit)? else { continue };
                child.total = total;
                let place = next.partition_point(|other| other.total <= total);
                next.insert(place, child);
                next.truncate(width);
            }
        }
        Ok(next)
    }
}

/// A row of an earlier channel that is hidden while other rows are coded.
#[derive(Debug)]
pub(super) struct HiddenRow {
    channel: usize,
    row: usize,
    slot: usize,
    /// The row is of the stride `1 << bit`.
    bit: usize,
    point: [f64; 3],
    span: [f64; 3],
    packed_steps: u64,
    residual: [f32; 3],
}

impl HiddenRow {
    /// Those of `rows` that lie between the ends of `runs`, in which all rows are known.
    pub(super) fn find(runs: &[Run], rows: &[usize], before: usize) -> Vec<Self> {
        let mut found = Vec::new();
        for (i, &row) in rows.iter().enumerate() {
            if rows[..i].contains(&row) {
                continue;
            }
            for run in runs.iter().filter(|run| row > before.max(run.zero) && row < run.end) {
                found.push(Self {
                    channel: run.channel,
                    row,
                    slot: slot(row - before),
                    bit: (row - before).trailing_zeros() as usize,
                    point: [f64::NAN; 3],
                    span: [f64::NAN; 3],
                    packed_steps: 0,
                    residual: [0.0; 3],
                });
            }
        }
        found
    }

    /// Hides the row, or restores it, if it is decoded after the rows of the stride `1 << bit`.
    fn exchange(&mut self, channels: &mut Channels, bit: usize) {
        if self.bit >= bit {
            return;
        }
        let Self { channel, row, slot, .. } = *self;
        let track = &mut channels.tracks[channel];
        std::mem::swap(&mut track.points[row], &mut self.point);
        for (axis, units) in track.span.iter_mut().zip(&mut self.span) {
            std::mem::swap(&mut axis[slot], units);
        }
        std::mem::swap(&mut track.packed_steps[slot], &mut self.packed_steps);
        channels.cross_channel.exchange_residual(channel, slot, &mut self.residual);
    }

    /// Runs `code` on a group that does not know those of `rows` that are decoded after the stride `1 << bit`.
    pub(super) fn without<T>(
        rows: &mut [Self],
        bit: usize,
        group: &mut Dense,
        code: impl FnOnce(&mut Dense) -> T,
    ) -> T {
        rows.iter_mut().for_each(|row| row.exchange(&mut group.channels, bit));
        let result = code(group);
        rows.iter_mut().for_each(|row| row.exchange(&mut group.channels, bit));
        result
    }
}
