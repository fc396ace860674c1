//! How tall a subject stands, whatever the pose of the scan.

use super::Bone;
use super::json::STATURE_MM;

/// Stature, over the way from the crown along throat, pelvis, thigh and shank: the mean over the two average shapes of
/// `MakeHuman` in 13 poses, with the joints of the default method. It stands for the feet and for what the way leaves out.
const STATURE_OF_BONES: f64 = 1.045;
/// Standard deviation of that, as a part of stature: 0.013 on these two shapes, 0.018 at most on others.
const VARIES: f64 = 0.018;

/// The root sum square of the bones' standard deviations, as a part of stature, is 0.031 to 0.035 where no joint is in doubt. Above
/// this stature is no surer than the bones are.
const IN_DOUBT: f64 = 0.045;

/// One side's bone is taken alone where it is so many times as sure as the other's.
const SURER: f64 = 1.5;

/// Stature and its standard deviation in millimetres; nothing where a bone is missing, or of nobody's size. `size_sigma` is
/// what is expected of all bones together, as a part of them: it does not become less by their number.
pub(super) fn stature(bones: &[Bone], size_sigma: f64) -> Option<(f64, f64)> {
    let bone = |name: &str| bones.iter().find(|bone| bone.name == name);
    let alone = |name: &str| bone(name).map(|bone| [bone.length_mm, bone.uncertainty_mm]);
    let mean = |a: &str, b: &str| match (alone(a), alone(b)) {
        // Of a limb that is cut off the other side tells more than both.
        (Some(a), Some(b)) if a[1] > SURER * b[1] => Some(b),
        (Some(a), Some(b)) if b[1] > SURER * a[1] => Some(a),
        (Some(a), Some(b)) => Some([f64::midpoint(a[0], b[0]), f64::midpoint(a[1], b[1])]),
        (one, other) => one.or(other),
    };
    let way = [
        alone("head_throat")?,
        alone("throat_pelvis")?,
        mean("l_thigh", "r_thigh")?,
        mean("l_shank", "r_shank")?,
    ];
    let stature_mm = STATURE_OF_BONES * way.iter().map(|[length, _]| length).sum::<f64>();
    let of_bones = way.iter().map(|[_, sigma]| sigma.powi(2)).sum::<f64>().sqrt() / stature_mm;
    let sigma = if of_bones > IN_DOUBT { of_bones } else { VARIES }.hypot(size_sigma);
    STATURE_MM.contains(&stature_mm).then_some((stature_mm, sigma * stature_mm))
}
