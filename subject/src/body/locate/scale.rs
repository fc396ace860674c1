//! How large the body is, in no unit and whatever the pose.

use super::{FOOT, Fields};

/// How long, in body scales, the way between the feet is on an upright body.
const FEET: f64 = 1.09;
/// How long all ways between two of the five ends are together, each counted once.
const ALL: f64 = 10.3;

/// The body scale, in the mesh's unit: about the stature.
///
/// The mean of two lengths of the surface, each divided by what it is to the stature on a body of average build. The way
/// between the feet changes by 5 % with the pose, the sum of all ten ways by 3 %, and both hardly with the girth.
/// Nothing where an end cannot be reached from another, or two are the same.
pub(super) fn body_scale(fields: &Fields<'_>) -> Option<f64> {
    let feet = fields.between(FOOT[0], FOOT[1])?;
    let mut all = 0.0;
    for one in 0..5 {
        for other in 0..one {
            all += fields.between(one, other).filter(|way| *way > 0.0)?;
        }
    }
    let scale = f64::midpoint(feet / FEET, all / ALL);
    (scale.is_finite() && scale > 0.0).then_some(scale)
}
