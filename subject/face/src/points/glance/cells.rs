//! How the whole crop looks: slopes by direction and brightness of its cells, in a byte each.

use crate::Plane;
use crate::points::crop::{HEIGHT, WIDTH};
use crate::slopes::{WAYS, ways};

/// Pixels of the halved crop along the side of a cell: 0.27 of the eyes' distance.
const CELL: usize = 8;
const WIDE: usize = WIDTH / 2 / CELL;
const HIGH: usize = HEIGHT / 2 / CELL;
const PER_CELL: usize = WAYS + 1;
/// Bytes of the look of a crop.
pub const CELLS_LOOK: usize = WIDE * HIGH * PER_CELL;
/// Contrast that is noise, in roots of grey levels: added before it is divided by.
pub(super) const FLOOR: f32 = 0.25;
/// Bytes of a slope as steep as the contrast around, and of a standard deviation of brightness.
pub(super) const SLOPE_BYTES: f32 = 128.0;
const BRIGHT_BYTES: f32 = 40.0;
const MIDDLE: f32 = 128.0;

/// Sums over a cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    slopes: [f32; WAYS],
    brightness: f32,
    energy: f32,
}

/// Row by row, cell by cell: eight slopes from the right on clockwise, brightness.
pub(super) fn look(roots: &Plane) -> Vec<u8> {
    let mut cells = [[Cell::default(); WIDE]; HIGH];
    for (y, row) in cells.iter_mut().enumerate() {
        for (x, cell) in row.iter_mut().enumerate() {
            *cell = pooled(roots, x * CELL, y * CELL);
        }
    }
    let all = || cells.iter().flatten();
    let count = (WIDE * HIGH) as f32;
    let mean = all().map(|cell| cell.brightness).sum::<f32>() / count;
    let spread = all().map(|cell| (cell.brightness - mean).powi(2)).sum::<f32>() / count;
    let spread = spread.sqrt() + FLOOR;
    let energy = |y: usize, x: usize| {
        // Beside the border is what lies at it.
        let (y, x) = (y.clamp(1, HIGH) - 1, x.clamp(1, WIDE) - 1);
        cells.get(y).and_then(|row| row.get(x)).map_or(0.0, |cell| cell.energy)
    };
    let mut out = Vec::with_capacity(CELLS_LOOK);
    for (y, row) in cells.iter().enumerate() {
        for (x, cell) in row.iter().enumerate() {
            // By 1, 2, 1 both ways.
            let near = |d: usize| if d == 1 { 2.0 } else { 1.0 };
            let around: f32 = (0..3)
                .flat_map(|dy| (0..3).map(move |dx| (dy, dx)))
                .map(|(dy, dx)| near(dy) * near(dx) * energy(y + dy, x + dx))
                .sum();
            let contrast = (around / 16.0).sqrt() + FLOOR;
            out.extend(cell.slopes.iter().map(|sum| byte(SLOPE_BYTES * sum / contrast)));
            out.push(byte(MIDDLE + BRIGHT_BYTES * (cell.brightness - mean) / spread));
        }
    }
    out
}

pub(super) fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// The cell whose upper left pixel that is: means over its pixels.
fn pooled(roots: &Plane, left: usize, top: usize) -> Cell {
    let mut cell = Cell::default();
    let share = 1.0 / (CELL * CELL) as f32;
    for y in top..top + CELL {
        for x in left..left + CELL {
            let (dx, dy) = slope(roots, x as isize, y as isize);
            for (way, by) in ways(dx, dy) {
                if let Some(sum) = cell.slopes.get_mut(way) {
                    *sum += share * by;
                }
            }
            cell.energy += share * (dx * dx + dy * dy);
            cell.brightness += share * roots.get(x as isize, y as isize);
        }
    }
    cell
}

/// To the right and down, over two pixels.
pub(super) fn slope(roots: &Plane, x: isize, y: isize) -> (f32, f32) {
    (roots.get(x + 1, y) - roots.get(x - 1, y), roots.get(x, y + 1) - roots.get(x, y - 1))
}
