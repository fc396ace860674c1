//! Landmarks: points inside the body, at places that exist on every body.

use super::limb::{Marks, Sections, arm, leg};
use super::model::{LandmarkGroup, Model};
use super::scan_faults::{BodyScale, Neck, Touching};
use super::{FOOT, Fields, HAND, HEAD, scan_faults};
use crate::Mesh;
use crate::mesh::Point;

/// Number of landmarks of an arm.
pub const ARM_LANDMARKS: usize = BY_WRIST.len() + 1 + BY_ELBOW.len() + 1 + BY_ARMPIT.len();
/// Number of landmarks of a leg, with its half of the trunk.
pub const LEG_LANDMARKS: usize = OF_FOOT.len() + BY_ANKLE.len() + BY_KNEE.len() + BY_GROIN.len();
/// Number of landmarks between crown and chest.
pub const HEAD_LANDMARKS: usize = 13;

/// Distances of the head's landmarks from the crown, in body scales.
const HEAD_LEVELS: [f64; HEAD_LANDMARKS] =
    [0.03, 0.06, 0.1, 0.14, 0.16, 0.18, 0.20, 0.22, 0.26, 0.30, 0.36, 0.42, 0.48];
/// Index of the landmark at the neck.
const NECK: usize = 6;
/// Largest distance of the head's first landmark, which lies 0.03 below its presumed top, from the point farthest from
/// the neck: 0.038 was measured with the correct top, 0.074 with one off by 8 % of stature.
const FROM_TOP_MAX: f64 = 0.055;
/// Largest missing length of a limb, in body scales: an arm has 0.44 of stature with its hand, a leg 0.53 (Drillis and
/// Contini 1966), and a remainder of less than 0.04 does not protrude.
const MISSING_MAX: f64 = 0.40;
/// The surface within this distance of the end of a hand belongs to the arm, in body scales.
const ARM_LENGTH: f64 = 0.40;
/// Curves of a hand reach to the middle of the chest, in body scales.
const ARM_REACH: f64 = 0.6;
/// Curves of a foot reach to the neck.
const LEG_REACH: f64 = 0.96;
/// Curves of the crown reach to the chest.
const HEAD_REACH: f64 = 0.54;
/// Width of the transition between the regions of two limbs, in body scales, so that no triangle on the boundary is all
/// or nothing.
const FADE: f64 = 0.04;

/// The landmarks of one half of the body, in body scales.
#[derive(Debug, Clone)]
pub struct Half {
    /// From the hand to the shoulder and into the trunk.
    pub arm: Vec<Point>,
    /// From the foot to the hip and up the trunk.
    pub leg: Vec<Point>,
    /// Sharpness of the centre line's bend at elbow and knee, dimensionless: determines the standard deviation of the
    /// joint.
    pub sharpness: [f64; 2],
    /// Marks of arm and leg (wrist or ankle, hinge, root), in body scales from the end.
    pub marks: [[f64; 3]; 2],
    /// Level-set curves of the hand and of the foot.
    pub sections: [Sections; 2],
}

/// The landmarks of a body, each the centre of a level-set curve, in body scales.
#[derive(Debug, Clone)]
pub struct Landmarks {
    /// The side of the first hand and foot, and the other.
    pub halves: [Half; 2],
    /// From the crown down.
    pub head: Vec<Point>,
    /// Straight distance of the first of them from the point of the head farthest from the neck, in body scales.
    pub from_top: f64,
    /// Body scale, in the mesh's unit: the factor for all lengths here.
    pub scale: f64,
    /// Which limbs touch something.
    pub touching: Touching,
    /// Missing length of each arm and leg, in body scales; 0 if whole.
    pub missing: [[f64; 2]; 2],
    /// Girths of head and neck.
    pub neck: Neck,
}

impl Landmarks {
    /// Finds the landmarks of `mesh`. `None` if the extremities cannot be those of a body: one is unreachable,
    /// distances are contradictory, or a limb has no centre line.
    #[must_use]
    pub fn new(mesh: &Mesh, fields: &Fields<'_>) -> Option<Self> {
        let from_distances = scan_faults::missing_by_distances(fields);
        let curves = Curves::new(mesh, &Fields { missing: from_distances, ..*fields })?;
        let toes = FOOT.map(|foot| mesh.point(fields.ends[foot]) / curves.scale.length);
        let (arms, legs) = (curves.arms.each_ref(), curves.legs.each_ref());
        let missing = scan_faults::missing_by_shape(fields, from_distances, arms, legs, toes);
        let fields = Fields { missing, ..*fields };
        let curves = if missing == from_distances { curves } else { Curves::new(mesh, &fields)? };
        Self::from_curves(curves, &fields)
    }

