//! What one marker's residuals say about another's.
//!
//! Markers of one body accelerate together. For every pair of channels and every class of levels an
//! average remembers the inner products of their residuals at the same rows; the residual of a channel
//! is then expected from up to three channels before it, by least squares. Before anything was seen,
//! markers that are close together are taken to move alike: the covariance starts from a function of
//! their distance, as in kriging.

use std::hint::select_unpredictable;

use super::{
    SPAN,
    level_prediction::{Batch, LevelPrediction, PADDED, Sites},
    points::{LANES, Points, copy, lanes, put, round},
};
use crate::{
    GROUP_CHANNELS,
    bound::squared_distance,
    coding::isa::{Isa, Kernel},
};

/// Classes of levels: anchors; strides 8 and more; 4; 2; 1.
const CLASSES: usize = 5;
/// Channels that a residual is expected from, at most.
const REFERENCES: usize = 3;

/// Every variance is taken to be so much larger: relative, and in squared tolerances.
const RIDGE: (f64, f64) = (1.15, 2.0);
/// A reference must explain at least this share of the energy, all of them together that one.
const LEAST_GAIN: (f64, f64) = (0.02, 0.15);
/// A larger weight is an accident of the numbers.
const MAX_WEIGHT: f64 = 256.0;

/// What a span leaves of the covariances.
const DECAY: f64 = 0.9;
/// Products are in squares of 256 units.
const SCALE: f64 = 65536.0;

/// The weight of the distances, in averages of all channels' energies.
const KERNEL_WEIGHT: f64 = 0.3;
/// The least such average, in squared tolerances.
const LEAST_ENERGY: f64 = 10.0;
/// Residuals count up to this length, in units: 500 tolerances.
const MAX_RESIDUAL: f64 = 128_000.0;

/// The references of one channel in one class.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct References {
    /// How many are filled.
    pub(super) n: usize,
    /// Their channels.
    pub(super) channels: [usize; REFERENCES],
    /// Whether each goes along or against.
    pub(super) signs: [f64; REFERENCES],
    /// All 0 where they do not explain enough to be used for the expectation.
    pub(super) weights: [f64; REFERENCES],
}

/// Values of every channel.
type Lane = [f64; GROUP_CHANNELS];

/// Values of every channel, side by side.
type Lanes = [[f64; LANES]; GROUP_CHANNELS / LANES];
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(LANES));

/// The residuals of a channel in a span, by axis and place; zero where there is none.
type SpanVectors = [[f32; PADDED]; 3];

/// The class of a kind of row.
pub(super) fn class_of(kind: usize) -> usize {
    [0, 0, 0, 0, 4, 3, 2].get(kind).copied().unwrap_or(1)
}

/// All averages of a group.
#[derive(Debug)]
pub(super) struct CrossChannel {
    isa: Isa,
    /// By class, channel, channel, both ways around.
    covariances: Vec<Lane>,
    /// How alike channels are taken to move for their distance, by channel and channel, both ways around; 1 with
    /// itself.
    kernel: Vec<Lane>,
    /// Of the span, by axis: where the channels are, in units; NaN where that is not known.
    places: [Lane; 3],
    /// Of the span, by class: the weight of the kernel, and one over the variances with their ridge. Only anchors
    /// change theirs within a span.
    energies: [f64; CLASSES],
    inverse: [Lane; CLASSES],
    references: Vec<References>,
    /// The residuals of the current span, by channel.
    residuals: Vec<SpanVectors>,
    /// Which of them are of anchors, a bit a slot.
    anchors: [u64; GROUP_CHANNELS],
    /// Room to work in: the residuals by place, axis and channel; zero where there is none, and at anchors.
    span: Box<[[[f32; GROUP_CHANNELS]; 3]; SPAN]>,
    work: Box<Work>,
}

impl CrossChannel {
    pub(super) fn new(isa: Isa) -> Self {
        Self {
            isa,
            covariances: vec![[0.0; GROUP_CHANNELS]; CLASSES * GROUP_CHANNELS],
            kernel: vec![[0.0; GROUP_CHANNELS]; GROUP_CHANNELS],
            places: [[f64::NAN; GROUP_CHANNELS]; 3],
            energies: [0.0; CLASSES],
            inverse: [[1.0; GROUP_CHANNELS]; CLASSES],
            references: vec![References::default(); CLASSES * GROUP_CHANNELS],
            residuals: vec![[[0.0; PADDED]; 3]; GROUP_CHANNELS],
            anchors: [0; GROUP_CHANNELS],
            span: Box::new([[[0.0; GROUP_CHANNELS]; 3]; SPAN]),
            work: Box::new(Work::new()),
        }
    }

