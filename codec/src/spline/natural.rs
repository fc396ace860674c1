//! The natural cubic spline through samples at whole rows, by its second derivatives (moments).
//!
//! Inside an interval of length `h` from knot 0 to knot 1, with `a = (x1 - x)/h` and `b = 1 - a`: `y = a y0 + b y1 +
//! ((a^3 - a) M0 + (b^3 - b) M1) h^2 / 6` (de Boor, A Practical Guide to Splines, chapter IV). It uses additions,
//! multiplications and divisions in f64 in a fixed order, so that every machine gets the same bits.

use crate::{
    Position,
    bound::{self, Vector, widen},
};

/// The moments at the knots, and memory for solving for them.
#[derive(Debug, Clone, Default)]
pub(super) struct Moments {
    pub(super) values: Vec<Vector>,
    /// Forward sweep of the Thomas algorithm: upper diagonal and right-hand side, divided.
    sweep: Vec<(f64, Vector)>,
}

/// A knot: its row within the run, and its position.
pub(super) type Knot = (usize, Vector);

impl Moments {
    /// Solves for the moments of the whole spline, which are zero at both ends.
    pub(super) fn solve(&mut self, knots: &[Knot]) {
        self.values.clear();
        self.values.resize(knots.len(), [0.0; 3]);
        if let Some(last) = knots.len().checked_sub(1) {
            self.solve_between(knots, 0, last);
        }
    }

    /// Solves for the moments strictly between the knots `low` and `high`, whose own moments are fixed.
    pub(super) fn solve_between(&mut self, knots: &[Knot], low: usize, high: usize) {
        let (mut upper, mut right) = (0.0, self.values[low]);
        self.sweep.clear();
        for i in low + 1..high {
            let [(x0, y0), (x1, y1), (x2, y2)] = [knots[i - 1], knots[i], knots[i + 1]];
            let (h0, h1) = ((x1 - x0) as f64, (x2 - x1) as f64);
            // Row i: h0 M[i-1] + 2 (h0 + h1) M[i] + h1 M[i+1] = 6 (slope1 - slope0).
            let pivot = 2.0 * (h0 + h1) - h0 * upper;
            for (axis, right) in right.iter_mut().enumerate() {
                let bend = 6.0 * ((y2[axis] - y1[axis]) / h1 - (y1[axis] - y0[axis]) / h0);
                *right = (bend - h0 * *right) / pivot;
            }
            upper = h1 / pivot;
            self.sweep.push((upper, right));
        }
        for (i, &(upper, right)) in (low + 1..high).zip(&self.sweep).rev() {
            let next = self.values[i + 1];
            self.values[i] = std::array::from_fn(|axis| right[axis] - upper * next[axis]);
        }
    }

    /// The spline at `row`, which lies between the knots `interval` and `interval + 1`.
    /// At a knot it equals the knot's position exactly.
    pub(super) fn at(&self, knots: &[Knot], interval: usize, row: usize) -> Vector {
        let [(x0, y0), (x1, y1)] = [knots[interval], knots[interval + 1]];
        let [m0, m1] = [self.values[interval], self.values[interval + 1]];
        let h = (x1 - x0) as f64;
        let (a, b) = ((x1 - row) as f64 / h, (row - x0) as f64 / h);
        let (ca, cb) = ((a * a * a - a) * (h * h / 6.0), (b * b * b - b) * (h * h / 6.0));
        std::array::from_fn(|axis| a * y0[axis] + b * y1[axis] + (ca * m0[axis] + cb * m1[axis]))
    }
}

/// Reconstructs a run from its knots as float32, as decoders do.
///
/// The first knot is row 0 and the last the run's last row; rows of `run` in between are written.
pub(super) fn rebuild(knots: &[Knot], moments: &mut Moments, run: &mut [Position]) {
    if let [(_, only)] = knots {
        run.fill(only.map(|v| v as f32));
        return;
    }
    moments.solve(knots);
    for (interval, pair) in knots.windows(2).enumerate() {
        let (from, to) = (pair[0].0, pair[1].0);
        for (row, position) in (from..=to).zip(&mut run[from..]) {
            *position = moments.at(knots, interval, row).map(|v| v as f32);
        }
    }
}

/// A run's knots and its reconstruction. Its memory is reused from run to run.
#[derive(Debug, Clone, Default)]
pub(super) struct RunFit {
    /// The kept rows, in order.
    pub(super) knots: Vec<Knot>,
    moments: Moments,
    /// The reconstruction.
    pub(super) rebuilt: Vec<Position>,
    /// The largest error of the last measurement.
    pub(super) max_error_mm: f64,
}