    fn from_curves(curves: Curves, fields: &Fields<'_>) -> Option<Self> {
        let scale = curves.scale.length;
        let hands = fields.between(HAND[0], HAND[1])? / scale;
        let missing = [HAND, FOOT].map(|pair| pair.map(|end| fields.missing[end] / scale));
        // The curves of a cut limb give no evidence of contact.
        let arms = whole(&curves.arms, missing[0]);
        let touching = Touching::new(curves.scale, arms, whole(&curves.legs, missing[1]));
        let marks_of = |found: [Option<Marks>; 2], missing: [f64; 2]| {
            let [one, other] = found;
            match missing.map(|part| part > 0.0) {
                [false, false] | [true, true] => Some([one?, other?]),
                // A cut limb gives no marks; it takes those of the other.
                [true, false] => other.map(|marks| [marks; 2]),
                [false, true] => one.map(|marks| [marks; 2]),
            }
        };
        let at_arms = marks_of(curves.arms.each_ref().map(|of| arm(of, hands)), missing[0])?;
        let at_legs = marks_of(curves.legs.each_ref().map(leg), missing[1])?;
        let from_top = curves.distance_from_top();
        let [arm, other_arm] = curves.arms;
        let [leg, other_leg] = curves.legs;
        Some(Self {
            halves: [
                half_landmarks(arm, at_arms[0], leg, at_legs[0]),
                half_landmarks(other_arm, at_arms[1], other_leg, at_legs[1]),
            ],
            touching,
            missing,
            from_top,
            neck: curves.neck,
            head: HEAD_LEVELS.iter().map(|level| curves.head.centre_at(*level)).collect(),
            scale,
        })
    }

    /// Position of a joint as seen from one side of the body, in body scales.
    pub(super) fn joint(&self, model: &Model, side: usize) -> Point {
        let [one, other] = &self.halves;
        let (own, other) = if side == 0 { (one, other) } else { (other, one) };
        let mut sum = Point::zeros();
        for span in &model.spans {
            let points = match span.part {
                LandmarkGroup::Arm => &own.arm,
                LandmarkGroup::OtherArm => &other.arm,
                LandmarkGroup::Leg => &own.leg,
                LandmarkGroup::OtherLeg => &other.leg,
                LandmarkGroup::Head => &self.head,
            };
            for (weight, point) in span.weights.iter().zip(points.iter().skip(span.first)) {
                sum += point * *weight;
            }
        }
        sum
    }

    /// Whether head and hands have plausible girths. On a body with a short limb or a contact, a hand with its wrist
    /// can fit for a head with its neck by the distances, and the head for a hand.
    #[must_use]
    pub fn ends_may_be_right(&self) -> bool {
        let hands =
            self.halves.iter().all(|half| scan_faults::may_be_a_hand(&half.sections[0].perimeter));
        hands && self.neck.may_be_a_head()
    }

    /// Whether the missing parts are plausible, for extremities that fit a body only if part of a limb is missing: some
    /// part is missing, and some of the limb is left. Otherwise an extremity was mistaken for another.
    #[must_use]
    pub fn limbs_may_be_cut(&self) -> bool {
        let parts = self.missing.as_flattened();
        parts.iter().any(|part| *part > 0.0) && parts.iter().all(|part| *part <= MISSING_MAX)
    }

    /// Whether the presumed top of the head may be the forehead, a temple or an open mouth.
    #[must_use]
    pub fn head_is_in_doubt(&self) -> bool {
        self.from_top > FROM_TOP_MAX
    }
}

/// The level-set curves of all five extremities.
struct Curves {
    scale: BodyScale,
    arms: [Sections; 2],
    legs: [Sections; 2],
    head: Sections,
    neck: Neck,
    /// The vertices of the head, in body scales.
    head_vertices: Vec<Point>,
}

