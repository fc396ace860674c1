//! Which references a channel has, and how much each weighs: least squares, one reference at a time.

use crate::{GROUP_CHANNELS, coding::isa::Kernel};

use super::weave::{REFERENCES, References};

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
pub(super) struct Solving<'a> {
    pub(super) j: usize,
    /// Of the class, by channel and channel, both ways around.
    pub(super) covariances: &'a [Lane],
    /// By channel and channel, both ways around; 1 with itself.
    pub(super) kernel: &'a [Lane],
    /// The weight of the kernel.
    pub(super) energy: f64,
    /// One over the variances of the class with their ridge.
    pub(super) inverse: &'a Lane,
}

impl Solving<'_> {
    #[inline(always)]
    fn of(&self, a: usize, b: usize) -> f64 {
        self.covariances[a][b] + self.energy * self.kernel[a][b]
    }

    /// How many channels are looked at: those before this one, and some more to fill the lanes.
    #[inline(always)]
    fn width(&self) -> usize {
        self.j.next_multiple_of(LANES).min(GROUP_CHANNELS)
    }

    /// Of a channel with those before this one.
    #[inline(always)]
    fn row(&self, a: usize, row: &mut Lane) {
        let (covariances, kernel) = (&self.covariances[a], &self.kernel[a]);
        let width = self.width();
        for first in (0..width).step_by(LANES) {
            for k in first..first + LANES {
                row[k] = covariances[k] + self.energy * kernel[k];
            }
        }
    }

    /// The channel that explains most of what `rows` with their weights leave, and how much; the
    /// channels themselves are left out.
    #[inline(always)]
    fn best(&self, alike: &Lane, found: &References, rows: &[Lane; REFERENCES]) -> (f64, usize) {
        let mut explained = [0.0; GROUP_CHANNELS];
        let width = self.width();
        let mut most = [0.0; LANES];
        for first in (0..width).step_by(LANES) {
            for lane in 0..LANES {
                let k = first + lane;
                let mut shared = alike[k];
                for (weight, row) in found.weights[..found.n].iter().zip(rows) {
                    shared -= weight * row[k];
                }
                explained[k] = shared * shared * self.inverse[k];
            }
        }
        explained[self.j..width].fill(0.0);
        for &channel in &found.channels[..found.n] {
            explained[channel] = 0.0;
        }
        for lanes in explained[..width].chunks_exact(LANES) {
            for (most, &value) in most.iter_mut().zip(lanes) {
                *most = if value > *most { value } else { *most };
            }
        }
        let most = most.iter().fold(0.0, |most, &value| if value > most { value } else { most });
        if most == 0.0 {
            return (0.0, usize::MAX);
        }
        let first = explained[..self.j].iter().position(|&value| value == most);
        (most, first.unwrap_or(usize::MAX))
    }

    /// Least squares by Gauss and Jordan, without pivoting: the ridge keeps the pivots of a covariance away
    /// from zero, and what comes of another system is not used.
    #[inline(always)]
    fn weigh(&self, channels: &[usize]) -> [f64; REFERENCES] {
        let n = channels.len();
        let mut system = [[0.0; REFERENCES + 1]; REFERENCES];
        for i in 0..n {
            for k in 0..n {
                system[i][k] = self.of(channels[i], channels[k]);
            }
            system[i][i] = ridged(system[i][i]);
            system[i][n] = self.of(self.j, channels[i]);
        }
        for i in 0..n {
            let pivot = system[i][i];
            for value in &mut system[i][i..=n] {
                *value /= pivot;
            }
            let row = system[i];
            for other in (0..n).filter(|&other| other != i) {
                let factor = system[other][i];
                for k in i..=n {
                    system[other][k] -= factor * row[k];
                }
            }
        }
        std::array::from_fn(|i| if i < n { system[i][n] } else { 0.0 })
    }
}

/// Channels side by side.
const LANES: usize = 4;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(LANES));

impl Kernel for Solving<'_> {
    type Output = References;

    #[inline(always)]
    fn run(self) -> References {
        let j = self.j;
        let own = self.of(j, j);
        let mut alike = [0.0; GROUP_CHANNELS];
        self.row(j, &mut alike);
        let mut rows = [[0.0; GROUP_CHANNELS]; REFERENCES];
        let mut found = References::default();
        let mut gain = 0.0;
        while found.n < REFERENCES {
            let best = self.best(&alike, &found, &rows);
            if best.1 == usize::MAX || best.0 < LEAST_GAIN.0 * own {
                break;
            }
            self.row(best.1, &mut rows[found.n]);
            found.channels[found.n] = best.1;
            found.n += 1;
            let n = found.n;
            found.weights = self.weigh(&found.channels[..n]);
            gain = (0..n)
                .fold(0.0, |sum, i| sum + found.weights[i] * self.of(j, found.channels[i]))
                / own;
        }
        for i in 0..found.n {
            found.signs[i] = if self.of(j, found.channels[i]) < 0.0 { -1.0 } else { 1.0 };
        }
        // Sums over anchors lack what came later: their system may be no covariance, and near singular.
        let bounded = found.weights.iter().all(|weight| weight.abs() < MAX_WEIGHT);
        if !(bounded && gain > LEAST_GAIN.1) {
            found.weights = [0.0; REFERENCES];
        }
        found
    }
}
