//! Points inside the body, at places that every body has.

use nalgebra::Vector3;

use super::limb::{Marks, arm, leg};
use super::neck;
use super::scale::BodyScale;
use super::section::Sections;
use super::touching::Touching;
use super::{FOOT, Fields, HAND, HEAD};
use crate::body::Mesh;

/// How many landmarks an arm has.
pub const ARM_LANDMARKS: usize = 22;
/// How many landmarks a leg has, with the half of the trunk above it.
pub const LEG_LANDMARKS: usize = 28;
/// How many landmarks lie between the crown and the chest.
pub const HEAD_LANDMARKS: usize = 13;

/// From the crown down, in body scales.
const HEAD_LEVELS: [f64; HEAD_LANDMARKS] =
    [0.03, 0.06, 0.1, 0.14, 0.16, 0.18, 0.20, 0.22, 0.26, 0.30, 0.36, 0.42, 0.48];
/// The surface within this of the end of a hand, in body scales, is arm and not trunk.
const ARM_LENGTH: f64 = 0.40;
/// The curves round a hand are looked at up to the middle of the chest, in body scales.
const ARM_REACH: f64 = 0.6;
/// Those round a foot up to the neck.
const LEG_REACH: f64 = 0.96;
/// Those round the crown down to the chest.
const HEAD_REACH: f64 = 0.54;
/// Where two limbs' shares of the surface meet, one fades into the other over this, in body scales: a triangle on the
/// boundary would otherwise be all here or all there.
const FADE: f64 = 0.04;

/// The landmarks of one half of the body, in body scales.
#[derive(Debug, Clone)]
pub struct Half {
    /// From the hand to the shoulder, and beyond it into the trunk.
    pub arm: Vec<Vector3<f64>>,
    /// From the foot to the hip, and beyond it up the trunk.
    pub leg: Vec<Vector3<f64>>,
    /// How sharply the centre line bends at elbow and knee: in no unit, for how sure the joint is.
    pub sharpness: [f64; 2],
    /// The marks of the arm, then the leg: narrowing, hinge, root, in body scales from the end.
    pub marks: [[f64; 3]; 2],
    /// The level-set curves round the hand's end, and round the foot's.
    pub sections: [Sections; 2],
}

/// The landmarks of a body, each the middle of a level-set curve, in body scales.
#[derive(Debug, Clone)]
pub struct Landmarks {
    /// The side of the first hand and the first foot, and the other.
    pub halves: [Half; 2],
    /// From the crown down.
    pub head: Vec<Vector3<f64>>,
    /// The body scale, in the mesh's unit: what all is to be multiplied by.
    pub scale: f64,
    /// Which limbs touch something.
    pub touching: Touching,
    /// How much the body narrows below the head: the longest curve round the head over the shortest behind that, and 1
    /// where that is no neck.
    pub narrows: f64,
}

impl Landmarks {
    /// Finds the landmarks of `mesh`. Nothing if the ends are no body's: a field that does not reach, ways between ends that
    /// contradict each other, or a limb without a centre line.
    #[must_use]
    pub fn new(mesh: &Mesh, fields: &Fields<'_>) -> Option<Self> {
        let body_scale = BodyScale::new(fields)?;
        let scale = body_scale.length;
        let hands = fields.between(HAND[0], HAND[1])? / scale;
        let not_arm = |vertex: usize| {
            HAND.iter()
                .map(|hand| share(fields.at(*hand, vertex), ARM_LENGTH * scale, scale))
                .product::<f64>()
        };
        let cut = |field: &[f64], reach: f64, weight: &dyn Fn(usize) -> f64| {
            let weights: Vec<f64> = (0..mesh.positions.len()).map(weight).collect();
            Sections::new(mesh, field, &weights, scale, reach)
        };
        let half = |side: usize| {
            let [hand, other_hand] = [HAND[side], HAND[1 - side]];
            let of_hand = cut(fields.distances[hand], ARM_REACH, &|vertex| {
                share(fields.at(other_hand, vertex), fields.at(hand, vertex), scale)
            })?;
            let [foot, other_foot] = [FOOT[side], FOOT[1 - side]];
            let of_foot = cut(fields.distances[foot], LEG_REACH, &|vertex| {
                let own = share(fields.at(other_foot, vertex), fields.at(foot, vertex), scale);
                own * not_arm(vertex)
            })?;
            let (at_arm, at_leg) = (arm(&of_hand, hands)?, leg(&of_foot)?);
            Some(along(of_hand, at_arm, of_foot, at_leg))
        };
        let of_head = cut(fields.distances[HEAD], HEAD_REACH, &not_arm)?;
        let halves = [half(0)?, half(1)?];
        let limbs = |limb: usize| halves.each_ref().map(|half| &half.sections[limb]);
        let touching = Touching::new(body_scale, limbs(0), limbs(1));
        Some(Self {
            halves,
            touching,
            narrows: neck::narrows(&of_head.perimeter),
            head: HEAD_LEVELS.iter().map(|level| of_head.centre_at(*level)).collect(),
            scale,
        })
    }
}

/// 1 where `far` is well beyond `near`, 0 where it is well before, and between them in between.
fn share(far: f64, near: f64, scale: f64) -> f64 {
    let share = 0.5 + (far - near) / (FADE * scale);
    // A vertex that neither reaches has no difference.
    if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
}

fn along(arm: Sections, at_arm: Marks, leg: Sections, at_leg: Marks) -> Half {
    let Marks { narrow: w, hinge: e, root: a, .. } = at_arm;
    let (forearm, upper) = (e - w, a - e);
    let arm_levels: [f64; ARM_LANDMARKS] = [
        w - 0.04,
        w - 0.02,
        w - 0.01,
        w,
        w + 0.01,
        w + 0.02,
        w + 0.04,
        w + 0.5 * forearm,
        e - 0.04,
        e - 0.02,
        e,
        e + 0.02,
        e + 0.04,
        e + 0.5 * upper,
        a - 0.04,
        a - 0.02,
        a,
        a + 0.02,
        a + 0.04,
        a + 0.07,
        a + 0.10,
        a + 0.14,
    ];
    let Marks { narrow: n, hinge: k, root: g, .. } = at_leg;
    let leg_levels: [f64; LEG_LANDMARKS] = [
        0.05,
        0.08,
        0.10,
        n - 0.02,
        n - 0.01,
        n,
        n + 0.02,
        n + 0.04,
        n + 0.08,
        k - 0.06,
        k - 0.03,
        k - 0.015,
        k,
        k + 0.015,
        k + 0.03,
        k + 0.06,
        g - 0.12,
        g - 0.08,
        g - 0.04,
        g,
        g + 0.02,
        g + 0.04,
        g + 0.08,
        g + 0.12,
        g + 0.16,
        g + 0.22,
        g + 0.28,
        g + 0.34,
    ];
    Half {
        arm: arm_levels.iter().map(|level| arm.centre_at(*level)).collect(),
        leg: leg_levels.iter().map(|level| leg.centre_at(*level)).collect(),
        sharpness: [at_arm.sharpness, at_leg.sharpness],
        marks: [[w, e, a], [n, k, g]],
        sections: [arm, leg],
    }
}
