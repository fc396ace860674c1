//! Cross-channel prediction: the residuals of a channel from those of up to three reference channels before it.
//!
//! Markers of one body accelerate together. For every pair of channels and every class of levels a decaying sum of the
//! inner products of their residuals at the same rows estimates their covariance; ridge regression on the references
//! then predicts the residual of a channel. References are selected greedily, the one that explains most first. As in
//! kriging, a prior covariance that falls with the markers' distance is added, so that close markers are assumed to
//! move alike before any residual is known.
//!
//! Up to three references gain 7 %. With at most two the ratio is 0.1 % lower, with one the same; both are within the
//! noise of the measurement. The prior gains 3 %.

use std::hint::select_unpredictable;

use super::{
    SPAN,
    lattice::{LANES, Points, copy, lanes, put, round},
    level_prediction::{Batch, LevelLayout, LevelPrediction, PADDED_SPAN},
};
use crate::{
    GROUP_CHANNELS,
    block::squared_distance,
    coding::isa::{Isa, Kernel},
};

/// Classes of levels with covariances of their own: anchors; strides 8 and more; 4; 2; 1.
const CLASSES: usize = 5;
/// Maximum number of references of a channel.
const REFERENCES: usize = 3;

/// The ridge of the regression: a reference's variance is multiplied by the first number, and the second, in squared
/// tolerances, is added.
const RIDGE: (f64, f64) = (1.15, 2.0);
/// Smallest shares of a channel's energy: that a further reference must explain, and that all references must explain
/// together to correct the prediction.
const MIN_GAIN: (f64, f64) = (0.02, 0.15);
/// Regression weights of this size or more come from a nearly singular system and are not used.
const MAX_WEIGHT: f64 = 256.0;

/// Factor on the covariances at the end of every span.
const DECAY: f64 = 0.9;
/// Squared units per squared tolerance: 256 * 256.
const SCALE: f64 = 65536.0;

/// Weight of the prior, relative to the mean energy of all channels.
const KERNEL_WEIGHT: f64 = 0.3;
/// Smallest mean energy in that product, in squared tolerances.
const MIN_ENERGY: f64 = 10.0;
/// Longer residuals are shortened to this length, in units: 500 tolerances.
const MAX_RESIDUAL: f64 = 128_000.0;
/// Range of the prior in millimetres: the correlation at the distance d is (800 / (800 + d))^3.
const PRIOR_RANGE_MM: f64 = 800.0;

/// The references of one channel in one class.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct References {
    /// Number of references.
    pub(super) n: usize,
    /// Their channel numbers.
    pub(super) channels: [usize; REFERENCES],
    /// Signs of their covariances with the channel: 1 or -1.
    pub(super) signs: [f64; REFERENCES],
    /// Regression weights; all 0 where the references explain too little to correct the prediction.
    pub(super) weights: [f64; REFERENCES],
}

/// One value per channel.
type PerChannel = [f64; GROUP_CHANNELS];

/// One value per channel, in vectors of [`LANES`].
type ChannelLanes = [[f64; LANES]; GROUP_CHANNELS / LANES];
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(LANES));

/// The residuals of a channel in a span in units, by axis and slot; zero where there is none.
pub(super) type SpanResiduals = [[f32; PADDED_SPAN]; 3];

/// The covariance class of a kind of row.
pub(super) fn class_of(kind: usize) -> usize {
    [0, 0, 0, 0, 4, 3, 2].get(kind).copied().unwrap_or(1)
}

/// The covariances, references and current residuals of a group.
#[derive(Debug)]
pub(super) struct CrossChannel {
    isa: Isa,
    /// Covariances in squared tolerances by class, channel and channel; symmetric.
    covariances: Vec<PerChannel>,
    /// Prior correlation of two channels by their distance, by channel and channel; symmetric, 1 on the diagonal.
    kernel: Vec<PerChannel>,
    /// Positions of the channels at the start of the span in units, by axis; NaN where unknown.
    positions: [PerChannel; 3],
    /// By class, for this span: the weight of the prior, and the reciprocals of the ridged variances. Only those of
    /// anchors change within a span.
    energies: [f64; CLASSES],
    inverse: [PerChannel; CLASSES],
    references: Vec<References>,
    /// Residuals of the current span by channel.
    residuals: Vec<SpanResiduals>,
    /// One bit per slot and channel: the residual belongs to an anchor.
    anchors: [u64; GROUP_CHANNELS],
    /// Scratch memory: the residuals by slot, axis and channel; zero where there is none, and at anchors.
    span: Box<[[[f32; GROUP_CHANNELS]; 3]; SPAN]>,
    buffers: Box<SolverBuffers>,
}

