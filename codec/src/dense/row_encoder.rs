//! The encoder of the rows of a block: planned and greedy choices, and the measured errors.

use super::{
    level::{ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout},
    level_samples::LevelSamples,
    planner::Planner,
    points::{Grid, Point, Points},
    walk::{Dense, SpanCodec, SpanPresence},
};
use crate::{
    BlockReport, GROUP_CHANNELS, Position, Result, Rows, coding::range::RangeEncoder, ensure,
};

/// The encoder of one block.
pub(super) struct RowEncoder<'a, 'r> {
    channels: &'a [Rows<'a>],
    pub(super) coder: RangeEncoder<'a>,
    pub(super) reports: &'r mut [BlockReport],
    pub(super) kept_rows: &'r mut [bool],
    /// Plans the points of each span; without it every choice is greedy.
    planner: Option<&'r mut Planner>,
    /// The channel of the current level, and the slot of its first row.
    channel: usize,
    slot: usize,
    /// The largest squared error so far by channel, in mm^2.
    squares: [f64; GROUP_CHANNELS],
    samples: LevelSamples,
    /// Rows of the spans that were begun.
    rows_begun: usize,
}

impl<'a, 'r> RowEncoder<'a, 'r> {
    pub(super) fn new(
        channels: &'a [Rows<'a>],
        grid: Grid,
        coder: RangeEncoder<'a>,
        (reports, kept_rows): (&'r mut [BlockReport], &'r mut [bool]),
        planner: Option<&'r mut Planner>,
    ) -> Self {
        Self {
            channels,
            coder,
            reports,
            kept_rows,
            planner,
            channel: 0,
            slot: 0,
            squares: [0.0; GROUP_CHANNELS],
            samples: LevelSamples::new(grid),
            rows_begun: 0,
        }
    }

    /// Codes samples that were decoded from another block, to exactly the same floats.
    pub(super) fn exactly(self, grid: Grid) -> Self {
        Self { samples: LevelSamples::exact(grid), ..self }
    }

    /// The first channel that misses a sample by more than it may: later ones are predicted from it.
    pub(super) fn first_miss(&self) -> Option<usize> {
        self.squares.iter().position(|&squares| squares > self.samples.max_square)
    }

    /// Rows that were coded, or begun.
    pub(super) fn rows_begun(&self) -> usize {
        self.rows_begun
    }

    /// Ends the block and reports the errors; `false` when it exceeds its limit of bytes or the tolerance.
    pub(super) fn finish(self) -> bool {
        let is_within = self.first_miss().is_none();
        for (report, squares) in self.reports.iter_mut().zip(self.squares) {
            report.max_error_mm = squares.sqrt();
        }
        self.coder.finish() && is_within
    }

    /// The planned steps of a row if they lead into the tolerance ball; else its prediction, if that is inside.
    fn planned(&self, inputs: &ResidualInputs) -> Option<Point> {
        let plan = self.planner.as_ref()?.plan(self.channel);
        let steps = plan.steps(self.slot + inputs.place)?;
        let fits = |steps: &Point| {
            inputs.lattice.contains(*steps)
                && self.samples.is_inside(inputs, steps.map(|step| step as f64))
        };
        [steps, [0; 3]].into_iter().find(fits)
    }
}

impl<'a> RowCodec for RowEncoder<'a, '_> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut RangeEncoder<'a> {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        self.planned(&inputs).unwrap_or_else(|| self.samples.choose(&inputs))
    }

    fn position(&self, channel: usize, row: usize) -> Option<Position> {
        Some(self.channels[channel].positions()[row])
    }

    fn is_exact(&self) -> bool {
        self.samples.max_square == 0.0
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        (self.channel, self.slot) = (layout.run.channel, layout.slot);
        self.samples.begin(self.channels[self.channel].positions(), layout);
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let outside = self.samples.outside(batch, predictions);
        match &self.planner {
            Some(planner) => outside | planner.plan(batch.channel).decided_from(batch.slot) as u32,
            None => outside,
        }
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32) {
        // Rows that keep their predictions were measured in `outside`.
        let mut squares = [0.0; N];
        if kept == 0 {
            squares.copy_from_slice(&self.samples.predicted_squares[..N]);
        } else {
            squares = self.samples.squares(batch, points);
        }
        let most = &mut self.squares[batch.channel];
        for square in &squares[..batch.n] {
            *most = most.max(*square);
        }
        self.reports[batch.channel].kept += kept.count_ones();
        let mut kept = kept;
        while kept != 0 {
            self.kept_rows[batch.row(kept.trailing_zeros() as usize)] = true;
            kept &= kept - 1;
        }
    }
}

impl SpanCodec for RowEncoder<'_, '_> {
    fn begin_span(&mut self, group: &Dense, span: SpanPresence<'_>) -> Result<()> {
        self.rows_begun += span.last - span.before;
        if self.samples.max_square == 0.0 {
            // Samples that cannot be met will not be met by what follows either.
            ensure(self.first_miss().is_none(), "a sample that no lattice point meets")?;
        }
        match &mut self.planner {
            Some(planner) => planner.plan_span(group, self.channels, span),
            None => Ok(()),
        }
    }
}
