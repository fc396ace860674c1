//! How a face looks once it is upright: slopes by direction, brightness and contrast of its cells, in a byte each.

use super::frame::{Frame, length};
use super::octaves::Octaves;
use crate::slopes::{WAYS, ways};

/// Cells along each side, a quarter of the distance of the eyes wide: two and a half distances in all.
const SIDE: usize = 10;
/// Samples along the side of a cell.
const CELL: usize = 4;
/// Cells beyond the border, that contrast is told from.
const AROUND: usize = 1;
const WIDE: usize = SIDE + 2 * AROUND;
const SAMPLES: usize = WIDE * CELL;
/// Where the cells begin, in distances of the eyes from the middle of the eyes.
const LEFT: f32 = -1.25;
const TOP: f32 = -0.75;
/// Between samples, in distances of the eyes.
const STEP: f32 = 1.0 / 16.0;
/// What is told of a cell: its slopes, its brightness, its contrast.
const PER_CELL: usize = WAYS + 2;
/// Numbers of one look.
pub const LOOK: usize = SIDE * SIDE * PER_CELL;
/// Contrast that is noise, in roots of grey levels: added before it is divided by.
const FLOOR: f32 = 0.25;
/// Bytes of a slope as steep as the contrast around, of a standard deviation of brightness, and of twice the contrast.
const SLOPE_BYTES: f32 = 128.0;
const BRIGHT_BYTES: f32 = 40.0;
const CONTRAST_BYTES: f32 = 40.0;
const MIDDLE: f32 = 128.0;

/// [`LOOK`] bytes, and more of a second look: row by row, cell by cell, eight slopes from the right on clockwise, brightness, contrast.
pub type Look = Vec<u8>;

/// Of the face that has this frame on the photograph.
pub(super) fn look(octaves: &Octaves, frame: &Frame) -> Look {
    let shrink = length(frame.down) * STEP;
    let Some((plane, done)) = octaves.at(shrink) else { return Vec::new() };
    let by = 1.0 / done;
    let mut root = [[0.0_f32; SAMPLES]; SAMPLES];
    for (y, row) in root.iter_mut().enumerate() {
        for (x, value) in row.iter_mut().enumerate() {
            let at = |i: usize, from: f32| from + STEP * (i as f32 + 0.5 - (AROUND * CELL) as f32);
            let [px, py] = frame.at(at(x, LEFT), at(y, TOP));
            *value = plane.sample((px + 0.5) * by - 0.5, (py + 0.5) * by - 0.5).max(0.0).sqrt();
        }
    }
    told(&pooled(&root))
}

/// The look of the mirror image.
pub(super) fn mirrored(look: &Look) -> Look {
    let swapped = |cell: &[u8]| -> [u8; PER_CELL] {
        let mut out = [0; PER_CELL];
        for (to, from) in out.iter_mut().zip([4, 3, 2, 1, 0, 7, 6, 5, 8, 9]) {
            *to = cell.get(from).copied().unwrap_or_default();
        }
        out
    };
    look.chunks(SIDE * PER_CELL)
        .flat_map(|row| row.chunks(PER_CELL).rev().flat_map(swapped))
        .collect()
}

/// Sums over a cell: slopes, brightness, squares of slopes.
type Sums = [f32; PER_CELL];

fn pooled(root: &[[f32; SAMPLES]; SAMPLES]) -> [[Sums; WIDE]; WIDE] {
    let mut cells = [[[0.0; PER_CELL]; WIDE]; WIDE];
    for (y, row) in root.iter().enumerate() {
        let upper = root.get(y.saturating_sub(1)).unwrap_or(row);
        let lower = root.get(y + 1).unwrap_or(row);
        for (x, &value) in row.iter().enumerate() {
            let before = row.get(x.saturating_sub(1)).copied().unwrap_or(value);
            let after = row.get(x + 1).copied().unwrap_or(value);
            let of = |line: &[f32; SAMPLES]| line.get(x).copied().unwrap_or(value);
            let (dx, dy) = (after - before, of(lower) - of(upper));
            let Some(cell) = cells.get_mut(y / CELL).and_then(|row| row.get_mut(x / CELL)) else {
                continue;
            };
            let mut add = |i: usize, by: f32| {
                if let Some(sum) = cell.get_mut(i) {
                    *sum += by;
                }
            };
            for (way, by) in ways(dx, dy) {
                add(way, by);
            }
            add(WAYS, value);
            add(WAYS + 1, dx * dx + dy * dy);
        }
    }
    cells
}

/// In the contrast of around, and in bytes.
fn told(cells: &[[Sums; WIDE]; WIDE]) -> Look {
    let samples = (CELL * CELL) as f32;
    let energy = |row: usize, column: usize| {
        cells.get(row).and_then(|row| row.get(column)).map_or(0.0, |cell| cell[WAYS + 1] / samples)
    };
    let inner = || {
        (AROUND..AROUND + SIDE).flat_map(|row| {
            (AROUND..AROUND + SIDE).filter_map(move |column| {
                cells.get(row).and_then(|row| row.get(column)).map(|cell| (row, column, cell))
            })
        })
    };
    let count = (SIDE * SIDE) as f32;
    let bright = |cell: &Sums| cell[WAYS] / samples;
    let mean = inner().map(|(_, _, cell)| bright(cell)).sum::<f32>() / count;
    let spread = inner().map(|(_, _, cell)| (bright(cell) - mean).powi(2)).sum::<f32>() / count;
    let spread = spread.sqrt() + FLOOR;
    let whole = (inner().map(|(row, column, _)| energy(row, column)).sum::<f32>() / count).sqrt();
    let mut out = Vec::with_capacity(LOOK);
    for (row, column, cell) in inner() {
        // By 1, 2, 1 both ways.
        let near = |d: usize| if d == 1 { 2.0 } else { 1.0 };
        let around: f32 = (0..3)
            .flat_map(|dy| (0..3).map(move |dx| (dy, dx)))
            .map(|(dy, dx)| near(dy) * near(dx) * energy(row + dy - 1, column + dx - 1))
            .sum();
        let contrast = (around / 16.0).sqrt() + FLOOR;
        let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
        out.extend(cell.iter().take(WAYS).map(|sum| byte(SLOPE_BYTES * sum / samples / contrast)));
        out.push(byte(MIDDLE + BRIGHT_BYTES * (bright(cell) - mean) / spread));
        let own = energy(row, column).sqrt() + FLOOR;
        out.push(byte(MIDDLE + CONTRAST_BYTES * (own / (whole + FLOOR)).log2()));
    }
    out
}