impl CrossChannel {
    pub(super) fn new(isa: Isa) -> Self {
        Self {
            isa,
            covariances: vec![[0.0; GROUP_CHANNELS]; CLASSES * GROUP_CHANNELS],
            kernel: vec![[0.0; GROUP_CHANNELS]; GROUP_CHANNELS],
            positions: [[f64::NAN; GROUP_CHANNELS]; 3],
            energies: [0.0; CLASSES],
            inverse: [[1.0; GROUP_CHANNELS]; CLASSES],
            references: vec![References::default(); CLASSES * GROUP_CHANNELS],
            residuals: vec![[[0.0; PADDED_SPAN]; 3]; GROUP_CHANNELS],
            anchors: [0; GROUP_CHANNELS],
            span: Box::new([[[0.0; GROUP_CHANNELS]; 3]; SPAN]),
            buffers: Box::new(SolverBuffers::new()),
        }
    }

    pub(super) fn reset(&mut self) {
        self.covariances.fill([0.0; GROUP_CHANNELS]);
        self.references.fill(References::default());
    }

    /// Copies the covariances of `n` channels.
    pub(super) fn follow(&mut self, other: &Self, n: usize) {
        for class in 0..CLASSES {
            let rows = class * GROUP_CHANNELS..class * GROUP_CHANNELS + n;
            self.covariances[rows.clone()].copy_from_slice(&other.covariances[rows]);
        }
    }

    /// The residuals of a channel in the current span.
    pub(super) fn residuals(&self, j: usize) -> &SpanResiduals {
        &self.residuals[j]
    }

    pub(super) fn residuals_mut(&mut self, j: usize) -> &mut SpanResiduals {
        &mut self.residuals[j]
    }

    /// Swaps a residual of the current span with `residual`.
    pub(super) fn exchange_residual(&mut self, j: usize, slot: usize, residual: &mut [f32; 3]) {
        for (axis, units) in self.residuals[j].iter_mut().zip(residual) {
            std::mem::swap(&mut axis[slot], units);
        }
    }

    /// Begins a span of `n` channels.
    pub(super) fn begin(&mut self, n: usize) {
        self.residuals[..n.next_multiple_of(TILE_COLUMNS)].fill([[0.0; PADDED_SPAN]; 3]);
        // An error in a damaged block leaves the bits of an unfinished span.
        self.anchors = [0; GROUP_CHANNELS];
        for (k, lane) in self.kernel.iter_mut().enumerate().take(n) {
            lane[..n].fill(0.0);
            lane[k] = 1.0;
        }
        self.positions.iter_mut().for_each(|axis| axis[..n].fill(f64::NAN));
        for class in 0..CLASSES {
            self.prepare_class(class, n);
        }
    }

    /// Computes the prior's weight and the reciprocal ridged variances of a class.
    fn prepare_class(&mut self, class: usize, n: usize) {
        let covariances = &self.covariances[class * GROUP_CHANNELS..][..n];
        let variances = covariances.iter().enumerate().map(|(k, lane)| lane[k]);
        let energies = variances.clone().fold(0.0, |sum, variance| sum + variance);
        let energy = (energies / n as f64).max(MIN_ENERGY) * KERNEL_WEIGHT;
        self.energies[class] = energy;
        for (out, variance) in self.inverse[class].iter_mut().zip(variances) {
            *out = 1.0 / ridged(variance + energy);
        }
    }

    /// Ends a span: adds the products of its residuals to the covariances, and decays them.
    pub(super) fn end(&mut self, n: usize) {
        // Anchors were added when they were coded.
        for (vectors, anchors) in self.residuals.iter_mut().zip(&mut self.anchors) {
            while *anchors != 0 {
                let slot = anchors.trailing_zeros() as usize;
                vectors.iter_mut().for_each(|lane| lane[slot] = 0.0);
                *anchors &= *anchors - 1;
            }
        }
        let isa = self.isa;
        isa.run(CovarianceUpdate { cross: self, n });
    }

