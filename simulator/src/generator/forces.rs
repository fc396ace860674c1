//! Two force plates under the generated jumps: what they feel of the body that stands on them.
//!
//! The force is that of Newton's second law for a point mass at the pelvis. It acts at the feet: each bears a part of
//! it, by where the pelvis is between them, and a plate feels the feet that stand on it. In flight it is exactly 0.

use super::arithmetic::V3;
use super::plan::GRAVITY_M_S2;
use super::subject::{Subject, Support};
use super::{GenerateError, JumpSpec, RETURN_M};

/// Centres of the plates on the x axis, in metres: where trials begin and where they end. The jumps go from one to the
/// other.
const CENTRES_M: [f64; 2] = [0.0, RETURN_M];

/// Half the length and half the width of a plate, in metres: the larger plates of laboratories have 900 by 600 mm.
const HALF_M: [f64; 2] = [0.45, 0.30];

/// A foot this much higher than the other one bears nothing, in metres: one step of a walk lifts it further.
const LIFTED_M: f64 = 0.03;

/// Mass per square of the stature, kg/m^2: an ordinary build.
const BODY_MASS_INDEX: f64 = 23.0;

/// Step of the difference that gives the acceleration, in seconds. The curves have two continuous derivatives.
const STEP_S: f64 = 1e-3;

/// Two force plates, and the subject above them.
#[derive(Debug)]
pub struct ForcePlates {
    subject: Subject,
    mass_kg: f64,
}

/// Components of a plate: the force on the body in newtons, and its moment about the centre of the plate's surface in
/// newton metres, in the axes of the capture volume. The centre of pressure is at (-My / Fz, Mx / Fz).
pub const PLATE_COMPONENTS: [&str; 6] = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"];

impl ForcePlates {
    /// The plates under the jumps of a specification, for its length.
    ///
    /// # Errors
    /// When [`JumpSpec::generate`] refuses the specification.
    pub fn new(spec: &JumpSpec) -> Result<Self, GenerateError> {
        spec.check()?;
        let mut subject = Subject::new(spec.seed, spec.first_trial);
        let seconds = spec.seconds.unwrap_or_else(|| subject.first_trial_s());
        subject.extend_to(seconds);
        let mass_kg = BODY_MASS_INDEX * subject.stature_m() * subject.stature_m();
        Ok(Self { subject, mass_kg })
    }

    /// Mass of the body, kg.
    #[must_use]
    pub fn mass_kg(&self) -> f64 {
        self.mass_kg
    }

    /// Upward velocity of the body, m/s.
    #[must_use]
    pub fn velocity_up_m_s(&self, time_s: f64) -> f64 {
        let z = |at_s: f64| self.subject.support(at_s).pelvis[2];
        (z(time_s + STEP_S) - z(time_s - STEP_S)) / (2.0 * STEP_S)
    }

    /// What both plates feel at a time: their [components](PLATE_COMPONENTS).
    #[must_use]
    pub fn at(&self, time_s: f64) -> [[f64; 6]; 2] {
        let support = self.subject.support(time_s);
        let mut plates = [[0.0; 6]; 2];
        if support.is_airborne {
            return plates;
        }
        let [before, after] = [-STEP_S, STEP_S].map(|by| self.subject.support(time_s + by).pelvis);
        let acceleration: V3 = std::array::from_fn(|axis| {
            (before[axis] + after[axis] - 2.0 * support.pelvis[axis]) / (STEP_S * STEP_S)
        });
        // A body does not pull at the floor.
        let up = (self.mass_kg * (acceleration[2] + GRAVITY_M_S2)).max(0.0);
        let force = [self.mass_kg * acceleration[0], self.mass_kg * acceleration[1], up];
        for (foot, share) in support.feet.iter().zip(shares(&support)) {
            let Some((plate, [x, y])) = plate_under(*foot) else { continue };
            let [fx, fy, fz] = force.map(|newtons| share * newtons);
            let moments = [y * fz, -x * fz, x * fy - y * fx];
            let felt = [fx, fy, fz].into_iter().chain(moments);
            plates[plate].iter_mut().zip(felt).for_each(|(sum, felt)| *sum += felt);
        }
        plates
    }
}

