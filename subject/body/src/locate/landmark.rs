//! Points inside the body, at places that every body has.

use nalgebra::Vector3;

use super::limb::{Marks, arm, leg};
use super::missing;
use super::neck::{self, Neck};
use super::scale::BodyScale;
use super::section::Sections;
use super::touching::Touching;
use super::{FOOT, Fields, HAND, HEAD};
use crate::Mesh;

/// How many landmarks an arm has.
pub const ARM_LANDMARKS: usize = 22;
/// How many landmarks a leg has, with the half of the trunk above it.
pub const LEG_LANDMARKS: usize = 28;
/// How many landmarks lie between the crown and the chest.
pub const HEAD_LANDMARKS: usize = 13;

/// From the crown down, in body scales.
const HEAD_LEVELS: [f64; HEAD_LANDMARKS] =
    [0.03, 0.06, 0.1, 0.14, 0.16, 0.18, 0.20, 0.22, 0.26, 0.30, 0.36, 0.42, 0.48];
/// Which of them is at the neck.
const NECK: usize = 6;
/// The head's first landmark, which lies 0.03 below what was taken for its top, is no farther than this from what is farthest
/// from the neck: 0.038 was seen of heads whose top was found, and 0.074 of one that was off by 8 % of stature.
const FROM_TOP_MOST: f64 = 0.055;
/// No more than this of a limb is missing, in body scales: an arm has 0.44 of stature with its hand, a leg 0.53 (Drillis and
/// Contini 1966), and what is left of less than 0.04 does not stand out.
const MISSING_MOST: f64 = 0.40;
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
    /// How far the first of them is from the place on the head that is farthest, straight, from the neck, in body scales.
    pub from_top: f64,
    /// The body scale, in the mesh's unit: what all is to be multiplied by.
    pub scale: f64,
    /// Which limbs touch something.
    pub touching: Touching,
    /// How much of each arm and of each leg is missing, in body scales: 0 of whole ones.
    pub missing: [[f64; 2]; 2],
    /// The girths of head and neck.
    pub neck: Neck,
}

impl Landmarks {
    /// Finds the landmarks of `mesh`. Nothing if the ends are no body's: a field that does not reach, ways between ends that
    /// contradict each other, or a limb without a centre line.
    #[must_use]
    pub fn new(mesh: &Mesh, fields: &Fields<'_>) -> Option<Self> {
        let by_ways = missing::by_ways(fields);
        let curves = Curves::new(mesh, &Fields { missing: by_ways, ..*fields })?;
        let toes = FOOT.map(|foot| {
            let end = mesh.positions.get(fields.ends[foot] as usize);
            Vector3::from(end.copied().unwrap_or_default()) / curves.scale.length
        });
        let (arms, legs) = (curves.arms.each_ref(), curves.legs.each_ref());
        let missing = missing::by_shape(fields, by_ways, arms, legs, toes);
        let fields = Fields { missing, ..*fields };
        let curves = if missing == by_ways { curves } else { Curves::new(mesh, &fields)? };
        Self::among(curves, &fields)
    }

    fn among(curves: Curves, fields: &Fields<'_>) -> Option<Self> {
        let scale = curves.scale.length;
        let hands = fields.between(HAND[0], HAND[1])? / scale;
        let missing = [HAND, FOOT].map(|pair| pair.map(|end| fields.missing[end] / scale));
        // The curves of a limb that ends early say nothing of what it touches.
        let arms = whole(&curves.arms, missing[0]);
        let touching = Touching::new(curves.scale, arms, whole(&curves.legs, missing[1]));
        let marks_of = |found: [Option<Marks>; 2], missing: [f64; 2]| {
            let [one, other] = found;
            match missing.map(|part| part > 0.0) {
                [false, false] | [true, true] => Some([one?, other?]),
                // Of a limb that ends early its marks cannot be told: they are as far from its end as the other's.
                [true, false] => other.map(|marks| [marks; 2]),
                [false, true] => one.map(|marks| [marks; 2]),
            }
        };
        let at_arms = marks_of(curves.arms.each_ref().map(|of| arm(of, hands)), missing[0])?;
        let at_legs = marks_of(curves.legs.each_ref().map(leg), missing[1])?;
        let from_top = curves.off_top();
        let [arm, other_arm] = curves.arms;
        let [leg, other_leg] = curves.legs;
        Some(Self {
            halves: [
                along(arm, at_arms[0], leg, at_legs[0]),
                along(other_arm, at_arms[1], other_leg, at_legs[1]),
            ],
            touching,
            missing,
            from_top,
            neck: curves.neck,
            head: HEAD_LEVELS.iter().map(|level| curves.head.centre_at(*level)).collect(),
            scale,
        })
    }
}