    /// Sets the position of a channel at the start of this span, in units.
    pub(super) fn set_position(&mut self, channel: usize, point: [f64; 3]) {
        for (axis, units) in self.positions.iter_mut().zip(point) {
            axis[channel] = units;
        }
    }

    /// Whether the position of a channel in this span is known.
    pub(super) fn has_position(&self, channel: usize) -> bool {
        !self.positions[0][channel].is_nan()
    }

    /// The prior correlation of two channels, by their distance.
    pub(super) fn nearness(&self, j: usize, k: usize) -> f64 {
        self.kernel[j][k]
    }

    /// The references of channel `j` in a class.
    pub(super) fn references(&self, class: usize, j: usize) -> &References {
        &self.references[class * GROUP_CHANNELS + j]
    }

    /// Stores the residuals of a batch: the decoded points less the predictions in time.
    #[inline(always)]
    pub(super) fn remember<const N: usize>(
        &mut self,
        batch: Batch,
        level: &LevelPrediction,
        points: &Points<N>,
    ) {
        let mut residuals = *points;
        for (residuals, expected) in residuals.iter_mut().zip(&level.expected) {
            let expected: [f64; N] = lanes(expected, batch.from);
            for i in 0..N {
                residuals[i] -= expected[i];
            }
        }
        let [x, y, z] = &residuals;
        let mut squares = [0.0; N];
        for i in 0..N {
            squares[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
        }
        let most = MAX_RESIDUAL * MAX_RESIDUAL;
        if squares.iter().fold(false, |far, &squares| far | (squares > most)) {
            for (i, squares) in squares.into_iter().enumerate().filter(|&(_, s)| s > most) {
                let share = MAX_RESIDUAL / squares.sqrt();
                residuals.iter_mut().for_each(|axis| axis[i] *= share);
            }
        }
        for (out, residuals) in self.residuals[batch.channel].iter_mut().zip(&residuals) {
            copy(&residuals.map(|units| units as f32), &mut out[batch.slot..], batch.n);
        }
    }

    /// Adds the residual of an anchor that was just coded to the covariances: later anchors of the span choose their
    /// references with it. The residuals of levels are added at the end of the span.
    pub(super) fn learn_anchor(&mut self, j: usize, place: usize) {
        self.anchors[j] |= 1 << place;
        let residual = |k: usize, axis: usize| f64::from(self.residuals[k][axis][place]);
        let [x, y, z] = [residual(j, 0), residual(j, 1), residual(j, 2)];
        for k in 0..=j {
            let product = x * residual(k, 0) + y * residual(k, 1) + z * residual(k, 2);
            let covariance = self.covariances[j][k] + product / SCALE;
            self.covariances[j][k] = covariance;
            self.covariances[k][j] = covariance;
        }
    }

    /// Computes the prior correlations of channel `j` of `n` with the channels before it, and selects its references in
    /// every class. `unit_mm` is the size of a unit in millimetres.
    pub(super) fn choose_references(&mut self, j: usize, n: usize, unit_mm: f64) {
        self.prepare_class(0, n);
        let isa = self.isa;
        isa.run(ReferenceSearch { cross: self, j, unit_mm });
    }

    /// Corrects the predictions in time of all rows of a level by the residuals of the references.
    #[inline(always)]
    pub(super) fn correct(&self, class: usize, level: &mut LevelPrediction) {
        let LevelLayout { n, slot, run, .. } = level.layout;
        let references = self.references(class, run.channel);
        let found = references.n.min(REFERENCES);
        for first in (0..n).step_by(LANES) {
            for axis in 0..3 {
                let (mut sums, mut referred) = ([0.0; LANES], [0.0; LANES]);
                for i in 0..found {
                    let vectors = &self.residuals[references.channels[i]];
                    let residuals: [f32; LANES] = lanes(&vectors[axis], slot + first);
                    let residuals = residuals.map(f64::from);
                    let (weight, sign) = (references.weights[i], references.signs[i]);
                    for lane in 0..LANES {
                        let weighed = weight * residuals[lane];
                        sums[lane] += weighed;
                        referred[lane] += residuals[lane] * sign;
                    }
                }
                let expected: [f64; LANES] = lanes(&level.expected[axis], first);
                let prediction = std::array::from_fn(|lane| expected[lane] + round(sums[lane]));
                put(&mut level.prediction[axis], first, prediction);
                put(&mut level.reference_residuals[axis], first, referred);
            }
        }
    }
}

// End of a span: the sums of products of residuals, for all pairs of channels.

/// Slots of the rows of each class: none for anchors, which are added when coded; strides 32, 16 and 8; 4; 2; 1.
const SLOTS: [(usize, usize); CLASSES] = [(0, 0), (0, 8), (8, 16), (16, 32), (32, 64)];

/// Size of a tile of channel pairs that is summed in registers.
const TILE_ROWS: usize = 4;
const TILE_COLUMNS: usize = 8;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(TILE_COLUMNS));
const _: () = assert!(TILE_COLUMNS.is_multiple_of(TILE_ROWS));

