//! The order in which a group's rows are coded: the same walk encodes and decodes.

use super::{
    LEVELS, SPAN,
    ahead::{Ahead, Sites},
    code::Points,
    lattice::{Fineness, Grid, Lattice, Point},
    layout as is,
    layout::ORIGIN,
    lengths::Lengths,
    model::Model,
    origin,
    pulls::Pulls,
    row,
    track::{End, MEMORY, SpanMarks, SpanPoints, Track},
    weave::Weave,
};
use crate::{
    CodecError,
    coding::{isa::Isa, range::BinaryCoder},
};

/// What an encoder is asked before a residual is coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Question {
    /// Among the rows ahead.
    pub(super) place: usize,
    /// In units, whole.
    pub(super) prediction: [f64; 3],
    /// Of the row.
    pub(super) kind: usize,
    pub(super) lattice: Lattice,
    pub(super) fineness: Fineness,
    /// Averages of the magnitudes in 1/256, by axis.
    pub(super) activity: [i32; 3],
    /// Nothing is predicted from the row.
    pub(super) last_level: bool,
}

/// Encoder or decoder.
pub(super) trait Side {
    type Coder: BinaryCoder;
    fn coder(&mut self) -> &mut Self::Coder;
    /// The lattice steps to code for a row outside; all zero to stay at the prediction.
    fn choose(&mut self, question: Question) -> Point;
    /// Which of the candidates a first row is coded from, and the steps from there. Ignored, too.
    fn start(&mut self, channel: usize, row: usize, step: i64, ways: &[Point]) -> (usize, Point);
    /// Which rows come next.
    fn ahead(&mut self, channel: usize, sites: &Sites);
    /// Of some of them, a bit each, those whose sample is not within the tolerance of the prediction. A decoder's
    /// answer is ignored.
    fn outside<const N: usize>(
        &mut self,
        channel: usize,
        batch: Batch,
        predictions: &Points<N>,
    ) -> u32;
    /// The points of some rows are known, in units; of those that are kept a bit is set.
    fn settle<const N: usize>(
        &mut self,
        channel: usize,
        batch: Batch,
        points: &Points<N>,
        kept: u32,
    );
}

/// A few rows of one level, as rows of a track.
#[derive(Debug, Clone, Copy)]
pub(super) struct Batch {
    pub(super) first: usize,
    pub(super) step: usize,
    /// [`TOGETHER`](super::code::TOGETHER) at most.
    pub(super) n: usize,
    /// The place of the first among the rows ahead.
    pub(super) from: usize,
}

impl Batch {
    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// As a row of the block.
    pub(super) fn row(&self, i: usize) -> usize {
        self.at(i) - MEMORY
    }
}

/// A run of present rows within a span, as rows of a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Run {
    /// Its first row, or the row before the span when it goes on from there.
    zero: usize,
    channel: usize,
    end: usize,
}

/// Everything that a group of channels remembers.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) grid: Grid,
    pub(super) tracks: Vec<Track>,
    pub(super) model: Model,
    pub(super) weave: Weave,
    pub(super) lengths: Lengths,
    pub(super) ahead: Box<Ahead>,
    pub(super) pulls: Box<Pulls>,
    pub(super) isa: Isa,
    runs: Vec<Run>,
    /// Rows since the key block.
    first_row: u64,
}

impl Group {
    pub(super) fn new(grid: Grid) -> Self {
        Self {
            grid,
            tracks: Vec::new(),
            model: Model::new(),
            weave: Weave::new(),
            lengths: Lengths::new(),
            ahead: Box::new(Ahead::new()),
            pulls: Box::new(Pulls::new()),
            isa: Isa::detect(),
            runs: Vec::new(),
            first_row: 0,
        }
    }

