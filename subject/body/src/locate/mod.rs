//! The default method: joint centres from the shape of a body's surface and the geodesic distances along it.
//!
//! (Yu et al. 2008) cut the body by one distance field, from the head. This method uses five, one from each extremity:
//! near its own end a limb is cut straight across, in any pose.
//!
//! 1. [`refine_ends`] moves the extremities to places that exist on every body.
//! 2. The level-set curves of each field give marks along every limb: the end of the hand, the widening into the trunk,
//!    the bend of the centre line.
//! 3. [`Landmarks`] are the centres of curves at fixed places between the marks.
//! 4. A joint is a weighted mean of landmarks. The weights add up to one, so the joint moves, turns and grows with the
//!    body; `benches/subject/learn.py` learned them.
//! 5. Bones of the two sides are given one length, and the upper ones are drawn towards the average body's.
//! 6. The feet determine left and right.

mod landmark;
mod limb;
mod model;
mod scan_faults;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use self::model::{JOINTS, Model};
use crate::{
    Estimate, Joint, Joints, Side,
    extremity::{Extremities, FarPoint},
    geodesic::{Graph, Workspace, distances, distances_from},
    mesh::Point,
};
pub use landmark::{ARM_LANDMARKS, HEAD_LANDMARKS, Half, LEG_LANDMARKS, Landmarks};
pub use limb::Sections;
pub use scan_faults::{Neck, Touching};

/// Distance between two levels of a field, in body scales.
const STEP: f64 = 0.006;

/// Index of the head among the five extremities.
pub const HEAD: usize = 0;
/// Indices of the hands.
pub const HAND: [usize; 2] = [1, 2];
/// Indices of the feet.
pub const FOOT: [usize; 2] = [3, 4];

/// The extremities of a body and the geodesic distances from each: head, two hands, two feet, the first hand on the
/// side of the first foot.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a> {
    /// Vertices of the extremities.
    pub ends: [u32; 5],
    /// One distance per vertex, in the mesh's unit; infinite if it is unreachable.
    pub distances: [&'a [f64]; 5],
    /// Distances from the top of the head as first found, if it was moved since. The neck is measured by these.
    pub first_head: Option<&'a [f64]>,
    /// Missing length of each limb, in the mesh's unit; 0 if the limb is whole. It is added to all distances from that
    /// end, as if they led to where the limb would end.
    pub missing: [f64; 5],
}

impl Fields<'_> {
    /// Distance of `vertex` from an extremity; infinite if there is no such vertex.
    fn at(&self, end: usize, vertex: usize) -> f64 {
        self.distances
            .get(end)
            .and_then(|field| field.get(vertex))
            .map_or(f64::INFINITY, |distance| distance + self.missing.get(end).unwrap_or(&0.0))
    }

    /// Distance between two extremities; none if there is no path or no such vertex.
    fn between(&self, one: usize, other: usize) -> Option<f64> {
        let vertex = *self.ends.get(other)? as usize;
        let distance = self.at(one, vertex) + self.missing.get(other)?;
        Some(distance).filter(|distance| distance.is_finite())
    }

    /// Distances between all ten pairs of extremities.
    fn pairwise(&self) -> impl Iterator<Item = Option<f64>> {
        (0..5).flat_map(move |one| (0..one).map(move |other| self.between(one, other)))
    }
}

/// Largest move of an extremity, as a fraction of the distance between the feet: within a hand or a foot, never past a
/// wrist.
const REACH: f64 = 0.15;

/// Radius of the search for the top of the head, as the same fraction.
const HEAD_REACH: f64 = 0.14;
/// Number of further searches, if the highest point lies in the outer part of the radius.
const HEAD_STEPS: usize = 3;
/// Start of the outer part, as a fraction of the radius.
const HEAD_EDGE: f64 = 0.5;
/// Vertices belong to the top of the head if they are nearer to the limbs by less than this fraction.
const CROWN: f64 = 0.03;

/// The refined extremities, with the distances from each.
#[derive(Debug, Clone)]
pub struct RefinedEnds {
    /// Vertices of head, hands and feet.
    pub vertices: [u32; 5],
    /// One distance per vertex for each extremity, in the mesh's unit; for the head, from all of its top.
    pub distances: [Vec<f64>; 5],
    /// Distances from the top of the head as first found, if it was moved since.
    pub first_head: Option<Vec<f64>>,
}

impl RefinedEnds {
    /// The fields in the form that [`Landmarks`] take.
    #[must_use]
    pub fn fields(&self) -> Fields<'_> {
        Fields {
            ends: self.vertices,
            distances: self.distances.each_ref().map(Vec::as_slice),
            first_head: self.first_head.as_deref(),
            missing: [0.0; 5],
        }
    }
}

