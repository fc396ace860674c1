//! From which rows a row is interpolated, and where it is expected.
//!
//! The polynomial through two rows on either side (Lagrange), which on even spacing is
//! (-1, 9, 9, -1)/16. Near the ends of a run the spacing is uneven, or there is one row less.

use super::lattice::Point;

/// Fraction bits of a tap weight.
const WEIGHT_BITS: u32 = 16;

/// A row and its neighbours, as indices into the channel's points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    /// The row.
    pub(super) at: usize,
    /// The stride of its level.
    pub(super) stride: usize,
    /// The nearest decoded row before it.
    pub(super) left: usize,
    /// The nearest decoded row after it.
    pub(super) right: usize,
    outer_right: Option<usize>,
    outer_left: Option<usize>,
}

/// Where a row is expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    /// The interpolation.
    pub(super) point: Point,
    /// How far it lies from the chord of the two near neighbours, in units.
    pub(super) off: Point,
}

impl Site {
    /// Row `at` of a level in a run of which the rows from `start` to `zero` and the row `end` are decoded.
    pub(super) fn new(at: usize, stride: usize, (start, zero, end): (usize, usize, usize)) -> Self {
        let left = (at - stride).max(zero);
        let right = (at + stride).min(end);
        let outer_right = Some((at + 3 * stride).min(end)).filter(|&row| row > right);
        let outer_left = match at.checked_sub(3 * stride).filter(|&row| row >= start) {
            Some(row) => Some(row),
            None if left == zero => Some(zero.saturating_sub(2 * stride).max(start)),
            None => None,
        };
        let outer_left = outer_left.filter(|&row| row < left);
        Self { at, stride, left, right, outer_right, outer_left }
    }

    fn is_even(&self) -> bool {
        self.left + self.stride == self.at
            && self.right == self.at + self.stride
            && self.outer_right == Some(self.at + 3 * self.stride)
            && self.outer_left == self.at.checked_sub(3 * self.stride)
    }

    /// Interpolates.
    pub(super) fn expect(&self, points: impl Fn(usize) -> Point) -> Expected {
        let (base, far) = (points(self.left), points(self.right));
        let mut curve = [0; 3];
        if let (true, Some(right), Some(left)) = (self.is_even(), self.outer_right, self.outer_left)
        {
            let (right, left) = (points(right), points(left));
            for axis in 0..3 {
                let near = far[axis].wrapping_sub(base[axis]).wrapping_mul(9);
                let outer = right[axis].wrapping_sub(base[axis]).wrapping_add(left[axis]);
                let sum = near.wrapping_sub(outer.wrapping_sub(base[axis]));
                curve[axis] = sum.wrapping_add(8) >> 4;
            }
        } else {
            curve = self.lagrange(&points);
        }
        self.describe(base, far, curve)
    }

    /// Distance of the polynomial from the left neighbour, weights in 2^-16 rounded half up.
    fn lagrange(&self, points: &impl Fn(usize) -> Point) -> Point {
        let base = points(self.left);
        let nodes = [Some(self.left), Some(self.right), self.outer_right, self.outer_left];
        let mut sum = [1_i64 << (WEIGHT_BITS - 1); 3];
        for node in nodes.into_iter().skip(1).flatten() {
            let (mut numerator, mut denominator) = (1_i64 << WEIGHT_BITS, 1_i64);
            for other in nodes.into_iter().flatten().filter(|&other| other != node) {
                numerator *= self.at as i64 - other as i64;
                denominator *= node as i64 - other as i64;
            }
            if denominator < 0 {
                (numerator, denominator) = (-numerator, -denominator);
            }
            let weight = (2 * numerator + denominator).div_euclid(2 * denominator);
            let point = points(node);
            for axis in 0..3 {
                let off = point[axis].wrapping_sub(base[axis]);
                sum[axis] = sum[axis].wrapping_add(off.wrapping_mul(weight));
            }
        }
        sum.map(|sum| sum >> WEIGHT_BITS)
    }

    fn describe(&self, base: Point, far: Point, curve: Point) -> Expected {
        let (before, whole) = ((self.at - self.left) as i64, (self.right - self.left) as i64);
        let (mut point, mut off) = (base, curve);
        for axis in 0..3 {
            point[axis] = base[axis].wrapping_add(curve[axis]);
            let across = far[axis].wrapping_sub(base[axis]);
            let chord = match whole == 2 * before {
                true => across >> 1,
                false => across.wrapping_mul(before).div_euclid(whole),
            };
            off[axis] = curve[axis].wrapping_sub(chord);
        }
        Expected { point, off }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(row: usize) -> Point {
        let t = row as i64 - 40;
        [t * t * t * 64, t * t * 1024 - 7, 300 * t]
    }

    #[test]
    fn cubics_are_met_wherever_four_rows_are_known() {
        let points: Vec<Point> = (0..200).map(cubic).collect();
        for (start, zero, end) in [(0, 64, 128), (60, 64, 128), (64, 64, 128), (0, 70, 97)] {
            for stride in [1, 2, 4, 8, 16, 32] {
                for at in (64 + stride..end).step_by(2 * stride).filter(|&at| at > zero) {
                    let site = Site::new(at, stride, (start, zero, end));
                    if site.outer_left.is_none() || site.outer_right.is_none() {
                        continue;
                    }
                    let expected = site.expect(|row| points[row]).point;
                    for axis in 0..3 {
                        let off = (expected[axis] - points[at][axis]).abs();
                        // A weight is off by at most 2^-17.
                        let scale = points.iter().map(|p| p[axis].abs()).max().unwrap();
                        assert!(off <= 1 + scale / (1 << 14), "{site:?} axis {axis}: {off}");
                    }
                }
            }
        }
    }

    #[test]
    fn even_spacing_is_the_four_point_rule() {
        let mut points = vec![[0; 3]; 33];
        points[16] = [160, 0, 0];
        let weight = |at| Site::new(at, 2, (0, 8, 32)).expect(|row| points[row]).point[0];
        assert_eq!((weight(10), weight(14), weight(18), weight(22)), (-10, 90, 90, -10));
    }
}
