//! Joints where rings are least round (Yu et al. 2008, sections 6 and 7).

use super::minima::{minima, smoothed};
use super::{StopRule, extremity_points, head_by_symmetry};
use crate::extremity::Extremities;
use crate::geodesic::{Adjacency, Graph, Workspace, distances};
use crate::level::{Rings, cut, even_levels};
use crate::reeb::{Reeb, Segments};
use crate::{Estimate, Joint, Joints, Mesh, Refusal, Side};

/// n of algorithm 2, which the paper does not give.
pub(crate) const LEVEL_COUNT: u32 = 100;
/// A minimum nearer to an end of its segment than this part of it is no joint: the rings there are cut askew.
const MARGIN: f64 = 0.1;

/// What is expected of the distance to the true centre, as a part of the longest way from the head: the root mean square
/// over the two average shapes of `MakeHuman` in 13 poses, of which that way is the stature, to a few per cent
/// (`cargo run -p mocapd-body --example bodies paper`).
fn sigma(joint: Joint) -> f64 {
    match joint {
        Joint::Head => 0.043,
        Joint::Throat => 0.058,
        Joint::Pelvis => 0.081,
        Joint::Shoulder(_) => 0.058,
        Joint::Elbow(_) => 0.088,
        Joint::Wrist(_) => 0.056,
        Joint::Hip(_) => 0.067,
        Joint::Knee(_) => 0.042,
        Joint::Ankle(_) => 0.166,
    }
}

/// What the paper's method gives for a mesh.
#[derive(Debug, Clone)]
pub struct Paper {
    /// Its joints; those without a minimum are missing.
    pub joints: Joints,
    /// The ends that it was given or found.
    pub extremities: Extremities,
    /// The rings of the distance from the head.
    pub rings: Rings,
    /// How they hang together.
    pub reeb: Reeb,
    /// The five segments.
    pub segments: Segments,
}

/// The paper's method on `mesh`, from the vertex `start` of algorithm 1 on, or with ends that are known already.
///
/// The reading of what the paper leaves open: shoulder and hip are where arm and leg begin; elbow and wrist, knee and
/// ankle are the two deepest minima of the smoothed circularity inside the segment, in order; the throat is the deepest
/// of the trunk above the armpits, the pelvis its last ring.
///
/// # Errors
///
/// [`Refusal::TooFewEnds`]: algorithm 1 ended with other than five points. [`Refusal::Contact`]: the Reeb graph is not
/// that of a body. [`Refusal::BrokenMesh`] as [`Adjacency::new`] says.
pub fn joints(mesh: &Mesh, start: u32, known: Option<Extremities>) -> Result<Paper, Refusal> {
    let adjacency = Adjacency::new(mesh)?;
    let graph = Graph::along_edges(mesh, &adjacency);
    let mut workspace = Workspace::default();
    let extremities = match known {
        Some(known) => known,
        None => ends(&graph, start, &mut workspace)?,
    };
    let field = distances(&graph, extremities.head, &mut workspace);
    let rings = cut(mesh, &adjacency, &field, even_levels(&field, LEVEL_COUNT));
    let [_, tips @ ..] = extremities.all();
    let reeb = Reeb::new(mesh, &adjacency, &rings, &tips);
    let segments = Segments::new(&reeb, &rings)?;
    let mut joints = Joints::default();
    let longest = field.iter().copied().filter(|far| far.is_finite()).fold(0.0, f64::max);
    let mut put = |joint: Joint, position: Option<[f64; 3]>| {
        if let Some(position) = position {
            joints.estimates.insert(joint, Estimate { position, sigma: sigma(joint) * longest });
        }
    };
    for (at, side) in [Side::Left, Side::Right].into_iter().enumerate() {
        let (arm, leg) = (&segments.arms[at], &segments.legs[at]);
        let [elbow, wrist] = two_deepest(&rings, arm);
        let [knee, ankle] = two_deepest(&rings, leg);
        put(Joint::Shoulder(side), arm.first().map(|ring| mean(&rings, *ring)));
        put(Joint::Elbow(side), elbow);
        put(Joint::Wrist(side), wrist);
        put(Joint::Hip(side), leg.first().map(|ring| mean(&rings, *ring)));
        put(Joint::Knee(side), knee);
        put(Joint::Ankle(side), ankle);
    }
    let armpit = segments.armpits[0].min(segments.armpits[1]);
    let level = |ring: &u32| rings.values[rings.rings[*ring as usize].level as usize];
    let upper = segments.trunk.iter().copied().take_while(|ring| level(ring) < armpit);
    let upper: Vec<u32> = upper.collect();
    put(Joint::Throat, inside(&rings, &upper).first().map(|ring| mean(&rings, *ring)));
    put(Joint::Pelvis, segments.trunk.last().map(|ring| mean(&rings, *ring)));
    put(Joint::Head, mesh.positions.get(extremities.head as usize).copied());
    Ok(Paper { joints, extremities, rings, reeb, segments })
}

/// The five ends, from the vertex `start` on.
pub(super) fn ends(
    graph: &Graph,
    start: u32,
    workspace: &mut Workspace,
) -> Result<Extremities, Refusal> {
    let points = extremity_points(graph, start, StopRule::Corrected, workspace);
    let ends: [u32; 5] = points
        .try_into()
        .map_err(|points: Vec<u32>| Refusal::TooFewEnds { found: points.len() })?;
    let fields = ends.map(|end| distances(graph, end, workspace));
    Ok(head_by_symmetry(ends, &fields))
}

/// The two deepest minima inside a limb, (6), the nearer to the trunk first.
fn two_deepest(rings: &Rings, limb: &[u32]) -> [Option<[f64; 3]>; 2] {
    let mut two: Vec<u32> = inside(rings, limb).into_iter().take(2).collect();
    two.sort_by_key(|ring| rings.rings[*ring as usize].level);
    [0, 1].map(|at| two.get(at).map(|ring| mean(rings, *ring)))
}

/// The rings of a segment where its circularity has a minimum, the deepest first, without those near its ends.
fn inside(rings: &Rings, segment: &[u32]) -> Vec<u32> {
    let curve: Vec<f64> =
        segment.iter().map(|ring| rings.rings[*ring as usize].circularity()).collect();
    let last = curve.len() as f64;
    let within = |at: usize| (MARGIN * last..(1.0 - MARGIN) * last).contains(&(at as f64));
    let found = minima(&smoothed(&curve)).into_iter().filter(|(at, _)| within(*at));
    found.map(|(at, _)| segment[at]).collect()
}

/// (7): the mean of a ring's points.
fn mean(rings: &Rings, ring: u32) -> [f64; 3] {
    rings.rings[ring as usize].mean_point()
}
