//! Poses of rigid bodies in sampled channels, within a bound of the position's and of the angle's error.
//!
//! A body has [`POSE_CHANNELS`] channels: x y z in millimetres, the unit quaternion w x y z, and a residual in
//! millimetres. Numbers are rounded to lattices whose steps follow from the bounds; the blocks of [`sampled`](crate::sampled)
//! then code them without loss. `docs/poses.md` has the proof, and every pose is measured: one that a lattice does not
//! hold within the bound keeps its numbers.

use crate::{CodecError, GROUP_CHANNELS, Tolerance};

/// Channels of a body.
pub const POSE_CHANNELS: usize = 8;

/// Bodies of a group.
pub const GROUP_BODIES: usize = GROUP_CHANNELS / POSE_CHANNELS;

/// The numbers of a body in a row, in the order of its channels.
pub type PoseRow = [f32; POSE_CHANNELS];

/// The distance from a body's origin at which a rotation by the default bound of the angle moves a point by the bound of
/// the position: that of the markers of a tool, or the half length of a limb's segment.
pub const LEVER_MM: f64 = 200.0;

/// Smallest and largest bound of the angle, in degrees. Below, float32 is too coarse; above, the series of this file are.
pub const ANGLE_DEGREES: std::ops::RangeInclusive<f64> = 1e-4..=10.0;

/// Half the distance of float32 numbers at 8 m, in millimetres: the largest rounding of a coordinate of the lattice.
const COORDINATE_ROUNDING_MM: f64 = 1.0 / 4096.0;

/// Largest rounding of a quaternion: half the distance of float32 numbers below 1 in each of four numbers, when it is put
/// on the lattice and once more when it is scaled to a length of 1.
const QUATERNION_ROUNDING: f64 = 1.0 / 8_388_608.0;

/// Distance between residuals, in millimetres: the largest power of two that is not above the link's unit for residuals of
/// markers, 0.01 mm.
const RESIDUAL_STEP_MM: f64 = 1.0 / 128.0;

/// Largest error of residuals, in millimetres. Those that are beyond the lattice keep their numbers.
pub const RESIDUAL_ERROR_MM: f64 = RESIDUAL_STEP_MM / 2.0;

/// The largest error of poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseBounds {
    position_mm: f64,
    angle_degrees: f64,
}

impl PoseBounds {
    /// A bound of the distance between positions, and one of the angle between rotations.
    ///
    /// # Errors
    /// `InvalidArgument` for an angle outside [`ANGLE_DEGREES`].
    pub fn new(position: Tolerance, angle_degrees: f64) -> Result<Self, CodecError> {
        if !ANGLE_DEGREES.contains(&angle_degrees) {
            return Err(CodecError::InvalidArgument(format!(
                "an angle tolerance of {angle_degrees} degrees: give one from {} to {} degrees",
                ANGLE_DEGREES.start(),
                ANGLE_DEGREES.end()
            )));
        }
        Ok(Self { position_mm: position.mm(), angle_degrees })
    }

    /// The bounds for a recording with this tolerance: the angle is the one that moves a point [`LEVER_MM`] from the
    /// body's origin by the tolerance, within the range of angles.
    #[must_use]
    pub fn of_tolerance(position: Tolerance) -> Self {
        // The chord of the angle on a circle of this radius is 2 r sin(angle / 2).
        let sine = (position.mm() / (2.0 * LEVER_MM)).min(0.1);
        let degrees = (2.0 * arc_sine(sine)).to_degrees();
        let angle_degrees = degrees.clamp(*ANGLE_DEGREES.start(), *ANGLE_DEGREES.end());
        Self { position_mm: position.mm(), angle_degrees }
    }

    /// Largest distance between a position and its reconstruction, in millimetres.
    #[must_use]
    pub fn position_mm(&self) -> f64 {
        self.position_mm
    }

    /// Largest angle between a rotation and its reconstruction, in degrees.
    #[must_use]
    pub fn angle_degrees(&self) -> f64 {
        self.angle_degrees
    }

    /// Distance of neighbouring coordinates on the lattice, in millimetres: half a diagonal of its cells is the bound. 0
    /// if float32 is too coarse for one.
    fn coordinate_step_mm(&self) -> f64 {
        let step = 2.0 * (self.position_mm / 3.0_f64.sqrt() - COORDINATE_ROUNDING_MM);
        if step > 2.0 * COORDINATE_ROUNDING_MM { few_bits(step) } else { 0.0 }
    }

