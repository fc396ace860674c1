//! The method of Yu et al. (2008) as printed, for comparison with the default method.
//!
//! 1. Geodesic distances are Dijkstra's along edges, the extremities those of algorithm 1, and the head is found by
//!    symmetry alone.
//!
//! 2. Algorithm 2: the distance from the head is cut at even levels. The Reeb graph of the level-set curves gives
//!    trunk, arms and legs.
//!
//! 3. A joint is the centroid (equation 7) of a curve whose circularity (equation 5) has a local minimum (equation 6):
//!    near a joint the ends of the bones make the section irregular, in the middle of a bone the muscles make it round.
//!
//! What the paper leaves open is read in the plainest way, and the reading is documented where it is applied.
//! The printed rules on shapes whose results can be derived by hand.
//!
//! 1. Geodesic distances are Dijkstra's along edges, the extremities those of algorithm 1, and the head is found by
//!    symmetry alone.
//!
//! 2. Algorithm 2: the distance from the head is cut at even levels. The Reeb graph of the level-set curves gives
//!    trunk, arms and legs.
//!
//! 3. A joint is the centroid (equation 7) of a curve whose circularity (equation 5) has a local minimum (equation 6):
//!    near a joint the ends of the bones make the section irregular, in the middle of a bone the muscles make it round.
//!
//! What the paper leaves open is read in the plainest way, and the reading is documented where it is applied.

use crate::{
    Estimate, Joint, Joints, Mesh, Refusal, Side,
    extremity::Extremities,
    geodesic::{Adjacency, Graph, Workspace, distances},
    level::Rings,
    mesh::distance,
    reeb::Levels,
};

/// A minimum within this fraction of a segment's length from its end is not a joint, since curves are cut obliquely
/// there.
const MARGIN: f64 = 0.1;

/// Expected error of each joint as a fraction of the longest distance from the head, which equals stature to a few per
/// cent: the root mean square over the two average shapes of `MakeHuman` in 13 poses (`cargo run -p mocapd-body
/// --example bodies paper`).
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

/// Result of the published method.
#[derive(Debug, Clone)]
pub struct PaperResult {
    /// Joints; those without a minimum are missing.
    pub joints: Joints,
    /// The extremities, given or found.
    pub extremities: Extremities,
    /// Level sets of the distance from the head, their Reeb graph, and the five segments.
    pub levels: Levels,
}

/// Runs the published method on `mesh`, with algorithm 1 starting at vertex `start`, or with known extremities.
///
/// Reading of what the paper leaves open: shoulder and hip are where arm and leg begin. Elbow and wrist, knee and ankle
/// are the two deepest minima of the smoothed circularity inside the segment, in order. The throat is the deepest
/// minimum of the trunk above the armpits, the pelvis the trunk's last curve.
///
/// # Errors
///
/// [`Refusal::TooFewEnds`]: algorithm 1 ended with other than five points. [`Refusal::Contact`]: the Reeb graph is not
/// that of a body. [`Refusal::BrokenMesh`]: see [`Adjacency::new`].
pub fn joints(mesh: &Mesh, start: u32, known: Option<Extremities>) -> Result<PaperResult, Refusal> {
    let adjacency = Adjacency::new(mesh)?;
    let graph = Graph::along_edges(mesh, &adjacency);
    let mut workspace = Workspace::default();
    let extremities = match known {
        Some(known) => known,
        None => ends(&graph, start, &mut workspace)?,
    };
    let field = distances(&graph, extremities.head, &mut workspace);
    let levels = Levels::of_free_limbs(mesh, &adjacency, &field, &extremities)?;
    let Levels { rings, segments, .. } = &levels;
    let mut joints = Joints::default();
    let longest = field.iter().copied().filter(|far| far.is_finite()).fold(0.0, f64::max);
    let mut put = |joint: Joint, position: Option<[f64; 3]>| {
        if let Some(position) = position {
            joints.estimates.insert(joint, Estimate { position, sigma: sigma(joint) * longest });
        }
    };
    for (at, side) in Side::BOTH.into_iter().enumerate() {
        let (arm, leg) = (&segments.arms[at], &segments.legs[at]);
        let [elbow, wrist] = two_deepest(rings, arm);
        let [knee, ankle] = two_deepest(rings, leg);
        put(Joint::Shoulder(side), arm.first().map(|ring| mean(rings, *ring)));
        put(Joint::Elbow(side), elbow);
        put(Joint::Wrist(side), wrist);
        put(Joint::Hip(side), leg.first().map(|ring| mean(rings, *ring)));
        put(Joint::Knee(side), knee);
        put(Joint::Ankle(side), ankle);
    }
    let armpit = segments.armpits[0].min(segments.armpits[1]);
    let level = |ring: &u32| rings.values[rings.rings[*ring as usize].level as usize];
    let upper = segments.trunk.iter().copied().take_while(|ring| level(ring) < armpit);
    let upper: Vec<u32> = upper.collect();
    put(Joint::Throat, inside(rings, &upper).first().map(|ring| mean(rings, *ring)));
    put(Joint::Pelvis, segments.trunk.last().map(|ring| mean(rings, *ring)));
    put(Joint::Head, mesh.positions.get(extremities.head as usize).copied());
    Ok(PaperResult { joints, extremities, levels })
}

