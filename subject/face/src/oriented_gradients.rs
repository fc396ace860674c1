//! Histograms of oriented gradients (Dalal and Triggs 2005): gradients of brightness by direction, pooled over square
//! cells and normalised by the local contrast, quantised to bytes.

use crate::plane::Plane;

/// Number of directions, 45 degrees apart, clockwise from the right.
pub(crate) const DIRECTIONS: usize = 8;
/// Noise floor of the contrast, in square roots of grey levels: added before the division.
pub(crate) const FLOOR: f32 = 0.25;
/// Quantisation: byte value of a gradient as steep as the local contrast, and of one standard deviation of brightness.
pub(crate) const SLOPE_BYTES: f32 = 128.0;
const BRIGHT_BYTES: f32 = 40.0;
/// Byte value of the mean.
pub(crate) const MIDDLE: f32 = 128.0;

/// Splits a gradient into its parts along the two nearest of eight directions: index and amount of each.
pub(crate) fn directions(dx: f32, dy: f32) -> [(usize, f32); 2] {
    let (wide, high) = (dx.abs(), dy.abs());
    let flat = match (wide >= high, dx >= 0.0, dy >= 0.0) {
        (true, true, _) => 0,
        (false, _, true) => 2,
        (true, false, _) => 4,
        (false, _, false) => 6,
    };
    let diagonal = match (dx >= 0.0, dy >= 0.0) {
        (true, true) => 1,
        (false, true) => 3,
        (false, false) => 5,
        (true, false) => 7,
    };
    [(flat, (wide - high).abs()), (diagonal, std::f32::consts::SQRT_2 * wide.min(high))]
}

pub(crate) fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// Means over the pixels of a cell.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Histogram {
    slopes: [f32; DIRECTIONS],
    brightness: f32,
    /// Mean squared gradient.
    pub(crate) energy: f32,
}

/// The cells of a plane, row by row.
#[derive(Debug)]
pub(crate) struct Histograms {
    across: usize,
    down: usize,
    cells: Vec<Histogram>,
}

impl Histograms {
    /// Pools square roots of brightness over cells of `side` pixels; the plane's sides must be multiples of it.
    pub(crate) fn pooled(roots: &Plane, side: usize) -> Self {
        let (width, height) = (roots.width(), roots.height());
        let (across, down) = (width / side, height / side);
        let mut cells = vec![Histogram::default(); across * down];
        for y in 0..down * side {
            let (upper, row) = (roots.row(y.saturating_sub(1)), roots.row(y));
            let lower = roots.row((y + 1).min(height - 1));
            let cells = cells.iter_mut().skip(y / side * across).take(across);
            for (column, cell) in cells.enumerate() {
                for x in column * side..(column + 1) * side {
                    let at = |line: &[f32], x: usize| line.get(x).copied().unwrap_or_default();
                    let dx = at(row, (x + 1).min(width - 1)) - at(row, x.saturating_sub(1));
                    let dy = at(lower, x) - at(upper, x);
                    for (direction, by) in directions(dx, dy) {
                        if let Some(sum) = cell.slopes.get_mut(direction) {
                            *sum += by;
                        }
                    }
                    cell.brightness += at(row, x);
                    cell.energy += dx * dx + dy * dy;
                }
            }
        }
        let share = 1.0 / (side * side) as f32;
        for cell in &mut cells {
            cell.slopes = cell.slopes.map(|sum| share * sum);
            cell.brightness *= share;
            cell.energy *= share;
        }
        Self { across, down, cells }
    }

    /// The cells at least `border` cells from the edge: row, column, and the cell.
    pub(crate) fn inner(&self, border: usize) -> impl Iterator<Item = (usize, usize, &Histogram)> {
        let rows = border..self.down - border;
        let places = rows.flat_map(move |y| (border..self.across - border).map(move |x| (y, x)));
        places.filter_map(|(y, x)| Some((y, x, self.cells.get(y * self.across + x)?)))
    }

    /// Features of those cells: eight gradients clockwise from the right, relative to the local contrast; brightness in
    /// deviations from the mean; and the features that `more` appends.
    pub(crate) fn bytes(&self, border: usize, more: impl Fn(&Histogram, &mut Vec<u8>)) -> Vec<u8> {
        let bright = || self.inner(border).map(|(_, _, cell)| cell.brightness);
        let count = ((self.down - 2 * border) * (self.across - 2 * border)) as f32;
        let mean = bright().sum::<f32>() / count;
        let spread = bright().map(|value| (value - mean).powi(2)).sum::<f32>() / count;
        let spread = spread.sqrt() + FLOOR;
        let mut bytes = Vec::new();
        for (row, column, cell) in self.inner(border) {
            let contrast = self.contrast(row, column);
            bytes.extend(cell.slopes.iter().map(|slope| byte(SLOPE_BYTES * slope / contrast)));
            bytes.push(byte(MIDDLE + BRIGHT_BYTES * (cell.brightness - mean) / spread));
            more(cell, &mut bytes);
        }
        bytes
    }

    /// Contrast over a cell and its neighbours, weighted 1, 2, 1 both ways; beyond the border the border repeats.
    fn contrast(&self, row: usize, column: usize) -> f32 {
        let energy = |y: usize, x: usize| {
            let (y, x) = (y.clamp(1, self.down) - 1, x.clamp(1, self.across) - 1);
            self.cells.get(y * self.across + x).map_or(0.0, |cell| cell.energy)
        };
        let near = |d: usize| if d == 1 { 2.0 } else { 1.0 };
        let around: f32 = (0..3)
            .flat_map(|dy| (0..3).map(move |dx| (dy, dx)))
            .map(|(dy, dx)| near(dy) * near(dx) * energy(row + dy, column + dx))
            .sum();
        (around / 16.0).sqrt() + FLOOR
    }
}
