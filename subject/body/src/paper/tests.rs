//! The printed rules on shapes whose results can be derived by hand.

use super::*;
use crate::Mesh;
use crate::geodesic::{Adjacency, Graph, Workspace, distances};

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
