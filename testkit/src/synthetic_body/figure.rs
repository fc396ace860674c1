//! A figure: joints in a pose, given as joint angles of the limbs, and the capsules around them.

use std::collections::BTreeMap;

use mocapd_body::{Estimate, Joint, Side};

use super::{
    Point,
    surface::{Capsule, Field},
};
use crate::random::Random;

/// Pose of a synthetic body. No limb touches another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pose {
    /// Arms and legs spread halfway.
    A,
    /// Arms out to the sides.
    T,
    /// Arms at the sides, a hand's breadth from the trunk.
    Down,
    /// In stride: one arm and the other leg forward.
    Walk,
    /// Knees deeply bent, arms forward.
    Squat,
    /// Seated, as on a chair, with the forearms forward.
    Sit,
    /// Arms overhead.
    Up,
}

/// Joint angles of one limb, degrees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    /// Flexion of the upper segment, from down towards forward.
    swing: f64,
    /// Abduction of the upper segment, from down to the side.
    spread: f64,
    /// Flexion of elbow (forward) or knee (backward).
    bend: f64,
}

const fn limb(swing: f64, spread: f64, bend: f64) -> Limb {
    Limb { swing, spread, bend }
}

impl Pose {
    /// All poses.
    pub const ALL: [Self; 7] =
        [Self::A, Self::T, Self::Down, Self::Walk, Self::Squat, Self::Sit, Self::Up];

    /// Angles of the left and right arm.
    fn arms(self) -> [Limb; 2] {
        match self {
            Self::A => [limb(0.0, 45.0, 12.0); 2],
            Self::T => [limb(0.0, 88.0, 6.0); 2],
            Self::Down => [limb(2.0, 20.0, 8.0); 2],
            Self::Walk => [limb(32.0, 22.0, 35.0), limb(-28.0, 22.0, 18.0)],
            Self::Squat => [limb(80.0, 18.0, 15.0); 2],
            Self::Sit => [limb(12.0, 28.0, 85.0); 2],
            Self::Up => [limb(0.0, 150.0, 12.0); 2],
        }
    }

    /// Angles of the left and right leg.
    fn legs(self) -> [Limb; 2] {
        match self {
            Self::A => [limb(0.0, 12.0, 4.0); 2],
            Self::T | Self::Down | Self::Up => [limb(2.0, 8.0, 5.0); 2],
            Self::Walk => [limb(-18.0, 6.0, 22.0), limb(26.0, 6.0, 10.0)],
            Self::Squat => [limb(88.0, 28.0, 100.0); 2],
            Self::Sit => [limb(85.0, 12.0, 85.0); 2],
        }
    }
}

/// The joints of a pose and the solid around them, in metres; x is the subject's left, y is up, z is forward.
pub(super) struct Figure {
    pub(super) joints: BTreeMap<Joint, Estimate>,
    pub(super) field: Field,
}

impl Figure {
    /// Draws a figure. Lengths are fractions of stature after Drillis and Contini 1966, varied by a few per cent.
    pub(super) fn new(random: &mut Random, pose: Pose) -> Self {
        let stature = random.between(1.5, 1.95);
        let mut share = |of: f64, by: f64| of * random.between(1.0 - by, 1.0 + by);
        let girth = share(1.05, 0.1);
        let lengths =
            [[share(0.186, 0.05), share(0.146, 0.05)], [share(0.245, 0.04), share(0.246, 0.04)]];
        let (shoulder_x, hip_x) = (share(0.115, 0.06), share(0.052, 0.06));
        let (capsules, joints) = (Vec::new(), BTreeMap::new());
        let mut figure = FigureBuilder { stature, girth, capsules, joints };
        figure.trunk(shoulder_x, hip_x);
        let limbs = pose.arms().into_iter().zip(pose.legs());
        for ((side, sign), (arm, leg)) in
            [(Side::Left, 1.0), (Side::Right, -1.0)].into_iter().zip(limbs)
        {
            let shoulder = Point::new(sign * shoulder_x, 0.82, 0.0);
            let hip = Point::new(sign * hip_x, 0.525, 0.0);
            figure.arm(side, &LimbGeometry::new(shoulder, lengths[0], arm, sign, 1.0));
            figure.leg(side, &LimbGeometry::new(hip, lengths[1], leg, sign, -1.0));
        }
        let field = Field { capsules: figure.capsules, blend: 0.02 * stature };
        Self { joints: figure.joints, field }
    }
}

/// A limb of two segments, in fractions of stature.
struct LimbGeometry {
    /// Shoulder, elbow, wrist; or hip, knee, ankle.
    joints: [Point; 3],
    /// Direction of the lower segment.
    along: Point,
    /// Perpendicular to it, in the direction of the toes.
    front: Point,
    /// Axis of the hinge joint, perpendicular to both segments.
    hinge: Point,
}

