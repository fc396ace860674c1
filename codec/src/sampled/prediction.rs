//! The prediction of a sample, and the distribution of the sample around it.
//!
//! A sample is predicted from differences of the channel's own past and from the changes of its reference channels, by
//! recursive least squares with a forgetting factor (Haykin, Adaptive Filter Theory, chapter 9) in f64, in the order
//! of the loops below. Values are in units of the channel's scale.
//!
//! The distribution is a mixture of Student's t distributions of several widths, whose weights follow the samples by
//! Bayes' rule. Student's distribution of an even number of degrees of freedom has an algebraic distribution function: a square
//! root, a division and a polynomial (Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.4). The result
//! is therefore the same on every machine, without tables. Two degrees have a heavy tail, sixteen are almost a normal
//! distribution; mixtures of several widths approximate those in between.

use std::hint::black_box;

/// Differences of order 1 to 7 of the channel's past, after its level.
const DIFFERENCES: usize = 8;
/// First differences further back. Eight need 0.1 % fewer bytes on five recorded takes, and 40 % more time.
const LAGS: usize = 4;
/// Maximum number of reference channels. Four that the encoder chooses need no more bytes than the eight nearest, which
/// take twice the time.
pub(super) const REFERENCES: usize = 4;
/// Number of regressors.
const ORDER: usize = DIFFERENCES + LAGS + 2 * REFERENCES;

/// The weight of the past falls by this factor with every sample: a memory of about 700 samples. 0.9995 needs 0.4 % more
/// bytes.
const FORGETTING: f64 = 0.9985;
/// Initial variance of a weight. 0.05 needs 0.1 % more bytes, 30 the same number.
const VARIANCE: f64 = 1.0;
/// Nothing is forgotten while an entry of the inverse exceeds this: otherwise the inverse grows without bound if inputs
/// do not change.
const VARIANCE_MAX: f64 = 1e9;

/// Variance of weights inherited from another channel, relative to the variance there. On recorded positions 1 needs
/// 0.5 % more bytes, and weights alone, with an initial variance of 1, 1 % more.
const INHERITED_VARIANCE: f64 = 10.0;

/// Inputs beyond this power are not learnt from.
const POWER_MAX: f64 = 1e30;

type Regressors = [f64; ORDER];

/// The predictor of one channel.
#[derive(Debug, Clone)]
pub(super) struct Predictor {
    weights: Regressors,
    /// The inverse of the correlations of the regressors.
    inverse: Box<[Regressors; ORDER]>,
    /// Its largest entry.
    largest: f64,
    inputs: Regressors,
    /// The last value and its differences of order 1 to 7.
    differences: [f64; DIFFERENCES],
    /// First differences, newest first.
    changes: [f64; DIFFERENCES + LAGS - 1],
    mean: f64,
    /// Values since the past began, up to the number of differences: those of higher orders are 0.
    n_values: usize,
}

impl Predictor {
    pub(super) fn new() -> Self {
        let mut new = Self {
            weights: [0.0; ORDER],
            inverse: Box::new([[0.0; ORDER]; ORDER]),
            largest: VARIANCE,
            inputs: [0.0; ORDER],
            differences: [0.0; DIFFERENCES],
            changes: [0.0; DIFFERENCES + LAGS - 1],
            mean: 0.0,
            n_values: DIFFERENCES,
        };
        new.reset_inverse();
        new
    }

    /// Resets the predictor to a first value.
    pub(super) fn start(&mut self, value: f64) {
        self.weights = [0.0; ORDER];
        self.restart(value);
        self.n_values = DIFFERENCES;
        self.reset_inverse();
    }

    /// Starts from a value with the weights that another channel learnt for its own past.
    pub(super) fn start_like(&mut self, value: f64, other: &Self) {
        self.start(value);
        self.n_values = 1;
        let own = DIFFERENCES + LAGS;
        self.weights[..own].copy_from_slice(&other.weights[..own]);
        for (i, (row, learnt)) in
            self.inverse.iter_mut().zip(other.inverse.iter()).enumerate().take(own)
        {
            for (entry, learnt) in row.iter_mut().zip(learnt).take(own) {
                *entry = learnt * INHERITED_VARIANCE;
            }
            self.largest = if row[i] > self.largest { row[i] } else { self.largest };
        }
    }

    /// Begins a new past at a value: nothing before it is near in time. The weights stay.
    pub(super) fn restart(&mut self, value: f64) {
        self.differences = [0.0; DIFFERENCES];
        self.differences[0] = value;
        self.changes = [0.0; DIFFERENCES + LAGS - 1];
        self.mean = value;
        self.n_values = 1;
    }

    fn reset_inverse(&mut self) {
        self.largest = VARIANCE;
        for (i, row) in self.inverse.iter_mut().enumerate() {
            *row = [0.0; ORDER];
            row[i] = VARIANCE;
        }
    }

