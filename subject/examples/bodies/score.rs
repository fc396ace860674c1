//! Whether an end is what it is named.

use mocapd_subject::body::Mesh;
use mocapd_subject::body::extremity::Extremities;

use crate::read::Truth;

/// A joint at the end of a limb lies within this part of the stature of the end.
const NEAR_MAX: f64 = 0.12;
/// The same where only a joint farther up is known: the wrist is a hand away, the ankle a foot, the neck a head.
const FARTHER_MAX: f64 = 0.16;

/// What is known of the ends of a body: each kind with the joints that may stand for it, and how near they must be.
const KINDS: [(&str, [(&str, f64); 2]); 3] = [
    ("head", [("head_top", NEAR_MAX), ("head", FARTHER_MAX)]),
    ("hand", [("mcp3", NEAR_MAX), ("wrist", FARTHER_MAX)]),
    ("foot", [("toe", NEAR_MAX), ("ankle", FARTHER_MAX)]),
];

/// Whether every end is of its kind, and the ends of a pair on two sides. None if nothing is known of the mesh.
pub(crate) fn right(mesh: &Mesh, truth: &Truth, ends: &Extremities) -> Option<bool> {
    truth.joints.as_ref()?;
    let at = |vertex: u32| mesh.positions[vertex as usize];
    let head = near(truth, 0, "", at(ends.head));
    let pair = |kind: usize, [a, b]: [u32; 2]| {
        let sides = |one, other| near(truth, kind, one, at(a)) && near(truth, kind, other, at(b));
        sides(".L", ".R") || sides(".R", ".L")
    };
    Some(head && pair(1, ends.hands) && pair(2, ends.feet))
}

fn near(truth: &Truth, kind: usize, side: &str, end: [f64; 3]) -> bool {
    let Some(joints) = &truth.joints else { return false };
    let known = |name: &str| joints.get(&format!("{name}{side}"));
    KINDS[kind].1.iter().any(|(name, most)| {
        known(name).is_some_and(|joint| distance(*joint, end) <= most * truth.stature_m)
    }) || (kind == 0
        && joints.len() < 15
        && known("neck").is_some_and(|neck| distance(*neck, end) < 0.25 * truth.stature_m))
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}