/// The five extremities by algorithm 1.
fn ends(graph: &Graph, start: u32, workspace: &mut Workspace) -> Result<Extremities, Refusal> {
    let points = extremity_points(graph, start, StopRule::Corrected, workspace);
    let few = |points: Vec<u32>| Refusal::TooFewEnds { found: points.len() };
    let ends: [u32; 5] = points.try_into().map_err(few)?;
    let fields = ends.map(|end| distances(graph, end, workspace));
    Ok(head_by_symmetry(ends, &fields))
}

/// The two deepest minima (6) inside a limb, the one nearer to the trunk first.
fn two_deepest(rings: &Rings, limb: &[u32]) -> [Option<[f64; 3]>; 2] {
    let mut two: Vec<u32> = inside(rings, limb).into_iter().take(2).collect();
    two.sort_by_key(|ring| rings.rings[*ring as usize].level);
    [0, 1].map(|at| two.get(at).map(|ring| mean(rings, *ring)))
}

/// The curves of a segment at minima of its circularity, deepest first, without those near its ends.
fn inside(rings: &Rings, segment: &[u32]) -> Vec<u32> {
    let curve: Vec<f64> =
        segment.iter().map(|ring| rings.rings[*ring as usize].circularity()).collect();
    let last = curve.len() as f64;
    let within = |at: usize| (MARGIN * last..(1.0 - MARGIN) * last).contains(&(at as f64));
    let found = minima(&smoothed(&curve)).into_iter().filter(|(at, _)| within(*at));
    found.map(|(at, _)| segment[at]).collect()
}

/// Centroid (7): the mean of a curve's points.
fn mean(rings: &Rings, ring: u32) -> [f64; 3] {
    rings.rings[ring as usize].mean_point()
}

/// Local minima and their depths: how far the curve rises on its lower side before a deeper minimum.
///
/// Deepest first; end points do not count.
fn minima(curve: &[f64]) -> Vec<(usize, f64)> {
    let mut found = Vec::new();
    for at in 1..curve.len().saturating_sub(1) {
        // The first point of a plateau counts.
        if !(curve[at] < curve[at - 1] && curve[at] <= curve[at + 1]) {
            continue;
        }
        let climb = |side: &mut dyn Iterator<Item = &f64>| {
            let until_deeper = side.take_while(|value| **value >= curve[at]);
            until_deeper.copied().fold(curve[at], f64::max) - curve[at]
        };
        let left = climb(&mut curve[..at].iter().rev());
        let right = climb(&mut curve[at + 1..].iter());
        found.push((at, left.min(right)));
    }
    found.sort_by(|one, other| other.1.total_cmp(&one.1).then(one.0.cmp(&other.0)));
    found
}

/// Moving average over three values.
fn smoothed(curve: &[f64]) -> Vec<f64> {
    let windows = (0..curve.len()).map(|at| {
        let window = &curve[at.saturating_sub(1)..curve.len().min(at + 2)];
        window.iter().sum::<f64>() / window.len() as f64
    });
    windows.collect()
}