/// Moves each extremity to the vertex nearby that is farthest from the four others together. The head becomes the whole
/// of its flat top, because the farthest vertex of it depends on the triangulation.
///
/// So a thumb becomes a fingertip and a heel a toe. `distances_from_ends` are those from [`Extremities::all`]. They are
/// computed again only for an extremity that moves to a vertex that is not among `known`.
#[must_use]
pub fn refine_ends(
    graph: &Graph,
    extremities: &Extremities,
    distances_from_ends: [Vec<f64>; 5],
    known: &[FarPoint],
    workspace: &mut Workspace,
) -> RefinedEnds {
    let vertices = extremities.all();
    let mut refined = RefinedEnds { vertices, distances: distances_from_ends, first_head: None };
    let moved = farthest(&refined.fields());
    let around = top_of_head(graph, &refined.fields(), workspace);
    let crown_of = |around: &[f64]| crown(&refined.fields(), around);
    let first = crown_of(&refined.distances[HEAD]);
    let crown = around.as_deref().map_or_else(|| first.clone(), crown_of);
    if around.is_some() && !first.is_empty() {
        refined.first_head = Some(distances_from(graph, first, workspace));
    }
    for (end, to) in moved.into_iter().enumerate() {
        if end == HEAD && !crown.is_empty() {
            refined.distances[end] = distances_from(graph, crown.iter().copied(), workspace);
        } else if to != refined.vertices[end] {
            refined.vertices[end] = to;
            let known = known.iter().find(|far| far.vertex == to);
            refined.distances[end] = match known {
                Some(far) => far.distances.clone(),
                None => distances(graph, to, workspace),
            };
        }
    }
    refined
}

/// Mean distance of a vertex from the ends of the limbs.
fn from_limbs(fields: &Fields<'_>, at: u32) -> f64 {
    (1..5).map(|end| fields.at(end, at as usize)).sum::<f64>() / 4.0
}

/// Distances from the vertex of the head farthest from the limbs, if the present one is far from it: on the forehead or
/// a temple.
fn top_of_head(graph: &Graph, fields: &Fields<'_>, workspace: &mut Workspace) -> Option<Vec<f64>> {
    let reach = HEAD_REACH * fields.between(FOOT[0], FOOT[1])?;
    let mut moved: Option<Vec<f64>> = None;
    for _ in 0..HEAD_STEPS {
        let around = moved.as_deref().unwrap_or(fields.distances[HEAD]);
        let near = (0_u32..).zip(around).filter(|(_, d)| **d < reach);
        let ranked = near.map(|(at, d)| (from_limbs(fields, at), at, *d));
        let best = ranked.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        // Only a top near the edge of the searched region may continue beyond it.
        let Some((_, top, _)) = best.filter(|(_, _, d)| *d > HEAD_EDGE * reach) else { break };
        moved = Some(distances(graph, top, workspace));
    }
    moved
}

/// The vertices of the top of the head, each with its deficit of distance from the limbs. With these offsets the
/// distances continue without a step, so the exact choice of vertices hardly matters.
fn crown(fields: &Fields<'_>, around: &[f64]) -> Vec<(u32, f64)> {
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return Vec::new() };
    let near = || (0_u32..).zip(around).filter(|(_, d)| **d < HEAD_REACH * feet);
    let most = near().map(|(at, _)| from_limbs(fields, at)).fold(0.0, f64::max);
    let starts = near().map(|(at, _)| (at, most - from_limbs(fields, at)));
    starts.filter(|(_, start)| *start < CROWN * feet).collect()
}

fn farthest(fields: &Fields<'_>) -> [u32; 5] {
    let mut found = fields.ends;
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return found };
    for (end, vertex) in found.iter_mut().enumerate().filter(|(end, _)| *end != HEAD) {
        let rest = (0..5).filter(|other| *other != end);
        let total = |at: u32| rest.clone().map(|other| fields.at(other, at as usize)).sum::<f64>();
        let near = (0_u32..).zip(fields.distances[end]).filter(|(_, d)| **d < REACH * feet);
        let ranked = near.map(|(at, _)| (total(at), at)).filter(|(d, _)| d.is_finite());
        // Ties go to the lowest index, so that every machine finds the same.
        let best = ranked.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        *vertex = best.map_or(*vertex, |(_, at)| at);
    }
    found
}

/// Index of a landmark in the forefoot, proximal to the toes.
const TOES: usize = 0;

/// Additional standard deviations of joints of a limb that touches something, in body scales: about the root mean
/// square errors on the learned shapes with limbs touching.
const SHOULDER_IN_DOUBT: f64 = 0.15;
const ELBOW_IN_DOUBT: f64 = 0.05;
const HIP_IN_DOUBT: f64 = 0.06;
const KNEE_IN_DOUBT: f64 = 0.07;
/// Additional standard deviation of every joint if the body scale is in doubt.
const SCALE_IN_DOUBT: f64 = 0.02;

