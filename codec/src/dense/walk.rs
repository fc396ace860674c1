//! The order in which the rows of a group are coded, and the decoder. The same traversal encodes and decodes.

use super::{
    LEVELS, P_CODED, SPAN,
    contexts::{FINE, INTERPOLATED, RAW},
    lattice::{Fineness, Grid, Lattice, Point, Points},
    level::{Channels, RowCodec},
    level_prediction::{Batch, DecodedRun, LevelLayout, PAST_ROWS},
    model::ModelCoder,
    row_syntax::{self, FirstRow, OriginCandidates},
    track::{RunEnd, Track},
};
use crate::{
    DecodedRows, GROUP_CHANNELS, Result, Tolerance, block,
    coding::{
        isa::Isa,
        range::{BinaryCoder, RangeDecoder},
    },
    ensure,
    frame::{Payload, PayloadDecoder},
};

/// A run of present rows of one channel within a span. Rows are indices into a [`Track`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Run {
    /// Its first row, or the row before the span if the run continues from there.
    pub(super) zero: usize,
    pub(super) channel: usize,
    pub(super) end: usize,
}

/// The rows of a span, and which of them are present.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpanPresence<'a> {
    /// The row before its first one, and its last one, as indices into a [`Track`].
    pub(super) before: usize,
    pub(super) last: usize,
    /// The presence flags of the block by channel; `None` for a channel that is stored raw.
    pub(super) present: &'a [Option<&'a [bool]>],
}

/// A coder of the rows of whole spans.
pub(super) trait SpanCodec: RowCodec {
    /// Begins a span before any of its rows is coded.
    fn begin_span(&mut self, _group: &Dense, _span: SpanPresence<'_>) -> Result<()> {
        Ok(())
    }
}

/// Encoder and decoder of one group of channels.
#[derive(Debug)]
pub(crate) struct Dense {
    pub(super) grid: Grid,
    pub(super) channels: Channels,
    /// The runs of the current span.
    pub(super) runs: Vec<Run>,
    /// Number of rows from the key block to this block.
    pub(super) first_row: u64,
}

impl Payload for Dense {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.channels.grow(n_channels);
        self.channels.tracks.iter_mut().for_each(|track| track.prepare(n_rows));
        // Runs are at least one row long and one row apart.
        self.runs.reserve((n_channels * SPAN.div_ceil(2)).saturating_sub(self.runs.len()));
    }

    fn reset(&mut self) {
        self.channels.reset();
        self.first_row = 0;
    }

    fn forget_rows(&mut self) {
        self.channels.tracks.iter_mut().for_each(Track::forget);
    }
}

