//! Plans of the points of whole spans: the search for the points of each run, as deep as the encoder's effort allows.
//!
//! Within a span the points of a channel depend on the channels before it and on itself alone; only the probabilities
//! adapt in the order in which rows are coded. So a copy of the group, with probabilities that are fixed while the span is
//! planned, is enough to evaluate each choice, one channel after another.
//!
//! For each coarse row, from the anchor down, every lattice point in the tolerance ball is tried: the rest of the run is
//! coded greedily, and its cost counted. The cheapest plans so far continue to the next row.
//!
//! The first pass has the probabilities from before the span, which do not know it yet. Further passes plan it again, with
//! those from after it, coded with the plans of the pass before.
//!
//! Plans are made channel by channel, but rows are coded level by level: where a run ends between the rows of a whole
//! span, the rows next to its ends have not been decoded in all channels before it, and are hidden.

use std::{fmt, ops::RangeInclusive, rc::Rc, str::FromStr};

use super::{
    LEVELS, SPAN,
    choice::{ChannelState, Rehearsal, SpanPlan, Trial},
    lattice::Grid,
    level::{Channels, RowCodec},
    level_prediction::{LevelLayout, slot},
    model::Model,
    walk::{Dense, Run, SpanPresence},
};
use crate::{CodecError, GROUP_CHANNELS, Result, Rows};

/// How much time the encoder of `dense` takes to make blocks smaller; other resamplers have one way to encode.
///
/// Time is relative to effort 1, and bytes are the change from it: geometric means over 20 recorded takes at six tolerances from 0.1
/// to 20 mm.
///
/// | effort | rows whose points are searched | plans at a time | time | bytes |
/// |---|---|---|---|---|
/// | 1 | none | | 1 | 0 |
/// | 2 | anchors | 1 | 3.3 | -2.1 % |
/// | 3 | and stride 32 | 1 | 3.7 | -3.9 % |
/// | 4 | and strides 16 and 8 | 1 | 5.7 | -6.7 % |
/// | 5 | and stride 4 | 1 | 8.1 | -7.6 % |
/// | 6 | as 4 | 4 | 12 | -7.9 % |
/// | 7 | as 5 | 4 | 22 | -8.7 % |
/// | 8 | and stride 2 | 4 | 41 | -9.2 % |
/// | 9 | as 8 | 24, in three passes | 310 | -10.5 % |
///
/// The time at effort 9 is 2.9 times that of one pass with 12 plans (three takes), which took 106; its bytes are those in the
/// best order of channels that an import finds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Effort(u8);

/// How far plans look ahead.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchDepth {
    /// The shortest searched stride is `1 << least_bit`; anchors alone for [`LEVELS`].
    least_bit: usize,
    /// Number of plans that are followed at the same time.
    beam: usize,
    /// How often a span is planned.
    passes: usize,
}

impl Effort {
    /// The minimum effort: each row is chosen without looking ahead. Recordings always use it.
    pub const MIN: Self = Self(1);
    /// The maximum effort.
    pub const MAX: Self = Self(9);

    /// # Errors
    /// `InvalidArgument` unless the level is 1 to 9.
    pub fn new(level: u8) -> Result<Self> {
        if (Self::MIN.0..=Self::MAX.0).contains(&level) {
            return Ok(Self(level));
        }
        Err(CodecError::InvalidArgument(format!("effort {level} is out of range: give 1 to 9")))
    }

    /// The level, 1 to 9.
    #[must_use]
    pub fn level(self) -> u8 {
        self.0
    }

    /// The depth of the search; `None` where nothing is searched.
    pub(super) fn depth(self) -> Option<SearchDepth> {
        let (least_bit, beam, passes) = match self.0 {
            0..=1 => return None,
            2 => (LEVELS, 1, 1),
            3 => (5, 1, 1),
            4 => (3, 1, 1),
            5 => (2, 1, 1),
            6 => (3, 4, 1),
            7 => (2, 4, 1),
            8 => (1, 4, 1),
            _ => (1, 24, 3),
        };
        Some(SearchDepth { least_bit, beam, passes })
    }
}

