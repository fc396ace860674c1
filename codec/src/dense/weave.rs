//! What one marker's residuals say about another's.
//!
//! Markers of one body accelerate together. For every pair of channels and every class of levels an
//! average remembers the inner products of their residuals at the same rows; the residual of a channel
//! is then expected from up to three channels before it, by least squares. Before anything was seen,
//! markers that are close together are taken to move alike: the covariance starts from a function of
//! their distance, as in kriging.

use crate::GROUP_CHANNELS;

use super::SPAN;

/// Classes of levels: anchors; strides 8 and more; 4; 2; 1.
pub(super) const CLASSES: usize = 5;
/// Channels that a residual is expected from, at most.
pub(super) const REFERENCES: usize = 3;

/// What a span leaves of the averages.
const DECAY: f64 = 0.9;
/// The weight of the distances, in averages of all channels' energies.
const KERNEL_WEIGHT: f64 = 0.3;
/// The least such average, in squared tolerances.
const LEAST_ENERGY: f64 = 10.0;
/// Every variance is taken to be so much larger: relative, and in squared tolerances.
const RIDGE: (f64, f64) = (1.15, 2.0);
/// A reference must explain at least this share of the energy, all of them together that one.
const LEAST_GAIN: (f64, f64) = (0.02, 0.15);
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
    weights: [f64; REFERENCES],
    /// Whether they explain enough to be used for the expectation.
    used: bool,
}

/// All averages of a group.
#[derive(Debug)]
pub(super) struct Weave {
    /// By class, channel, earlier channel or itself.
    covariances: Vec<f64>,
    /// By channel and earlier channel.
    kernel: Vec<f64>,
    references: Vec<References>,
    /// Of the current span: by row, axis, channel. Zero where there is none.
    residuals: Vec<f64>,
}

const PAIRS: usize = GROUP_CHANNELS * GROUP_CHANNELS;

fn pair(a: usize, b: usize) -> usize {
    a.max(b) * GROUP_CHANNELS + a.min(b)
}

