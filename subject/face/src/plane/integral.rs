//! Sums over rectangles in four reads (Crow 1984, summed-area tables).

use super::Plane;

/// Sums of a plane's values from the top left.
#[derive(Debug, Clone)]
pub struct Integral {
    width: usize,
    height: usize,
    /// `(width + 1) * (height + 1)`; the first row and column are zeros.
    sums: Vec<f64>,
}

impl Integral {
    /// Of a plane.
    #[must_use]
    pub fn new(plane: &Plane) -> Self {
        let (width, height) = (plane.width(), plane.height());
        let mut sums = vec![0.0; (width + 1) * (height + 1)];
        for y in 0..height {
            let (above, below) = sums.split_at_mut((y + 1) * (width + 1));
            let above = above.get(y * (width + 1)..).unwrap_or_default();
            let mut row = 0.0;
            let cells = below.iter_mut().zip(above).skip(1);
            for ((sum, &upper), &value) in cells.zip(plane.row(y)) {
                row += f64::from(value);
                *sum = upper + row;
            }
        }
        Self { width, height, sums }
    }

    /// The sum of the pixels with `left <= x < right` and `top <= y < bottom`, as far as they lie inside.
    #[must_use]
    pub fn sum(&self, left: isize, top: isize, right: isize, bottom: isize) -> f64 {
        let (left, right) = (within(left, self.width), within(right, self.width));
        let (top, bottom) = (within(top, self.height), within(bottom, self.height));
        if right <= left || bottom <= top {
            return 0.0;
        }
        let at = |x, y| self.sums.get(y * (self.width + 1) + x).copied().unwrap_or_default();
        at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)
    }

    /// The mean over the same rectangle; 0 where nothing of it lies inside.
    #[must_use]
    pub fn mean(&self, left: isize, top: isize, right: isize, bottom: isize) -> f64 {
        let across = within(right, self.width) as f64 - within(left, self.width) as f64;
        let down = within(bottom, self.height) as f64 - within(top, self.height) as f64;
        if across <= 0.0 || down <= 0.0 {
            return 0.0;
        }
        self.sum(left, top, right, bottom) / (across * down)
    }
}

fn within(at: isize, end: usize) -> usize {
    at.clamp(0, end as isize) as usize
}
