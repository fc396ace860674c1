//! Computation time.

use std::hint::black_box;
use std::time::Instant;

use mocapd_body::geodesic::{Adjacency, Graph, Workspace, distances};
use mocapd_body::locate::{Landmarks, joints, refine_ends};
use mocapd_body::{Mesh, extremity};

use crate::case::{Case, skeleton};
use crate::table::quantile;

/// The whole pipeline from a mesh in memory, compared with one run of Dijkstra's algorithm along the edges of the same
/// mesh.
pub(crate) fn print(cases: &[Case]) {
    println!(
        "| faces | meshes | median ms | slowest ms | of it joints | one Dijkstra ms | ratio |"
    );
    println!("|---|---|---|---|---|---|---|");
    let mut sizes: Vec<usize> = cases.iter().map(|case| case.mesh.triangles.len()).collect();
    sizes.sort_unstable();
    sizes.dedup();
    for size in sizes {
        let of_size = cases.iter().filter(|case| case.mesh.triangles.len() == size);
        let (mut whole, mut joints, mut bare) = (Vec::new(), Vec::new(), Vec::new());
        for case in of_size.take(5) {
            whole.push(median_of_five(|| drop(black_box(skeleton(&case.mesh)))));
            let Ok(adjacency) = Adjacency::new(&case.mesh) else { continue };
            joints.extend(of_joints(&case.mesh, &adjacency));
            let graph = Graph::along_edges(&case.mesh, &adjacency);
            let bare_run = || drop(black_box(distances(&graph, 0, &mut Workspace::default())));
            bare.push(median_of_five(bare_run));
        }
        let meshes = whole.len();
        let (median, slowest) = (quantile(&mut whole, 0.5), quantile(&mut whole, 1.0));
        let (joints, bare) = (quantile(&mut joints, 0.5), quantile(&mut bare, 0.5));
        println!(
            "| {size} | {meshes} | {median:.1} | {slowest:.1} | {joints:.1} | {bare:.2} | {:.1} |",
            median / bare
        );
    }
}

/// From the extremities to the joints.
fn of_joints(mesh: &Mesh, adjacency: &Adjacency) -> Option<f64> {
    let graph = Graph::with_short_cuts(mesh, adjacency);
    let mut workspace = Workspace::default();
    let ends = extremity::find(mesh, &graph, &mut workspace).ok()?;
    Some(median_of_five(|| {
        let (extremities, fields) = (&ends.extremities, ends.fields.clone());
        let refined = refine_ends(&graph, extremities, fields, &ends.spread, &mut workspace);
        let landmarks = Landmarks::new(mesh, &refined.fields());
        drop(black_box(landmarks.map(|landmarks| joints(&landmarks))));
    }))
}

/// Median wall-clock time of five runs, in milliseconds.
fn median_of_five(mut run: impl FnMut()) -> f64 {
    let mut times = [0.0; 5].map(|_: f64| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    });
    quantile(&mut times, 0.5)
}