/// Additional standard deviation of the head if its point is not the one farthest from the neck: the forehead or a
/// temple is at most a quarter of the head's girth away, 0.08 of stature.
const OFF_TOP: f64 = 0.05;

/// Additional standard deviation of the joints of a cut limb along it, in body scales: the missing length comes from
/// distances that change with the pose by 0.03, and the place of a stump's end by its thickness.
const OF_STUMP: f64 = 0.05;
/// Additional standard deviation of hip and shoulder of a cut limb, which landmarks of the trunk support too.
const ROOT_OF_STUMP: f64 = 0.03;
/// Minimum length of limb beyond a joint, in body scales, for the joint to be located.
const STUMP_MIN: f64 = 0.03;

/// The joints of a set of landmarks, in the frame and unit of their mesh.
#[must_use]
pub fn joints(landmarks: &Landmarks) -> Joints {
    let of = &*JOINTS;
    let arms = limbs(landmarks, 0, [&of.shoulder, &of.elbow, &of.wrist], limb::elbow_sigma);
    let arms = equalise_bones(arms, UPPER_ARM_PRIOR, of.upper_arm);
    let legs = limbs(landmarks, 1, [&of.hip, &of.knee, &of.ankle], limb::knee_sigma);
    let legs = equalise_bones(legs, THIGH_PRIOR, of.thigh);
    let toes = [0, 1].map(|side| landmarks.halves[side].leg.get(TOES).copied().unwrap_or_default());
    let left = index_of_left(legs, toes);
    let Touching { arms: arms_touch, legs: legs_touch, scale } = landmarks.touching;
    let doubt = if scale { SCALE_IN_DOUBT } else { 0.0 };
    let mut estimates = BTreeMap::new();
    let mut add = |joint: Joint, at: Point, sigma: f64| {
        let position = (at * landmarks.scale).into();
        let sigma = sigma.hypot(doubt) * landmarks.scale;
        estimates.insert(joint, Estimate { position, sigma });
    };
    let of_top = if landmarks.head_is_in_doubt() { OFF_TOP } else { 0.0 };
    // Midline joints are seen from both sides.
    let middle = |model: &Model| (landmarks.joint(model, 0) + landmarks.joint(model, 1)) / 2.0;
    add(Joint::Head, middle(&of.head), of.head.sigma.hypot(of_top));
    add(Joint::Throat, middle(&of.throat), of.throat.sigma);
    let in_doubt = |touches: bool, by: f64| if touches { by } else { 0.0 };
    // Hips depend on arm landmarks too.
    let touched = arms_touch.contains(&true) || legs_touch.contains(&true);
    let of_stumps = legs.map(|leg| leg.stump(ROOT_OF_STUMP));
    let hip_sigma = of.hip.sigma.hypot(in_doubt(touched, HIP_IN_DOUBT));
    let hip_sigma = hip_sigma.hypot(of_stumps[0].max(of_stumps[1]));
    // The errors of the two hips are about half common, half independent.
    add(Joint::Pelvis, (legs[0].root + legs[1].root) / 2.0, hip_sigma);
    for (half, (arm, leg)) in arms.iter().zip(&legs).enumerate() {
        let side = if half == left.unwrap_or(0) { Side::Left } else { Side::Right };
        let of_arm = |sigma: f64, by: f64| sigma.hypot(in_doubt(arms_touch[half], by));
        let shoulder_sigma = of_arm(of.shoulder.sigma, SHOULDER_IN_DOUBT);
        add(Joint::Shoulder(side), arm.root, shoulder_sigma.hypot(arm.stump(ROOT_OF_STUMP)));
        add(Joint::Hip(side), leg.root, hip_sigma);
        let elbow_sigma = of_arm(arm.hinge_sigma, ELBOW_IN_DOUBT);
        let knee_sigma = leg.hinge_sigma.hypot(in_doubt(legs_touch[half], KNEE_IN_DOUBT));
        let [[wrist, elbow, _], [ankle, knee, _]] = landmarks.halves[half].marks;
        for (joint, limb, at, mark, sigma) in [
            (Joint::Elbow(side), arm, arm.hinge, elbow, elbow_sigma),
            (Joint::Wrist(side), arm, arm.end, wrist, of.wrist.sigma),
            (Joint::Knee(side), leg, leg.hinge, knee, knee_sigma),
            (Joint::Ankle(side), leg, leg.end, ankle, of.ankle.sigma),
        ] {
            if limb.missing <= 0.0 || mark >= limb.missing + STUMP_MIN {
                add(joint, at, sigma.hypot(limb.stump(OF_STUMP)));
            }
        }
    }
    Joints { estimates, sides_told: left.is_some(), size_sigma: 0.0 }
}

