//! Shortest paths from one vertex, or several, to all.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::graph::Graph;

/// Turns over all vertices before a heap takes over, whose time is bounded. Bodies need some ten.
const SWEEPS_MAX: usize = 48;
/// How often a vertex may be come to in them, on average. On bodies it is 1.3 to 1.7 times.
const VISITS_MAX: usize = 4;

/// What one run leaves for the next, so that a dozen sources cost little more than their links.
///
/// It may be used with any graph: what it leaves changes how long a run takes, and never what it gives.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    // Lengths are never negative, and the bits of such numbers are in the order of the numbers.
    heap: BinaryHeap<Reverse<(u64, u32)>>,
    /// Every vertex once, in the order in which the first run came to them.
    order: Vec<u32>,
    /// Which vertices have come nearer since their links were last followed.
    active: Vec<bool>,
}

/// The length of the shortest way from `source` to every vertex, in the mesh's unit; infinite where there is none.
#[must_use]
pub fn distances(graph: &Graph, source: u32, workspace: &mut Workspace) -> Vec<f64> {
    distances_from(graph, [(source, 0.0)], workspace)
}

/// The same from several sources at once, each with a length that its ways start with: the least of all.
///
/// A source that is no vertex is passed over.
#[must_use]
pub fn distances_from(
    graph: &Graph,
    sources: impl IntoIterator<Item = (u32, f64)>,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let count = graph.vertex_count();
    let mut found = vec![f64::INFINITY; count];
    let Workspace { heap, order, active } = workspace;
    active.clear();
    active.resize(count, false);
    for (source, start) in sources {
        if let Some(best) = found.get_mut(source as usize).filter(|best| start < **best) {
            *best = start;
            active[source as usize] = true;
        }
    }
    let known = order.len() == count;
    if !(known && sweep(graph, order, &mut found, active)) {
        let nearer = (0_u32..).zip(&found).filter(|(vertex, _)| active[*vertex as usize]);
        heap.clear();
        heap.extend(nearer.map(|(vertex, far)| Reverse((far.to_bits(), vertex))));
        let reached = dijkstra(graph, heap, &mut found);
        order.clear();
        // What was known and did not help is forgotten: the next run begins without.
        if !known {
            let apart = (0_u32..).zip(&found).filter(|(_, far)| far.is_infinite());
            order.extend(reached.into_iter().chain(apart.map(|(vertex, _)| vertex)));
        }
    }
    found
}

/// Dijkstra's method, from what lies in the heap; gives the vertices in the order in which it came to them.
fn dijkstra(
    graph: &Graph,
    heap: &mut BinaryHeap<Reverse<(u64, u32)>>,
    found: &mut [f64],
) -> Vec<u32> {
    let mut reached = Vec::with_capacity(found.len());
    while let Some(Reverse((bits, vertex))) = heap.pop() {
        let here = f64::from_bits(bits);
        if here > found[vertex as usize] {
            continue;
        }
        reached.push(vertex);
        for link in graph.links(vertex) {
            let there = here + link.length;
            let best = &mut found[link.to as usize];
            if there < *best {
                *best = there;
                heap.push(Reverse((there.to_bits(), link.to)));
            }
        }
    }
    reached
}

/// Follows the links of what has come nearer, there and back in an `order` that was right for another source, until
/// nothing comes nearer; false if that takes too many turns.
///
/// Limbs are tubes: along each, the order of any source is that of this one or its reverse. So most vertices are come to
/// when they are final, and no heap and no branch is in the way. Lengths are the least sums along ways, as a heap gives
/// them, to the last bit.
fn sweep(graph: &Graph, order: &[u32], found: &mut [f64], active: &mut [bool]) -> bool {
    let mut left = VISITS_MAX * order.len();
    for pass in 0..SWEEPS_MAX {
        let before = left;
        for index in 0..order.len() {
            let vertex = order[if pass % 2 == 0 { index } else { order.len() - 1 - index }];
            if !std::mem::replace(&mut active[vertex as usize], false) {
                continue;
            }
            let Some(rest) = left.checked_sub(1) else {
                active[vertex as usize] = true;
                return false;
            };
            left = rest;
            let here = found[vertex as usize];
            for link in graph.links(vertex) {
                let to = link.to as usize;
                let (there, best) = (here + link.length, found[to]);
                let nearer = there < best;
                found[to] = if nearer { there } else { best };
                active[to] |= nearer;
            }
        }
        if left == before {
            return true;
        }
    }
    false
}