/// The corners of the plates in the capture volume, in millimetres: those of the quadrants (+x +y), (-x +y), (-x -y),
/// (+x -y).
#[must_use]
pub fn plate_corners_mm() -> [[[f32; 3]; 4]; 2] {
    let [x, y] = HALF_M;
    let quadrants = [[x, y], [-x, y], [-x, -y], [x, -y]];
    CENTRES_M.map(|centre| {
        quadrants.map(|[along, across]| [centre + along, across, 0.0].map(|m| (m * 1000.0) as f32))
    })
}

/// The parts of the force that the feet bear.
fn shares(support: &Support) -> [f64; 2] {
    let [left, right] = support.feet;
    if left[2] > right[2] + LIFTED_M {
        return [0.0, 1.0];
    }
    if right[2] > left[2] + LIFTED_M {
        return [1.0, 0.0];
    }
    let along = [left[0] - right[0], left[1] - right[1]];
    let apart = along[0] * along[0] + along[1] * along[1];
    let from = [support.pelvis[0] - right[0], support.pelvis[1] - right[1]];
    let part = (from[0] * along[0] + from[1] * along[1]) / apart.max(1e-9);
    let of_left = part.clamp(0.0, 1.0);
    [of_left, 1.0 - of_left]
}

/// The plate that a foot stands on, and its place from the plate's centre.
fn plate_under(foot: V3) -> Option<(usize, [f64; 2])> {
    let places = CENTRES_M.map(|centre| [foot[0] - centre, foot[1]]);
    let is_on = |[x, y]: &[f64; 2]| x.abs() <= HALF_M[0] && y.abs() <= HALF_M[1];
    places.into_iter().enumerate().find(|(_, place)| is_on(place))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::Phase;

    /// Both plates' forces over a jump at 2000 Hz, with the phases' first samples.
    fn recorded(seed: u64) -> (ForcePlates, Vec<f64>, Vec<(Phase, usize)>) {
        let spec = JumpSpec::new(seed, 2000.0);
        let plates = ForcePlates::new(&spec).unwrap();
        let jump = JumpSpec { n_markers: 1, ..spec }.generate().unwrap();
        let total = |i: usize| plates.at(i as f64 / 2000.0).iter().map(|plate| plate[2]).sum();
        let n = jump.motion.positions_mm.len();
        let forces = (0..n).map(total).collect();
        (plates, forces, jump.phases)
    }

    #[test]
    fn the_force_is_zero_in_flight_and_its_impulse_is_the_velocity_of_take_off() {
        for seed in 0..8 {
            let (plates, forces, phases) = recorded(seed);
            let begins = |phase: Phase| phases.iter().find(|(of, _)| *of == phase).unwrap().1;
            let (push, flight, landing) =
                (begins(Phase::TakeOff), begins(Phase::Flight), begins(Phase::Settling));
            assert!(forces[flight..landing].iter().all(|&newtons| newtons == 0.0), "{seed}");
            let weight = plates.mass_kg() * GRAVITY_M_S2;
            assert!((forces[10] / weight - 1.0).abs() < 0.01, "standing: {}", forces[10]);
            // From the lowest point, at which the body rests.
            let impulse: f64 =
                forces[push..flight].iter().map(|newtons| (newtons - weight) / 2000.0).sum();
            let velocity = plates.velocity_up_m_s(flight as f64 / 2000.0);
            let ratio = impulse / plates.mass_kg() / velocity;
            assert!((ratio - 1.0).abs() < 0.02, "seed {seed}: {ratio}");
            assert!(forces[landing + 100] > 1.2 * weight, "it lands on a plate");
        }
    }

    #[test]
    fn the_centre_of_pressure_lies_between_the_feet() {
        let spec = JumpSpec::new(3, 100.0);
        let plates = ForcePlates::new(&spec).unwrap();
        for time_s in [0.1, 0.5, 0.8] {
            let support = plates.subject.support(time_s);
            let [_, _, fz, mx, my, _] = plates.at(time_s)[0];
            let [x, y] = [-my / fz, mx / fz];
            let [left, right] = support.feet;
            assert!((x - left[0]).abs() < 0.05 && y < left[1] && y > right[1], "{x} {y}");
        }
    }
}