    pub(super) fn reset(&mut self) {
        self.covariances.fill([0.0; GROUP_CHANNELS]);
        self.references.fill(References::default());
    }

    /// A span of `n` channels begins.
    pub(super) fn begin(&mut self, n: usize) {
        self.residuals[..n.next_multiple_of(WIDE)].fill([[0.0; PADDED]; 3]);
        // Those of a span that was not ended, because its bytes were damaged.
        self.anchors = [0; GROUP_CHANNELS];
        for (k, lane) in self.kernel.iter_mut().enumerate().take(n) {
            lane[..n].fill(0.0);
            lane[k] = 1.0;
        }
        self.places.iter_mut().for_each(|axis| axis[..n].fill(f64::NAN));
        for class in 0..CLASSES {
            self.weigh_kernel(class, n);
        }
    }

    /// What the solving of a class needs of all its variances.
    fn weigh_kernel(&mut self, class: usize, n: usize) {
        let covariances = &self.covariances[class * GROUP_CHANNELS..][..n];
        let variances = covariances.iter().enumerate().map(|(k, lane)| lane[k]);
        let energies = variances.clone().fold(0.0, |sum, variance| sum + variance);
        let energy = (energies / n as f64).max(LEAST_ENERGY) * KERNEL_WEIGHT;
        self.energies[class] = energy;
        for (out, variance) in self.inverse[class].iter_mut().zip(variances) {
            *out = 1.0 / ridged(variance + energy);
        }
    }

    /// The span is over: what was seen in it is remembered, and the averages forget a little.
    pub(super) fn end(&mut self, n: usize) {
        // Anchors were learnt from at once.
        for (vectors, anchors) in self.residuals.iter_mut().zip(&mut self.anchors) {
            while *anchors != 0 {
                let slot = anchors.trailing_zeros() as usize;
                vectors.iter_mut().for_each(|lane| lane[slot] = 0.0);
                *anchors &= *anchors - 1;
            }
        }
        let isa = self.isa;
        isa.run(Covarying { cross: self, n });
    }

    /// States where a channel is in this span, in units.
    pub(super) fn place(&mut self, channel: usize, point: [f64; 3]) {
        for (axis, units) in self.places.iter_mut().zip(point) {
            axis[channel] = units;
        }
    }

    /// Whether that has been stated.
    pub(super) fn has_place(&self, channel: usize) -> bool {
        !self.places[0][channel].is_nan()
    }

    /// How alike two channels are taken to move for their distance.
    pub(super) fn nearness(&self, j: usize, k: usize) -> f64 {
        self.kernel[j][k]
    }

    pub(super) fn references(&self, class: usize, j: usize) -> &References {
        &self.references[class * GROUP_CHANNELS + j]
    }

    /// Remembers the residuals of some rows of a level: where they are, less where time alone put them.
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

    /// Learns from the residual of an anchor that was just coded. It counts at once: the anchors of one span come one
    /// after another and choose their references in between. Levels count at the end of the span.
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

    /// Works out how near channel `j` of `n` is to those before it, and its references in every class.
    pub(super) fn look_around(&mut self, j: usize, n: usize, unit_mm: f64) {
        self.weigh_kernel(0, n);
        let isa = self.isa;
        isa.run(LookingAround { cross: self, j, unit_mm });
    }

    /// Adds what the references say of all rows.
    #[inline(always)]
    pub(super) fn correct(&self, class: usize, level: &mut LevelPrediction) {
        let Sites { n, slot, run, .. } = level.sites;
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
                put(&mut level.referred[axis], first, referred);
            }
        }
    }
}

// The end of a span: sums of products of its residuals, for all pairs of channels at once.

/// Where the rows of a class lie side by side: strides 32, 16 and 8; 4; 2; 1.
/// Anchors count as they are coded.
const SLOTS: [(usize, usize); CLASSES] = [(0, 0), (0, 8), (8, 16), (16, 32), (32, 64)];

/// Channels by channels that are summed side by side.
const HIGH: usize = 4;
const WIDE: usize = 8;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(WIDE) && WIDE.is_multiple_of(HIGH));

/// The end of a span of `n` channels.
struct Covarying<'a> {
    cross: &'a mut CrossChannel,
    n: usize,
}

