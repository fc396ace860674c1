//! Planes of numbers and of yes and no: what every step on a photograph is made of.
//!
//! Coordinates are those of [`Photo`](super::Photo): whole numbers are the centres of pixels, x right, y down. What lies
//! outside is what lies at the border.

mod components;
mod filter;
mod integral;
mod mask;
mod resize;
#[cfg(test)]
mod tests;

pub use components::{Blob, Labels};
pub use filter::Gradient;
pub use integral::Integral;
pub use mask::Mask;

/// One number a pixel, row by row from the top left.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// `value` everywhere. A plane has one pixel at least.
    #[must_use]
    pub fn filled(width: usize, height: usize, value: f32) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self { width, height, values: vec![value; width * height] }
    }

    /// Row after row of `values`; what is missing is 0, and what is over is left out.
    #[must_use]
    pub fn from_values(width: usize, height: usize, mut values: Vec<f32>) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        values.resize(width * height, 0.0);
        Self { width, height, values }
    }

    /// What `value` makes of each x and y.
    #[must_use]
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Self { width, height, values }
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All of them, row by row.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All of them, to be changed.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Row `y` from the left; empty outside.
    #[must_use]
    pub fn row(&self, y: usize) -> &[f32] {
        self.values.get(y * self.width..(y + 1) * self.width).unwrap_or_default()
    }

    /// The value of a pixel; the border's outside.
    #[must_use]
    pub fn get(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values.get(y * self.width + x).copied().unwrap_or_default()
    }

    /// The value between pixels, bilinear; 0 where `x` or `y` is not a number.
    #[must_use]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        // NaN fails both comparisons of clamp's, and would come out of it.
        if x.is_nan() || y.is_nan() {
            return 0.0;
        }
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let right = (left + 1).min(self.width - 1);
        let (fx, fy) = (x - left as f32, y - top as f32);
        let upper = self.row(top);
        let lower = self.row((top + 1).min(self.height - 1));
        let mix = |row: &[f32]| match (row.get(left), row.get(right)) {
            (Some(a), Some(b)) => a + (b - a) * fx,
            _ => 0.0,
        };
        let (above, below) = (mix(upper), mix(lower));
        above + (below - above) * fy
    }

    /// Whether x and y lie between the centres of the outermost pixels.
    #[must_use]
    pub fn holds(&self, x: f32, y: f32) -> bool {
        x >= 0.0 && y >= 0.0 && x <= (self.width - 1) as f32 && y <= (self.height - 1) as f32
    }

    /// Each value changed by itself.
    #[must_use]
    pub fn map(&self, change: impl Fn(f32) -> f32) -> Self {
        Self { values: self.values.iter().map(|&v| change(v)).collect(), ..*self }
    }

    /// Each value with the one at the same place of `other`; what `other` does not have is left out of the change.
    #[must_use]
    pub fn zip(&self, other: &Self, join: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self.clone();
        for (value, &with) in out.values.iter_mut().zip(&other.values) {
            *value = join(*value, with);
        }
        out
    }

    /// Where `is` holds.
    #[must_use]
    pub fn mask(&self, is: impl Fn(f32) -> bool) -> Mask {
        Mask::from_values(self.width, self.height, self.values.iter().map(|&v| is(v)).collect())
    }

    /// The value that `share` (0 to 1) of all values are not above; NaN counts as largest.
    #[must_use]
    pub fn quantile(&self, share: f32) -> f32 {
        let mut values = self.values.clone();
        let at = ((values.len() - 1) as f32 * share.clamp(0.0, 1.0)).round() as usize;
        let (_, value, _) = values.select_nth_unstable_by(at, f32::total_cmp);
        *value
    }
}
