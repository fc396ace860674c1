//! The rows of one level and run: what the other channels say of them, their residuals, and what is learnt from them.
//!
//! The same code encodes and decodes: what both sides do differently is behind [`RowCodec`].

use super::{
    contexts::{INTERPOLATED, ORIGIN},
    cross_channel::{CrossChannel, class_of},
    distance_correction::{DistanceCorrection, BATCH_ROWS},
    level_prediction::{Batch, LevelPrediction, LevelLayout},
    model::Model,
    points::{Fineness, LANES, Lattice, Point, Points, in_range, lanes},
    residual::{self, Neighbourhood, Residual},
    segment_lengths::SegmentLengths,
    track::{Steps, Track, update_activity},
};
use crate::{
    Result,
    coding::{
        isa::{Isa, Kernel},
        range::BinaryCoder,
    },
    ensure,
};

/// What an encoder is asked before a residual is coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct ResidualInputs {
    /// Among the rows of the level.
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

/// What a first row is coded from: one of the candidates, and the steps from there.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FirstRow {
    pub(super) candidate: usize,
    pub(super) steps: Point,
}

/// Encoder or decoder. What a decoder answers where it is asked for a choice is ignored.
pub(super) trait RowCodec {
    type Coder: BinaryCoder;

    fn coder(&mut self) -> &mut Self::Coder;

    /// The lattice steps to code for a row outside; all zero to stay at the prediction.
    #[inline(always)]
    fn choose(&mut self, _question: ResidualInputs) -> Point {
        [0; 3]
    }

    /// How a first row is coded, in steps so large.
    fn choose_first(&mut self, _channel: usize, _row: usize, _step: i64, _origins: &[Point]) -> FirstRow {
        FirstRow::default()
    }

    /// Which rows come next.
    #[inline(always)]
    fn begin(&mut self, _sites: &LevelLayout) {}

    /// Of some of them, a bit each, those whose sample is not within the tolerance of the prediction.
    #[inline(always)]
    fn outside<const N: usize>(&mut self, _batch: Batch, _predictions: &Points<N>) -> u32 {
        0
    }

    /// The points of some rows are known, in units; of those that are kept a bit is set.
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32);
}

/// Strides 1, 2 and 4, which are off by little.
const FINE_KINDS: std::ops::Range<usize> = INTERPOLATED..INTERPOLATED + 3;

/// Everything that a group remembers of its channels, and what their rows are coded with.
#[derive(Debug)]
pub(super) struct Channels {
    pub(super) tracks: Vec<Track>,
    pub(super) model: Model,
    pub(super) cross_channel: CrossChannel,
    pub(super) segments: SegmentLengths,
    correction: Box<DistanceCorrection>,
    pub(super) level: Box<LevelPrediction>,
    isa: Isa,
}

impl Channels {
    pub(super) fn new(isa: Isa) -> Self {
        Self {
            tracks: Vec::new(),
            model: Model::new(),
            cross_channel: CrossChannel::new(isa),
            segments: SegmentLengths::new(),
            correction: Box::new(DistanceCorrection::new()),
            level: Box::new(LevelPrediction::new()),
            isa,
        }
    }

    pub(super) fn grow(&mut self, n_channels: usize) {
        if self.tracks.len() < n_channels {
            self.tracks.resize_with(n_channels, Track::new);
        }
    }

    pub(super) fn reset(&mut self) {
        self.tracks.iter_mut().for_each(Track::reset);
        self.model.reset();
        self.cross_channel.reset();
        self.segments.reset();
        self.correction.reset();
    }

    /// Stores a first row, which is moved by some steps.
    pub(super) fn store_first_row<S: RowCodec>(
        &mut self,
        codec: &mut S,
        layout: &LevelLayout,
        point: Point,
        steps: Point,
    ) -> Result<()> {
        let batch = layout.batch(0, 1);
        codec.begin(layout);
        let track = &mut self.tracks[batch.channel];
        let mut activity = track.activity[ORIGIN];
        track.record_steps(batch.first, batch.slot, steps, &mut activity);
        track.activity[ORIGIN] = activity;
        self.store_rows(codec, batch, &point.map(|units| [units as f64; 1]), 1)
    }

    /// Codes the rows of the [`level`](Self::level): of anchors it is known where time alone puts them.
    pub(super) fn code<S: RowCodec>(&mut self, codec: &mut S, kind: usize) -> Result<()> {
        let isa = self.isa;
        if FINE_KINDS.contains(&kind) {
            isa.run(LevelPass::<S, BATCH_ROWS, false> { channels: self, codec, kind })
        } else {
            isa.run(LevelPass::<S, LANES, true> { channels: self, codec, kind })
        }
    }

    /// The marks of the references, summed, at some rows that lie side by side.
    #[inline(always)]
    fn reference_magnitudes<const N: usize>(&self, channel: usize, class: usize, slot: usize) -> [u64; N] {
        let found = self.cross_channel.references(class, channel);
        let marks = |k: usize| -> [u64; N] { lanes(&self.tracks[k].packed_steps, slot) };
        if found.n == 0 && channel > 0 {
            return marks(channel - 1).map(|marks| 2 * marks);
        }
        let mut sums = [0; N];
        for &k in &found.channels[..found.n] {
            for (sum, marks) in sums.iter_mut().zip(marks(k)) {
                *sum += marks;
            }
        }
        sums
    }

