//! Points and directions of a picture: x to the right, y down.

/// A point, in pixels or another unit of the picture.
pub(crate) type Point = [f64; 2];

pub(crate) fn middle(a: Point, b: Point) -> Point {
    [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]
}

/// The mean; the origin if there are no points.
pub(crate) fn mean(points: impl IntoIterator<Item = Point>) -> Point {
    let (mut sum, mut n) = ([0.0; 2], 0.0_f64);
    for [x, y] in points {
        sum = [sum[0] + x, sum[1] + y];
        n += 1.0;
    }
    sum.map(|sum| sum / n.max(1.0))
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// `p + k n`.
pub(crate) fn along(p: Point, n: Point, k: f64) -> Point {
    [p[0] + k * n[0], p[1] + k * n[1]]
}

/// Unit vector from `a` to `b`; to the right if they coincide.
pub(crate) fn direction(a: Point, b: Point) -> Point {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let l = (x * x + y * y).sqrt();
    if l > 1e-9 { [x / l, y / l] } else { [1.0, 0.0] }
}

/// The upward normal of a unit vector that points to the right.
pub(crate) fn up(d: Point) -> Point {
    [d[1], -d[0]]
}

/// The point at `t` (0 to 1) of the cubic through four points at equal parameter steps.
#[inline]
pub(crate) fn cubic(p: [Point; 4], t: f64) -> Point {
    let u = 3.0 * t;
    let w = [
        -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        -u * (u - 1.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    ];
    p.iter().zip(w).fold([0.0; 2], |q, (p, w)| [q[0] + w * p[0], q[1] + w * p[1]])
}

/// Minimum and maximum; infinities if there are no values.
pub(crate) fn extent(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    values.into_iter().fold(none, |(low, high), v| (low.min(v), high.max(v)))
}
