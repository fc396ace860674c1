//! Bodies with longer and shorter bones: the surface is stretched along the bones, and the joints with it.

use std::collections::BTreeMap;

use mocapd_body::Mesh;
use nalgebra::Vector3;

/// Known joint positions by name.
pub(crate) type Truth = BTreeMap<String, [f64; 3]>;

/// Factors by which bones are stretched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lengths {
    pub(crate) upper_arm: f64,
    pub(crate) forearm: f64,
    pub(crate) thigh: f64,
    pub(crate) shank: f64,
    pub(crate) foot: f64,
}

impl Lengths {
    pub(crate) const SAME: Self =
        Self { upper_arm: 1.0, forearm: 1.0, thigh: 1.0, shank: 1.0, foot: 1.0 };
}

/// Radius around a joint within which the surface determines the distance between joint and extremity, in units of
/// `scale`.
const ROUND: f64 = 0.06;

/// Stretches the bones of all limbs. Everything farther out moves along; the trunk stays.
pub(crate) fn stretched(
    mesh: &Mesh,
    truth: &Truth,
    fields: &[Vec<f64>; 5],
    scale: f64,
    lengths: &Lengths,
) -> (Mesh, Truth) {
    let (mut changed, mut joints) = (mesh.clone(), truth.clone());
    let arm = ["shoulder", "elbow", "wrist", "mcp3"];
    let leg = ["hip", "knee", "ankle", "toe"];
    let by =
        [[lengths.upper_arm, lengths.forearm, 1.0], [lengths.thigh, lengths.shank, lengths.foot]];
    for (end, field) in fields.iter().enumerate().skip(1) {
        let (names, by) = if end < 3 { (arm, by[0]) } else { (leg, by[1]) };
        // The limb whose outer joint is nearest to the source of this distance field.
        let outer = |side: &str| level(mesh, field, truth, &format!("{}.{side}", names[2]), scale);
        let side = if outer("L") < outer("R") { "L" } else { "R" };
        let names = names.map(|name| format!("{name}.{side}"));
        let at = names.clone().map(|name| Vector3::from(truth[&name]));
        let mut levels = names.clone().map(|name| level(mesh, field, truth, &name, scale));
        levels[3] = 0.0;
        for bone in 0..3 {
            let longer = (at[bone + 1] - at[bone]) * (by[bone] - 1.0);
            let span = (levels[bone] - levels[bone + 1]).max(f64::MIN_POSITIVE);
            for (position, distance) in changed.positions.iter_mut().zip(field) {
                let part = ((levels[bone] - distance) / span).clamp(0.0, 1.0);
                *position = (Vector3::from(*position) + longer * part).into();
            }
            for name in &names[bone + 1..] {
                let moved = Vector3::from(joints[name]) + longer;
                joints.insert(name.clone(), moved.into());
            }
        }
    }
    (changed, joints)
}

/// Mean distance of the surface around a joint from the extremity.
fn level(mesh: &Mesh, field: &[f64], truth: &Truth, joint: &str, scale: f64) -> f64 {
    let at = Vector3::from(truth[joint]);
    let (mut sum, mut count) = (0.0, 0.0);
    for (position, distance) in mesh.positions.iter().zip(field) {
        let far = (Vector3::from(*position) - at).norm() / scale;
        let weight = (1.0 - far / (2.0 * ROUND)).max(0.0);
        sum += weight * distance;
        count += weight;
    }
    sum / count
}