    pub(super) fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        if self.tracks.len() < n_channels {
            self.tracks.resize_with(n_channels, Track::default);
        }
        self.tracks.iter_mut().for_each(|track| track.prepare(n_rows));
        // Runs are at least a row long and a row apart.
        self.runs.reserve((n_channels * SPAN.div_ceil(2)).saturating_sub(self.runs.len()));
    }

    pub(super) fn reset(&mut self) {
        self.tracks.iter_mut().for_each(Track::reset);
        self.model.reset();
        self.weave.reset();
        self.lengths.reset();
        self.first_row = 0;
    }

    /// The rows before the next block are not known.
    pub(super) fn break_off(&mut self) {
        self.tracks.iter_mut().for_each(Track::forget);
    }

    /// Codes the rows of a block, `present` by channel; `None` for a channel that is stored raw.
    pub(super) fn block<S: Side>(
        &mut self,
        side: &mut S,
        n_rows: usize,
        present: &[Option<&[bool]>],
    ) -> Result<(), CodecError> {
        let n = present.len();
        if self.tracks.len() < n {
            self.tracks.resize_with(n, Track::default);
        }
        self.tracks.iter_mut().for_each(|track| track.begin(n_rows));
        let mut before = MEMORY - 1;
        while before + 1 < MEMORY + n_rows {
            let last = (before + SPAN).min(MEMORY + n_rows - 1);
            self.span(side, (before, last), present)?;
            before = last;
        }
        self.tracks.iter_mut().for_each(|track| track.finish(n_rows));
        self.first_row += n_rows as u64;
        Ok(())
    }

    /// The rows after `before`, up to `last`.
    fn span<S: Side>(
        &mut self,
        side: &mut S,
        (before, last): (usize, usize),
        present: &[Option<&[bool]>],
    ) -> Result<(), CodecError> {
        let n = present.len();
        self.weave.begin(n);
        for (channel, track) in self.tracks[..n].iter_mut().enumerate() {
            track.span = SpanPoints::default();
            track.marks = SpanMarks::default();
            if track.known[before] {
                self.weave.place(channel, track.at(before));
            }
        }
        self.find_runs((before, last), present);
        let mut runs = std::mem::take(&mut self.runs);
        let walked = self.walk(side, &mut runs, before, present);
        self.runs = runs;
        walked?;
        self.weave.end(n);
        Ok(())
    }

    /// All rows of some runs.
    fn walk<S: Side>(
        &mut self,
        side: &mut S,
        runs: &mut [Run],
        before: usize,
        present: &[Option<&[bool]>],
    ) -> Result<(), CodecError> {
        let mut looked_around = 0_u64;
        for &run in &*runs {
            if run.zero > before {
                self.origin(side, run.channel, (run.zero, before), present)?;
                self.tracks[run.channel].known[run.zero] = true;
            } else {
                let track = &mut self.tracks[run.channel];
                track.run_start = track.run_start.max((before + 1).saturating_sub(MEMORY));
            }
            if looked_around >> run.channel & 1 == 0 {
                looked_around |= 1 << run.channel;
                self.look_around(run.channel, present.len(), before);
            }
            if run.end > run.zero {
                self.anchor(side, run, before)?;
            }
            let track = &mut self.tracks[run.channel];
            track.known[run.end] = true;
            let row = self.first_row + (run.end - MEMORY) as u64;
            track.end = Some(End { row, point: track.point(run.end), taken: false });
        }
        // Now by channel, so that the references of a row are there before it.
        runs.sort_unstable_by_key(|run| (run.channel, run.zero));
        for stride in (0..LEVELS).rev().map(|bit| 1 << bit) {
            self.level(side, runs, stride, before)?;
        }
        for run in &*runs {
            let track = &mut self.tracks[run.channel];
            track.known[run.zero..=run.end].fill(true);
            // A run that begins in this span starts with its own first row.
            if run.zero > before {
                track.run_start = run.zero;
            }
        }
        Ok(())
    }

    /// All runs of the span, by first row, then channel.
    fn find_runs(&mut self, (before, last): (usize, usize), present: &[Option<&[bool]>]) {
        self.runs.clear();
        for (channel, present) in present.iter().enumerate() {
            let Some(present) = present else { continue };
            let goes_on = self.tracks[channel].known[before];
            let rows = &present[before + 1 - MEMORY..=last - MEMORY];
            // Most often there is no gap.
            if rows.iter().fold(true, |all, &row| all & row) {
                let zero = if goes_on { before } else { before + 1 };
                self.runs.push(Run { zero, channel, end: last });
                continue;
            }
            let mut row = before + 1;
            while row <= last {
                if !present[row - MEMORY] {
                    row += 1;
                    continue;
                }
                let zero = if goes_on && row == before + 1 { before } else { row };
                while row < last && present[row + 1 - MEMORY] {
                    row += 1;
                }
                self.runs.push(Run { zero, channel, end: row });
                row += 2;
            }
        }
        self.runs.sort_unstable();
    }

    /// Where the channel is among the others, and what follows from it.
    fn look_around(&mut self, channel: usize, n: usize, before: usize) {
        let track = &self.tracks[channel];
        if !self.weave.has_place(channel) && track.known[before + 1] {
            self.weave.place(channel, track.at(before + 1));
        }
        self.weave.find_near(channel, self.grid.unit_mm);
        let weave = &self.weave;
        self.lengths.choose(channel, |k| weave.nearness(channel, k));
        self.weave.solve(channel, n);
    }

    /// The rows of one level, by channel.
    fn level<S: Side>(
        &mut self,
        side: &mut S,
        runs: &[Run],
        stride: usize,
        before: usize,
    ) -> Result<(), CodecError> {
        for run in runs {
            let start = self.start_of(run, before);
            self.ahead.sites = Sites::level(stride, (start, run.zero, run.end), before);
            if self.ahead.sites.n == 0 {
                continue;
            }
            self.rows(side, run.channel, 4 + stride.ilog2() as usize)?;
        }
        Ok(())
    }

    fn start_of(&self, run: &Run, before: usize) -> usize {
        if run.zero > before { run.zero } else { self.tracks[run.channel].run_start }
    }

    /// The first row of a run.
    fn origin<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        (at, before): (usize, usize),
        present: &[Option<&[bool]>],
    ) -> Result<(), CodecError> {
        let found = origin::Ways::find(&self.tracks, channel, at, self.first_row, present);
        let step = self.tracks[channel].fineness.step(Lattice::Cubic);
        let (choice, steps) = side.start(channel, at - MEMORY, step, found.points());
        let choice = found.code(side.coder(), &mut self.model, choice);
        if let Some(end) = found.taken(choice).and_then(|k| self.tracks[k].end.as_mut()) {
            end.taken = true;
        }
        let steps = row::origin(side.coder(), &mut self.model, found.class(choice), steps)?;
        let from = found.points()[choice];
        let point: Point =
            std::array::from_fn(|axis| from[axis].wrapping_add(steps[axis].wrapping_mul(step)));
        self.settle_first(side, (channel, at, before), ORIGIN, (point, steps))
    }

    /// The last row of a run within the span.
    fn anchor<S: Side>(&mut self, side: &mut S, run: Run, before: usize) -> Result<(), CodecError> {
        let (channel, rows) = (run.channel, run.end - run.zero);
        let start = self.start_of(&run, before);
        let track = &self.tracks[channel];
        let known = |back: usize| track.point(run.zero - back);
        let (expected, guesses) = track.anchor.guess(known, run.zero - start, rows);
        let kind = match rows {
            17.. => 1,
            5.. => 2,
            _ => 3,
        };
        self.ahead.guessed(Sites::anchor((start, run.zero, run.end), before), expected);
        self.rows(side, channel, kind)?;
        let track = &mut self.tracks[channel];
        let point = track.point(run.end);
        track.anchor.score(&guesses, point);
        Ok(())
    }

    /// How a channel is stored in this block: not at all here, in fine steps, or as usual.
    pub(super) fn storage(
        &mut self,
        coder: &mut impl BinaryCoder,
        channel: usize,
        fineness: Option<Fineness>,
    ) -> Option<Fineness> {
        if self.tracks.len() <= channel {
            self.tracks.resize_with(channel + 1, Track::default);
        }
        let track = &mut self.tracks[channel];
        let raw = self.model.single(coder, is::RAW.at(track.was_raw), fineness.is_none());
        track.was_raw = 1 + usize::from(raw);
        if raw {
            return None;
        }
        let fine = fineness == Some(Fineness::Fine);
        let fine = self.model.single(coder, is::FINE.at(track.was_fine), fine);
        track.was_fine = 1 + usize::from(fine);
        track.fineness = if fine { Fineness::Fine } else { Fineness::Normal };
        Some(track.fineness)
    }
}