/// The paper's `a`: a new point within this fraction of the longest distance from earlier points is not an extremity.
const NEARNESS: f64 = 0.2;
/// Bound on the number of points, since only the shape ends the loop.
const POINT_COUNT_MAX: usize = 32;

/// The condition under which algorithm 1 takes another point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopRule {
    /// The printed condition: while the new point is NEARER to earlier points than `a` times the longest
    /// distance. It contradicts the paper's own explanation and ends at the second or third point.
    Printed,
    /// The explained condition: until the new point is near enough to earlier points.
    Corrected,
}

/// Algorithm 1: repeatedly takes the vertex with the largest SUM of distances to earlier points, beginning with the one
/// farthest from `start`.
#[must_use]
pub fn extremity_points(
    graph: &Graph,
    start: u32,
    rule: StopRule,
    workspace: &mut Workspace,
) -> Vec<u32> {
    let mut points = Vec::new();
    let mut sum = vec![0.0; graph.vertex_count()];
    let mut nearest = vec![f64::INFINITY; graph.vertex_count()];
    let mut longest = 0.0_f64;
    let mut next = farthest(&distances(graph, start, workspace));
    while let Some(point) = next.filter(|_| points.len() < POINT_COUNT_MAX) {
        points.push(point);
        let field = distances(graph, point, workspace);
        longest = points.iter().fold(longest, |most, other| most.max(field[*other as usize]));
        for (at, far) in field.iter().enumerate() {
            sum[at] += far;
            nearest[at] = nearest[at].min(*far);
        }
        next = farthest(&sum).filter(|new| {
            let far = nearest[*new as usize] >= NEARNESS * longest;
            points.len() == 1 || far == (rule == StopRule::Corrected)
        });
    }
    points
}

/// Finds the head among five extremities: its distances to the other four fall into two equal pairs, the nearer one
/// being the hands (section 5: cost |g(c,p1) - g(c,p2)| + |g(c,p3) - g(c,p4)|, minimum over the three pairings).
///
/// A foot is often as symmetric and then wins; nothing in the paper prevents it.
#[must_use]
pub fn head_by_symmetry(ends: [u32; 5], fields: &[Vec<f64>; 5]) -> Extremities {
    let mut best = (f64::INFINITY, Extremities { head: 0, hands: [0; 2], feet: [0; 2] });
    for (head, field) in fields.iter().enumerate() {
        let reach = |end: usize| field.get(ends[end] as usize).copied().unwrap_or(f64::INFINITY);
        let mut others = [0, 1, 2, 3, 4].into_iter().filter(|end| *end != head);
        let [a, b, c, d] = [0; 4].map(|_| others.next().unwrap_or(head));
        for [[p, q], [r, s]] in [[[a, b], [c, d]], [[a, c], [b, d]], [[a, d], [b, c]]] {
            let cost = (reach(p) - reach(q)).abs() + (reach(r) - reach(s)).abs();
            if cost < best.0 {
                let (mut hands, mut feet) = ([ends[p], ends[q]], [ends[r], ends[s]]);
                if reach(p) + reach(q) > reach(r) + reach(s) {
                    std::mem::swap(&mut hands, &mut feet);
                }
                best = (cost, Extremities { head: ends[head], hands, feet });
            }
        }
    }
    best.1
}

/// The vertex with the largest finite value, the first of equals.
fn farthest(field: &[f64]) -> Option<u32> {
    let mut best: Option<(u32, f64)> = None;
    for (vertex, value) in (0_u32..).zip(field).filter(|(_, value)| value.is_finite()) {
        if best.is_none_or(|(_, most)| *value > most) {
            best = Some((vertex, *value));
        }
    }
    best.map(|(vertex, _)| vertex)
}

/// Names of the extremities, in the order of [`Extremities::all`].
const ENDS: [&str; 5] = ["a head", "a hand", "a hand", "a foot", "a foot"];