impl Curves {
    fn new(mesh: &Mesh, fields: &Fields<'_>) -> Option<Self> {
        let body_scale = BodyScale::new(fields)?;
        let scale = body_scale.length;
        let all = 0..mesh.positions.len();
        let not_arm = |vertex: usize| {
            let beyond = |hand: usize| share(fields.at(hand, vertex), ARM_LENGTH * scale, scale);
            HAND.into_iter().map(beyond).product::<f64>()
        };
        let own = |end: usize, other: usize, vertex: usize| {
            share(fields.at(other, vertex), fields.at(end, vertex), scale)
        };
        let cut = |field: &[f64], reach: f64, weight: &dyn Fn(usize) -> f64| {
            let weights: Vec<f64> = all.clone().map(weight).collect();
            Sections::new(mesh, field, &weights, scale, reach)
        };
        let field = |end: usize| all.clone().map(|at| fields.at(end, at)).collect::<Vec<f64>>();
        let of_hand = |hand: usize, other: usize| {
            cut(&field(hand), ARM_REACH, &|vertex| own(hand, other, vertex))
        };
        let of_foot = |foot: usize, other: usize| {
            cut(&field(foot), LEG_REACH, &|vertex| own(foot, other, vertex) * not_arm(vertex))
        };
        let head = cut(&field(HEAD), HEAD_REACH, &not_arm)?;
        let first_head = match fields.first_head {
            Some(field) => &cut(field, HEAD_REACH, &not_arm)?,
            None => &head,
        };
        let on_head = all
            .clone()
            .filter(|vertex| fields.at(HEAD, *vertex) < HEAD_LEVELS[NECK] * scale)
            .map(|vertex| mesh.point(vertex as u32) / scale);
        Some(Self {
            head_vertices: on_head.collect(),
            neck: Neck::new(&first_head.perimeter),
            scale: body_scale,
            arms: [of_hand(HAND[0], HAND[1])?, of_hand(HAND[1], HAND[0])?],
            legs: [of_foot(FOOT[0], FOOT[1])?, of_foot(FOOT[1], FOOT[0])?],
            head,
        })
    }

    /// Distance of the head's first landmark from the point of the head farthest from the neck.
    fn distance_from_top(&self) -> f64 {
        let neck = self.head.centre_at(HEAD_LEVELS[NECK]);
        let first = self.head.centre_at(HEAD_LEVELS[0]);
        let far = |at: &&Point| (*at - neck).norm();
        let top = self.head_vertices.iter().max_by(|one, other| far(one).total_cmp(&far(other)));
        top.map_or(0.0, |top| (top - first).norm())
    }
}

/// The curves of whole limbs.
fn whole(curves: &[Sections; 2], missing: [f64; 2]) -> [Option<&Sections>; 2] {
    [0, 1].map(|side| curves.get(side).filter(|_| missing[side] <= 0.0))
}

/// Smooth step from 0 to 1 as `far` grows past `near`.
fn share(far: f64, near: f64, scale: f64) -> f64 {
    let share = 0.5 + (far - near) / (FADE * scale);
    // NaN for a vertex that neither end reaches.
    if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
}

/// Places of an arm's landmarks relative to wrist, elbow and armpit, in body scales.
const BY_WRIST: [f64; 7] = [-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04];
const BY_ELBOW: [f64; 5] = [-0.04, -0.02, 0.0, 0.02, 0.04];
const BY_ARMPIT: [f64; 8] = [-0.04, -0.02, 0.0, 0.02, 0.04, 0.07, 0.10, 0.14];
/// Places of a leg's landmarks from the end of the foot and relative to ankle, knee and groin.
const OF_FOOT: [f64; 3] = [0.05, 0.08, 0.10];
const BY_ANKLE: [f64; 6] = [-0.02, -0.01, 0.0, 0.02, 0.04, 0.08];
const BY_KNEE: [f64; 7] = [-0.06, -0.03, -0.015, 0.0, 0.015, 0.03, 0.06];
const BY_GROIN: [f64; 12] =
    [-0.12, -0.08, -0.04, 0.0, 0.02, 0.04, 0.08, 0.12, 0.16, 0.22, 0.28, 0.34];

fn half_landmarks(arm: Sections, at_arm: Marks, leg: Sections, at_leg: Marks) -> Half {
    let Marks { narrow: wrist, hinge: elbow, root: armpit, .. } = at_arm;
    let Marks { narrow: ankle, hinge: knee, root: groin, .. } = at_leg;
    let arm_levels = (BY_WRIST.map(|by| wrist + by).into_iter())
        .chain([wrist + 0.5 * (elbow - wrist)])
        .chain(BY_ELBOW.map(|by| elbow + by))
        .chain([elbow + 0.5 * (armpit - elbow)])
        .chain(BY_ARMPIT.map(|by| armpit + by));
    let leg_levels = (OF_FOOT.into_iter())
        .chain(BY_ANKLE.map(|by| ankle + by))
        .chain(BY_KNEE.map(|by| knee + by))
        .chain(BY_GROIN.map(|by| groin + by));
    Half {
        arm: arm_levels.map(|level| arm.centre_at(level)).collect(),
        leg: leg_levels.map(|level| leg.centre_at(level)).collect(),
        sharpness: [at_arm.sharpness, at_leg.sharpness],
        marks: [[wrist, elbow, armpit], [ankle, knee, groin]],
        sections: [arm, leg],
    }
}
