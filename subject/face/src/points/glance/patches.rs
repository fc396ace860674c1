//! How it looks around landmarks: slopes by direction of four cells around each, in a byte each.

use super::cells::{FLOOR, SLOPE_BYTES, byte, slope};
use super::{TOLD, Told};
use crate::Plane;
use crate::slopes::{WAYS, ways};

/// Pixels of the halved crop along the side of a cell: a fifth of the eyes' distance. A landmark lies where four meet.
const CELL: usize = 6;
const SIDE: usize = 2 * CELL;
const PER_POINT: usize = 4 * WAYS;
/// Beyond that there is nothing else to be seen (pixels of the crop).
const FAR: f64 = 1e4;
/// Bytes of the look of all patches.
pub const PATCHES_LOOK: usize = PER_POINT * TOLD.len();

/// Landmark by landmark, its upper left cell first, then the upper right one: eight slopes from the right on clockwise.
pub(super) fn look(roots: &Plane, told: &Told) -> Vec<u8> {
    told.iter().flat_map(|point| around(roots, *point)).collect()
}

fn around(roots: &Plane, [x, y]: [f64; 2]) -> [u8; PER_POINT] {
    // A pixel of the halved crop lies between two of the crop; what is not a number becomes 0.
    let first = |v: f64| {
        let v = v.clamp(-FAR, FAR);
        (v / 2.0 - 0.25 - (SIDE - 1) as f64 / 2.0).round() as isize
    };
    let (left, top) = (first(x), first(y));
    let mut sums = [0.0_f32; PER_POINT];
    let mut energy = 0.0;
    for row in 0..SIDE {
        for column in 0..SIDE {
            let (x, y) = (left + column as isize, top + row as isize);
            let (dx, dy) = slope(roots, x, y);
            let cell = 2 * (row / CELL) + column / CELL;
            for (way, by) in ways(dx, dy) {
                if let Some(sum) = sums.get_mut(cell * WAYS + way) {
                    *sum += by;
                }
            }
            energy += dx * dx + dy * dy;
        }
    }
    let contrast = (energy / (SIDE * SIDE) as f32).sqrt() + FLOOR;
    sums.map(|sum| byte(SLOPE_BYTES * sum / (CELL * CELL) as f32 / contrast))
}
