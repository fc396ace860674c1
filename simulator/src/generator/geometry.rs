//! Vectors, a sine that gives the same bits on every machine, and keyframed curves.

/// A point or direction: x forward, y left, z up; metres.
pub(super) type V3 = [f64; 3];

pub(super) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn scale(a: V3, k: f64) -> V3 {
    [a[0] * k, a[1] * k, a[2] * k]
}

pub(super) fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn norm(a: V3) -> f64 {
    dot(a, a).sqrt()
}

/// Scales a vector to unit length; a zero vector stays zero.
pub(super) fn unit(a: V3) -> V3 {
    let n = norm(a);
    if n > 0.0 { scale(a, 1.0 / n) } else { a }
}

/// `at` plus weighted axes.
pub(super) fn offset(at: V3, axes: [V3; 3], weights: V3) -> V3 {
    let [x, y, z] = std::array::from_fn(|i| scale(axes[i], weights[i]));
    add(add(add(at, x), y), z)
}

/// Sine and cosine of an angle in radians, within 1e-15 for angles below 1000.
///
/// Those of the C library differ in the last bit from version to version. This one uses only + - *, which round alike
/// everywhere.
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    const HALF_PI_HIGH: f64 = std::f64::consts::FRAC_PI_2;
    /// pi / 2 minus its nearest f64.
    const HALF_PI_LOW: f64 = 6.123_233_995_736_766e-17;
    let quadrant = (angle / HALF_PI_HIGH).round();
    let x = (angle - quadrant * HALF_PI_HIGH) - quadrant * HALF_PI_LOW;
    let x2 = x * x;
    // Taylor series: for |x| <= pi / 4 the first omitted term is below 1e-17.
    let (mut sin, mut cos) = (0.0, 0.0);
    for k in (1..=8u32).rev() {
        let k = f64::from(k);
        sin = -x2 / ((2.0 * k) * (2.0 * k + 1.0)) * (1.0 + sin);
        cos = -x2 / ((2.0 * k) * (2.0 * k - 1.0)) * (1.0 + cos);
    }
    let (sin, cos) = (x * (1.0 + sin), 1.0 + cos);
    match quadrant.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// The polynomial of lowest degree from 0 to 1 with zero velocity and acceleration at its ends; constant outside 0..1.
///
/// It is also the minimum-jerk path between two rests (Flash and Hogan, J. Neurosci. 5(7), 1985, eq. 3).
pub(super) fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

// Keyframed curves: quintic segments that meet with equal value, velocity and acceleration.

/// Value, velocity and acceleration of a curve at one time, in the curve's own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Keyframe {
    pub(super) time_s: f64,
    pub(super) value: f64,
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
}

/// A curve through keyframes: twice continuously differentiable, constant before the first and after the last.
#[derive(Debug, Clone, Default)]
pub(super) struct Curve {
    keyframes: Vec<Keyframe>,
}

impl Curve {
    /// Creates a curve with one keyframe at rest.
    pub(super) fn resting(time_s: f64, value: f64) -> Self {
        let mut curve = Self::default();
        curve.rest(time_s, value);
        curve
    }

    /// Appends a keyframe at rest.
    pub(super) fn rest(&mut self, time_s: f64, value: f64) {
        self.pass(Keyframe { time_s, value, velocity: 0.0, acceleration: 0.0 });
    }

    /// Appends a keyframe in motion. Times must ascend: a keyframe before the last one moves to just after it.
    pub(super) fn pass(&mut self, mut keyframe: Keyframe) {
        if let Some(last) = self.keyframes.last() {
            keyframe.time_s = keyframe.time_s.max(last.time_s + 1e-3);
        }
        self.keyframes.push(keyframe);
    }

    /// The curve's value at a time.
    pub(super) fn at(&self, time_s: f64) -> f64 {
        let next = self.keyframes.partition_point(|k| k.time_s <= time_s);
        match (next.checked_sub(1).and_then(|i| self.keyframes.get(i)), self.keyframes.get(next)) {
            (Some(a), Some(b)) => quintic(a, b, time_s),
            (Some(k), None) | (None, Some(k)) => k.value,
            (None, None) => 0.0,
        }
    }
}

/// The quintic Hermite segment between two keyframes.
fn quintic(a: &Keyframe, b: &Keyframe, time_s: f64) -> f64 {
    let h = b.time_s - a.time_s;
    let x = (time_s - a.time_s) / h;
    let (va, vb) = (a.velocity * h, b.velocity * h);
    let (aa, ab) = (a.acceleration * h * h, b.acceleration * h * h);
    let d = b.value - a.value;
    let c2 = 0.5 * aa;
    let c3 = 10.0 * d - 6.0 * va - 4.0 * vb - 1.5 * aa + 0.5 * ab;
    let c4 = -15.0 * d + 8.0 * va + 7.0 * vb + 1.5 * aa - ab;
    let c5 = 6.0 * d - 3.0 * va - 3.0 * vb - 0.5 * aa + 0.5 * ab;
    a.value + x * (va + x * (c2 + x * (c3 + x * (c4 + x * c5))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_agrees_with_the_c_library() {
        for i in -4000..4000 {
            let x = f64::from(i) * 0.013_7;
            let (s, c) = sin_cos(x);
            assert!((s - x.sin()).abs() < 1e-14 && (c - x.cos()).abs() < 1e-14, "{x}");
        }
    }

    #[test]
    fn curves_match_keyframes_and_their_derivatives() {
        let mut curve = Curve::resting(0.0, 1.0);
        curve.pass(Keyframe { time_s: 0.5, value: 2.0, velocity: 3.0, acceleration: -9.81 });
        curve.rest(1.25, 0.5);
        let e = 1e-4;
        for side in [-1.0, 1.0] {
            let (y0, y1, y2) =
                (curve.at(0.5), curve.at(0.5 + side * e), curve.at(0.5 + 2.0 * side * e));
            let velocity = side * (4.0 * y1 - 3.0 * y0 - y2) / (2.0 * e);
            let acceleration = (y2 - 2.0 * y1 + y0) / (e * e);
            assert!((y0 - 2.0).abs() < 1e-12);
            assert!((velocity - 3.0).abs() < 1e-3, "{velocity}");
            assert!((acceleration + 9.81).abs() < 0.1, "{acceleration}");
        }
        assert_eq!(curve.at(-1.0), 1.0);
        assert_eq!(curve.at(9.0), 0.5);
    }
}
