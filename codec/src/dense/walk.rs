//! The order in which the rows of a group are coded. The same traversal encodes and decodes.

use super::{
    LEVELS, SPAN,
    contexts::{FINE, INTERPOLATED, RAW},
    first_row::{self, OriginCandidates},
    level::{Channels, FirstRow, RowCodec},
    level_prediction::{DecodedRun, LevelLayout, PAST_ROWS},
    points::{Fineness, Grid, Lattice, Point},
    track::{RunEnd, Track},
};
use crate::{
    Result, Tolerance, block,
    coding::{isa::Isa, range::BinaryCoder},
    frame::Payload,
};

/// A run of present rows of one channel within a span. Rows are indices into a [`Track`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Run {
    /// Its first row, or the row before the span if the run continues from there.
    zero: usize,
    channel: usize,
    end: usize,
}

/// Encoder and decoder of one group of channels.
#[derive(Debug)]
pub(crate) struct Dense {
    pub(super) grid: Grid,
    pub(super) channels: Channels,
    runs: Vec<Run>,
    /// Number of rows from the key block to this block.
    first_row: u64,
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
    pub(super) fn block<S: RowCodec>(
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
            self.span(codec, before, last, present)?;
            before = last;
        }
        self.channels.tracks.iter_mut().for_each(|track| track.finish(n_rows));
        self.first_row += n_rows as u64;
        Ok(())
    }

    /// Codes a span: the rows after `before`, up to `last`.
    fn span<S: RowCodec>(
        &mut self,
        codec: &mut S,
        before: usize,
        last: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        let n = present.len();
        let Channels { tracks, cross_channel, .. } = &mut self.channels;
        cross_channel.begin(n);
        for (channel, track) in tracks[..n].iter_mut().enumerate() {
            track.begin_span();
            // NaN, where the row is unknown.
            cross_channel.set_position(channel, track.points[before]);
        }
        self.find_runs(before, last, present);
        let mut runs = std::mem::take(&mut self.runs);
        let walked = self.walk(codec, &mut runs, before, present);
        self.runs = runs;
        walked?;
        self.channels.cross_channel.end(n);
        Ok(())
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
    fn walk<S: RowCodec>(
        &mut self,
        codec: &mut S,
        runs: &mut [Run],
        before: usize,
        present: &[Option<&[bool]>],
    ) -> Result<()> {
        let mut searched = 0_u64;
        for &run in &*runs {
            if run.zero > before {
                self.origin(codec, run, before, present)?;
            } else {
                let track = &mut self.channels.tracks[run.channel];
                track.run_start = track.run_start.max((before + 1).saturating_sub(PAST_ROWS));
            }
            if searched >> run.channel & 1 == 0 {
                searched |= 1 << run.channel;
                self.choose_neighbours(run.channel, present.len(), before);
            }
            if run.end > run.zero {
                self.anchor(codec, run, before)?;
            }
            let track = &mut self.channels.tracks[run.channel];
            let row = self.first_row + (run.end - PAST_ROWS) as u64;
            track.end = Some(RunEnd { row, point: track.point(run.end), taken: false });
        }
        // By channel, so that the references of a row are decoded before it.
        runs.sort_unstable_by_key(|run| (run.channel, run.zero));
        for bit in (0..LEVELS).rev() {
            for run in &*runs {
                let layout = LevelLayout::level(1 << bit, self.decoded_run(run, before), before);
                if layout.n > 0 {
                    self.channels.level.layout = layout;
                    self.channels.code(codec, INTERPOLATED + bit)?;
                }
            }
        }
        // For the next span, a run that begins in this one starts at its own first row.
        for run in runs.iter().filter(|run| run.zero > before) {
            self.channels.tracks[run.channel].run_start = run.zero;
        }
        Ok(())
    }

    fn decoded_run(&self, run: &Run, before: usize) -> DecodedRun {
        let Run { zero, channel, end } = *run;
        let start = if zero > before { zero } else { self.channels.tracks[channel].run_start };
        DecodedRun { channel, start, zero, end }
    }

    /// Chooses the reference channels and the partners of a channel by its position among the others.
    fn choose_neighbours(&mut self, channel: usize, n: usize, before: usize) {
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
            codec.choose_first(channel, at - PAST_ROWS, step, origins.points());
        let candidate = origins.code(codec.coder(), model, candidate);
        if let Some(end) = origins.taken(candidate).and_then(|k| tracks[k].end.as_mut()) {
            end.taken = true;
        }
        let class = origins.class(candidate);
        let steps = first_row::residual(codec.coder(), model, class, steps)?;
        let from = origins.points()[candidate];
        let point: Point =
            std::array::from_fn(|axis| from[axis].wrapping_add(steps[axis].wrapping_mul(step)));
        let decoded = DecodedRun { channel, start: at, zero: at, end: at };
        let layout = LevelLayout::anchor(decoded, before);
        self.channels.store_first_row(codec, &layout, point, steps)
    }

    /// Codes the anchor of a run: its last row within the span.
    fn anchor<S: RowCodec>(&mut self, codec: &mut S, run: Run, before: usize) -> Result<()> {
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
        coder: &mut impl BinaryCoder,
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
