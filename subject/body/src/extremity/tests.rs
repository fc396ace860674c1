//! Shapes whose extremities are known, and shapes that are not bodies.

use super::naming::misfit;
use super::{peaks, *};
use crate::Mesh;
use crate::geodesic::{Adjacency, Graph, Workspace};
use crate::tests::sphere;

/// A sphere with spikes: vertices are pushed out, to `reach` in a given direction, and by less around it.
fn spiked(spikes: &[([f64; 3], f64)]) -> Mesh {
    let mut mesh = sphere(60);
    for at in &mut mesh.positions {
        let radius = spikes.iter().map(|(towards, reach)| {
            let norm = towards.iter().map(|part| part * part).sum::<f64>().sqrt();
            let cosine = (0..3).map(|axis| at[axis] * towards[axis] / norm).sum::<f64>();
            let angle = cosine.clamp(-1.0, 1.0).acos();
            1.0 + (reach - 1.0) * (-(angle / 0.12).powi(2)).exp()
        });
        let radius = radius.fold(1.0, f64::max);
        *at = at.map(|part| part * radius);
    }
    mesh
}

fn ends(mesh: &Mesh) -> Result<Ends, Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    find(mesh, &graph, &mut Workspace::default())
}

#[test]
fn peak_prominence_is_measured_from_the_separating_valley() {
    // A strip with heights of 5 at one end and 3 and 4 further on, with valleys of 1 and 2 in between.
    let heights = [5.0, 1.0, 3.0, 2.0, 4.0, 0.0];
    let positions = (0..12_u32).map(|at| [f64::from(at / 2), f64::from(at % 2), 0.0]).collect();
    let triangles =
        (0..5).map(|at| 2 * at).flat_map(|at| [[at, at + 1, at + 2], [at + 1, at + 3, at + 2]]);
    let mesh = Mesh { positions, triangles: triangles.collect() };
    let graph = Graph::along_edges(&mesh, &Adjacency::new(&mesh).unwrap());
    let values: Vec<f64> = heights.iter().flat_map(|height| [*height, *height]).collect();
    let found: Vec<_> =
        peaks(&graph, &values).iter().map(|peak| (peak.vertex, peak.persistence)).collect();
    assert_eq!(found, [(0, 5.0), (8, 3.0), (4, 1.0)]);
}

#[test]
fn a_sphere_has_no_ends() {
    let refusal = ends(&sphere(24)).unwrap_err();
    assert_eq!(refusal.code(), "too-few-ends", "{refusal}");
}

#[test]
fn a_star_is_not_a_body() {
    let towards =
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    let refusal = ends(&spiked(&towards.map(|towards| (towards, 4.0)))).unwrap_err();
    assert!(matches!(refusal.code(), "not-a-body" | "ambiguous"), "{refusal}");
}

#[test]
fn an_animal_has_more_limbs_than_a_body() {
    // Four legs, a neck with a head, and a tail.
    let towards = [
        [0.8, 0.4, -1.0],
        [0.8, -0.4, -1.0],
        [-0.8, 0.4, -1.0],
        [-0.8, -0.4, -1.0],
        [1.0, 0.0, 0.8],
        [-1.0, 0.0, 0.5],
    ];
    let refusal = ends(&spiked(&towards.map(|towards| (towards, 4.0)))).unwrap_err();
    assert_eq!(refusal, Refusal::TooManyEnds { found: 6 });
}

#[test]
fn a_table_with_four_legs_has_too_few_ends() {
    let towards = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
    let refusal = ends(&spiked(&towards.map(|towards| (towards, 4.0)))).unwrap_err();
    assert_eq!(refusal, Refusal::TooFewEnds { found: 4 });
}

#[test]
fn two_pieces_are_refused() {
    let mut mesh = sphere(16);
    let first = mesh.positions.len() as u32;
    let more: Vec<_> = mesh.positions.iter().map(|[x, y, z]| [x + 5.0, *y, *z]).collect();
    mesh.positions.extend(more);
    let more: Vec<_> = mesh.triangles.iter().map(|corners| corners.map(|at| at + first)).collect();
    mesh.triangles.extend(more);
    assert_eq!(ends(&mesh).unwrap_err().code(), "in-pieces");
}

#[test]
fn the_misfit_is_independent_of_size_and_side() {
    // A tree: half distances from a neck and a crotch that are 0.6 apart.
    let (head, hand, foot, trunk) = (0.28, 0.75, 0.95, 0.6);
    let arm = |one: usize, other: usize| match (one.min(other), one.max(other)) {
        (a, b) if a == b => 0.0,
        (0, 1 | 2) => head + hand,
        (0, _) => head + trunk + foot,
        (1, 2) => 2.0 * hand,
        (3, 4) => 2.0 * foot,
        _ => hand + trunk + foot,
    };
    let distances = |order: [usize; 5], scale: f64| order.map(|a| order.map(|b| scale * arm(a, b)));
    let whole = misfit(distances([0, 1, 2, 3, 4], 1.0)).rms;
    for (order, scale) in [([0, 2, 1, 4, 3], 1.0), ([0, 1, 2, 3, 4], 1000.0)] {
        assert!((misfit(distances(order, scale)).rms - whole).abs() < 1e-9);
    }
    let swapped = misfit(distances([0, 3, 4, 1, 2], 1.0)).rms;
    assert!(whole < MISFIT_MAX && swapped > 2.0 * whole, "{whole} and {swapped}");
}
