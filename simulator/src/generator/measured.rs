//! What a laboratory measures of the generated jumps besides markers: rigid bodies on the segments of the body, as a
//! camera system would track them, and two force plates, by what they feel of the body that stands on them.

use mocapd_drivers::device::{BODIES_MAX, BodyInfo, Pose, PoseStatus};

use super::arithmetic::{Rng, V3, add, cross, dot, norm, offset, scale, sub, unit};
use super::body::SEGMENTS;
use super::plan::{GRAVITY_M_S2, Subject, SubjectState, Support};
use super::spec::noise;
use super::{GenerateError, JumpSpec, RETURN_M};

/// How long a body stays lost, in seconds: the time that a limb takes to pass in front of it.
const LOST_S: f64 = 0.2;

/// The distance of a body's markers from its origin, in millimetres, over which the noise of their positions turns it.
const RADIUS_MM: f64 = 60.0;

/// Rigid bodies and their poses.
///
/// A pose is a function of its frame's number in the run, so the ground truth of a recording can be computed again.
#[derive(Debug, PartialEq)]
pub enum RigidBodies {
    /// On the segments of the generated body.
    Generated(Box<GeneratedBodies>),
    /// Those of a take.
    Recorded(RecordedPoses),
}

/// The poses of a take's rigid bodies.
#[derive(Debug, PartialEq)]
pub struct RecordedPoses {
    infos: Vec<BodyInfo>,
    /// By frame, where its poses begin in `poses`, and whether it has any; one more for the end.
    frames: Vec<(usize, bool)>,
    poses: Vec<Pose>,
}

impl RecordedPoses {
    /// Of no frame yet.
    #[must_use]
    pub fn new(infos: Vec<BodyInfo>) -> Self {
        Self { infos, frames: vec![(0, false)], poses: Vec::new() }
    }

    /// Adds the poses of the next frame; without `has_poses` the device sends none for it.
    pub fn add_frame(&mut self, has_poses: bool, poses: impl Iterator<Item = Pose>) {
        if let Some((_, has)) = self.frames.last_mut() {
            *has = has_poses;
        }
        self.poses.extend(poses);
        self.frames.push((self.poses.len(), false));
    }

    fn poses(&self, number: u64) -> Option<&[Pose]> {
        let at = usize::try_from(number).ok()?;
        let (start, has_poses) = self.frames.get(at)?;
        let (end, _) = self.frames.get(at + 1)?;
        self.poses.get(*start..*end).filter(|_| *has_poses)
    }
}

/// Rigid bodies on one segment after another, and the subject that they move with.
#[derive(Debug)]
pub struct GeneratedBodies {
    spec: JumpSpec,
    n_bodies: usize,
    subject: Subject,
}

impl PartialEq for GeneratedBodies {
    fn eq(&self, other: &Self) -> bool {
        (self.spec, self.n_bodies) == (other.spec, other.n_bodies)
    }
}

impl RigidBodies {
    /// The bodies on the subject of a specification, for its length. With an [`Occlusion`](super::Occlusion), its fraction
    /// of the poses is missing.
    ///
    /// # Errors
    /// When [`JumpSpec::generate`] refuses the specification, or for no bodies or too many.
    pub fn new(spec: &JumpSpec, n_bodies: usize) -> Result<Self, GenerateError> {
        Ok(Self::Generated(Box::new(GeneratedBodies::new(spec, n_bodies)?)))
    }

    /// Those of a take.
    #[must_use]
    pub fn recorded(poses: RecordedPoses) -> Self {
        Self::Recorded(poses)
    }

    /// The table that the device announces.
    #[must_use]
    pub fn infos(&self) -> Vec<BodyInfo> {
        match self {
            Self::Generated(bodies) => bodies.infos(),
            Self::Recorded(poses) => poses.infos.clone(),
        }
    }

    /// Replaces `poses` by those of frame `number` of the run, at `rate_hz`. Returns whether the device has any for this frame.
    pub fn poses(&self, number: u64, rate_hz: f64, poses: &mut Vec<Pose>) -> bool {
        poses.clear();
        match self {
            Self::Generated(bodies) => {
                bodies.poses(number, rate_hz, poses);
                true
            }
            Self::Recorded(recorded) => {
                let found = recorded.poses(number);
                poses.extend_from_slice(found.unwrap_or_default());
                found.is_some()
            }
        }
    }
}

