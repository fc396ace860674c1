//! Plans of the points of whole spans.
//!
//! Within a span the points of a channel depend on the channels before it and on itself alone; only the probabilities
//! adapt in the order in which rows are coded. So a copy of the group, with the probabilities fixed at the beginning of
//! the span, is enough to evaluate each choice, one channel after another.

use super::{
    LEVELS,
    effort::SearchDepth,
    level_prediction::LevelLayout,
    points::Grid,
    run_search::{HiddenRow, RunSearch},
    trial::{SpanPlan, Trial},
    walk::{Dense, Run, SpanPresence},
};
use crate::{GROUP_CHANNELS, Result, Rows};

/// Plans spans, one after another.
#[derive(Debug)]
pub(super) struct Planner {
    depth: SearchDepth,
    grid: Grid,
    /// The copy of the group.
    group: Dense,
    /// By channel: the plan of the current span.
    plans: Vec<SpanPlan>,
}

impl Planner {
    /// A planner for `group`.
    pub(super) fn new(group: Dense, depth: SearchDepth) -> Self {
        let plans = vec![SpanPlan::NONE; GROUP_CHANNELS];
        Self { depth, grid: group.grid, group, plans }
    }

    /// The plan of a channel in the current span.
    #[inline(always)]
    pub(super) fn plan(&self, channel: usize) -> &SpanPlan {
        &self.plans[channel]
    }

    /// Plans a span of a group that has begun it.
    pub(super) fn plan_span(
        &mut self,
        group: &Dense,
        channels: &[Rows<'_>],
        span: SpanPresence<'_>,
    ) -> Result<()> {
        self.plans.fill(SpanPlan::NONE);
        self.group.follow(group, span);
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
        self.group.follow(group, span);
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
