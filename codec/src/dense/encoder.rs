//! The encoder of a group: coded, raw and stored channels, planned and greedy choices for their rows, and the check of
//! the error bound.

#[cfg(feature = "training")]
use super::tally::Tally;
use super::{
    P_CODED, SPAN,
    choice::LevelSamples,
    lattice::{Fineness, Grid, Point, Points},
    level::{ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout},
    planner::{Effort, Planner, SearchDepth},
    walk::{Dense, SpanCodec, SpanPresence},
};
#[cfg(feature = "training")]
use crate::frame::count_finite;
use crate::{
    BlockReport, DecodedRows, GROUP_CHANNELS, Position, Result, Rows, Tolerance,
    coding::range::{BinaryCoder, RangeEncoder},
    ensure,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
};

/// The largest magnitude of a coordinate in a channel of finite samples; `None` when it has no samples.
fn largest(rows: Rows<'_>) -> Option<f32> {
    // Without their signs, the bits of floats have the order of the numbers.
    let (mut some, mut bits) = (false, 0);
    for (position, &present) in rows.positions().iter().zip(rows.present()) {
        let counted = if present { !(1 << 31) } else { 0 };
        let most = position.map(|coordinate| coordinate.to_bits() & counted);
        bits = most.into_iter().fold(bits, u32::max);
        some |= present;
    }
    some.then(|| f32::from_bits(bits))
}

/// Whether a sample has the coordinate -0.0, to which no point decodes.
fn has_negative_zero(rows: Rows<'_>) -> bool {
    let samples = (0..rows.len()).filter_map(|row| rows.get(row));
    samples.flatten().any(|coordinate| coordinate.to_bits() == (-0.0_f32).to_bits())
}

impl PayloadEncoder for Dense {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        // A block stored as a whole: its samples, and the end of the range coder.
        n_channels * n_rows * 12 + 8
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        if exact {
            self.encode_exactly(channels, out, reports, kept_rows);
        } else {
            self.encode_planned(channels, out, (reports, kept_rows), None);
        }
        Ok(())
    }
}

/// Work on a block of decoded samples, in times that its rows are coded: each time, one more channel may be found that
/// can only be stored.
const EXACT_PASSES: usize = 4;

impl Dense {
    /// Codes samples that were decoded from other blocks as a key block that decodes to the same floats. Points that lie
    /// on the lattices, as all of the first rows of a key block do and those of a marker that never moves, take few
    /// bytes; channels with others are stored.
    fn encode_exactly(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) {
        let (start, n_rows) = (out.len(), channels.first().map_or(0, Rows::len));
        let limit = reports.iter().map(|report| report.samples as usize * 12).sum();
        let mut fineness: Vec<Option<Fineness>> = channels
            .iter()
            .map(|rows| self.grid.fineness(largest(*rows)?).filter(|_| !has_negative_zero(*rows)))
            .collect();
        let mut rows_left = EXACT_PASSES * n_rows + GROUP_CHANNELS * SPAN;
        while fineness.iter().any(Option::is_some) {
            self.reset();
            kept_rows.fill(false);
            reports.iter_mut().for_each(|report| report.kept = 0);
            let coder = RangeEncoder::new(out, limit);
            let codec = RowEncoder::new(channels, self.grid, coder, (reports, kept_rows), None);
            let mut codec = codec.exactly(self.grid);
            let coded = self.encode_stored(&mut codec, channels, &fineness);
            let (missed, rows) = (codec.first_miss(), codec.rows_begun());
            if codec.finish() && coded.is_ok() {
                return;
            }
            out.truncate(start);
            let (Some(missed), Some(left)) = (missed, rows_left.checked_sub(rows)) else { break };
            (fineness[missed], rows_left) = (None, left);
        }
        kept_rows.fill(false);
        self.store_all(channels, out, reports, kept_rows);
    }

