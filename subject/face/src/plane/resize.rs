//! Another size, each new pixel the mean of the area that it covers.

use super::Plane;

impl Plane {
    /// Half as wide and half as high, each pixel the mean of four; an odd last row or column is left out.
    #[must_use]
    pub fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut out = Self::filled(width, height, 0.0);
        for (y, to) in out.values.chunks_exact_mut(width).enumerate() {
            let (upper, lower) = (self.row(2 * y), self.row((2 * y + 1).min(self.height - 1)));
            let pairs = upper.chunks(2).zip(lower.chunks(2));
            for (value, (above, below)) in to.iter_mut().zip(pairs) {
                let count = above.len() + below.len();
                *value = above.iter().chain(below).sum::<f32>() / count as f32;
            }
        }
        out
    }

    /// `width` by `height` pixels (1 at least). Smaller is the mean of what is covered, without aliasing; larger repeats
    /// with mixed borders. A point `x` of this plane lies at `(x + 0.5) * width / self.width() - 0.5` of the new one.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let columns = shares(self.width, width);
        let rows = shares(self.height, height);
        let mut out = Self::filled(width, height, 0.0);
        let mut tall = vec![0.0; self.width];
        for (to, (first, weights)) in out.values.chunks_exact_mut(width).zip(&rows) {
            tall.fill(0.0);
            for (i, &weight) in weights.iter().enumerate() {
                for (sum, value) in tall.iter_mut().zip(self.row(first + i)) {
                    *sum += weight * value;
                }
            }
            for (value, (first, weights)) in to.iter_mut().zip(&columns) {
                let from = tall.get(*first..).unwrap_or_default();
                *value = from.iter().zip(weights).map(|(value, weight)| value * weight).sum();
            }
        }
        out
    }
}

/// For each new pixel the first old one that it covers, and the shares of it and of those behind it; shares sum to 1.
fn shares(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let step = from as f64 / to as f64;
    let cover = |i: usize| {
        let (start, end) = (i as f64 * step, (i + 1) as f64 * step);
        let first = (start as usize).min(from - 1);
        let last = (end.ceil() as usize).clamp(first + 1, from);
        let share = |old: usize| (end.min((old + 1) as f64) - start.max(old as f64)).max(0.0);
        let weights: Vec<f64> = (first..last).map(share).collect();
        let sum: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        (first, weights.iter().map(|weight| (weight / sum) as f32).collect())
    };
    (0..to).map(cover).collect()
}