impl GeneratedBodies {
    fn new(spec: &JumpSpec, n_bodies: usize) -> Result<Self, GenerateError> {
        spec.check()?;
        if !(1..=BODIES_MAX).contains(&n_bodies) {
            let (value, high) = (n_bodies as f64, BODIES_MAX as f64);
            return Err(GenerateError::OutOfRange { what: "bodies", value, low: 1.0, high });
        }
        let mut subject = Subject::new(spec.seed, spec.first_trial);
        let seconds = spec.seconds.unwrap_or_else(|| subject.first_trial_s());
        subject.extend_to(seconds);
        Ok(Self { spec: *spec, n_bodies, subject })
    }

    fn infos(&self) -> Vec<BodyInfo> {
        let name = |index: usize| {
            let segment = SEGMENTS[index % SEGMENTS.len()].0;
            match index / SEGMENTS.len() {
                0 => segment.to_owned(),
                n => format!("{segment}_{}", n + 1),
            }
        };
        (0..self.n_bodies).map(|i| BodyInfo { id: i as u16 + 1, name: name(i) }).collect()
    }

    fn poses(&self, number: u64, rate_hz: f64, poses: &mut Vec<Pose>) {
        let time_s = number as f64 / rate_hz;
        let state = self.subject.at(time_s);
        for index in 0..self.n_bodies {
            let body = index as u16 + 1;
            match self.gap(index, time_s) {
                None => poses.push(self.pose(index, number, &state)),
                Some(0..3) => poses.push(Pose::without(body, PoseStatus::Lost)),
                Some(3) => poses.push(Pose::without(body, PoseStatus::Rejected)),
                // Not listed.
                Some(_) => {}
            }
        }
    }

    /// A number below 5 that selects the kind of gap, if there is one at this time.
    fn gap(&self, index: usize, time_s: f64) -> Option<usize> {
        let fraction = self.spec.occlusion?.fraction;
        let slot = (time_s / LOST_S) as u64;
        let mut rng = Rng::stream(self.spec.seed ^ (0x4_0000 + index as u64), slot);
        (rng.unit() < fraction).then(|| rng.below(5))
    }

    fn pose(&self, index: usize, number: u64, state: &SubjectState) -> Pose {
        let (_, (from, to), follows_chest, radius_m) = SEGMENTS[index % SEGMENTS.len()];
        let bone = sub(state.sites[to], state.sites[from]);
        let along = unit(bone);
        let left = state.lateral[usize::from(follows_chest)];
        let left = unit(sub(left, scale(along, dot(left, along))));
        let front = cross(left, along);
        // Further bodies of a segment are at other places of it.
        let place = 0.5 / (1 + index / SEGMENTS.len()) as f64;
        let origin = offset(state.sites[from], [bone, left, front], [place, 0.0, radius_m]);
        let stream = (0x5_0000 + index as u64) << 40 | number;
        let mut rng = Rng::stream(self.spec.seed ^ 0x5_0000, stream);
        let noise_mm = self.spec.noise_mm;
        let at_mm = add(scale(origin, 1000.0), noise(noise_mm, &mut rng));
        let turn = noise(noise_mm / RADIUS_MM / 2.0, &mut rng);
        let quaternion = turned(quaternion([front, left, along]), turn);
        Pose {
            body: index as u16 + 1,
            status: PoseStatus::Tracked,
            position_mm: at_mm.map(|x| x as f32),
            quaternion: quaternion.map(|x| x as f32),
            residual_mm: (norm(noise(noise_mm, &mut rng)) / 2.0) as f32,
        }
    }
}