/// An arm or a leg, in body scales.
#[derive(Debug, Clone, Copy)]
struct Limb {
    /// Shoulder or hip.
    root: Point,
    /// Elbow or knee.
    hinge: Point,
    /// Wrist or ankle.
    end: Point,
    /// Standard deviation of the hinge along the limb.
    hinge_sigma: f64,
    /// Missing length of the limb. A cut limb keeps its bones, and the other limb its own lengths.
    missing: f64,
}

impl Limb {
    /// `by` if part of the limb is missing, else 0.
    fn stump(&self, by: f64) -> f64 {
        if self.missing > 0.0 { by } else { 0.0 }
    }
}

/// Both arms (`part` 0) or both legs (1), by the models `of` their root, hinge and end.
fn limbs(landmarks: &Landmarks, part: usize, of: [&Model; 3], sigma: fn(f64) -> f64) -> [Limb; 2] {
    [0, 1].map(|side| {
        let [root, hinge, end] = of.map(|model| landmarks.joint(model, side));
        let hinge_sigma = sigma(landmarks.halves[side].sharpness[part]).hypot(of[1].sigma);
        Limb { root, hinge, end, hinge_sigma, missing: landmarks.missing[part][side] }
    })
}

/// Weight of the average body's bone length against the measured one.
///
/// Shoulder and hip lie deep, and their landmarks shift with the girth. Elbow and knee lie on a bend and were weighed
/// against the average already.
const UPPER_ARM_PRIOR: f64 = 0.6;
/// Half the optimum for bodies near the average: it costs these little and leaves others as they are.
const THIGH_PRIOR: f64 = 0.3;

/// Gives the bones of two limbs one length, and draws the upper bones towards `average`, the average body's length.
/// Joints move along their bones from the ends inwards, since outer joints are more certain.
fn equalise_bones(mut limbs: [Limb; 2], prior_weight: f64, average: f64) -> [Limb; 2] {
    let whole = limbs.map(|limb| if limb.missing > 0.0 { 0.0 } else { 1.0 });
    if whole == [0.0; 2] {
        return limbs;
    }
    let weights = [0, 1].map(|side| whole[side] * limbs[side].hinge_sigma.powi(-2));
    let length = mean(limbs.map(|limb| (limb.hinge - limb.end).norm()), weights);
    for limb in limbs.iter_mut().filter(|limb| limb.missing <= 0.0) {
        limb.hinge = at(limb.end, limb.hinge, length);
    }
    let length = mean(limbs.map(|limb| (limb.root - limb.hinge).norm()), whole);
    let length = length + prior_weight * (average - length);
    for limb in limbs.iter_mut().filter(|limb| limb.missing <= 0.0) {
        limb.root = at(limb.hinge, limb.root, length);
    }
    limbs
}

/// Weighted mean of the two sides.
fn mean([a, b]: [f64; 2], [weight_a, weight_b]: [f64; 2]) -> f64 {
    (a * weight_a + b * weight_b) / (weight_a + weight_b)
}

/// The point at distance `length` from `from` in the direction of `towards`.
fn at(from: Point, towards: Point, length: f64) -> Point {
    let bone = (towards - from).try_normalize(0.0).unwrap_or_default();
    from + bone * length
}

/// Minimum cosine of the angle between the hips' axis and the legs'; below it left and right stay unknown.
const AGREEMENT_MIN: f64 = 0.3;

/// Minimum cosine if only one foot is visible: a leg rotated outwards by 60 degrees is not evidence.
const AGREEMENT_OF_ONE_MIN: f64 = 0.5;

/// Index of the left leg; none if the feet give no answer. `toes` are points in the front of the feet.
///
/// Toes point forwards. Hip, knee and ankle bend about axes that run from right to left, so in every pose the cross
/// product of shank (upwards) and foot (forwards) points to the left.
fn index_of_left(legs: [Limb; 2], toes: [Point; 2]) -> Option<usize> {
    let with_feet = legs.iter().zip(toes).filter(|(leg, _)| leg.missing <= 0.0);
    let to_left =
        |(leg, toes): (&Limb, Point)| (leg.hinge - leg.end).cross(&(toes - leg.end)).normalize();
    let feet: Vec<Point> = with_feet.map(to_left).collect();
    let least = match feet.len() {
        0 => return None,
        1 => AGREEMENT_OF_ONE_MIN,
        _ => AGREEMENT_MIN,
    };
    // Legs rotated against each other cancel: the sum is short on purpose, and not normalised.
    let sum: Point = feet.iter().sum();
    let agreement = (legs[0].root - legs[1].root).normalize().dot(&sum) / feet.len() as f64;
    (agreement.abs() >= least).then_some(usize::from(agreement < 0.0))
}
