//! Bones that are as long on the left as on the right, and about as long as bones are.

use nalgebra::Vector3;

use super::weights;

/// How much the length of the average body counts against the measured one.
///
/// Shoulder and hip lie deep, and their landmarks shift with the girth; elbow and knee lie on a bend. Of people of one
/// stature, bones vary by 3 to 5 %, but forearms more.
const AVERAGE_COUNTS: Counts = Counts { forearm: 0.0, upper_arm: 0.6, shank: 0.5, thigh: 0.6 };

struct Counts {
    forearm: f64,
    upper_arm: f64,
    shank: f64,
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
}

/// Moves joints along their bones, from the ends of the limbs inwards: what lies farther out is surer.
pub(super) fn settle(mut limbs: [Limbs; 2]) -> [Limbs; 2] {
    let counts = AVERAGE_COUNTS;
    let elbows = limbs.map(|limb| limb.elbow_sigma.powi(-2));
    let lengths = limbs.map(|limb| (limb.elbow - limb.wrist).norm());
    let length = common(lengths, elbows, weights::FOREARM, counts.forearm);
    limbs.iter_mut().for_each(|limb| limb.elbow = at(limb.wrist, limb.elbow, length));

    let lengths = limbs.map(|limb| (limb.shoulder - limb.elbow).norm());
    let length = common(lengths, [1.0; 2], weights::UPPER_ARM, counts.upper_arm);
    limbs.iter_mut().for_each(|limb| limb.shoulder = at(limb.elbow, limb.shoulder, length));

    let knees = limbs.map(|limb| limb.knee_sigma.powi(-2));
    let shanks = limbs.map(|limb| (limb.knee - limb.ankle).norm());
    let thighs = limbs.map(|limb| (limb.hip - limb.knee).norm());
    // What part of the leg the shank is varies less than how long it is.
    let leg = f64::midpoint(shanks[0] + thighs[0], shanks[1] + thighs[1]);
    let average = leg * weights::SHANK / (weights::SHANK + weights::THIGH);
    let length = common(shanks, knees, average, counts.shank);
    limbs.iter_mut().for_each(|limb| limb.knee = at(limb.ankle, limb.knee, length));

    let lengths = limbs.map(|limb| (limb.hip - limb.knee).norm());
    let length = common(lengths, [1.0; 2], weights::THIGH, counts.thigh);
    limbs.iter_mut().for_each(|limb| limb.hip = at(limb.knee, limb.hip, length));
    limbs
}

/// The length of the bone of both sides: their mean by how sure each is, drawn to the average of all bodies.
fn common([a, b]: [f64; 2], [sure_a, sure_b]: [f64; 2], average: f64, counts: f64) -> f64 {
    let both = (a * sure_a + b * sure_b) / (sure_a + sure_b);
    both + counts * (average - both)
}

/// The point so far from `from` as `length`, in the direction of `towards`.
fn at(from: Vector3<f64>, towards: Vector3<f64>, length: f64) -> Vector3<f64> {
    let bone = (towards - from).try_normalize(0.0).unwrap_or_default();
    from + bone * length
}
