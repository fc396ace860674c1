//! Arithmetic that gives the same bits on every machine and in every version: vectors, a sine, keyframed curves and
//! random numbers.
//!
//! The generator is xoshiro256++ (Blackman and Vigna, "Scrambled linear pseudorandom number generators", ACM TOMS 47(4),
//! 2021), its state filled by `SplitMix64` (Steele, Lea and Flood, OOPSLA 2014), as its authors advise.

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

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Rng {
    state: [u64; 4],
}

fn splitmix64(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Rng {
    /// The stream of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut s = seed;
        Self { state: std::array::from_fn(|_| splitmix64(&mut s)) }
    }

    /// One of many independent streams of a seed, so that a marker's noise does not change when markers are added.
    #[must_use]
    pub fn stream(seed: u64, index: u64) -> Self {
        let mut s = index.wrapping_add(0x5851_f42d_4c95_7f2d);
        Self::new(seed ^ splitmix64(&mut s))
    }

    /// 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        let [s0, s1, s2, s3] = &mut self.state;
        let result = s0.wrapping_add(*s3).rotate_left(23).wrapping_add(*s0);
        let t = *s1 << 17;
        *s2 ^= *s0;
        *s3 ^= *s1;
        *s1 ^= *s2;
        *s0 ^= *s3;
        *s2 ^= t;
        *s3 = s3.rotate_left(45);
        result
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A number from 0 to `n - 1`; 0 if `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n.saturating_sub(1))
    }

    /// Uniform between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Mean 0, variance 1, nearly normal: the sum of 12 uniforms less 6 (Irwin 1927; Hall 1927).
    ///
    /// It needs no logarithm, whose last bit differs between C libraries. The tails end at 6 sigma.
    pub fn normal(&mut self) -> f64 {
        let mut sum = 0u64;
        for _ in 0..3 {
            let bits = self.next_u64();
            sum += (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        }
        // Each of the 12 parts represents the middle of its bin of 1/65536, which adds 12 / 2 = 6.
        (sum as f64 + 6.0) / 65536.0 - 6.0
    }
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

    #[test]
    fn first_numbers_of_the_published_algorithm() {
        // State 1 2 3 4, computed by hand from the paper's definition: rotl(1 + 4, 23) + 1.
        let mut rng = Rng { state: [1, 2, 3, 4] };
        assert_eq!(rng.next_u64(), (5 << 23) + 1);
        assert_eq!(rng.next_u64(), 58_720_359);
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let mut rng = Rng::new(7);
        let n = 200_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            let v = rng.normal();
            sum += v;
            squares += v * v;
        }
        let mean = sum / f64::from(n);
        let variance = squares / f64::from(n) - mean * mean;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.015, "{mean} {variance}");
    }
}