impl Covarying<'_> {
    #[inline(always)]
    fn turn(&mut self) {
        // Channels beyond `n` are zero.
        let n = self.n.next_multiple_of(WIDE);
        let CrossChannel { residuals, span, .. } = &mut *self.cross;
        for (channel, vectors) in residuals.iter().enumerate().take(n) {
            for (axis, lane) in vectors.iter().enumerate() {
                for (row, residual) in span.iter_mut().zip(lane) {
                    row[axis][channel] = *residual;
                }
            }
        }
    }

    /// The covariances of a few channels from `j` on with a few from `k` on.
    #[inline(always)]
    fn tile(&mut self, class: usize, j: usize, k: usize) {
        let (first, end) = SLOTS[class];
        let mut sums = [[0.0_f32; WIDE]; HIGH];
        for row in &self.cross.span[first..end] {
            for lane in row {
                let own: [f32; HIGH] = std::array::from_fn(|i| lane[j + i]);
                let other: [f32; WIDE] = std::array::from_fn(|i| lane[k + i]);
                for (own, sums) in own.into_iter().zip(&mut sums) {
                    for (sum, other) in sums.iter_mut().zip(other) {
                        *sum += own * other;
                    }
                }
            }
        }
        let covariances = &mut self.cross.covariances[class * GROUP_CHANNELS + j..][..HIGH];
        for (covariances, sums) in covariances.iter_mut().zip(sums) {
            for (covariance, sum) in covariances[k..k + WIDE].iter_mut().zip(sums) {
                *covariance = (*covariance + f64::from(sum) / SCALE) * DECAY;
            }
        }
    }
}

impl Kernel for Covarying<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        self.turn();
        for class in 0..CLASSES {
            for j in (0..self.n).step_by(HIGH) {
                for k in (0..j + HIGH).step_by(WIDE) {
                    self.tile(class, j, k);
                }
            }
            // What the later channel of a pair learnt holds for both.
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

// Which references a channel has, and how much each weighs: least squares, one reference at a time.

/// A variance as a reference's.
fn ridged(variance: f64) -> f64 {
    variance * RIDGE.0 + RIDGE.1
}

/// The references of channel `j` in one class.
#[derive(Debug, Clone, Copy)]
struct Solving<'a> {
    j: usize,
    /// Of the class, by channel and channel, both ways around.
    covariances: &'a [Lane],
    /// By channel and channel, both ways around; 1 with itself.
    kernel: &'a [Lane],
    /// The weight of the kernel.
    energy: f64,
    /// One over the variances of the class with their ridge.
    inverse: &'a Lane,
}

#[inline(always)]
fn at(lanes: &Lanes, channel: usize) -> f64 {
    lanes.as_flattened()[channel]
}