impl Weave {
    pub(super) fn new() -> Self {
        Self {
            covariances: vec![0.0; CLASSES * PAIRS],
            kernel: vec![0.0; PAIRS],
            references: vec![References::default(); CLASSES * GROUP_CHANNELS],
            residuals: vec![0.0; (SPAN + 1) * 3 * GROUP_CHANNELS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.covariances.fill(0.0);
        self.kernel.fill(0.0);
        self.references.fill(References::default());
    }

    /// A span of `n` channels begins.
    pub(super) fn begin(&mut self, n: usize) {
        for lane in self.residuals.chunks_exact_mut(GROUP_CHANNELS) {
            lane[..n].fill(0.0);
        }
        for lane in self.kernel.chunks_exact_mut(GROUP_CHANNELS).take(n) {
            lane[..n].fill(0.0);
        }
    }

    /// The span is over: the averages forget a little.
    pub(super) fn end(&mut self, n: usize) {
        for class in self.covariances.chunks_exact_mut(PAIRS) {
            for (j, lane) in class.chunks_exact_mut(GROUP_CHANNELS).enumerate().take(n) {
                lane[..=j].iter_mut().for_each(|covariance| *covariance *= DECAY);
            }
        }
    }

    /// States how far apart two channels are.
    pub(super) fn place(&mut self, j: usize, k: usize, distance_mm: f64) {
        let near = 800.0 / (800.0 + distance_mm);
        self.kernel[pair(j, k)] = near * near * near;
    }

    /// How alike two channels are taken to move for their distance.
    pub(super) fn nearness(&self, j: usize, k: usize) -> f64 {
        self.kernel[pair(j, k)]
    }

    pub(super) fn references(&self, class: usize, j: usize) -> &References {
        &self.references[class * GROUP_CHANNELS + j]
    }

    /// A residual of the current span.
    pub(super) fn residual(&self, row: usize, axis: usize, channel: usize) -> f64 {
        self.residuals[(row * 3 + axis) * GROUP_CHANNELS + channel]
    }

    /// What the references expect of a residual, in units.
    pub(super) fn expect(&self, class: usize, j: usize, row: usize) -> [f64; 3] {
        let references = self.references(class, j);
        let mut sums = [0.0; 3];
        if references.used {
            for i in 0..references.n {
                for (axis, sum) in sums.iter_mut().enumerate() {
                    *sum +=
                        references.weights[i] * self.residual(row, axis, references.channels[i]);
                }
            }
        }
        sums
    }

    /// Remembers a residual.
    pub(super) fn learn(&mut self, class: usize, j: usize, row: usize, mut residual: [f64; 3]) {
        let [x, y, z] = residual;
        let length = (x * x + y * y + z * z).sqrt();
        if length == 0.0 {
            return;
        }
        if length > MAX_RESIDUAL {
            residual = residual.map(|component| component * (MAX_RESIDUAL / length));
        }
        let lanes = &mut self.residuals[row * 3 * GROUP_CHANNELS..(row + 1) * 3 * GROUP_CHANNELS];
        for (lane, component) in lanes.chunks_exact_mut(GROUP_CHANNELS).zip(residual) {
            lane[j] = component;
        }
        let (xs, rest) = lanes.split_at(GROUP_CHANNELS);
        let (ys, zs) = rest.split_at(GROUP_CHANNELS);
        let first = (class * GROUP_CHANNELS + j) * GROUP_CHANNELS;
        let covariances = &mut self.covariances[first..=first + j];
        let [x, y, z] = residual.map(|component| component / 65536.0);
        let others = xs[..=j].iter().zip(&ys[..=j]).zip(&zs[..=j]);
        for (covariance, ((other_x, other_y), other_z)) in covariances.iter_mut().zip(others) {
            *covariance += x * other_x + y * other_y + z * other_z;
        }
    }

    /// Chooses and weighs the references of channel `j` of `n`, for every class.
    pub(super) fn solve(&mut self, j: usize, n: usize) {
        for class in 0..CLASSES {
            self.references[class * GROUP_CHANNELS + j] = self.solved(class, j, n);
        }
    }

    fn solved(&self, class: usize, j: usize, n: usize) -> References {
        let covariances = &self.covariances[class * PAIRS..(class + 1) * PAIRS];
        let energies = (0..n).fold(0.0, |sum, k| sum + covariances[pair(k, k)]);
        let energy = (energies / n as f64).max(LEAST_ENERGY) * KERNEL_WEIGHT;
        let of = |a: usize, b: usize| {
            let near = if a == b { 1.0 } else { self.kernel[pair(a, b)] };
            covariances[pair(a, b)] + energy * near
        };
        let own = of(j, j);
        let (mut alike, mut ridged) = ([0.0; GROUP_CHANNELS], [0.0; GROUP_CHANNELS]);
        for k in 0..j {
            alike[k] =
                covariances[j * GROUP_CHANNELS + k] + energy * self.kernel[j * GROUP_CHANNELS + k];
            ridged[k] = (covariances[k * GROUP_CHANNELS + k] + energy) * RIDGE.0 + RIDGE.1;
        }
        let mut found = References::default();
        let mut gain = 0.0;
        while found.n < REFERENCES {
            let mut best = (0.0, usize::MAX);
            for k in (0..j).filter(|k| !found.channels[..found.n].contains(k)) {
                let mut shared = alike[k];
                for i in 0..found.n {
                    shared -= found.weights[i] * of(k, found.channels[i]);
                }
                let explained = shared * shared / ridged[k];
                if explained > best.0 {
                    best = (explained, k);
                }
            }
            if best.1 == usize::MAX || best.0 < LEAST_GAIN.0 * own {
                break;
            }
            found.channels[found.n] = best.1;
            found.n += 1;
            let n = found.n;
            found.weights = weigh(&found.channels[..n], j, of);
            gain =
                (0..n).fold(0.0, |sum, i| sum + found.weights[i] * of(j, found.channels[i])) / own;
        }
        for i in 0..found.n {
            found.signs[i] = if of(j, found.channels[i]) < 0.0 { -1.0 } else { 1.0 };
        }
        found.used = gain > LEAST_GAIN.1;
        found
    }
}

/// Least squares by Gauss and Jordan, without pivoting: the ridge keeps the pivots away from zero.
fn weigh(channels: &[usize], j: usize, of: impl Fn(usize, usize) -> f64) -> [f64; REFERENCES] {
    let n = channels.len();
    let mut system = [[0.0; REFERENCES + 1]; REFERENCES];
    for i in 0..n {
        for k in 0..n {
            system[i][k] = of(channels[i], channels[k]);
        }
        system[i][i] = system[i][i] * RIDGE.0 + RIDGE.1;
        system[i][n] = of(j, channels[i]);
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