impl Dense {
    /// A group in its initial state.
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self::with_isa(tolerance, Isa::detect())
    }

    pub(super) fn with_isa(tolerance: Tolerance, isa: Isa) -> Self {
        let (grid, channels) = (Grid::new(tolerance), Channels::new(isa));
        Self { grid, channels, runs: Vec::new(), first_row: 0 }
    }

    /// Codes the rows of a block. `present` has the flags of each channel; `None` for a channel that is stored raw.
    pub(super) fn block<S: SpanCodec>(
        &mut self,
        codec: &mut S,
        n_rows: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        self.channels.grow(present.len());
        self.channels.tracks.iter_mut().for_each(|track| track.begin(n_rows));
        let mut before = PAST_ROWS - 1;
        while before + 1 < PAST_ROWS + n_rows {
            let last = (before + SPAN).min(PAST_ROWS + n_rows - 1);
            self.span(codec, SpanPresence { before, last, present })?;
            before = last;
        }
        self.channels.tracks.iter_mut().for_each(|track| track.finish(n_rows));
        self.first_row += n_rows as u64;
        Ok(())
    }

    /// Codes a span.
    fn span<S: SpanCodec>(&mut self, codec: &mut S, span: SpanPresence<'_>) -> Result<()> {
        let SpanPresence { before, last, present } = span;
        let n = present.len();
        self.begin_span(before, n);
        self.find_runs(before, last, present);
        codec.begin_span(self, span)?;
        let mut runs = std::mem::take(&mut self.runs);
        let walked = self.walk(codec, &mut runs, before, present);
        self.runs = runs;
        walked?;
        self.channels.cross_channel.end(n);
        Ok(())
    }

    /// Copies the state of a group at the beginning of a span, and begins the span.
    pub(super) fn follow(&mut self, other: &Self, span: SpanPresence<'_>) {
        let SpanPresence { before, last, present } = span;
        // Older rows were copied with the spans before.
        self.channels.follow(&other.channels, present.len(), before + 1 - PAST_ROWS..=last);
        self.first_row = other.first_row;
        self.begin_span(before, present.len());
    }

    /// Begins a span of `n` channels.
    pub(super) fn begin_span(&mut self, before: usize, n: usize) {
        let Channels { tracks, cross_channel, .. } = &mut self.channels;
        cross_channel.begin(n);
        for (channel, track) in tracks[..n].iter_mut().enumerate() {
            track.begin_span();
            // NaN, where the row is unknown.
            cross_channel.set_position(channel, track.points[before]);
        }
    }

    /// Finds all runs of the span, ordered by first row, then channel.
    fn find_runs(&mut self, before: usize, last: usize, present: &[Option<&[bool]>]) {
        self.runs.clear();
        for (channel, present) in present.iter().enumerate() {
            let Some(present) = present else { continue };
            let goes_on = self.channels.tracks[channel].is_known(before);
            for run in block::runs(&present[before + 1 - PAST_ROWS..=last - PAST_ROWS]) {
                let zero = before + 1 + run.start - usize::from(goes_on && run.start == 0);
                self.runs.push(Run { zero, channel, end: before + run.end });
            }
        }
        self.runs.sort_unstable();
    }

    /// Codes all rows of the runs of a span.
    pub(super) fn walk<S: RowCodec>(
        &mut self,
        codec: &mut S,
        runs: &mut [Run],
        before: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        let mut searched = 0_u64;
        for &run in &*runs {
            self.begin_run(codec, run, before, present)?;
            if searched >> run.channel & 1 == 0 {
                searched |= 1 << run.channel;
                self.choose_neighbours(run.channel, present.len(), before);
            }
            if run.end > run.zero {
                self.anchor(codec, run, before)?;
            }
            self.end_run(run);
        }
        // By channel, so that the references of a row are decoded before it.
        runs.sort_unstable_by_key(|run| (run.channel, run.zero));
        for bit in (0..LEVELS).rev() {
            for run in &*runs {
                self.level(codec, run, before, bit)?;
            }
        }
        // For the next span, a run that begins in this one starts at its own first row.
        for run in runs.iter().filter(|run| run.zero > before) {
            self.channels.tracks[run.channel].run_start = run.zero;
        }
        Ok(())
    }

    /// Codes the first row of a run, unless it continues from the row before the span.
    pub(super) fn begin_run<S: RowCodec>(
        &mut self,
        codec: &mut S,
        run: Run,
        before: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        if run.zero > before {
            return self.origin(codec, run, before, present);
        }
        let track = &mut self.channels.tracks[run.channel];
        track.run_start = track.run_start.max((before + 1).saturating_sub(PAST_ROWS));
        Ok(())
    }

    /// Records the last row of a run, which is coded.
    pub(super) fn end_run(&mut self, run: Run) {
        let track = &mut self.channels.tracks[run.channel];
        let row = self.first_row + (run.end - PAST_ROWS) as u64;
        track.end = Some(RunEnd { row, point: track.point(run.end), taken: false });
    }

    /// The last row of the run before the current one of a channel, if it is a row of this block.
    pub(super) fn end_in_block(&self, channel: usize) -> Option<usize> {
        let end = self.channels.tracks[channel].end?;
        Some(end.row.checked_sub(self.first_row)? as usize + PAST_ROWS)
    }

    /// Codes the rows of a run of the stride `1 << bit`, if there are any.
    pub(super) fn level<S: RowCodec>(
        &mut self,
        codec: &mut S,
        run: &Run,
        before: usize,
        bit: usize,
    ) -> Result<()> {
        let layout = LevelLayout::level(1 << bit, self.decoded_run(run, before), before);
        if layout.n == 0 {
            return Ok(());
        }
        self.channels.level.layout = layout;
        self.channels.code(codec, INTERPOLATED + bit)
    }

    pub(super) fn decoded_run(&self, run: &Run, before: usize) -> DecodedRun {
        let Run { zero, channel, end } = *run;
        let start = if zero > before { zero } else { self.channels.tracks[channel].run_start };
        DecodedRun { channel, start, zero, end }
    }

    /// Chooses the reference channels and the partners of a channel by its position among the others.
    pub(super) fn choose_neighbours(&mut self, channel: usize, n: usize, before: usize) {
        let Channels { tracks, cross_channel, segments, .. } = &mut self.channels;
        if !cross_channel.has_position(channel) {
            cross_channel.set_position(channel, tracks[channel].points[before + 1]);
        }
        cross_channel.choose_references(channel, n, self.grid.unit_mm);
        segments.choose_partners(channel, |k| cross_channel.nearness(channel, k));
    }

    /// Codes the first row of a run.
    fn origin<S: RowCodec>(
        &mut self,
        codec: &mut S,
        run: Run,
        before: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        let Run { zero: at, channel, .. } = run;
        let Channels { tracks, model, .. } = &mut self.channels;
        let origins = OriginCandidates::find(tracks, channel, at, self.first_row, present);
        let step = tracks[channel].fineness.step(Lattice::Cubic);
        let FirstRow { candidate, steps } =
            codec.position(channel, at - PAST_ROWS).map_or_else(FirstRow::default, |position| {
                row_syntax::choose(self.grid, position, step, codec.is_exact(), origins.points())
            });
        let candidate = origins.code(codec.coder(), model, candidate);
        if let Some(end) = origins.taken(candidate).and_then(|k| tracks[k].end.as_mut()) {
            end.taken = true;
        }
        let class = origins.class(candidate);
        let steps = row_syntax::residual(codec.coder(), model, class, steps)?;
        let from = origins.points()[candidate];
        let point: Point =
            std::array::from_fn(|axis| from[axis].wrapping_add(steps[axis].wrapping_mul(step)));
        let decoded = DecodedRun { channel, start: at, zero: at, end: at };
        let layout = LevelLayout::anchor(decoded, before);
        self.channels.store_first_row(codec, &layout, point, steps)
    }

    /// Codes the anchor of a run: its last row within the span.
    pub(super) fn anchor<S: RowCodec>(
        &mut self,
        codec: &mut S,
        run: Run,
        before: usize,
    ) -> Result<()> {
        let decoded = self.decoded_run(&run, before);
        let (channel, rows) = (run.channel, run.end - run.zero);
        let track = &self.channels.tracks[channel];
        let known = |back: usize| track.point(run.zero - back);
        let n_before = run.zero - decoded.start;
        let (expected, extrapolations) = track.anchor_errors.extrapolate(known, n_before, rows);
        let kind = match rows {
            17.. => 1,
            5.. => 2,
            _ => 3,
        };
        self.channels.level.set_expected(LevelLayout::anchor(decoded, before), expected);
        self.channels.code(codec, kind)?;
        let track = &mut self.channels.tracks[channel];
        let point = track.point(run.end);
        track.anchor_errors.score(&extrapolations, point);
        Ok(())
    }

    /// Codes how a channel is stored in this block: `None` for raw, or the size of its lattice steps.
    pub(super) fn storage(
        &mut self,
        coder: &mut impl ModelCoder,
        channel: usize,
        fineness: Option<Fineness>,
    ) -> Option<Fineness> {
        self.channels.grow(channel + 1);
        let Channels { tracks, model, .. } = &mut self.channels;
        let track = &mut tracks[channel];
        let raw = model.single(coder, RAW.at(track.was_raw), fineness.is_none());
        track.was_raw = 1 + usize::from(raw);
        if raw {
            return None;
        }
        let fine = fineness == Some(Fineness::Fine);
        let fine = model.single(coder, FINE.at(track.was_fine), fine);
        track.was_fine = 1 + usize::from(fine);
        track.fineness = if fine { Fineness::Fine } else { Fineness::Normal };
        Some(track.fineness)
    }
}

