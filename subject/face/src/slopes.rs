//! Slopes of brightness by their direction.

/// Directions, 45 degrees apart: from the right on clockwise.
pub(crate) const WAYS: usize = 8;

/// A slope is the sum of its parts along the two nearest of eight directions: which ones, and how much.
pub(crate) fn ways(dx: f32, dy: f32) -> [(usize, f32); 2] {
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