/// Updates the covariances of `n` channels at the end of a span.
struct CovarianceUpdate<'a> {
    cross: &'a mut CrossChannel,
    n: usize,
}

impl CovarianceUpdate<'_> {
    #[inline(always)]
    fn transpose(&mut self) {
        // The residuals of channels beyond `n` are zero.
        let n = self.n.next_multiple_of(TILE_COLUMNS);
        let CrossChannel { residuals, span, .. } = &mut *self.cross;
        for (channel, vectors) in residuals.iter().enumerate().take(n) {
            for (axis, lane) in vectors.iter().enumerate() {
                for (row, residual) in span.iter_mut().zip(lane) {
                    row[axis][channel] = *residual;
                }
            }
        }
    }

    /// Updates the covariances of a tile: the channels from `j` on with those from `k` on.
    #[inline(always)]
    fn tile(&mut self, class: usize, j: usize, k: usize) {
        let (first, end) = SLOTS[class];
        let mut sums = [[0.0_f32; TILE_COLUMNS]; TILE_ROWS];
        for row in &self.cross.span[first..end] {
            for lane in row {
                let own: [f32; TILE_ROWS] = std::array::from_fn(|i| lane[j + i]);
                let other: [f32; TILE_COLUMNS] = std::array::from_fn(|i| lane[k + i]);
                for (own, sums) in own.into_iter().zip(&mut sums) {
                    for (sum, other) in sums.iter_mut().zip(other) {
                        *sum += own * other;
                    }
                }
            }
        }
        let covariances = &mut self.cross.covariances[class * GROUP_CHANNELS + j..][..TILE_ROWS];
        for (covariances, sums) in covariances.iter_mut().zip(sums) {
            for (covariance, sum) in covariances[k..k + TILE_COLUMNS].iter_mut().zip(sums) {
                *covariance = (*covariance + f64::from(sum) / SCALE) * DECAY;
            }
        }
    }
}

impl Kernel for CovarianceUpdate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        self.transpose();
        for class in 0..CLASSES {
            for j in (0..self.n).step_by(TILE_ROWS) {
                for k in (0..j + TILE_ROWS).step_by(TILE_COLUMNS) {
                    self.tile(class, j, k);
                }
            }
            // Mirrors the lower triangle.
            let covariances = &mut self.cross.covariances[class * GROUP_CHANNELS..][..self.n];
            for j in 0..covariances.len() {
                let (before, from) = covariances.split_at_mut(j);
                for (other, covariance) in before.iter_mut().zip(&from[0]) {
                    other[j] = *covariance;
                }
            }
        }
    }
}

// Selection of references and their weights: forward selection with least squares.

/// The variance of a reference with the ridge.
fn ridged(variance: f64) -> f64 {
    variance * RIDGE.0 + RIDGE.1
}

/// Selects the references of channel `j` in one class.
#[derive(Debug, Clone, Copy)]
struct ReferenceSolver<'a> {
    j: usize,
    /// Covariances of the class by channel and channel; symmetric.
    covariances: &'a [PerChannel],
    /// Prior correlations by channel and channel; symmetric, 1 on the diagonal.
    kernel: &'a [PerChannel],
    /// Weight of the prior.
    energy: f64,
    /// Reciprocals of the ridged variances of the class.
    inverse: &'a PerChannel,
}