    /// Codes a block of which the channels with a fineness are coded in rows, and the others stored.
    fn encode_stored(
        &mut self,
        codec: &mut RowEncoder<'_, '_>,
        channels: &[Rows<'_>],
        fineness: &[Option<Fineness>],
    ) -> Result<()> {
        let n_rows = channels.first().map_or(0, Rows::len);
        codec.coder.split(P_CODED, false);
        let mut present: [Option<&[bool]>; GROUP_CHANNELS] = [None; GROUP_CHANNELS];
        for (channel, rows) in channels.iter().enumerate() {
            let is_sampled = rows.present().contains(&true);
            if !is_sampled || self.storage(&mut codec.coder, channel, fineness[channel]).is_some() {
                present[channel] = Some(rows.present());
            } else {
                store(&mut codec.coder, *rows);
                codec.reports[channel].keep_all(*rows, codec.kept_rows);
            }
        }
        self.block(codec, n_rows, &present[..channels.len()])
    }

    /// Appends a payload like [`PayloadEncoder::encode`], with the points of a planner, if there is one.
    fn encode_planned(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        (reports, kept_rows): (&mut [BlockReport], &mut [bool]),
        planner: Option<&mut Planner>,
    ) {
        let start = out.len();
        // A larger block is stored as a whole.
        let limit = reports.iter().map(|report| report.samples as usize * 12).sum();
        let coder = RangeEncoder::new(out, limit);
        let mut codec = RowEncoder::new(channels, self.grid, coder, (reports, kept_rows), planner);
        let fineness = |rows: &Rows<'_>| self.grid.fineness(largest(*rows)?);
        let mut all = [None; GROUP_CHANNELS];
        all.iter_mut().zip(channels).for_each(|(one, rows)| *one = fineness(rows));
        let coded = self.encode_stored(&mut codec, channels, &all);
        if !codec.finish() || coded.is_err() {
            out.truncate(start);
            self.store_all(channels, out, reports, kept_rows);
        }
    }

    /// Stores a block as a whole, sample by sample; resets all state.
    fn store_all(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) {
        self.reset();
        let mut coder = RangeEncoder::new(out, usize::MAX);
        coder.split(P_CODED, true);
        for (rows, report) in channels.iter().zip(reports) {
            store(&mut coder, *rows);
            report.keep_all(*rows, kept_rows);
        }
        let finished = coder.finish();
        debug_assert!(finished, "there is no limit");
    }
}

/// An encoder that plans the points of each span before it codes them.
#[derive(Debug)]
pub(crate) struct PlanningEncoder {
    group: Dense,
    planner: Option<Planner>,
}

impl PlanningEncoder {
    pub(crate) fn new(tolerance: Tolerance, effort: Effort) -> Self {
        let planner = |depth: SearchDepth| Planner::new(Dense::new(tolerance), depth);
        Self { group: Dense::new(tolerance), planner: effort.depth().map(planner) }
    }
}

impl Payload for PlanningEncoder {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels, n_rows);
    }

    fn reset(&mut self) {
        self.group.reset();
    }

    fn forget_rows(&mut self) {
        self.group.forget_rows();
    }
}

impl PayloadEncoder for PlanningEncoder {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        Dense::max_payload_bytes(n_channels, n_rows)
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        if exact {
            return self.group.encode(channels, exact, out, reports, kept_rows);
        }
        let planner = self.planner.as_mut();
        self.group.encode_planned(channels, out, (reports, kept_rows), planner);
        Ok(())
    }
}

impl PayloadDecoder for PlanningEncoder {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        self.group.decode(payload, channels)
    }
}

/// Writes the samples of a channel as plain float32 bits.
fn store(coder: &mut impl BinaryCoder, rows: Rows<'_>) {
    for sample in (0..rows.len()).filter_map(|row| rows.get(row)) {
        for coordinate in sample {
            coder.plain(u64::from(coordinate.to_bits()), 32);
        }
    }
}

/// Codes the channels of a group in key blocks of `stretch_rows` rows and returns the statistics of all contexts.
///
/// # Errors
/// `InvalidArgument` under the conditions of [`BlockEncoder::encode`](crate::BlockEncoder::encode).
#[cfg(feature = "training")]
pub fn tally<'a>(
    tolerance: Tolerance,
    channels: &[Rows<'a>],
    stretch_rows: usize,
) -> Result<Tally> {
    let mut encoder = Dense::new(tolerance);
    let mut bytes = 0;
    let n_rows = channels.first().map_or(0, Rows::len);
    for first in (0..n_rows).step_by(stretch_rows.max(1)) {
        let last = (first + stretch_rows).min(n_rows);
        let part = |rows: &Rows<'a>| {
            Rows::new(&rows.positions()[first..last], &rows.present()[first..last])
        };
        let rows = channels.iter().map(part).collect::<Result<Vec<_>>>()?;
        let report = |rows: &Rows<'_>| -> Result<_> {
            Ok(BlockReport { samples: count_finite(*rows)? as u32, ..BlockReport::default() })
        };
        let mut reports = rows.iter().map(report).collect::<Result<Vec<_>>>()?;
        encoder.reset();
        let mut out = Vec::new();
        let mut kept_rows = vec![false; last - first];
        encoder.encode(&rows, false, &mut out, &mut reports, &mut kept_rows)?;
        bytes += out.len();
    }
    let mut tally = encoder.channels.model.tally;
    tally.bytes = bytes;
    Ok(tally)
}

/// The encoder of one block.
struct RowEncoder<'a, 'r> {
    channels: &'a [Rows<'a>],
    pub(super) coder: RangeEncoder<'a>,
    reports: &'r mut [BlockReport],
    kept_rows: &'r mut [bool],
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
    fn first_miss(&self) -> Option<usize> {
        self.squares.iter().position(|&squares| squares > self.samples.max_square)
    }

    /// Rows that were coded, or begun.
    fn rows_begun(&self) -> usize {
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

    /// The planned steps of a row.
    fn planned(&self, inputs: &ResidualInputs) -> Option<Point> {
        let plan = self.planner.as_ref()?.plan(self.channel);
        plan.fitting(self.slot + inputs.place, inputs, &self.samples)
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
