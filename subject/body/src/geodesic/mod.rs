//! Geodesic distances: mesh connectivity, graphs on a mesh, and shortest paths in them.
//!
//! There are two metrics. [`Graph::along_edges`] is that of (Yu et al. 2008, section 2): paths along edges, 3 to 6 %
//! too long by an amount that depends on the triangulation. [`Graph::with_short_cuts`] also crosses edges straight from
//! one triangle into the next, which removes most of that error.

mod graph;
#[cfg(test)]
mod tests;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

pub(crate) use graph::GraphEdge;
pub use graph::{Adjacency, Edge, Graph, Link, NONE};

/// Maximum number of sweeps over all vertices before Dijkstra's method takes over, whose time is bounded. Bodies need
/// about ten.
const SWEEPS_MAX: usize = 48;
/// Mean number of visits per vertex in the sweeps, at most. Bodies need 1.3 to 1.7.
const VISITS_MAX: usize = 4;

/// State that runs reuse, so that a dozen sources cost little more than their links.
///
/// Any graph may follow any other: the workspace affects only the time of a run, never its result.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    // Distances are never negative, and the bits of such numbers are in the order of the numbers.
    heap: Heap,
    /// Every vertex once, in the order in which the first run reached them.
    order: Vec<u32>,
    /// Vertices that came nearer since their links were last followed.
    active: Vec<bool>,
}

/// Vertices by distance, the nearest first.
type Heap = BinaryHeap<Reverse<(u64, u32)>>;

/// The length of the shortest path from `source` to every vertex, in the mesh's unit; infinite if there is none.
#[must_use]
pub fn distances(graph: &Graph, source: u32, workspace: &mut Workspace) -> Vec<f64> {
    distances_from(graph, [(source, 0.0)], workspace)
}

/// The least distance from several sources, each with an initial length.
///
/// A source that is not a vertex is ignored.
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
        // An order that did not help is dropped: the next run starts without one.
        if !known {
            let unreached = (0_u32..).zip(&found).filter(|(_, far)| far.is_infinite());
            order.extend(reached.into_iter().chain(unreached.map(|(vertex, _)| vertex)));
        }
    }
    found
}

/// Dijkstra's method from the vertices in the heap. Returns the vertices in the order in which they were reached.
fn dijkstra(graph: &Graph, heap: &mut Heap, found: &mut [f64]) -> Vec<u32> {
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

/// Relaxes links in alternating sweeps over an `order` computed for another source, until nothing changes; false if
/// that takes too many sweeps.
///
/// Limbs are tubes, and along each the order for any source is this one or its reverse. Most vertices are final when
/// visited, without a heap or a branch. The distances are the least sums along paths, equal to those of Dijkstra's
/// method to the last bit.
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