impl LimbGeometry {
    /// `folds` is 1 for a joint that bends forward, -1 for one that bends backward.
    fn new(root: Point, [upper, lower]: [f64; 2], limb: Limb, sign: f64, folds: f64) -> Self {
        let (swing, spread, bend) =
            (limb.swing.to_radians(), limb.spread.to_radians(), limb.bend.to_radians());
        let thigh = Point::new(
            sign * spread.sin(),
            -spread.cos() * swing.cos(),
            spread.cos() * swing.sin(),
        );
        // Perpendicular to the upper segment; forward when it hangs down.
        let ahead = Point::new(0.0, swing.sin(), swing.cos());
        let along = thigh * bend.cos() + ahead * (folds * bend.sin());
        let front = ahead * bend.cos() - thigh * (folds * bend.sin());
        let middle = root + thigh * upper;
        let end = middle + along * lower;
        let hinge = thigh.cross(&ahead);
        Self { joints: [root, middle, end], along, front, hinge }
    }

    /// The point at these distances from the last joint, along the lower segment and to the front.
    fn beyond(&self, along: f64, front: f64) -> Point {
        self.joints[2] + (self.along * along + self.front * front)
    }
}

/// Builds a figure. All inputs are in fractions of stature.
struct FigureBuilder {
    stature: f64,
    girth: f64,
    capsules: Vec<Capsule>,
    joints: BTreeMap<Joint, Estimate>,
}

impl FigureBuilder {
    fn joint(&mut self, joint: Joint, at: Point) {
        let position = (at * self.stature).into();
        self.joints.insert(joint, Estimate { position, sigma: 0.0 });
    }

    fn capsule(&mut self, ends: [Point; 2], radii: [f64; 2], depth: f64) {
        let ends = ends.map(|end| end * self.stature);
        let radii = radii.map(|radius| radius * self.stature);
        self.capsules.push(Capsule { depth, ..Capsule::round(ends, radii) });
    }

    fn limb_capsule(&mut self, ends: [Point; 2], radii: [f64; 2]) {
        self.capsule(ends, radii.map(|radius| radius * self.girth), 1.0);
    }

    fn trunk(&mut self, shoulder_x: f64, hip_x: f64) {
        let across = |x: f64, y: f64| [Point::new(-x, y, 0.0), Point::new(x, y, 0.0)];
        let middle = |ends: [[f64; 2]; 2]| ends.map(|[y, z]| Point::new(0.0, y, z));
        self.capsule(across(hip_x - 0.01, 0.54), [0.07 * self.girth; 2], 0.85);
        self.capsule(middle([[0.56, 0.0], [0.74, 0.0]]), [0.078 * self.girth; 2], 0.8);
        self.capsule(across(0.035, 0.735), [0.072 * self.girth; 2], 0.8);
        self.capsule(across(shoulder_x - 0.01, 0.81), [0.036; 2], 1.0);
        self.capsule(middle([[0.80, 0.0], [0.90, 0.01]]), [0.036, 0.034], 1.0);
        // The chin distinguishes front from back.
        self.capsule(middle([[0.895, 0.03], [0.92, 0.02]]), [0.022, 0.03], 1.0);
        self.capsule(middle([[0.91, 0.012], [0.947, 0.008]]), [0.045, 0.053], 1.0);
        self.joint(Joint::Head, Point::new(0.0, 1.0, 0.008));
        self.joint(Joint::Throat, Point::new(0.0, 0.845, 0.0));
        let [right, left] = across(hip_x, 0.525);
        self.joint(Joint::Pelvis, (right + left) * 0.5);
    }

    fn arm(&mut self, side: Side, limb: &LimbGeometry) {
        let [shoulder, elbow, wrist] = limb.joints;
        self.limb_capsule([shoulder, elbow], [0.034, 0.026]);
        self.limb_capsule([elbow, wrist], [0.026, 0.019]);
        // The epicondyles of the elbow: wide, not round.
        self.condyles(limb, 0.014, 0.019);
        // A fist.
        self.capsule([limb.beyond(0.012, 0.0), limb.beyond(0.04, 0.004)], [0.018, 0.023], 1.0);
        self.joint(Joint::Shoulder(side), shoulder);
        self.joint(Joint::Elbow(side), elbow);
        self.joint(Joint::Wrist(side), wrist);
    }

    fn leg(&mut self, side: Side, limb: &LimbGeometry) {
        let [hip, knee, ankle] = limb.joints;
        self.limb_capsule([hip, knee], [0.05, 0.033]);
        self.limb_capsule([knee, ankle], [0.032, 0.021]);
        self.condyles(limb, 0.016, 0.026);
        self.capsule([limb.beyond(0.02, -0.025), limb.beyond(0.024, 0.09)], [0.02, 0.017], 1.0);
        self.joint(Joint::Hip(side), hip);
        self.joint(Joint::Knee(side), knee);
        self.joint(Joint::Ankle(side), ankle);
    }

    fn condyles(&mut self, limb: &LimbGeometry, half: f64, radius: f64) {
        let middle = limb.joints[1];
        let out = limb.hinge * (half * self.girth);
        self.limb_capsule([middle - out, middle + out], [radius; 2]);
    }
}
