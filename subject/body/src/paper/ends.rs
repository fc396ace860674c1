//! Algorithm 1 of (Yu et al. 2008), and the head among the ends.

use crate::extremity::Extremities;
use crate::geodesic::{Graph, Workspace, distances};

/// How near a new point must be to those before, as a part of the longest way between them, to be none: a of the paper.
const NEARNESS: f64 = 0.2;
/// More ends than any body has; a bound, since the loop is told to end by the shape alone.
const POINT_COUNT_MAX: usize = 32;

/// When algorithm 1 takes another point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopRule {
    /// As printed: while the new point is NEARER to those before than a times the longest way. It contradicts the
    /// sentence beside it, and ends at the second point or the third.
    Printed,
    /// As the sentence says: until the new point is near enough to those before.
    Corrected,
}

/// Algorithm 1: points that are far from all others by the SUM of the distances, from the vertex `start` on.
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

/// The head among five ends: the one whose distances to the other four fall into two equal pairs; the nearer pair are the
/// hands (section 5: cost |g(c,p1) - g(c,p2)| + |g(c,p3) - g(c,p4)|, least over the three pairings).
///
/// A foot is often as symmetric, and is then taken for the head: the paper has nothing against it.
#[must_use]
pub fn head_by_symmetry(ends: [u32; 5], fields: &[Vec<f64>; 5]) -> Extremities {
    let mut best = (f64::INFINITY, Extremities { head: 0, hands: [0; 2], feet: [0; 2] });
    for (head, field) in fields.iter().enumerate() {
        let way = |end: usize| field.get(ends[end] as usize).copied().unwrap_or(f64::INFINITY);
        let mut others = [0, 1, 2, 3, 4].into_iter().filter(|end| *end != head);
        let [a, b, c, d] = [0; 4].map(|_| others.next().unwrap_or(head));
        for [[p, q], [r, s]] in [[[a, b], [c, d]], [[a, c], [b, d]], [[a, d], [b, c]]] {
            let cost = (way(p) - way(q)).abs() + (way(r) - way(s)).abs();
            if cost < best.0 {
                let (mut hands, mut feet) = ([ends[p], ends[q]], [ends[r], ends[s]]);
                if way(p) + way(q) > way(r) + way(s) {
                    std::mem::swap(&mut hands, &mut feet);
                }
                best = (cost, Extremities { head: ends[head], hands, feet });
            }
        }
    }
    best.1
}

/// The vertex with the greatest finite value, the first of equals.
fn farthest(field: &[f64]) -> Option<u32> {
    let mut best: Option<(u32, f64)> = None;
    for (vertex, value) in (0_u32..).zip(field).filter(|(_, value)| value.is_finite()) {
        if best.is_none_or(|(_, most)| *value > most) {
            best = Some((vertex, *value));
        }
    }
    best.map(|(vertex, _)| vertex)
}