    /// Distance of neighbouring numbers of quaternions on the lattice. Half a diagonal of its cells, in four dimensions,
    /// is one step; a quaternion that is moved by e and then scaled to a length of 1 turns by at most arcsin(e), and its
    /// rotation by twice that.
    fn quaternion_step(&self) -> f64 {
        few_bits(sine(self.angle_degrees.to_radians() / 2.0) - QUATERNION_ROUNDING)
    }
}

/// The largest number of at most eight significant bits that is not above this one. Its multiples by up to 2^16 are
/// float32 numbers, so that rounding does not add to their error.
fn few_bits(x: f64) -> f64 {
    f64::from_bits(x.to_bits() >> 45 << 45)
}

/// The sine of an angle of at most 5 degrees: libraries round it differently. The next term is below 1e-19.
fn sine(x: f64) -> f64 {
    let square = x * x;
    x * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))))
}

/// The arcsine of a number of at most 0.1; the next term is below 1e-14 of it.
fn arc_sine(x: f64) -> f64 {
    let square = x * x;
    let terms = 35.0 / 1152.0 + square * (63.0 / 2816.0 + square * (231.0 / 13312.0));
    x * (1.0
        + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * (15.0 / 336.0 + square * terms))))
}

/// The largest errors of poses, as measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseErrors {
    /// Largest distance between a position and its reconstruction, in millimetres.
    pub position_mm: f64,
    /// Largest angle between a rotation and its reconstruction, in degrees.
    pub angle_degrees: f64,
}

impl PoseErrors {
    /// Takes the larger of each.
    pub fn add(&mut self, other: &Self) {
        self.position_mm = self.position_mm.max(other.position_mm);
        self.angle_degrees = self.angle_degrees.max(other.angle_degrees);
    }
}

/// The numbers of a body without a pose: NaN, whose lowest bits have a code that says why.
#[must_use]
pub fn without_pose(code: u8) -> PoseRow {
    [f32::from_bits(NO_POSE | u32::from(code)); POSE_CHANNELS]
}

/// The code of a row without a pose; `None` if it has one, or if its numbers say nothing.
#[must_use]
pub fn code_without_pose(row: &PoseRow) -> Option<u8> {
    let code = (row[0].to_bits() & 0xff) as u8;
    row.iter().all(|number| number.to_bits() == NO_POSE | u32::from(code)).then_some(code)
}

/// The bits of a quiet NaN.
const NO_POSE: u32 = 0x7fc0_0000;

/// Whether a row has a pose.
#[must_use]
pub fn has_pose(row: &PoseRow) -> bool {
    row[..7].iter().all(|number| number.is_finite())
}