impl Solving<'_> {
    /// How many lanes are looked at: of the channels before this one, and some more to fill the last.
    #[inline(always)]
    fn width(&self) -> usize {
        self.j.div_ceil(LANES).min(GROUP_CHANNELS / LANES)
    }

    #[inline(always)]
    fn of(&self, a: usize, b: usize) -> f64 {
        self.covariances[a][b] + self.energy * self.kernel[a][b]
    }

    /// Of a channel with those before this one.
    #[inline(always)]
    fn row(&self, a: usize, row: &mut Lanes) {
        let (covariances, _) = self.covariances[a].as_chunks::<LANES>();
        let (kernel, _) = self.kernel[a].as_chunks::<LANES>();
        for first in 0..self.width() {
            row[first] = std::array::from_fn(|lane| {
                covariances[first][lane] + self.energy * kernel[first][lane]
            });
        }
    }

    /// The channel that explains most of what `N` references with their weights leave, and how much. Where
    /// `inverse` is 0 nothing is explained.
    #[inline(always)]
    fn best<const N: usize>(&self, work: &Work, found: &References) -> (f64, usize) {
        let (mut most, mut places) = ([0.0; LANES], [usize::MAX; LANES]);
        for first in 0..self.width() {
            let mut shared = work.alike[first];
            for (weight, row) in found.weights[..N].iter().zip(&work.rows) {
                for (shared, other) in shared.iter_mut().zip(row[first]) {
                    *shared -= weight * other;
                }
            }
            for lane in 0..LANES {
                let explained = shared[lane] * shared[lane] * work.inverse[first][lane];
                let better = explained > most[lane];
                most[lane] = if better { explained } else { most[lane] };
                places[lane] = if better { first } else { places[lane] };
            }
        }
        let mut best = (0.0, usize::MAX);
        for (lane, (most, place)) in most.into_iter().zip(places).enumerate() {
            let channel = place.wrapping_mul(LANES).wrapping_add(lane);
            // Without a branch: nobody knows which it is.
            let first = (most == best.0) & (most > 0.0) & (channel < best.1);
            let better = (most > best.0) | first;
            best.0 = select_unpredictable(better, most, best.0);
            best.1 = select_unpredictable(better, channel, best.1);
        }
        best
    }

    /// Least squares by Gauss and Jordan, without pivoting: the ridge keeps the pivots of a covariance away
    /// from zero, and what comes of another system is not used.
    #[inline(always)]
    fn weigh<const N: usize>(
        &self,
        work: &Work,
        channels: &[usize; REFERENCES],
    ) -> [f64; REFERENCES] {
        let mut system = [[0.0; REFERENCES + 1]; N];
        for i in 0..N {
            for k in 0..N {
                system[i][k] = self.of(channels[i], channels[k]);
            }
            system[i][i] = ridged(system[i][i]);
            system[i][N] = at(&work.alike, channels[i]);
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

    #[inline(always)]
    fn solve(&self, work: &mut Work) -> References {
        let j = self.j;
        let own = self.of(j, j);
        self.row(j, &mut work.alike);
        work.inverse.as_flattened_mut()[..j].copy_from_slice(&self.inverse[..j]);
        work.inverse.as_flattened_mut()[j..j.next_multiple_of(LANES)].fill(0.0);
        let mut found = References::default();
        let mut gain = 0.0;
        while found.n < REFERENCES {
            let n = found.n;
            let (most, channel) = match n {
                0 => self.best::<0>(work, &found),
                1 => self.best::<1>(work, &found),
                _ => self.best::<2>(work, &found),
            };
            if most == 0.0 || most < LEAST_GAIN.0 * own {
                break;
            }
            work.inverse.as_flattened_mut()[channel] = 0.0;
            if let Some(row) = work.rows.get_mut(n) {
                self.row(channel, row);
            }
            found.channels[n] = channel;
            found.n += 1;
            found.weights = match n {
                0 => self.weigh::<1>(work, &found.channels),
                1 => self.weigh::<2>(work, &found.channels),
                _ => self.weigh::<3>(work, &found.channels),
            };
            gain = (0..=n)
                .fold(0.0, |sum, i| sum + found.weights[i] * at(&work.alike, found.channels[i]))
                / own;
        }
        for i in 0..found.n {
            found.signs[i] = if at(&work.alike, found.channels[i]) < 0.0 { -1.0 } else { 1.0 };
        }
        // Sums over anchors lack what came later: their system may be no covariance, and near singular.
        let bounded = found.weights.iter().all(|weight| weight.abs() < MAX_WEIGHT);
        if !(bounded && gain > LEAST_GAIN.1) {
            found.weights = [0.0; REFERENCES];
        }
        found
    }
}

/// Room to work in: of one channel and class.
#[derive(Debug)]
struct Work {
    /// Of the channel with those before it.
    alike: Lanes,
    /// Of its references with those.
    rows: [Lanes; REFERENCES - 1],
    /// As [`Solving`] has it; 0 where a reference cannot be, or is already.
    inverse: Lanes,
}

impl Work {
    fn new() -> Self {
        let none = [[0.0; LANES]; GROUP_CHANNELS / LANES];
        Self { alike: none, rows: [none; REFERENCES - 1], inverse: none }
    }
}

/// How near a channel is to those before it, and its references in every class.
struct LookingAround<'a> {
    cross: &'a mut CrossChannel,
    j: usize,
    unit_mm: f64,
}

impl Kernel for LookingAround<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { cross, j, unit_mm } = self;
        let CrossChannel { covariances, kernel, energies, inverse, references, work, .. } = cross;
        let [xs, ys, zs] = &cross.places;
        let (before, own) = kernel.split_at_mut(j);
        let own = &mut own[0][..j];
        let place = [xs[j], ys[j], zs[j]];
        for (((near, x), y), z) in own.iter_mut().zip(xs).zip(ys).zip(zs) {
            let mm = squared_distance(place, [*x, *y, *z]).sqrt() * unit_mm;
            let ratio = 800.0 / (800.0 + mm);
            let cube = ratio * ratio * ratio;
            // Not so where one of them is nowhere.
            *near = if cube >= 0.0 { cube } else { 0.0 };
        }
        for (other, near) in before.iter_mut().zip(own) {
            other[j] = *near;
        }
        for class in 0..CLASSES {
            let of_class = class * GROUP_CHANNELS;
            let covariances = &covariances[of_class..of_class + GROUP_CHANNELS];
            let (energy, inverse) = (energies[class], &inverse[class]);
            let solving = Solving { j, covariances, kernel, energy, inverse };
            references[of_class + j] = solving.solve(work);
        }
    }
}

const _: () = assert!(SPAN == 64 && REFERENCES == 3);
