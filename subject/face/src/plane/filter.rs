//! Smoothing and slopes.

use super::Plane;

/// Widths of a Gaussian beyond this are cut to it: a kernel is never longer than 2 x 3 x 64 + 1.
const SIGMA_MAX_PX: f32 = 64.0;

/// The slope in x and y, a pixel, and how steep it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// To the right.
    pub x: Plane,
    /// Downwards.
    pub y: Plane,
    /// Length of both.
    pub magnitude: Plane,
}

impl Plane {
    /// Smoothed by a Gaussian of standard deviation `sigma_px`, cut at three of them.
    #[must_use]
    pub fn blurred(&self, sigma_px: f32) -> Self {
        if sigma_px.is_nan() || sigma_px <= 0.05 {
            return self.clone();
        }
        let sigma = sigma_px.min(SIGMA_MAX_PX);
        let radius = (3.0 * sigma).ceil() as usize;
        let weights: Vec<f32> =
            (0..=2 * radius).map(|i| (i as f32 - radius as f32) / sigma).map(gauss).collect();
        let sum: f32 = weights.iter().sum();
        let weights: Vec<f32> = weights.iter().map(|weight| weight / sum).collect();
        let mut out = Self::filled(self.width, self.height, 0.0);
        // A row with its borders drawn out, so that the inner loop asks nothing.
        let mut padded = Vec::with_capacity(self.width + 2 * radius);
        for (from, to) in
            self.values.chunks_exact(self.width).zip(out.values.chunks_exact_mut(self.width))
        {
            let (Some(&first), Some(&last)) = (from.first(), from.last()) else { continue };
            padded.clear();
            padded.extend(std::iter::repeat_n(first, radius));
            padded.extend_from_slice(from);
            padded.extend(std::iter::repeat_n(last, radius));
            for (shift, &weight) in weights.iter().enumerate() {
                let Some(shifted) = padded.get(shift..) else { continue };
                for (sum, value) in to.iter_mut().zip(shifted) {
                    *sum += weight * value;
                }
            }
        }
        let across = std::mem::replace(&mut out, Self::filled(self.width, self.height, 0.0));
        for (y, to) in out.values.chunks_exact_mut(self.width).enumerate() {
            for (shift, &weight) in weights.iter().enumerate() {
                let from = (y + shift).saturating_sub(radius).min(self.height - 1);
                for (sum, value) in to.iter_mut().zip(across.row(from)) {
                    *sum += weight * value;
                }
            }
        }
        out
    }

    /// Sobel's slopes, in values a pixel (weights 1 2 1 across, divided by 8).
    #[must_use]
    pub fn gradient(&self) -> Gradient {
        let mut x = Self::filled(self.width, self.height, 0.0);
        let mut y = x.clone();
        for row in 0..self.height {
            let above = self.row(row.saturating_sub(1));
            let here = self.row(row);
            let below = self.row((row + 1).min(self.height - 1));
            let outs = x.values.iter_mut().zip(&mut y.values).skip(row * self.width);
            for (column, (dx, dy)) in outs.take(self.width).enumerate() {
                let left = column.saturating_sub(1);
                let right = (column + 1).min(self.width - 1);
                let at = |row: &[f32], column: usize| row.get(column).copied().unwrap_or_default();
                let rise = |row| at(row, right) - at(row, left);
                let step = |column| at(below, column) - at(above, column);
                *dx = (rise(above) + 2.0 * rise(here) + rise(below)) / 8.0;
                *dy = (step(left) + 2.0 * step(column) + step(right)) / 8.0;
            }
        }
        let magnitude = x.zip(&y, f32::hypot);
        Gradient { x, y, magnitude }
    }
}

fn gauss(t: f32) -> f32 {
    (-0.5 * t * t).exp()
}
