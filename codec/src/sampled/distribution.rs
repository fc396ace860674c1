//! The distribution of a sample around its prediction: a mixture of Student's t distributions of several widths, whose
//! weights follow the samples by Bayes' rule.
//!
//! Student's distribution of an even number of degrees of freedom has an algebraic distribution function: a square
//! root, a division and a polynomial (Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.4). The result
//! is therefore the same on every machine, without tables. Two degrees have a heavy tail, sixteen are almost a normal
//! distribution; mixtures of several widths approximate those in between.

/// Number of distributions in the mixture.
pub(super) const PARTS: usize = 8;

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

/// Coefficients of the polynomial by part; a part uses those below half its degrees of freedom.
const COEFFICIENTS: [[f64; PARTS]; 8] = {
    let mut table = [[0.0; PARTS]; 8];
    let mut power = 0;
    let mut coefficient = 1.0;
    while power < 8 {
        let mut part = 0;
        while part < PARTS {
            if 2 * power < SHAPES[part].2 {
                table[power][part] = coefficient;
            }
            part += 1;
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
    weights: [f64; PARTS],
    inverse_widths: [f64; PARTS],
}

impl Distribution {
    pub(super) fn new() -> Self {
        let mut new = Self {
            averages: [1.0; 3],
            weights: [1.0 / PARTS as f64; PARTS],
            inverse_widths: [0.0; PARTS],
        };
        new.set_widths();
        new
    }

    #[inline(always)]
    fn set_widths(&mut self) {
        for (inverse, (average, width, degrees)) in self.inverse_widths.iter_mut().zip(SHAPES) {
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

    /// The distribution function of each part. Step by step for all parts, which are then computed side by side.
    #[inline(always)]
    fn parts(&self, error: f64) -> [f64; PARTS] {
        let (mut u, mut c) = ([0.0; PARTS], [0.0; PARTS]);
        for part in 0..PARTS {
            u[part] = error * self.inverse_widths[part];
            c[part] = 1.0 / (1.0 + u[part] * u[part]);
        }
        let mut sums = COEFFICIENTS[7];
        for coefficients in COEFFICIENTS[..7].iter().rev() {
            for part in 0..PARTS {
                sums[part] = sums[part] * c[part] + coefficients[part];
            }
        }
        for part in 0..PARTS {
            sums[part] = 0.5 + 0.5 * (u[part] * c[part].sqrt() * sums[part]);
        }
        sums
    }

    /// The probability of an error below this.
    #[inline(always)]
    pub(super) fn below(&self, error: f64) -> f64 {
        let parts = self.parts(error);
        let mut sums = [0.0; 4];
        for part in 0..PARTS {
            sums[part % 4] += parts[part] * self.weights[part];
        }
        (sums[0] + sums[1]) + (sums[2] + sums[3])
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
        let mut likelihoods = [0.0; PARTS];
        let mut sum = 0.0;
        for part in 0..PARTS {
            likelihoods[part] = self.weights[part] * (within[part] - below[part] + 1e-12);
            sum += likelihoods[part];
        }
        let share = (1.0 - SPREAD) / sum;
        for (weight, likelihood) in self.weights.iter_mut().zip(likelihoods) {
            *weight = likelihood * share + SPREAD / PARTS as f64;
        }
        let magnitude = if error < 0.0 { -error } else { error };
        for (average, rate) in self.averages.iter_mut().zip(RATES) {
            *average += (magnitude - *average) * rate;
            *average = if *average > SMALLEST { *average } else { SMALLEST };
        }
        self.set_widths();
    }
}
