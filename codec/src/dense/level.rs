//! The rows of one level of a run: prediction, residuals, and the update of all statistics.
//!
//! The same code encodes and decodes; [`RowCodec`] holds what differs between the two.

use std::ops::RangeInclusive;

use super::{
    contexts::{INTERPOLATED, ORIGIN},
    cross_channel::{CrossChannel, class_of},
    distance_correction::{BATCH_ROWS, DistanceCorrection},
    lattice::{Fineness, LANES, Lattice, Point, Points, in_range, lanes},
    level_prediction::{Batch, LevelLayout, LevelPrediction},
    model::{Model, ModelCoder},
    row_syntax::{self, Neighbourhood, Residual},
    segment_lengths::SegmentLengths,
    track::{Steps, Track, update_activity},
};
use crate::{
    Position, Result,
    coding::isa::{Isa, Kernel},
    ensure,
};

/// The inputs of an encoder's choice of a residual.
#[derive(Debug, Clone, Copy)]
pub(super) struct ResidualInputs {
    /// Index of the row within the level.
    pub(super) place: usize,
    /// The prediction in units; whole numbers.
    pub(super) prediction: [f64; 3],
    /// Kind of the row.
    pub(super) kind: usize,
    pub(super) lattice: Lattice,
    pub(super) fineness: Fineness,
    /// Average magnitudes of the kind by axis, in 1/256 of a lattice step.
    pub(super) activity: [i32; 3],
    /// Whether no row is predicted from this one.
    pub(super) last_level: bool,
}

/// The part of coding that differs between encoder and decoder. The default methods are a decoder's, whose choices are
/// ignored.
pub(super) trait RowCodec {
    type Coder: ModelCoder;

    fn coder(&mut self) -> &mut Self::Coder;

    /// Chooses the lattice steps of a row whose prediction misses the tolerance; all zero keep the prediction.
    #[inline(always)]
    fn choose(&mut self, _inputs: ResidualInputs) -> Point {
        [0; 3]
    }

    /// The position of a sample, from which the steps of a first row are chosen: only encoders have it.
    fn position(&self, _channel: usize, _row: usize) -> Option<Position> {
        None
    }

    /// Whether the samples are to be met exactly.
    fn is_exact(&self) -> bool {
        false
    }

    /// Begins the rows of a level.
    #[inline(always)]
    fn begin(&mut self, _layout: &LevelLayout) {}

    /// One bit per row of a batch: its sample is outside the tolerance ball of the prediction.
    #[inline(always)]
    fn outside<const N: usize>(&mut self, _batch: Batch, _predictions: &Points<N>) -> u32 {
        0
    }

    /// Whether the result is already decided, so that the rest of a level may be skipped.
    #[inline(always)]
    fn gives_up(&self) -> bool {
        false
    }

    /// Takes the final points of a batch in units; `kept` has one bit per row that is kept.
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32);
}

/// The kinds of the strides 1, 2 and 4, whose predictions are close.
const FINE_KINDS: std::ops::Range<usize> = INTERPOLATED..INTERPOLATED + 3;

/// The state of a group: its channels, the probability model, and the predictors.
#[derive(Debug)]
pub(super) struct Channels {
    pub(super) tracks: Vec<Track>,
    pub(super) model: Model,
    pub(super) cross_channel: CrossChannel,
    pub(super) segments: SegmentLengths,
    pub(super) correction: Box<DistanceCorrection>,
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

    /// Copies the state of `n` channels before a span, and the rows `rows`.
    pub(super) fn follow(&mut self, other: &Self, n: usize, rows: RangeInclusive<usize>) {
        self.grow(n);
        for (track, other) in self.tracks.iter_mut().zip(&other.tracks) {
            track.follow(other, rows.clone());
        }
        self.model.follow(&other.model);
        self.cross_channel.follow(&other.cross_channel, n);
        self.segments.follow(&other.segments, n);
        self.correction.follow(&other.correction, n);
    }

    /// Stores a first row with its coded steps.
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

    /// Codes the rows of the current [`level`](Self::level). The prediction in time of an anchor is already set.
    pub(super) fn code<S: RowCodec>(&mut self, codec: &mut S, kind: usize) -> Result<()> {
        let isa = self.isa;
        if FINE_KINDS.contains(&kind) {
            isa.run(LevelPass::<S, BATCH_ROWS, false> { channels: self, codec, kind })
        } else {
            isa.run(LevelPass::<S, LANES, true> { channels: self, codec, kind })
        }
    }

    /// The summed packed steps of the references at `N` rows from `slot` on; without references, twice those of the
    /// channel before.
    #[inline(always)]
    fn reference_magnitudes<const N: usize>(
        &self,
        channel: usize,
        class: usize,
        slot: usize,
    ) -> [u64; N] {
        let found = self.cross_channel.references(class, channel);
        let steps = |k: usize| -> [u64; N] { lanes(&self.tracks[k].packed_steps, slot) };
        if found.n == 0 && channel > 0 {
            return steps(channel - 1).map(|steps| 2 * steps);
        }
        let mut sums = [0; N];
        for &k in &found.channels[..found.n] {
            for (sum, steps) in sums.iter_mut().zip(steps(k)) {
                *sum += steps;
            }
        }
        sums
    }

    /// Stores the points of a batch; `kept` has one bit per row that is kept.
    #[inline(always)]
    fn store_rows<S: RowCodec, const N: usize>(
        &mut self,
        codec: &mut S,
        batch: Batch,
        points: &Points<N>,
        kept: u32,
    ) -> Result<()> {
        ensure(in_range(points, batch.n), "a position out of range")?;
        self.tracks[batch.channel].store_points(batch, points);
        codec.finish_rows(batch, points, kept);
        Ok(())
    }

    /// Codes a batch of up to `N` rows.
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
        let mut points =
            correction.correct::<N, COARSE>(channel, kind, level, segments, tracks, from);
        let outside = codec.outside(batch, &points);
        let layout = level.layout;
        let track = &mut tracks[channel];
        let mut activity = track.activity[kind];
        let mut kept = 0;
        let only = |steps: Steps| if layout.stride > 0 { steps } else { Steps::default() };
        // The right neighbour of a row is the left one of the next, and each row is the row before of the next.
        let mut left = track.steps[layout.neighbours(from).0];
        let mut before = only(track.steps_from(layout.run.start, batch.first, 2 * layout.stride));
        let mut before2 = only(track.steps_from(layout.run.start, batch.first, 4 * layout.stride));
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
            if !row_syntax::moving(codec.coder(), model, &near, level.bends[from + i], moved) {
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

/// Codes the rows of a level in batches of `N`.
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
            if codec.gives_up() {
                return Ok(());
            }
        }
        // Learn for the spans and channels that follow.
        if COARSE && S::Coder::LEARNS {
            channels.segments.learn(&layout, &channels.tracks);
        }
        if class == 0 && S::Coder::LEARNS {
            channels.cross_channel.learn_anchor(channel, layout.slot);
        }
        // No row is predicted from the last level.
        if kind != INTERPOLATED {
            channels.segments.remember(&layout, &channels.tracks);
        }
        Ok(())
    }
}
