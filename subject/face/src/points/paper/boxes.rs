//! The boxes that the template fixes (Yang et al. 2004, section 3), in the upright crop, and what is counted in them.

use crate::Plane;
use crate::points::crop::EYE_DISTANCE;
use crate::points::search::Point;

/// A rectangle of the crop (pixels), its right and bottom just outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) left: i32,
    pub(crate) top: i32,
    pub(crate) right: i32,
    pub(crate) bottom: i32,
}

impl Bounds {
    /// Around `at`: so far to both sides, up and down, in eye distances.
    pub(crate) fn around(at: Point, side: f64, up: f64, down: f64) -> Bounds {
        let px = |v: f64| v.round().clamp(-1e4, 1e4) as i32;
        Bounds {
            left: px(at[0] - side * EYE_DISTANCE),
            top: px(at[1] - up * EYE_DISTANCE),
            right: px(at[0] + side * EYE_DISTANCE) + 1,
            bottom: px(at[1] + down * EYE_DISTANCE) + 1,
        }
    }

    /// An eye with its brow: half of the box above the middle between the two, half below.
    pub(crate) fn eye(centre: Point) -> Bounds {
        Bounds::around(centre, 0.40, 0.62, 0.27)
    }

    /// The mouth.
    pub(crate) fn mouth(centre: Point) -> Bounds {
        Bounds::around(centre, 0.62, 0.30, 0.36)
    }

    /// The nose, between eyes and mouth.
    pub(crate) fn nose(eyes: Point, mouth: Point) -> Bounds {
        let middle = [(eyes[0] + mouth[0]) / 2.0, eyes[1]];
        let height = ((mouth[1] - eyes[1]) / EYE_DISTANCE).max(0.4);
        Bounds::around(middle, 0.36, -0.25 * height, 0.78 * height)
    }

    pub(crate) fn upper_half(self) -> Bounds {
        Bounds { bottom: (self.top + self.bottom) / 2, ..self }
    }

    pub(crate) fn lower_half(self) -> Bounds {
        Bounds { top: (self.top + self.bottom) / 2, ..self }
    }

    pub(crate) fn holds(self, x: i32, y: i32) -> bool {
        (self.left..self.right).contains(&x) && (self.top..self.bottom).contains(&y)
    }

    pub(crate) fn pixels(self) -> impl Iterator<Item = (i32, i32)> {
        (self.top..self.bottom).flat_map(move |y| (self.left..self.right).map(move |x| (x, y)))
    }
}

/// A pixel's value.
pub(crate) fn value(plane: &Plane, x: i32, y: i32) -> f64 {
    f64::from(plane.get(x as isize, y as isize))
}

/// Projection onto the columns: the mean of each.
pub(crate) fn columns(plane: &Plane, b: Bounds) -> Vec<f64> {
    let n = f64::from((b.bottom - b.top).max(1));
    (b.left..b.right)
        .map(|x| (b.top..b.bottom).map(|y| value(plane, x, y)).sum::<f64>() / n)
        .collect()
}

/// Projection onto the rows: the mean of each.
pub(crate) fn rows(plane: &Plane, b: Bounds) -> Vec<f64> {
    let n = f64::from((b.right - b.left).max(1));
    (b.top..b.bottom)
        .map(|y| (b.left..b.right).map(|x| value(plane, x, y)).sum::<f64>() / n)
        .collect()
}

/// The pixels of `bounds` that hang together with `seed` (by their sides) and are `like` it.
pub(crate) fn grow(
    bounds: Bounds,
    seed: (i32, i32),
    like: impl Fn(i32, i32) -> bool,
) -> Vec<(i32, i32)> {
    let width = (bounds.right - bounds.left).max(0);
    let index = |x: i32, y: i32| ((y - bounds.top) * width + (x - bounds.left)) as usize;
    let mut seen = vec![false; (width * (bounds.bottom - bounds.top).max(0)) as usize];
    let mut region = Vec::new();
    let mut open = vec![seed];
    while let Some((x, y)) = open.pop() {
        if !bounds.holds(x, y) || !like(x, y) {
            continue;
        }
        match seen.get_mut(index(x, y)) {
            Some(seen) if !*seen => *seen = true,
            _ => continue,
        }
        region.push((x, y));
        open.extend([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]);
    }
    region
}

/// The parabola through three points with different x, at `x`; `b`'s height where they are in one column.
pub(crate) fn parabola(a: Point, b: Point, c: Point, x: f64) -> f64 {
    let term = |p: Point, q: Point, r: Point| {
        let d = (p[0] - q[0]) * (p[0] - r[0]);
        (d.abs() > 1e-9).then(|| p[1] * (x - q[0]) * (x - r[0]) / d)
    };
    match (term(a, b, c), term(b, a, c), term(c, a, b)) {
        (Some(u), Some(v), Some(w)) => u + v + w,
        _ => b[1],
    }
}