impl PayloadDecoder for Dense {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        let n_channels = channels.len().min(GROUP_CHANNELS);
        let coder = RangeDecoder::new(payload);
        let mut codec = RowDecoder { channels, grid: self.grid, coder };
        if codec.coder.split(P_CODED, false) {
            self.reset();
            for channel in 0..n_channels {
                codec.stored(channel)?;
            }
            return codec.coder.finish();
        }
        // The flags are moved out while the other fields of the rows are written.
        let mut flags = [const { Vec::new() }; GROUP_CHANNELS];
        let mut is_raw = [false; GROUP_CHANNELS];
        for channel in 0..n_channels {
            if codec.channels[channel].has_samples() {
                // A decoder ignores its argument and returns the encoder's choice.
                let fineness = self.storage(&mut codec.coder, channel, Some(Fineness::Normal));
                is_raw[channel] = fineness.is_none();
            }
            if is_raw[channel] {
                codec.stored(channel)?;
            }
            flags[channel] = std::mem::take(&mut codec.channels[channel].present);
        }
        let present: [Option<&[bool]>; GROUP_CHANNELS] =
            std::array::from_fn(|channel| (!is_raw[channel]).then_some(&flags[channel][..]));
        self.block(&mut codec, n_rows, &present[..n_channels])?;
        let RowDecoder { channels, coder, .. } = codec;
        for (rows, present) in channels.iter_mut().zip(flags) {
            rows.present = present;
        }
        coder.finish()
    }
}

/// The decoder of one block.
struct RowDecoder<'a> {
    channels: &'a mut [DecodedRows],
    grid: Grid,
    coder: RangeDecoder<'a>,
}

impl RowDecoder<'_> {
    /// Reads the samples of a channel that are stored as plain float32 bits.
    fn stored(&mut self, channel: usize) -> Result<()> {
        let rows = &mut self.channels[channel];
        for row in 0..rows.present.len() {
            if !rows.present[row] {
                continue;
            }
            for coordinate in &mut rows.positions[row] {
                *coordinate = f32::from_bits(self.coder.plain(0, 32) as u32);
                ensure(coordinate.is_finite(), "a stored coordinate is not finite")?;
            }
            rows.kept[row] = true;
        }
        Ok(())
    }
}

impl SpanCodec for RowDecoder<'_> {}

impl<'a> RowCodec for RowDecoder<'a> {
    type Coder = RangeDecoder<'a>;

    fn coder(&mut self) -> &mut RangeDecoder<'a> {
        &mut self.coder
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32) {
        let DecodedRows { positions, kept: flags, .. } = &mut self.channels[batch.channel];
        let [x, y, z] = self.grid.positions(points);
        for i in 0..batch.n.min(N) {
            let row = batch.row(i);
            positions[row] = [x[i], y[i], z[i]];
        }
        // All flags are false so far.
        let mut kept = kept;
        while kept != 0 {
            flags[batch.row(kept.trailing_zeros() as usize)] = true;
            kept &= kept - 1;
        }
    }
}