/// The failure of the published method that explains a `refusal` of [`joints()`], on a body with free limbs whose
/// extremities are
/// `known`.
pub(crate) fn explain(
    mesh: &Mesh,
    adjacency: &Adjacency,
    start: u32,
    refusal: Refusal,
    known: &Extremities,
) -> Refusal {
    match refusal {
        Refusal::TooFewEnds { found } => Refusal::PaperEnds { found },
        Refusal::Contact { .. } => {
            let graph = Graph::along_edges(mesh, adjacency);
            let taken = ends(&graph, start, &mut Workspace::default()).ok();
            match taken.and_then(|taken| nearest(mesh, taken.head, known)) {
                None | Some(0) => Refusal::PaperParts,
                Some(i) => Refusal::PaperHead { taken: ENDS.get(i).copied().unwrap_or("a limb") },
            }
        }
        other => other,
    }
}

/// The extremity nearest to a vertex.
fn nearest(mesh: &Mesh, vertex: u32, ends: &Extremities) -> Option<usize> {
    let at = |vertex: u32| mesh.positions.get(vertex as usize).copied();
    let from = at(vertex)?;
    let far = |end: u32| at(end).map_or(f64::INFINITY, |to| distance(from, to));
    let ends = ends.all().map(far);
    ends.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map(|(end, _)| end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Mesh,
        geodesic::{Adjacency, Graph, Workspace, distances},
    };

    /// A flat star: strips of the given lengths from a common corner, each two vertices wide.
    fn star(lengths: &[u32]) -> (Mesh, Vec<u32>) {
        let mut mesh = Mesh { positions: vec![[0.0; 3]], triangles: Vec::new() };
        let mut tips = Vec::new();
        for (strip, length) in lengths.iter().enumerate() {
            let turn = std::f64::consts::TAU * strip as f64 / lengths.len() as f64;
            let (cos, sin) = (turn.cos(), turn.sin());
            let first = mesh.positions.len() as u32;
            for step in 1..=*length {
                let out = f64::from(step);
                for across in [0.0, 0.01] {
                    let at = [out * cos - across * sin, out * sin + across * cos, 0.0];
                    mesh.positions.push(at);
                }
            }
            mesh.triangles.push([0, first, first + 1]);
            for step in 0..length - 1 {
                let a = first + 2 * step;
                mesh.triangles.extend([[a, a + 2, a + 1], [a + 1, a + 2, a + 3]]);
            }
            tips.push(first + 2 * (length - 1));
        }
        (mesh, tips)
    }

    fn points(lengths: &[u32], rule: StopRule) -> usize {
        let (mesh, _) = star(lengths);
        let graph = Graph::along_edges(&mesh, &Adjacency::new(&mesh).unwrap());
        extremity_points(&graph, 0, rule, &mut Workspace::default()).len()
    }

    #[test]
    fn only_the_corrected_rule_finds_all_ends_of_a_star() {
        assert_eq!(points(&[10, 10, 10, 10, 10], StopRule::Corrected), 5);
        assert_eq!(points(&[10, 10, 10, 10, 10], StopRule::Printed), 2);
    }

    #[test]
    fn the_sum_misses_a_short_end() {
        // Three ends at 12 and a head at 4: returning to a long end adds more to the sum than visiting the head.
        assert!(points(&[12, 12, 12, 12, 4], StopRule::Corrected) < 5);
    }

    #[test]
    fn the_head_is_equally_far_from_two_pairs() {
        let (mesh, tips) = star(&[3, 7, 9, 9, 7]);
        let graph = Graph::along_edges(&mesh, &Adjacency::new(&mesh).unwrap());
        let ends: [u32; 5] = tips.try_into().unwrap();
        let fields = ends.map(|end| distances(&graph, end, &mut Workspace::default()));
        let mut found = head_by_symmetry(ends, &fields);
        found.hands.sort_unstable();
        found.feet.sort_unstable();
        assert_eq!(found.head, ends[0]);
        assert_eq!((found.hands, found.feet), ([ends[1], ends[4]], [ends[2], ends[3]]));
    }

    #[test]
    fn minima_are_ordered_by_depth() {
        let curve = [5.0, 3.0, 4.0, 1.0, 6.0, 5.5, 5.5, 7.0];
        let found = minima(&curve);
        assert_eq!(found, [(3, 4.0), (1, 1.0), (5, 0.5)]);
        assert!(minima(&[1.0, 2.0]).is_empty() && minima(&[]).is_empty());
        assert_eq!(smoothed(&[0.0, 3.0, 6.0]), [1.5, 3.0, 4.5]);
    }
}