/// The quaternion w, x, y, z of the rotation that has these axes (Shepperd 1978): the largest of its numbers is positive,
/// so its sign changes now and then, as that of many systems does.
fn quaternion([x, y, z]: [V3; 3]) -> [f64; 4] {
    let trace = x[0] + y[1] + z[2];
    let candidates = [trace, x[0], y[1], z[2]];
    let largest = (1..4).fold(0, |best, i| if candidates[i] > candidates[best] { i } else { best });
    let twice = (1.0 + 2.0 * candidates[largest] - trace).max(0.0).sqrt();
    let (half, per) = (twice / 2.0, 0.5 / twice);
    let (yz, zy, zx, xz, xy, yx) = (y[2], z[1], z[0], x[2], x[1], y[0]);
    match largest {
        0 => [half, (yz - zy) * per, (zx - xz) * per, (xy - yx) * per],
        1 => [(yz - zy) * per, half, (xy + yx) * per, (zx + xz) * per],
        2 => [(zx - xz) * per, (xy + yx) * per, half, (yz + zy) * per],
        _ => [(xy - yx) * per, (zx + xz) * per, (yz + zy) * per, half],
    }
}

/// The rotation turned by twice the small vector `by`, of length 1 again.
fn turned([w, x, y, z]: [f64; 4], by: V3) -> [f64; 4] {
    let vector = [x, y, z];
    let turned = add(add(vector, scale(by, w)), cross(by, vector));
    let product = [w - dot(by, vector), turned[0], turned[1], turned[2]];
    let length = product.iter().map(|number| number * number).sum::<f64>().sqrt();
    product.map(|number| number / length)
}

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
    use crate::generator::{Occlusion, Phase};

    /// The vector rotated by a quaternion.
    fn rotated([w, x, y, z]: [f32; 4], v: V3) -> V3 {
        let [w, x, y, z] = [w, x, y, z].map(f64::from);
        let u = [x, y, z];
        let twice = scale(cross(u, v), 2.0);
        add(add(v, scale(twice, w)), cross(u, twice))
    }

    #[test]
    fn bodies_move_with_their_segments() {
        let spec = JumpSpec::new(5, 100.0).clean();
        let bodies = GeneratedBodies::new(&spec, 12).unwrap();
        let names: Vec<String> = bodies.infos().into_iter().map(|body| body.name).collect();
        assert_eq!((&names[0][..], &names[9][..], &names[11][..]), ("trunk", "head", "l_thigh_2"));
        let (mut poses, mut signs) = (Vec::new(), 0);
        for number in 0..1000 {
            poses.clear();
            bodies.poses(number, 100.0, &mut poses);
            assert!(poses.iter().map(|pose| pose.body).eq(1..=12));
            let state = bodies.subject.at(number as f64 / 100.0);
            for (pose, (_, (from, to), _, radius_m)) in poses.iter().zip(SEGMENTS) {
                assert!(pose.checked().status == PoseStatus::Tracked, "{pose:?}");
                // Its third axis is the bone, and its origin lies at the radius in front of the bone's middle.
                let bone = sub(state.sites[to], state.sites[from]);
                let axis = rotated(pose.quaternion, [0.0, 0.0, 1.0]);
                assert!(norm(sub(axis, unit(bone))) < 1e-6, "{number}: {axis:?} {bone:?}");
                let front = rotated(pose.quaternion, [1.0, 0.0, 0.0]);
                let middle = add(state.sites[from], scale(bone, 0.5));
                let origin = scale(add(middle, scale(front, radius_m)), 1000.0);
                let found = pose.position_mm.map(f64::from);
                assert!(norm(sub(found, origin)) < 1e-3, "{found:?} {origin:?}");
                signs += u32::from(pose.quaternion[0] < 0.0);
            }
        }
        assert!(signs > 0, "signs change");
    }

    #[test]
    fn a_fraction_of_the_poses_is_missing_in_every_way() {
        let occlusion = Some(Occlusion { fraction: 0.2, mean_gap_s: 0.2 });
        let spec = JumpSpec { occlusion, ..JumpSpec::new(5, 100.0) };
        let bodies = RigidBodies::new(&spec, 8).unwrap();
        let (mut poses, mut counts) = (Vec::new(), [0_u32; 4]);
        for number in 0..1100 {
            bodies.poses(number, 100.0, &mut poses);
            counts[3] += 8 - poses.len() as u32;
            poses.iter().for_each(|pose| counts[usize::from(pose.status.code())] += 1);
        }
        let missing = f64::from(8800 - counts[0]) / 8800.0;
        assert!((0.15..0.25).contains(&missing) && counts.iter().all(|n| *n > 100), "{counts:?}");
        for n_bodies in [0, 129] {
            assert!(RigidBodies::new(&spec, n_bodies).is_err());
        }
    }

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