impl Default for Effort {
    /// The minimum effort.
    fn default() -> Self {
        Self::MIN
    }
}

impl fmt::Display for Effort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Effort {
    type Err = CodecError;

    fn from_str(text: &str) -> Result<Self> {
        let level = text.parse().map_err(|_| {
            CodecError::InvalidArgument(format!(
                "'{text}' is not an effort: give a number from 1 to 9"
            ))
        })?;
        Self::new(level)
    }
}

/// Plans spans, one after another.
#[derive(Debug)]
pub(super) struct Planner {
    depth: SearchDepth,
    grid: Grid,
    /// The copy of the group.
    group: Dense,
    /// By channel: the plan of the current span.
    plans: Vec<SpanPlan>,
    /// The model after the span, coded with the plans of the pass before; `None` in the first pass.
    learned: Option<Model>,
}

impl Planner {
    /// A planner for `group`.
    pub(super) fn new(group: Dense, depth: SearchDepth) -> Self {
        let plans = vec![SpanPlan::NONE; GROUP_CHANNELS];
        Self { depth, grid: group.grid, group, plans, learned: None }
    }

    /// The plan of a channel in the current span.
    #[inline(always)]
    pub(super) fn plan(&self, channel: usize) -> &SpanPlan {
        &self.plans[channel]
    }