    /// Stores the points of some rows, of which those are kept whose bit is set.
    #[inline(always)]
    fn store_rows<S: RowCodec, const N: usize>(
        &mut self,
        codec: &mut S,
        batch: Batch,
        points: &Points<N>,
        kept: u32,
    ) -> Result<()> {
        ensure(in_range(points, batch.n), "a position beyond every coordinate")?;
        self.tracks[batch.channel].store_points(batch, points);
        codec.finish_rows(batch, points, kept);
        Ok(())
    }

    /// Codes some of the rows of the level, `N` at most.
    #[inline(always)]
    fn batch<S: RowCodec, const N: usize, const COARSE: bool>(
        &mut self,
        codec: &mut S,
        kind: usize,
        batch: Batch,
    ) -> Result<()> {
        let Batch { channel, from, slot, .. } = batch;
        let referred = self.reference_magnitudes::<N>(channel, class_of(kind), slot);
        let Self { tracks, model, segments, correction, level, isa, .. } = self;
        let mut points = correction.correct::<N, COARSE>(channel, kind, level, segments, tracks, from);
        let outside = codec.outside(batch, &points);
        let layout = level.layout;
        let track = &mut tracks[channel];
        let mut activity = track.activity[kind];
        let mut kept = 0;
        let only = |steps: Steps| if layout.stride > 0 { steps } else { Steps::default() };
        // What is right of a row is left of the next, and what is before it was the row itself.
        let mut left = track.steps[layout.neighbours(from).0];
        let mut before = only(track.steps_from(layout.run.start, batch.first, 2 * layout.stride));
        let mut before2 =
            only(track.steps_from(layout.run.start, batch.first, 4 * layout.stride));
        for i in 0..batch.n.min(N) {
            let at = batch.at(i);
            let right = only(track.steps[(at + layout.stride).min(layout.run.end)]);
            let references = referred[i];
            let near = Neighbourhood { kind, left, right, before, before2, references, activity };
            left = right;
            before2 = before;
            before = Steps::default();
            let lattice = Lattice::of(&activity);
            let mut steps = [0; 3];
            if outside >> i & 1 == 1 {
                let [x, y, z, _] = activity;
                steps = codec.choose(ResidualInputs {
                    place: from + i,
                    prediction: points.each_ref().map(|axis| axis[i]),
                    kind,
                    lattice,
                    fineness: track.fineness,
                    activity: [x, y, z],
                    last_level: kind == 4 || (kind < 4 && at == layout.run.zero + 1),
                });
            }
            let moved = steps != [0; 3];
            if !residual::moving(codec.coder(), model, &near, level.bends[from + i], moved) {
                update_activity(&mut activity, [0; 4]);
                continue;
            }
            let hints = &level.hints(from + i);
            let coder = codec.coder();
            let coded = isa.run(Residual { coder, model, near: &near, hints, lattice, steps })?;
            let step = track.fineness.step(lattice);
            for (axis, steps) in points.iter_mut().zip(coded.steps) {
                axis[i] = (axis[i] as i64).wrapping_add(steps.wrapping_mul(step)) as f64;
            }
            kept |= 1 << i;
            before = track.record_steps(at, slot + i, coded.magnitudes, &mut activity);
            let expected = level.prediction.each_ref().map(|axis| axis[from + i]);
            correction.score(channel, kind, i, expected, points.each_ref().map(|axis| axis[i]));
        }
        track.activity[kind] = activity;
        self.cross_channel.remember(batch, &self.level, &points);
        self.store_rows(codec, batch, &points, kept)
    }
}

/// Codes the rows of a level, so many together.
#[derive(Debug)]
struct LevelPass<'a, S, const N: usize, const COARSE: bool> {
    channels: &'a mut Channels,
    codec: &'a mut S,
    kind: usize,
}

impl<S: RowCodec, const N: usize, const COARSE: bool> Kernel for LevelPass<'_, S, N, COARSE> {
    type Output = Result<()>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { channels, codec, kind } = self;
        let (class, layout) = (class_of(kind), channels.level.layout);
        let channel = layout.run.channel;
        codec.begin(&layout);
        if kind >= INTERPOLATED {
            channels.level.interpolate(&channels.tracks[channel].points);
        }
        channels.cross_channel.correct(class, &mut channels.level);
        channels.segments.expect(&layout, &channels.tracks);
        channels.correction.begin(channel, kind);
        for first in (0..layout.n).step_by(N) {
            channels.batch::<S, N, COARSE>(codec, kind, layout.batch(first, N))?;
        }
        if COARSE {
            channels.segments.learn(&layout, &channels.tracks);
        }
        if class == 0 {
            channels.cross_channel.learn_anchor(channel, layout.slot);
        }
        // The last level is between no other rows.
        if kind != INTERPOLATED {
            channels.segments.remember(&layout, &channels.tracks);
        }
        Ok(())
    }
}