    /// The last value.
    pub(super) fn last(&self) -> f64 {
        self.differences[0]
    }

    /// The prediction of the next value, given the changes of the reference channels.
    #[inline(always)]
    pub(super) fn predict(&mut self, references: &[f64; 2 * REFERENCES]) -> f64 {
        self.inputs[0] = self.differences[0] - self.mean;
        self.inputs[1..DIFFERENCES].copy_from_slice(&self.differences[1..]);
        self.inputs[DIFFERENCES..DIFFERENCES + LAGS]
            .copy_from_slice(&self.changes[DIFFERENCES - 1..]);
        self.inputs[DIFFERENCES + LAGS..].copy_from_slice(references);
        let mut sums = [0.0; 4];
        let (inputs, _) = self.inputs.as_chunks::<4>();
        let (weights, _) = self.weights.as_chunks::<4>();
        for (inputs, weights) in inputs.iter().zip(weights) {
            for lane in 0..4 {
                sums[lane] += inputs[lane] * weights[lane];
            }
        }
        self.differences[0] + ((sums[0] + sums[1]) + (sums[2] + sums[3]))
    }

    /// Moves on to a value without learning from it.
    #[inline(always)]
    pub(super) fn push(&mut self, value: f64) {
        let mut difference = value;
        for slot in &mut self.differences {
            let before = std::mem::replace(slot, difference);
            difference -= before;
        }
        self.n_values = (self.n_values + 1).min(DIFFERENCES);
        for slot in &mut self.differences[self.n_values..] {
            *slot = 0.0;
        }
        self.changes.copy_within(..DIFFERENCES + LAGS - 2, 1);
        self.changes[0] = self.differences[1];
        self.mean += (value - self.mean) * (1.0 / 256.0);
    }

    /// Learns from the error of the last prediction: value less prediction.
    #[inline(always)]
    pub(super) fn learn(&mut self, error: f64) {
        let Self { weights, inverse, inputs, largest, .. } = self;
        let forgetting = if *largest < VARIANCE_MAX { FORGETTING } else { 1.0 };
        let mut gains = [0.0; ORDER];
        for (row, input) in inverse.iter().zip(inputs.iter()) {
            for (gain, entry) in gains.iter_mut().zip(row) {
                *gain += entry * input;
            }
        }
        let mut power = forgetting;
        for (gain, input) in gains.iter().zip(inputs.iter()) {
            power += gain * input;
        }
        if !(power >= forgetting && power < POWER_MAX) {
            self.reset_inverse();
            return;
        }
        let step = error / power;
        for (weight, gain) in weights.iter_mut().zip(&gains) {
            *weight += gain * step;
        }
        let (shrink, grow) = (1.0 / power, 1.0 / forgetting);
        *largest = 0.0;
        for (i, row) in inverse.iter_mut().enumerate() {
            let own = gains[i];
            for (entry, gain) in row.iter_mut().zip(&gains) {
                // In this order the matrix stays symmetric to the last bit.
                *entry = (*entry - own * gain * shrink) * grow;
            }
            *largest = if row[i] > *largest { row[i] } else { *largest };
        }
    }
}

/// Number of distributions in the mixture.
const PARTS: usize = 8;

/// Rates of the three averages of the error's magnitude: memories of 8, 32 and 256 samples.
const RATES: [f64; 3] = [1.0 / 8.0, 1.0 / 32.0, 1.0 / 256.0];

/// For each part: the average that scales it, its width relative to that, and its degrees of freedom. Chosen to cover
/// half to three times each average, not optimised.
const SHAPES: [(usize, f64, usize); PARTS] = [
    (0, 1.2, 16),
    (0, 0.7, 4),
    (1, 0.5, 16),
    (1, 1.25, 16),
    (1, 0.8, 2),
    (2, 0.3, 4),
    (2, 1.25, 16),
    (2, 2.5, 2),
];

/// The parts by lane of a vector: those of sixteen degrees of freedom, and the others, whose polynomials are shorter.
const LANES: [[usize; 4]; 2] = [[0, 2, 3, 6], [1, 5, 4, 7]];

/// Coefficients of the polynomials, by lane; a part has those below half its degrees of freedom.
const COEFFICIENTS: [[[f64; 4]; 8]; 2] = {
    let mut table = [[[0.0; 4]; 8]; 2];
    let mut power = 0;
    let mut coefficient = 1.0;
    while power < 8 {
        let mut at = 0;
        while at < PARTS {
            if 2 * power < SHAPES[LANES[at / 4][at % 4]].2 {
                table[at / 4][power][at % 4] = coefficient;
            }
            at += 1;
        }
        power += 1;
        coefficient *= (2 * power - 1) as f64 / (2 * power) as f64;
    }
    table
};

/// The square roots of 2, 4 and 16 degrees of freedom.
const fn root(degrees: usize) -> f64 {
    match degrees {
        2 => std::f64::consts::SQRT_2,
        4 => 2.0,
        _ => 4.0,
    }
}

