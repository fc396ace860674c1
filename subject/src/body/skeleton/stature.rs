//! How tall a subject stands, whatever the pose of the scan.

use super::Bone;
use super::json::STATURE_MM;

/// Stature, over the way from the crown along throat, pelvis, thigh and shank: the mean over the two average shapes of
/// `MakeHuman` in 13 poses, with the joints of the default method. It stands for the feet and for what the way leaves out.
const STATURE_OF_BONES: f64 = 1.045;
/// Standard deviation of that, as a part of stature: 0.013 on these two shapes, 0.018 at most on others.
const VARIES: f64 = 0.018;

/// Stature and its standard deviation in millimetres; nothing where a bone is missing, or of nobody's size.
pub(super) fn stature(bones: &[Bone]) -> Option<(f64, f64)> {
    let length =
        |name: &str| bones.iter().find(|bone| bone.name == name).map(|bone| bone.length_mm);
    let mean = |a: &str, b: &str| Some(f64::midpoint(length(a)?, length(b)?));
    let way = length("head_throat")?
        + length("throat_pelvis")?
        + mean("l_thigh", "r_thigh")?
        + mean("l_shank", "r_shank")?;
    let stature_mm = STATURE_OF_BONES * way;
    STATURE_MM.contains(&stature_mm).then_some((stature_mm, VARIES * stature_mm))
}