impl Landmarks {
    /// Whether head and hands have the girths of such. Where a limb is short or touches something, a hand with its wrist fits
    /// for a head with its neck by the ways between them, and the head for a hand.
    #[must_use]
    pub fn ends_may_be_right(&self) -> bool {
        let hands = self.halves.iter().all(|half| neck::may_be_a_hand(&half.sections[0].perimeter));
        hands && self.neck.may_be_a_head()
    }

    /// Whether what is missing may be, of ends that fit a body by ways only if a part of a limb is missing: there is such a part,
    /// and something is left of the limb. Otherwise an end was taken for another.
    #[must_use]
    pub fn limbs_may_be_cut(&self) -> bool {
        let parts = self.missing.as_flattened();
        parts.iter().any(|part| *part > 0.0) && parts.iter().all(|part| *part <= MISSING_MOST)
    }

    /// Whether what was taken for the top may be the forehead, a temple or an open mouth.
    #[must_use]
    pub fn head_is_in_doubt(&self) -> bool {
        self.from_top > FROM_TOP_MOST
    }
}

/// The level-set curves of all five ends.
struct Curves {
    scale: BodyScale,
    arms: [Sections; 2],
    legs: [Sections; 2],
    head: Sections,
    neck: Neck,
    /// The vertices of the head, in body scales.
    head_vertices: Vec<Vector3<f64>>,
}

impl Curves {
    fn new(mesh: &Mesh, fields: &Fields<'_>) -> Option<Self> {
        let body_scale = BodyScale::new(fields)?;
        let scale = body_scale.length;
        let not_arm = |vertex: usize| {
            HAND.iter()
                .map(|hand| share(fields.at(*hand, vertex), ARM_LENGTH * scale, scale))
                .product::<f64>()
        };
        let curves = |field: &[f64], reach: f64, weight: &dyn Fn(usize) -> f64| {
            let weights: Vec<f64> = (0..mesh.positions.len()).map(weight).collect();
            Sections::new(mesh, field, &weights, scale, reach)
        };
        let cut = |end: usize, reach: f64, weight: &dyn Fn(usize) -> f64| {
            let vertices = 0..mesh.positions.len();
            let field: Vec<f64> = vertices.map(|vertex| fields.at(end, vertex)).collect();
            curves(&field, reach, weight)
        };
        let of_hand = |side: usize| {
            let [hand, other_hand] = [HAND[side], HAND[1 - side]];
            cut(hand, ARM_REACH, &|vertex| {
                share(fields.at(other_hand, vertex), fields.at(hand, vertex), scale)
            })
        };
        let of_foot = |side: usize| {
            let [foot, other_foot] = [FOOT[side], FOOT[1 - side]];
            cut(foot, LEG_REACH, &|vertex| {
                let own = share(fields.at(other_foot, vertex), fields.at(foot, vertex), scale);
                own * not_arm(vertex)
            })
        };
        let head = cut(HEAD, HEAD_REACH, &not_arm)?;
        let first_head = match fields.first_head {
            Some(field) => &curves(field, HEAD_REACH, &not_arm)?,
            None => &head,
        };
        let on_head = (0..mesh.positions.len())
            .filter(|vertex| fields.at(HEAD, *vertex) < HEAD_LEVELS[NECK] * scale)
            .map(|vertex| Vector3::from(mesh.positions[vertex]) / scale);
        Some(Self {
            head_vertices: on_head.collect(),
            neck: Neck::new(&first_head.perimeter),
            scale: body_scale,
            arms: [of_hand(0)?, of_hand(1)?],
            legs: [of_foot(0)?, of_foot(1)?],
            head,
        })
    }
}

impl Curves {
    /// How far the head's first landmark is from the place on the head that is farthest from the neck.
    fn off_top(&self) -> f64 {
        let neck = self.head.centre_at(HEAD_LEVELS[NECK]);
        let first = self.head.centre_at(HEAD_LEVELS[0]);
        let way = |at: &&Vector3<f64>| (*at - neck).norm();
        let top = self.head_vertices.iter().max_by(|one, other| way(one).total_cmp(&way(other)));
        top.map_or(0.0, |top| (top - first).norm())
    }
}

/// The curves of limbs that do not end early.
fn whole(curves: &[Sections; 2], missing: [f64; 2]) -> [Option<&Sections>; 2] {
    [0, 1].map(|side| curves.get(side).filter(|_| missing[side] <= 0.0))
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