/// A quaternion scaled to a length of 1, as readers of poses within bounds have it.
#[must_use]
pub fn unit([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let [w, x, y, z] = [w, x, y, z].map(f64::from);
    let length = ((w * w + x * x) + (y * y + z * z)).sqrt();
    [w, x, y, z].map(|number| (number / length) as f32)
}

/// Rounds the poses of one body, one row after another.
#[derive(Debug, Clone)]
pub struct PoseQuantiser {
    bounds: PoseBounds,
    coordinate_step_mm: f64,
    quaternion_step: f64,
    /// The last quaternion, which the next one continues; zeros before the first.
    last: [f64; 4],
    errors: PoseErrors,
}

impl PoseQuantiser {
    /// Begins without a pose.
    #[must_use]
    pub fn new(bounds: PoseBounds) -> Self {
        Self {
            bounds,
            coordinate_step_mm: bounds.coordinate_step_mm(),
            quaternion_step: bounds.quaternion_step(),
            last: [0.0; 4],
            errors: PoseErrors::default(),
        }
    }

    /// The largest errors since they were last taken.
    pub fn take_errors(&mut self) -> PoseErrors {
        std::mem::take(&mut self.errors)
    }

    /// Rounds the numbers of a row. One without a pose stays as it is.
    pub fn round(&mut self, row: &mut PoseRow) {
        if !has_pose(row) {
            return;
        }
        let [x, y, z, qw, qx, qy, qz, residual] = *row;
        let ([x, y, z], position_mm) = self.position([x, y, z]);
        let ([qw, qx, qy, qz], angle) = self.quaternion([qw, qx, qy, qz]);
        let mut rounded = [x, y, z, qw, qx, qy, qz, residual];
        let lattice = on_lattice(residual.into(), RESIDUAL_STEP_MM);
        if (f64::from(lattice) - f64::from(residual)).abs() <= RESIDUAL_ERROR_MM {
            rounded[7] = lattice;
        }
        self.errors.add(&PoseErrors { position_mm, angle_degrees: angle.to_degrees() });
        *row = rounded;
    }

    fn position(&self, position_mm: [f32; 3]) -> ([f32; 3], f64) {
        if self.coordinate_step_mm > 0.0 {
            let rounded = position_mm.map(|x| on_lattice(x.into(), self.coordinate_step_mm));
            let [x, y, z] =
                std::array::from_fn(|i| f64::from(rounded[i]) - f64::from(position_mm[i]));
            let error_mm = (x * x + y * y + z * z).sqrt();
            if error_mm <= self.bounds.position_mm {
                return (rounded, error_mm);
            }
        }
        (position_mm, 0.0)
    }

    /// Returns also the angle of the error in radians.
    fn quaternion(&mut self, quaternion: [f32; 4]) -> ([f32; 4], f64) {
        let [w, x, y, z] = quaternion.map(f64::from);
        let length = ((w * w + x * x) + (y * y + z * z)).sqrt();
        if !(length > 0.0 && length.is_finite()) {
            return (quaternion, 0.0);
        }
        let mut exact = [w / length, x / length, y / length, z / length];
        if is_opposite(&exact, &self.last) {
            exact = exact.map(|number| -number);
        }
        self.last = exact;
        let rounded = exact.map(|number| on_lattice(number, self.quaternion_step));
        let angle = angle(&exact, unit(rounded));
        if angle <= self.bounds.angle_degrees.to_radians() {
            return (rounded, angle);
        }
        let kept = exact.map(|number| number as f32);
        (kept, self::angle(&exact, unit(kept)))
    }
}

/// Whether the negative of a quaternion continues the last one. Before the first, the one whose first number that is not
/// zero is positive does.
fn is_opposite(quaternion: &[f64; 4], last: &[f64; 4]) -> bool {
    let [w, x, y, z] = std::array::from_fn(|i| quaternion[i] * last[i]);
    if last.iter().all(|number| *number == 0.0) {
        return quaternion.iter().find(|number| **number != 0.0).is_some_and(|first| *first < 0.0);
    }
    (w + x) + (y + z) < 0.0
}

/// The angle between two rotations in radians, whose quaternions have about the same sign; infinite beyond 20 degrees.
fn angle(exact: &[f64; 4], stored: [f32; 4]) -> f64 {
    let [w, x, y, z] = stored.map(f64::from);
    let length = ((w * w + x * x) + (y * y + z * z)).sqrt();
    let stored = [w / length, x / length, y / length, z / length];
    let [w, x, y, z] = std::array::from_fn(|i| stored[i] - exact[i]);
    let chord = ((w * w + x * x) + (y * y + z * z)).sqrt();
    // The angle of quaternions is half that of rotations.
    if chord < 0.17 { 4.0 * arc_sine(chord / 2.0) } else { f64::INFINITY }
}

/// The nearest number of a lattice through zero, which has no negative zero.
fn on_lattice(x: f64, step: f64) -> f32 {
    ((x / step).round() * step) as f32 + 0.0
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    fn tolerance(mm: f64) -> Tolerance {
        Tolerance::from_mm(mm).unwrap()
    }

    fn number(random: &mut Random) -> f64 {
        (random.below(2_000_001) as f64 - 1e6) / 1e6
    }

    /// A pose at room scale, its quaternion not quite of length 1.
    fn pose(random: &mut Random) -> PoseRow {
        let mut quaternion: [f64; 4] = std::array::from_fn(|_| number(random));
        if random.one_in(4) {
            quaternion[random.below(4)] = 0.0;
        }
        let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-3);
        let length = length * (1.0 + 0.009 * number(random));
        let [w, x, y, z] = quaternion.map(|number| (number / length) as f32);
        let [a, b, c] = std::array::from_fn(|_| (8000.0 * number(random)) as f32);
        [a, b, c, w, x, y, z, random.below(300) as f32 / 100.0]
    }

    /// The angle between two rotations in degrees, by the library's functions.
    fn angle_degrees(a: [f32; 4], b: [f32; 4]) -> f64 {
        let unit = |q: [f32; 4]| {
            let length = q.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
            q.map(|x| f64::from(x) / length)
        };
        let (a, b) = (unit(a), unit(b));
        let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        let chord = |sign: f64| a.iter().zip(&b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>();
        (4.0 * (chord(dot.signum()).sqrt() / 2.0).asin()).to_degrees()
    }

    #[test]
    fn every_pose_is_within_its_bounds_and_the_bounds_are_used() {
        let mut random = Random::new(27);
        for (mm, degrees) in
            [(20.0, 10.0), (0.5, 0.143), (0.1, 0.0286), (0.01, 0.003), (0.0005, 0.0001)]
        {
            let bounds = PoseBounds::new(tolerance(mm), degrees).unwrap();
            let mut quantiser = PoseQuantiser::new(bounds);
            let mut largest = PoseErrors::default();
            for _ in 0..20_000 {
                let row = pose(&mut random);
                if !has_pose(&row) || row[3..7].iter().all(|x| *x == 0.0) {
                    continue;
                }
                let mut rounded = row;
                quantiser.round(&mut rounded);
                let [x, y, z] = std::array::from_fn(|i| f64::from(row[i]) - f64::from(rounded[i]));
                let [of, to] = [&row, &rounded].map(|row| [row[3], row[4], row[5], row[6]]);
                let decoded = unit(to);
                let length = decoded.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
                assert!((length - 1.0).abs() < 2e-7, "{decoded:?}");
                largest.add(&PoseErrors {
                    position_mm: (x * x + y * y + z * z).sqrt(),
                    angle_degrees: angle_degrees(of, decoded),
                });
                assert!((rounded[7] - row[7]).abs() <= 1.0 / 256.0);
            }
            let measured = quantiser.take_errors();
            assert!(measured.position_mm <= mm && measured.angle_degrees <= degrees);
            assert_eq!(measured.position_mm, largest.position_mm);
            let apart = (measured.angle_degrees / largest.angle_degrees - 1.0).abs();
            assert!(apart < 1e-3, "{measured:?} {largest:?}");
            assert!(mm < 0.005 || measured.position_mm > 0.9 * mm, "{mm}: {measured:?}");
            assert!(
                degrees < 0.002 || measured.angle_degrees > 0.8 * degrees,
                "{degrees}: {measured:?}"
            );
        }
    }

    #[test]
    fn quaternions_continue_across_the_sign() {
        let bounds = PoseBounds::of_tolerance(tolerance(0.1));
        let mut quantiser = PoseQuantiser::new(bounds);
        let mut last: Option<[f32; 4]> = None;
        for step in 0..2000_u16 {
            // Two turns about an axis, with a sign that a device chooses anew in each frame.
            let half = f64::from(step) * std::f64::consts::TAU / 1000.0;
            let sign = if step % 3 == 0 { -1.0 } else { 1.0 };
            let [w, x, z] = [half.cos(), 0.6 * half.sin(), 0.8 * half.sin()];
            let [w, x, z] = [w, x, z].map(|number| (sign * number) as f32);
            let mut row = [0.0, 0.0, 0.0, w, x, 0.0, z, f32::NAN];
            if step % 100 == 50 {
                // A body that is lost does not begin anew.
                let mut row = without_pose(1);
                quantiser.round(&mut row);
                assert_eq!(code_without_pose(&row), Some(1));
            }
            quantiser.round(&mut row);
            assert!(row[7].is_nan() && code_without_pose(&row).is_none());
            let now = [row[3], row[4], row[5], row[6]];
            if let Some(last) = last {
                let change = now.iter().zip(&last).map(|(a, b)| (a - b).abs());
                assert!(change.fold(0.0, f32::max) < 0.01, "step {step}: {last:?} {now:?}");
            } else {
                assert!(now[0] > 0.0);
            }
            assert!(now.iter().all(|x| x.to_bits() != (-0.0_f32).to_bits()));
            last = Some(now);
        }
    }

    #[test]
    fn the_series_are_those_of_the_functions() {
        for i in 1..=1000 {
            let x = f64::from(i) * 1e-4;
            assert!((sine(x) / x.sin() - 1.0).abs() < 1e-14, "{x}");
            assert!((arc_sine(x) / x.asin() - 1.0).abs() < 1e-12, "{x}");
        }
        let bounds = PoseBounds::of_tolerance(tolerance(0.1));
        let moved = 2.0 * LEVER_MM * (bounds.angle_degrees().to_radians() / 2.0).sin();
        assert!((moved - 0.1).abs() < 1e-9, "{moved}");
        assert_eq!(PoseBounds::of_tolerance(tolerance(1e6)).angle_degrees(), 10.0);
        assert!(PoseBounds::new(tolerance(1.0), 0.0).is_err());
        assert!(PoseBounds::new(tolerance(1.0), f64::NAN).is_err());
        assert_eq!(few_bits(0.1), 0.099_609_375);
    }
}
