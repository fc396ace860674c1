//! Corners of triangles that hang together about a vertex.

use std::collections::HashMap;

use super::connect::NONE;
use crate::Mesh;

/// For each corner, the first corner of those that hang together with it over edges.
pub(super) fn fans(across: &[u32]) -> Vec<u32> {
    let mut leader: Vec<u32> = (0..across.len() as u32).collect();
    let find = |leader: &mut [u32], mut at: u32| {
        while leader[at as usize] != at {
            leader[at as usize] = leader[leader[at as usize] as usize];
            at = leader[at as usize];
        }
        at
    };
    for (side, &other) in across.iter().enumerate() {
        if other == NONE || other < side as u32 {
            continue;
        }
        // A side begins at the corner of its own number, and ends at the next of its triangle.
        let ends = |side: u32| [side, side - side % 3 + (side + 1) % 3];
        let ([a, b], [c, d]) = (ends(side as u32), ends(other));
        for (one, two) in [(a, d), (b, c)] {
            let (one, two) = (find(&mut leader, one), find(&mut leader, two));
            leader[one.max(two) as usize] = one.min(two);
        }
    }
    for corner in 0..leader.len() as u32 {
        leader[corner as usize] = find(&mut leader, corner);
    }
    leader
}

/// Corners that hang together over edges share a vertex, and no others do.
pub(super) fn split_vertices(mesh: &mut Mesh, across: &[u32]) {
    // The first fan keeps the vertex, every other gets a copy.
    let mut owner = vec![NONE; mesh.positions.len()];
    let mut copies = HashMap::new();
    for (corner, fan) in fans(across).into_iter().enumerate() {
        let vertex = mesh.triangles[corner / 3][corner % 3];
        if owner[vertex as usize] == NONE {
            owner[vertex as usize] = fan;
        }
        if owner[vertex as usize] != fan {
            let position = mesh.positions[vertex as usize];
            let copy = *copies.entry(fan).or_insert_with(|| {
                mesh.positions.push(position);
                mesh.positions.len() as u32 - 1
            });
            mesh.triangles[corner / 3][corner % 3] = copy;
        }
    }
}
