//! A figure: joints in a pose, and capsules on them.

use std::collections::BTreeMap;

use mocapd_body::{Estimate, Joint, Side};

use super::Point;
use super::field::{Capsule, Field};
use super::pose::{Limb, Pose};
use super::random::Random;

/// Joints and a solid around them, in metres; x is the subject's left, y is up, z is forward.
pub(super) struct Figure {
    pub(super) joints: BTreeMap<Joint, Estimate>,
    pub(super) field: Field,
}

impl Figure {
    /// Lengths are shares of stature as in Drillis and Contini 1966, up to a few per cent of each person's own.
    pub(super) fn new(random: &mut Random, pose: Pose) -> Self {
        let stature = random.between(1.5, 1.95);
        let mut share = |of: f64, by: f64| of * random.between(1.0 - by, 1.0 + by);
        let girth = share(1.05, 0.1);
        let lengths =
            [[share(0.186, 0.05), share(0.146, 0.05)], [share(0.245, 0.04), share(0.246, 0.04)]];
        let (shoulder_x, hip_x) = (share(0.115, 0.06), share(0.052, 0.06));
        let mut figure = Drawing { stature, girth, capsules: Vec::new(), joints: BTreeMap::new() };
        figure.trunk(shoulder_x, hip_x);
        let limbs = pose.arms().into_iter().zip(pose.legs());
        for ((side, sign), (arm, leg)) in
            [(Side::Left, 1.0), (Side::Right, -1.0)].into_iter().zip(limbs)
        {
            let shoulder = Point::new(sign * shoulder_x, 0.82, 0.0);
            let hip = Point::new(sign * hip_x, 0.525, 0.0);
            figure.arm(side, &Bones::new(shoulder, lengths[0], arm, sign, 1.0));
            figure.leg(side, &Bones::new(hip, lengths[1], leg, sign, -1.0));
        }
        let field = Field { capsules: figure.capsules, blend: 0.02 * stature };
        Self { joints: figure.joints, field }
    }
}

/// Both parts of a limb, in shares of stature.
struct Bones {
    /// Shoulder, elbow, wrist; or hip, knee, ankle.
    joints: [Point; 3],
    /// Direction of the lower part.
    along: Point,
    /// Across it, to where the toes point.
    front: Point,
    /// Across both parts: the axis of the hinge.
    hinge: Point,
}

impl Bones {
    /// `folds` is 1 where the joint folds forward, -1 where it folds backward.
    fn new(root: Point, [upper, lower]: [f64; 2], limb: Limb, sign: f64, folds: f64) -> Self {
        let (swing, spread, bend) =
            (limb.swing.to_radians(), limb.spread.to_radians(), limb.bend.to_radians());
        let thigh = Point::new(
            sign * spread.sin(),
            -spread.cos() * swing.cos(),
            spread.cos() * swing.sin(),
        );
        // Square to the upper part, and forward where it hangs.
        let ahead = Point::new(0.0, swing.sin(), swing.cos());
        let along = thigh * bend.cos() + ahead * (folds * bend.sin());
        let front = ahead * bend.cos() - thigh * (folds * bend.sin());
        let middle = root + thigh * upper;
        let end = middle + along * lower;
        let hinge = thigh.cross(&ahead);
        Self { joints: [root, middle, end], along, front, hinge }
    }

    /// From the last joint, so far along and so far to the front.
    fn beyond(&self, along: f64, front: f64) -> Point {
        self.joints[2] + (self.along * along + self.front * front)
    }
}

/// A figure in the making. Everything given to it is in shares of stature.
struct Drawing {
    stature: f64,
    girth: f64,
    capsules: Vec<Capsule>,
    joints: BTreeMap<Joint, Estimate>,
}

impl Drawing {
    fn joint(&mut self, joint: Joint, at: Point) {
        let position = (at * self.stature).into();
        self.joints.insert(joint, Estimate { position, sigma: 0.0 });
    }

    fn capsule(&mut self, ends: [Point; 2], radii: [f64; 2], depth: f64) {
        let ends = ends.map(|end| end * self.stature);
        let radii = radii.map(|radius| radius * self.stature);
        self.capsules.push(Capsule { depth, ..Capsule::round(ends, radii) });
    }

    fn fleshy(&mut self, ends: [Point; 2], radii: [f64; 2]) {
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
        // The chin tells the front from the back.
        self.capsule(middle([[0.895, 0.03], [0.92, 0.02]]), [0.022, 0.03], 1.0);
        self.capsule(middle([[0.91, 0.012], [0.947, 0.008]]), [0.045, 0.053], 1.0);
        self.joint(Joint::Head, Point::new(0.0, 1.0, 0.008));
        self.joint(Joint::Throat, Point::new(0.0, 0.845, 0.0));
        let [right, left] = across(hip_x, 0.525);
        self.joint(Joint::Pelvis, (right + left) * 0.5);
    }

    fn arm(&mut self, side: Side, bones: &Bones) {
        let [shoulder, elbow, wrist] = bones.joints;
        self.fleshy([shoulder, elbow], [0.034, 0.026]);
        self.fleshy([elbow, wrist], [0.026, 0.019]);
        // The ends of the bone at the elbow: wide across, not round.
        self.knob(bones, 0.014, 0.019);
        // A fist.
        self.capsule([bones.beyond(0.012, 0.0), bones.beyond(0.04, 0.004)], [0.018, 0.023], 1.0);
        self.joint(Joint::Shoulder(side), shoulder);
        self.joint(Joint::Elbow(side), elbow);
        self.joint(Joint::Wrist(side), wrist);
    }

    fn leg(&mut self, side: Side, bones: &Bones) {
        let [hip, knee, ankle] = bones.joints;
        self.fleshy([hip, knee], [0.05, 0.033]);
        self.fleshy([knee, ankle], [0.032, 0.021]);
        self.knob(bones, 0.016, 0.026);
        self.capsule([bones.beyond(0.02, -0.025), bones.beyond(0.024, 0.09)], [0.02, 0.017], 1.0);
        self.joint(Joint::Hip(side), hip);
        self.joint(Joint::Knee(side), knee);
        self.joint(Joint::Ankle(side), ankle);
    }

    fn knob(&mut self, bones: &Bones, half: f64, radius: f64) {
        let middle = bones.joints[1];
        let out = bones.hinge * (half * self.girth);
        self.fleshy([middle - out, middle + out], [radius; 2]);
    }
}