/// The fraction of the weight that is redistributed evenly at every sample, so that no component vanishes.
const SPREAD: f64 = 0.01;

/// Smallest average of the error's magnitude, in units of the channel's scale.
const SMALLEST: f64 = 1e-12;

/// The distribution of the next sample, less its centre.
#[derive(Debug, Clone)]
pub(super) struct Distribution {
    averages: [f64; 3],
    weights: [[f64; 4]; 2],
    inverse_widths: [[f64; 4]; 2],
}

impl Distribution {
    pub(super) fn new() -> Self {
        let mut new = Self {
            averages: [1.0; 3],
            weights: [[1.0 / PARTS as f64; 4]; 2],
            inverse_widths: [[0.0; 4]; 2],
        };
        new.set_widths();
        new
    }

    #[inline(always)]
    fn set_widths(&mut self) {
        for (inverse, part) in
            self.inverse_widths.as_flattened_mut().iter_mut().zip(LANES.as_flattened())
        {
            let (average, width, degrees) = SHAPES[*part];
            *inverse = 1.0 / (self.averages[average] * (width * root(degrees)));
        }
    }

    /// The typical magnitude of an error.
    #[inline(always)]
    pub(super) fn width(&self) -> f64 {
        self.averages[1]
    }

    /// The smallest of the averages.
    #[inline(always)]
    pub(super) fn narrowest(&self) -> f64 {
        let [a, b, c] = self.averages;
        let least = if a < b { a } else { b };
        if least < c { least } else { c }
    }

    /// The distribution functions of one vector of parts, whose polynomials have `POWERS` coefficients.
    #[inline(always)]
    fn lanes<const POWERS: usize>(&self, vector: usize, error: f64) -> [f64; 4] {
        let coefficients = &COEFFICIENTS[vector];
        let (mut u, mut c, mut sums) = ([0.0; 4], [0.0; 4], [0.0; 4]);
        for lane in 0..4 {
            u[lane] = error * self.inverse_widths[vector][lane];
            c[lane] = 1.0 / (1.0 + u[lane] * u[lane]);
            sums[lane] = coefficients[POWERS - 1][lane];
        }
        for power in (0..POWERS - 1).rev() {
            for lane in 0..4 {
                sums[lane] = sums[lane] * c[lane] + coefficients[power][lane];
            }
        }
        for lane in 0..4 {
            sums[lane] = 0.5 + 0.5 * (u[lane] * c[lane].sqrt() * sums[lane]);
        }
        sums
    }

    /// The distribution function of each part, by lane.
    #[inline(always)]
    fn parts(&self, error: f64) -> [[f64; 4]; 2] {
        [self.lanes::<8>(0, error), self.lanes::<2>(1, error)]
    }

    /// The probability of an error below this.
    #[inline(always)]
    pub(super) fn below(&self, error: f64) -> f64 {
        let parts = self.parts(error);
        let mut products = [[0.0; 4]; 2];
        for vector in 0..2 {
            for lane in 0..4 {
                products[vector][lane] = parts[vector][lane] * self.weights[vector][lane];
            }
        }
        // Opaque: a compiler that sees what becomes of each product computes them one by one. Encoding takes 20 % less time.
        let [[p0, p2, p3, p6], [p1, p5, p4, p7]] = black_box(products);
        ((p0 + p4) + (p1 + p5)) + ((p2 + p6) + (p3 + p7))
    }

    /// Learns from an error, in the cell between two errors.
    #[inline(always)]
    pub(super) fn learn(&mut self, low: f64, high: f64, error: f64) {
        // Narrow cells are widened, so that differences of probabilities have enough bits.
        let narrow = self.averages[1] * (1.0 / 64.0);
        let (low, high) = if high - low < narrow {
            (error - 0.5 * narrow, error + 0.5 * narrow)
        } else {
            (low, high)
        };
        let (below, within) = (self.parts(low), self.parts(high));
        let mut likelihoods = [[0.0; 4]; 2];
        for vector in 0..2 {
            for lane in 0..4 {
                let probability = within[vector][lane] - below[vector][lane] + 1e-12;
                likelihoods[vector][lane] = self.weights[vector][lane] * probability;
            }
        }
        let likelihoods = black_box(likelihoods);
        let [[l0, l2, l3, l6], [l1, l5, l4, l7]] = likelihoods;
        let sum = l0 + l1 + l2 + l3 + l4 + l5 + l6 + l7;
        let share = (1.0 - SPREAD) / sum;
        self.weights = likelihoods
            .map(|lanes| lanes.map(|likelihood| likelihood * share + SPREAD / PARTS as f64));
        let magnitude = if error < 0.0 { -error } else { error };
        for (average, rate) in self.averages.iter_mut().zip(RATES) {
            *average += (magnitude - *average) * rate;
            *average = if *average > SMALLEST { *average } else { SMALLEST };
        }
        self.set_widths();
    }
}
