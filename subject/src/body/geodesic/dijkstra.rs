//! Shortest paths from one vertex, or several, to all.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::Graph;

/// What one run leaves for the next, so that a dozen sources cost one allocation.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    // Lengths are never negative, and the bits of such numbers are in the order of the numbers.
    heap: BinaryHeap<Reverse<(u64, u32)>>,
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
    let mut found = vec![f64::INFINITY; graph.vertex_count()];
    let heap = &mut workspace.heap;
    heap.clear();
    for (source, start) in sources {
        if let Some(best) = found.get_mut(source as usize).filter(|best| start < **best) {
            *best = start;
            heap.push(Reverse((start.to_bits(), source)));
        }
    }
    while let Some(Reverse((bits, vertex))) = heap.pop() {
        let here = f64::from_bits(bits);
        if here > found[vertex as usize] {
            continue;
        }
        for link in graph.links(vertex) {
            let there = here + link.length;
            let best = &mut found[link.to as usize];
            if there < *best {
                *best = there;
                heap.push(Reverse((there.to_bits(), link.to)));
            }
        }
    }
    found
}