#[inline(always)]
fn lane_at(lanes: &ChannelLanes, channel: usize) -> f64 {
    lanes.as_flattened()[channel]
}

impl ReferenceSolver<'_> {
    /// Number of vectors that hold the channels before this one.
    #[inline(always)]
    fn width(&self) -> usize {
        self.j.div_ceil(LANES).min(GROUP_CHANNELS / LANES)
    }

    /// The covariance of two channels, prior included: `of` in docs/codec.md.
    #[inline(always)]
    fn covariance(&self, a: usize, b: usize) -> f64 {
        self.covariances[a][b] + self.energy * self.kernel[a][b]
    }

    /// Fills `row` with the covariances of channel `a` with the channels before this one, prior included.
    #[inline(always)]
    fn row(&self, a: usize, row: &mut ChannelLanes) {
        let (covariances, _) = self.covariances[a].as_chunks::<LANES>();
        let (kernel, _) = self.kernel[a].as_chunks::<LANES>();
        for first in 0..self.width() {
            row[first] = std::array::from_fn(|lane| {
                covariances[first][lane] + self.energy * kernel[first][lane]
            });
        }
    }

    /// The channel that explains most of the covariance left over by `N` references, and how much it explains. Channels
    /// whose `inverse` is 0 explain nothing.
    #[inline(always)]
    fn best<const N: usize>(&self, buffers: &SolverBuffers, found: &References) -> (f64, usize) {
        let (mut most, mut places) = ([0.0; LANES], [usize::MAX; LANES]);
        for first in 0..self.width() {
            let mut shared = buffers.own_row[first];
            for (weight, row) in found.weights[..N].iter().zip(&buffers.rows) {
                for (shared, other) in shared.iter_mut().zip(row[first]) {
                    *shared -= weight * other;
                }
            }
            for lane in 0..LANES {
                let explained = shared[lane] * shared[lane] * buffers.inverse[first][lane];
                let better = explained > most[lane];
                most[lane] = if better { explained } else { most[lane] };
                places[lane] = if better { first } else { places[lane] };
            }
        }
        let mut best = (0.0, usize::MAX);
        for (lane, (most, place)) in most.into_iter().zip(places).enumerate() {
            let channel = place.wrapping_mul(LANES).wrapping_add(lane);
            // Without a branch, which would be unpredictable.
            let first = (most == best.0) & (most > 0.0) & (channel < best.1);
            let better = (most > best.0) | first;
            best.0 = select_unpredictable(better, most, best.0);
            best.1 = select_unpredictable(better, channel, best.1);
        }
        best
    }

    /// Solves for the weights of `N` references by Gauss-Jordan elimination without pivoting: the ridge keeps the
    /// pivots of a covariance matrix away from zero, and solutions of other systems are not used.
    #[inline(always)]
    fn solve_weights<const N: usize>(
        &self,
        buffers: &SolverBuffers,
        channels: &[usize; REFERENCES],
    ) -> [f64; REFERENCES] {
        let mut system = [[0.0; REFERENCES + 1]; N];
        for i in 0..N {
            for k in 0..N {
                system[i][k] = self.covariance(channels[i], channels[k]);
            }
            system[i][i] = ridged(system[i][i]);
            system[i][N] = lane_at(&buffers.own_row, channels[i]);
        }
        for i in 0..N {
            let pivot = system[i][i];
            for value in &mut system[i][i..=N] {
                *value /= pivot;
            }
            let row = system[i];
            for (other, values) in system.iter_mut().enumerate() {
                if other == i {
                    continue;
                }
                let factor = values[i];
                for k in i..=N {
                    values[k] -= factor * row[k];
                }
            }
        }
        std::array::from_fn(|i| if i < N { system[i][N] } else { 0.0 })
    }

    /// Selects up to [`REFERENCES`] references and their weights.
    #[inline(always)]
    fn solve(&self, buffers: &mut SolverBuffers) -> References {
        let j = self.j;
        let own = self.covariance(j, j);
        self.row(j, &mut buffers.own_row);
        buffers.inverse.as_flattened_mut()[..j].copy_from_slice(&self.inverse[..j]);
        buffers.inverse.as_flattened_mut()[j..j.next_multiple_of(LANES)].fill(0.0);
        let mut found = References::default();
        let mut gain = 0.0;
        while found.n < REFERENCES {
            let n = found.n;
            let (most, channel) = match n {
                0 => self.best::<0>(buffers, &found),
                1 => self.best::<1>(buffers, &found),
                _ => self.best::<2>(buffers, &found),
            };
            if most == 0.0 || most < MIN_GAIN.0 * own {
                break;
            }
            buffers.inverse.as_flattened_mut()[channel] = 0.0;
            if let Some(row) = buffers.rows.get_mut(n) {
                self.row(channel, row);
            }
            found.channels[n] = channel;
            found.n += 1;
            found.weights = match n {
                0 => self.solve_weights::<1>(buffers, &found.channels),
                1 => self.solve_weights::<2>(buffers, &found.channels),
                _ => self.solve_weights::<3>(buffers, &found.channels),
            };
            gain = (0..=n).fold(0.0, |sum, i| {
                sum + found.weights[i] * lane_at(&buffers.own_row, found.channels[i])
            }) / own;
        }
        for i in 0..found.n {
            let covariance = lane_at(&buffers.own_row, found.channels[i]);
            found.signs[i] = if covariance < 0.0 { -1.0 } else { 1.0 };
        }
        // Anchors later in the span are missing from the sums: the matrix may not be a covariance, and nearly singular.
        let bounded = found.weights.iter().all(|weight| weight.abs() < MAX_WEIGHT);
        if !(bounded && gain > MIN_GAIN.1) {
            found.weights = [0.0; REFERENCES];
        }
        found
    }
}

