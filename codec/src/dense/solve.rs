//! Which references a channel has, and how much each weighs: least squares, one reference at a time.

use std::hint::select_unpredictable;

use crate::{GROUP_CHANNELS, coding::isa::Kernel};

use super::weave::{CLASSES, REFERENCES, References};

/// Every variance is taken to be so much larger: relative, and in squared tolerances.
const RIDGE: (f64, f64) = (1.15, 2.0);
/// A reference must explain at least this share of the energy, all of them together that one.
const LEAST_GAIN: (f64, f64) = (0.02, 0.15);
/// A larger weight is an accident of the numbers.
const MAX_WEIGHT: f64 = 256.0;

/// Values of every channel.
pub(super) type Lane = [f64; GROUP_CHANNELS];

/// A variance as a reference's.
pub(super) fn ridged(variance: f64) -> f64 {
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

/// Channels side by side.
const LANES: usize = 4;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(LANES));

/// Values of every channel, side by side.
type Lanes = [[f64; LANES]; GROUP_CHANNELS / LANES];

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
}

/// Room to work in: of one channel and class.
#[derive(Debug)]
pub(super) struct Work {
    /// Of the channel with those before it.
    alike: Lanes,
    /// Of its references with those.
    rows: [Lanes; REFERENCES - 1],
    /// As [`Solving`] has it; 0 where a reference cannot be, or is already.
    inverse: Lanes,
}

impl Work {
    pub(super) fn new() -> Self {
        let none = [[0.0; LANES]; GROUP_CHANNELS / LANES];
        Self { alike: none, rows: [none; REFERENCES - 1], inverse: none }
    }
}

impl Solving<'_> {
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

/// The references of a channel in every class.
#[derive(Debug)]
pub(super) struct SolvingAll<'a> {
    pub(super) j: usize,
    /// By class, channel and channel, both ways around.
    pub(super) covariances: &'a [Lane],
    pub(super) kernel: &'a [Lane],
    /// By class.
    pub(super) energies: &'a [f64; CLASSES],
    pub(super) inverse: &'a [Lane; CLASSES],
    /// By class and channel.
    pub(super) references: &'a mut [References],
    pub(super) work: &'a mut Work,
}

impl Kernel for SolvingAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { j, covariances, kernel, energies, inverse, references, work } = self;
        for class in 0..CLASSES {
            let of_class = class * GROUP_CHANNELS;
            let covariances = &covariances[of_class..of_class + GROUP_CHANNELS];
            let (energy, inverse) = (energies[class], &inverse[class]);
            let solving = Solving { j, covariances, kernel, energy, inverse };
            references[of_class + j] = solving.solve(work);
        }
    }
}

const _: () = assert!(REFERENCES == 3);
