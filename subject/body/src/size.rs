//! Whether a body is as tall as the ways along its surface say: held against its volume.
//!
//! Where limbs have grown together with the trunk, as of somebody who crouches with the arms around the knees, ways lead across
//! and are too short, all of them together: the body comes out shorter than it is, and nothing in the ways shows it. Its volume
//! is as it was.

use super::geometry::{cross, dot, sub};
use super::{Estimate, Joint, Joints, Mesh, Note};

/// The cube root of a body's volume over its body scale: of an adult of 1.72 m and 24 kg/m^2 at a density of 1.0, 0.241 of
/// stature, which is 0.98 of the scale.
const VOLUME_ROOT: f64 = 0.235;
/// In contact a body that is stouter than that by more, as a logarithm, is in doubt: by a weight of 1.27 times the mean, a
/// body mass index above 30.
const STOUT_IN_CONTACT: f64 = 0.08;
/// Without a sign of contact: a body mass index above 50.
const STOUT: f64 = 0.25;

/// By how much the body may be taller than its ways say, as a part of them; nothing where its volume is that of its size.
pub(super) fn too_short(mesh: &Mesh, scale: f64, in_contact: bool) -> Option<f64> {
    let stout = (volume(mesh).cbrt() / (scale * VOLUME_ROOT)).ln();
    let most = if in_contact { STOUT_IN_CONTACT } else { STOUT };
    // A stout body in contact may be stout, or too short: nothing tells which.
    (stout > most).then_some(stout)
}

/// Makes the joints as unsure as a body is that may be taller by such a part.
pub(super) fn doubt(joints: &mut Joints, scale: f64, by: f64) -> Note {
    joints.size_sigma = by;
    for (joint, Estimate { sigma, .. }) in &mut joints.estimates {
        *sigma = sigma.hypot(by * from_end(*joint) * scale);
    }
    let text = format!(
        "the body is stouter than people of the size that its surface tells, as where limbs have grown together with the \
         trunk: it may be taller by {:.0} %, and all lengths with it; scan with limbs apart",
        100.0 * by
    );
    Note::new("size-unsure", text)
}

/// How far a joint is from the end that it is measured from, in body scales: so much of a wrong scale shows in its place.
fn from_end(joint: Joint) -> f64 {
    match joint {
        Joint::Head => 0.03,
        Joint::Wrist(_) => 0.10,
        Joint::Ankle(_) => 0.13,
        Joint::Throat => 0.20,
        Joint::Elbow(_) => 0.25,
        Joint::Knee(_) => 0.35,
        Joint::Shoulder(_) => 0.40,
        Joint::Hip(_) | Joint::Pelvis => 0.56,
    }
}

fn volume(mesh: &Mesh) -> f64 {
    let origin = mesh.positions.first().copied().unwrap_or_default();
    let of = |corners: &[u32; 3]| {
        let [a, b, c] = corners
            .map(|at| sub(mesh.positions.get(at as usize).copied().unwrap_or(origin), origin));
        dot(a, cross(b, c)) / 6.0
    };
    mesh.triangles.iter().map(of).sum::<f64>().max(0.0)
}
