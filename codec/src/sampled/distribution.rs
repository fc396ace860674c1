//! The distribution of a sample around its prediction: a mixture of Student's t distributions of several widths, whose
//! weights follow the samples by Bayes' rule.
//!
//! Student's distribution of an even number of degrees of freedom has an algebraic distribution function: a square
//! root, a division and a polynomial (Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.4). The result
//! is therefore the same on every machine, without tables. Two degrees have a heavy tail, sixteen are almost a normal
//! distribution; mixtures of several widths approximate those in between.

use std::hint::black_box;

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