    /// Plans a span of a group that has begun it. Of several passes the one whose plans cost least is kept.
    pub(super) fn plan_span(
        &mut self,
        group: &Dense,
        channels: &[Rows<'_>],
        span: SpanPresence<'_>,
    ) -> Result<()> {
        self.learned = None;
        if self.depth.passes == 1 {
            return self.plan_pass(group, channels, span);
        }
        let (mut least, mut best) = (u64::MAX, Vec::new());
        for _ in 0..self.depth.passes {
            self.plan_pass(group, channels, span)?;
            let cost = self.rehearse(group, channels, span)?;
            if cost < least {
                least = cost;
                best.clone_from(&self.plans);
            }
        }
        self.plans = best;
        Ok(())
    }

    /// Codes a span with its plans, which the model learns from. Returns the cost.
    fn rehearse(
        &mut self,
        group: &Dense,
        channels: &[Rows<'_>],
        span: SpanPresence<'_>,
    ) -> Result<u64> {
        self.group.follow(group, span);
        let mut rehearsal = Rehearsal::new(channels, &self.plans, self.grid);
        let mut runs = group.runs.clone();
        self.group.walk(&mut rehearsal, &mut runs, span.before, span.present)?;
        let learned = &self.group.channels.model;
        match &mut self.learned {
            Some(model) => model.follow(learned),
            none => *none = Some(learned.clone()),
        }
        Ok(rehearsal.cost())
    }

    /// Goes back to the beginning of the span, with the probabilities to plan with.
    fn begin(&mut self, group: &Dense, span: SpanPresence<'_>) {
        self.group.follow(group, span);
        if let Some(learned) = &self.learned {
            self.group.channels.model.follow(learned);
        }
    }

    /// Plans a span once.
    fn plan_pass(
        &mut self,
        group: &Dense,
        channels: &[Rows<'_>],
        span: SpanPresence<'_>,
    ) -> Result<()> {
        self.plans.fill(SpanPlan::NONE);
        self.begin(group, span);
        let mut trial = Trial::new(channels, self.grid);
        // Anchors are coded in the order of the runs, and rows of levels in that of the channels.
        if group.runs.is_sorted_by_key(|run| run.channel) {
            return self.plan_runs(&mut trial, &group.runs, span, self.depth);
        }
        self.plan_runs(
            &mut trial,
            &group.runs,
            span,
            SearchDepth { least_bit: LEVELS, ..self.depth },
        )?;
        self.begin(group, span);
        self.plan_levels(&mut trial, &group.runs, span)
    }

    /// Plans whole runs in the order of their anchors.
    fn plan_runs(
        &mut self,
        trial: &mut Trial<'_>,
        runs: &[Run],
        span: SpanPresence<'_>,
        depth: SearchDepth,
    ) -> Result<()> {
        let SpanPresence { before, last, .. } = span;
        for (index, &run) in runs.iter().enumerate() {
            let channel = run.channel;
            let mut rows = vec![run.zero, run.end];
            rows.extend(self.group.end_in_block(channel));
            let mut hidden = HiddenRow::find(&runs[..index], &rows, before);
            self.begin_run(trial, &runs[..=index], span, &mut hidden)?;
            if run.end > run.zero {
                let (group, hidden) = (&mut self.group, &mut hidden[..]);
                let first_bit = LEVELS;
                let search =
                    RunSearch { group, trial, hidden, run, before, last, depth, first_bit };
                self.plans[channel] = search.run(self.plans[channel])?;
                self.learn_anchor(run, before);
            }
            self.group.end_run(run);
        }
        Ok(())
    }

    /// Plans the levels of runs whose anchors are planned.
    fn plan_levels(
        &mut self,
        trial: &mut Trial<'_>,
        runs: &[Run],
        span: SpanPresence<'_>,
    ) -> Result<()> {
        let SpanPresence { before, last, .. } = span;
        for (index, &run) in runs.iter().enumerate() {
            self.begin_run(trial, &runs[..=index], span, &mut [])?;
            if run.end > run.zero {
                trial.plan = self.plans[run.channel];
                self.group.anchor(trial, run, before)?;
                self.learn_anchor(run, before);
            }
            self.group.end_run(run);
        }
        let mut runs = runs.to_vec();
        runs.sort_by_key(|run| (run.channel, run.zero));
        for &run in &runs {
            let earlier = &runs[..runs.partition_point(|earlier| earlier.channel < run.channel)];
            let mut hidden = HiddenRow::find(earlier, &[run.zero, run.end], before);
            let (group, hidden, depth) = (&mut self.group, &mut hidden[..], self.depth);
            let first_bit = LEVELS - 1;
            let search = RunSearch { group, trial, hidden, run, before, last, depth, first_bit };
            self.plans[run.channel] = search.run(self.plans[run.channel])?;
        }
        Ok(())
    }

    /// Codes the first row of the last of `runs`; the first of a channel chooses references and partners.
    fn begin_run(
        &mut self,
        trial: &mut Trial<'_>,
        runs: &[Run],
        span: SpanPresence<'_>,
        hidden: &mut [HiddenRow],
    ) -> Result<()> {
        let Some((&run, earlier)) = runs.split_last() else { return Ok(()) };
        let SpanPresence { before, present, .. } = span;
        HiddenRow::without(hidden, LEVELS, &mut self.group, |group| {
            group.begin_run(trial, run, before, present)
        })?;
        if earlier.iter().all(|earlier| earlier.channel != run.channel) {
            self.group.choose_neighbours(run.channel, present.len(), before);
        }
        Ok(())
    }

    fn learn_anchor(&mut self, run: Run, before: usize) {
        let slot = LevelLayout::anchor(self.group.decoded_run(&run, before), before).slot;
        self.group.channels.cross_channel.learn_anchor(run.channel, slot);
    }
}

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
struct RunSearch<'s, 'a> {
    pub(super) group: &'s mut Dense,
    pub(super) trial: &'s mut Trial<'a>,
    hidden: &'s mut [HiddenRow],
    pub(super) run: Run,
    pub(super) before: usize,
    pub(super) last: usize,
    pub(super) depth: SearchDepth,
    /// The level with which to begin: the stride `1 << first_bit`, or the anchor for [`LEVELS`].
    first_bit: usize,
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
struct HiddenRow {
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
