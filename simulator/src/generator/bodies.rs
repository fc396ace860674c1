//! Rigid bodies on the segments of the generated body, as a camera system would track them.

use mocapd_drivers::device::{BODIES_MAX, BodyInfo, Pose, PoseStatus};

use super::arithmetic::{Rng, V3, add, cross, dot, norm, offset, scale, sub, unit};
use super::body::SEGMENTS;
use super::spec::noise;
use super::subject::{Subject, SubjectState};
use super::{GenerateError, JumpSpec};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::Occlusion;

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
}
