//! Bones that are as long on the left as on the right, and about as long as bones are.

use nalgebra::Vector3;

use super::weights;

/// How much the length of the average body counts against the measured one.
///
/// Shoulder and hip lie deep, and their landmarks shift with the girth. Elbow and knee lie on a bend, whose place was weighed
/// against the average already. A thigh is drawn half as far as is best for bodies near the average: it costs these little, and
/// leaves others what they are.
const AVERAGE_COUNTS: Counts = Counts { upper_arm: 0.6, thigh: 0.3 };

struct Counts {
    upper_arm: f64,
    thigh: f64,
}

/// The limbs of one side, in body scales, and how far elbow and knee may be off along the limb.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limbs {
    pub(super) shoulder: Vector3<f64>,
    pub(super) elbow: Vector3<f64>,
    pub(super) wrist: Vector3<f64>,
    pub(super) hip: Vector3<f64>,
    pub(super) knee: Vector3<f64>,
    pub(super) ankle: Vector3<f64>,
    pub(super) elbow_sigma: f64,
    pub(super) knee_sigma: f64,
    /// Whether part of the arm is missing: its bones stay as they are, and the other arm's lengths are its own.
    pub(super) arm_missing: bool,
    /// The same of the leg.
    pub(super) leg_missing: bool,
}

/// Moves joints along their bones, from the ends of the limbs inwards: what lies farther out is surer.
pub(super) fn settle(mut limbs: [Limbs; 2]) -> [Limbs; 2] {
    let counts = AVERAGE_COUNTS;
    let arms = limbs.map(|limb| if limb.arm_missing { 0.0 } else { 1.0 });
    if arms != [0.0; 2] {
        let elbows = [0, 1].map(|side| arms[side] * limbs[side].elbow_sigma.powi(-2));
        let lengths = limbs.map(|limb| (limb.elbow - limb.wrist).norm());
        let length = mean(lengths, elbows);
        let whole = limbs.iter_mut().filter(|limb| !limb.arm_missing);
        whole.for_each(|limb| limb.elbow = at(limb.wrist, limb.elbow, length));

        let lengths = limbs.map(|limb| (limb.shoulder - limb.elbow).norm());
        let length = drawn(mean(lengths, arms), weights::UPPER_ARM, counts.upper_arm);
        let whole = limbs.iter_mut().filter(|limb| !limb.arm_missing);
        whole.for_each(|limb| limb.shoulder = at(limb.elbow, limb.shoulder, length));
    }
    let legs = limbs.map(|limb| if limb.leg_missing { 0.0 } else { 1.0 });
    if legs != [0.0; 2] {
        let knees = [0, 1].map(|side| legs[side] * limbs[side].knee_sigma.powi(-2));
        let lengths = limbs.map(|limb| (limb.knee - limb.ankle).norm());
        let length = mean(lengths, knees);
        let whole = limbs.iter_mut().filter(|limb| !limb.leg_missing);
        whole.for_each(|limb| limb.knee = at(limb.ankle, limb.knee, length));

        let lengths = limbs.map(|limb| (limb.hip - limb.knee).norm());
        let length = drawn(mean(lengths, legs), weights::THIGH, counts.thigh);
        let whole = limbs.iter_mut().filter(|limb| !limb.leg_missing);
        whole.for_each(|limb| limb.hip = at(limb.knee, limb.hip, length));
    }
    limbs
}

/// The length of the bone of both sides: their mean by how sure each is.
fn mean([a, b]: [f64; 2], [sure_a, sure_b]: [f64; 2]) -> f64 {
    (a * sure_a + b * sure_b) / (sure_a + sure_b)
}

fn drawn(length: f64, average: f64, counts: f64) -> f64 {
    length + counts * (average - length)
}

/// The point so far from `from` as `length`, in the direction of `towards`.
fn at(from: Vector3<f64>, towards: Vector3<f64>, length: f64) -> Vector3<f64> {
    let bone = (towards - from).try_normalize(0.0).unwrap_or_default();
    from + bone * length
}