impl RunFit {
    /// Starts a run with the given kept rows, in order.
    pub(super) fn start(&mut self, rows: impl IntoIterator<Item = usize>) {
        self.knots.clear();
        self.knots.extend(rows.into_iter().map(|row| (row, [0.0; 3])));
        self.max_error_mm = 0.0;
    }

    /// Adds a kept row.
    pub(super) fn insert(&mut self, row: usize) {
        let index = self.knots.partition_point(|&(knot, _)| knot < row);
        self.knots.insert(index, (row, [0.0; 3]));
    }

    /// The kept rows.
    pub(super) fn rows(&self) -> impl ExactSizeIterator<Item = usize> {
        self.knots.iter().map(|&(row, _)| row)
    }

    /// Reconstructs all `len` rows of the run.
    pub(super) fn rebuild(&mut self, len: usize) {
        self.rebuilt.resize(len, [0.0; 3]);
        rebuild(&self.knots, &mut self.moments, &mut self.rebuilt);
    }

    /// Reconstructs the run from its kept samples and measures its error; returns the row with the largest error, the
    /// first of equals.
    pub(super) fn measure(&mut self, samples: &[Position]) -> usize {
        for (row, position) in &mut self.knots {
            *position = widen(samples[*row]);
        }
        self.rebuild(samples.len());
        let (mut worst, mut at) = (0.0, 0);
        for (row, (&a, &b)) in self.rebuilt.iter().zip(samples).enumerate() {
            let error = bound::distance_mm(a, b);
            // Infinity less infinity, after an overflow, counts as the largest error.
            let error = if error.is_nan() { f64::INFINITY } else { error };
            if error > worst {
                (worst, at) = (error, row);
            }
        }
        self.max_error_mm = worst;
        at
    }

    /// Inserts the worst sample until the float32 reconstruction is within `tolerance_mm`.
    pub(super) fn prove(&mut self, samples: &[Position], tolerance_mm: f64) {
        loop {
            let worst = self.measure(samples);
            // Knots are reconstructed exactly, so the loop ends at the latest when every sample is kept.
            if self.max_error_mm <= tolerance_mm {
                return;
            }
            self.insert(worst);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knots(points: &[(usize, f64)]) -> Vec<Knot> {
        points.iter().map(|&(x, y)| (x, [y, -y, 2.0 * y])).collect()
    }

    #[test]
    fn known_moments_of_three_knots() {
        // 2 (h0 + h1) M1 = 6 ((y2 - y1)/h1 - (y1 - y0)/h0): with h = 1 and y = 0, 1, 0 this is M1 = -3.
        let mut moments = Moments::default();
        moments.solve(&knots(&[(0, 0.0), (1, 1.0), (2, 0.0)]));
        assert_eq!(moments.values, [[0.0; 3], [-3.0, 3.0, -6.0], [0.0; 3]]);
        // Uneven: h = 2, 4 and y = 0, 6, 0: 12 M1 = 6 (-1.5 - 3), so M1 = -2.25.
        let uneven = knots(&[(0, 0.0), (2, 6.0), (6, 0.0)]);
        moments.solve(&uneven);
        assert_eq!(moments.values[1], [-2.25, 2.25, -4.5]);
        // Halfway along the first interval: (0 + 6)/2 + (1/8 - 1/2) * -2.25 * 4/6.
        assert_eq!(moments.at(&uneven, 0, 1)[0], 3.0 + 0.375 * 2.25 * 4.0 / 6.0);
    }

    #[test]
    fn knots_are_exact_and_lines_are_kept() {
        let line: Vec<Knot> = [0, 3, 4, 9, 20].iter().map(|&x| (x, [x as f64; 3])).collect();
        let mut run = vec![[0.0; 3]; 21];
        let mut moments = Moments::default();
        rebuild(&line, &mut moments, &mut run);
        for (row, position) in run.iter().enumerate() {
            assert!((f64::from(position[0]) - row as f64).abs() < 1e-5);
        }
        let odd = knots(&[(0, 0.1), (5, f64::from(f32::MAX)), (7, -0.3)]);
        moments.solve(&odd);
        for (i, &(row, value)) in odd[..2].iter().enumerate() {
            assert_eq!(moments.at(&odd, i, row), value);
        }
        assert_eq!(moments.at(&odd, 1, 7), odd[2].1);
    }
}
