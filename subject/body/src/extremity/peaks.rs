//! What stands out of a function on the surface, and how far.

use super::choice::rounded;
use crate::geodesic::Graph;

/// A maximum of a function on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Where it is.
    pub vertex: u32,
    /// How far the function falls from here before a higher maximum can be reached; for the highest, to its least value.
    pub persistence: f64,
    /// The value where a higher maximum can be reached.
    pub saddle: f64,
}

const UNSEEN: u32 = u32::MAX;

/// The maxima of `values` upon the links of `graph`, the most persistent first (Edelsbrunner et al. 2002).
///
/// Vertices are taken from the highest down and joined to those before; where two hills meet, the lower ends.
pub(super) fn peaks(graph: &Graph, values: &[f64]) -> Vec<Peak> {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let most = finite.fold(0.0, f64::max);
    // Equal values in the order of their vertices: a symmetric body gives many.
    let mut order: Vec<(i64, u32)> = (0_u32..)
        .zip(values)
        .filter(|(_, value)| value.is_finite())
        .map(|(vertex, value)| (-(rounded(*value, most) as i64), vertex))
        .collect();
    order.sort_unstable();
    let value = |vertex: u32| values[vertex as usize];
    let mut hills = vec![UNSEEN; values.len()];
    // Which of two hills is higher: the one whose top came first.
    let mut rank = vec![0_u32; values.len()];
    let mut found = Vec::new();
    let mut around = Vec::new();
    for (at, (_, vertex)) in (0_u32..).zip(&order) {
        rank[*vertex as usize] = at;
        hills[*vertex as usize] = *vertex;
        around.clear();
        for link in graph.links(*vertex) {
            if hills[link.to as usize] == UNSEEN {
                continue;
            }
            let top = top_of(&mut hills, link.to);
            if top != *vertex && !around.contains(&top) {
                around.push(top);
            }
        }
        around.sort_unstable_by_key(|top| rank[*top as usize]);
        let Some((highest, lower)) = around.split_first() else { continue };
        hills[*vertex as usize] = *highest;
        for top in lower {
            hills[*top as usize] = *highest;
            let (height, saddle) = (value(*top), value(*vertex));
            found.push(Peak { vertex: *top, persistence: height - saddle, saddle });
        }
    }
    let ends = order.first().zip(order.last());
    if let Some(((_, top), (_, bottom))) = ends {
        let saddle = value(*bottom);
        found.push(Peak { vertex: *top, persistence: value(*top) - saddle, saddle });
    }
    let key = |peak: &Peak| (-(rounded(peak.persistence, most) as i64), peak.vertex);
    found.sort_unstable_by_key(key);
    found
}

/// The top of the hill that `vertex` is on; shortens the way there for the next.
fn top_of(hills: &mut [u32], mut vertex: u32) -> u32 {
    while hills[vertex as usize] != vertex {
        let next = hills[hills[vertex as usize] as usize];
        hills[vertex as usize] = next;
        vertex = next;
    }
    vertex
}