/// Scratch memory for selecting the references of one channel and class.
#[derive(Debug)]
struct SolverBuffers {
    /// Covariances of the channel with those before it.
    own_row: ChannelLanes,
    /// Covariances of its references with those channels.
    rows: [ChannelLanes; REFERENCES - 1],
    /// Reciprocal ridged variances; 0 for channels that are references already or come after this one.
    inverse: ChannelLanes,
}

impl SolverBuffers {
    fn new() -> Self {
        let none = [[0.0; LANES]; GROUP_CHANNELS / LANES];
        Self { own_row: none, rows: [none; REFERENCES - 1], inverse: none }
    }
}

/// Computes a channel's prior correlations and selects its references in every class.
struct ReferenceSearch<'a> {
    cross: &'a mut CrossChannel,
    j: usize,
    unit_mm: f64,
}

impl Kernel for ReferenceSearch<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { cross, j, unit_mm } = self;
        let CrossChannel { covariances, kernel, energies, inverse, references, buffers, .. } =
            cross;
        let [xs, ys, zs] = &cross.positions;
        let (before, own) = kernel.split_at_mut(j);
        let own = &mut own[0][..j];
        let place = [xs[j], ys[j], zs[j]];
        for (((near, x), y), z) in own.iter_mut().zip(xs).zip(ys).zip(zs) {
            let mm = squared_distance(place, [*x, *y, *z]).sqrt() * unit_mm;
            let ratio = PRIOR_RANGE_MM / (PRIOR_RANGE_MM + mm);
            let cube = ratio * ratio * ratio;
            // NaN, where a position is unknown, becomes 0.
            *near = if cube >= 0.0 { cube } else { 0.0 };
        }
        for (other, near) in before.iter_mut().zip(own) {
            other[j] = *near;
        }
        for class in 0..CLASSES {
            let of_class = class * GROUP_CHANNELS;
            let covariances = &covariances[of_class..of_class + GROUP_CHANNELS];
            let (energy, inverse) = (energies[class], &inverse[class]);
            let solver = ReferenceSolver { j, covariances, kernel, energy, inverse };
            references[of_class + j] = solver.solve(buffers);
        }
    }
}

// `anchors` has a bit per slot, and `solve` has a case for each number of references.
const _: () = assert!(SPAN == 64 && REFERENCES == 3);
