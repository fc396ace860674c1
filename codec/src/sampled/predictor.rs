//! The prediction of a sample: recursive least squares over differences of the channel's own past and over the changes
//! of its reference channels.
//!
//! Recursive least squares with a forgetting factor (Haykin, Adaptive Filter Theory, chapter 9) in f64, in the order
//! of the loops below. Values are in units of the channel's scale.

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
