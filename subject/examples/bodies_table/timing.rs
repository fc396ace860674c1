//! How long it takes.

use std::hint::black_box;
use std::time::Instant;

use mocapd_subject::body::geodesic::{Adjacency, Graph, Workspace, distances};

use crate::case::{Case, skeleton};
use crate::table::quantile;

/// The whole pipeline from a mesh in memory, beside one run of Dijkstra's method along the edges of the same mesh.
pub(crate) fn print(cases: &[Case]) {
    println!("| faces | meshes | median ms | slowest ms | one Dijkstra ms | ratio |");
    println!("|---|---|---|---|---|---|");
    let mut sizes: Vec<usize> = cases.iter().map(|case| case.mesh.triangles.len()).collect();
    sizes.sort_unstable();
    sizes.dedup();
    for size in sizes {
        let of_size = cases.iter().filter(|case| case.mesh.triangles.len() == size);
        let (mut whole, mut bare) = (Vec::new(), Vec::new());
        for case in of_size.take(5) {
            whole.push(median_of_five(|| drop(black_box(skeleton(&case.mesh)))));
            let Ok(adjacency) = Adjacency::new(&case.mesh) else { continue };
            let graph = Graph::along_edges(&case.mesh, &adjacency);
            let mut workspace = Workspace::default();
            bare.push(median_of_five(|| drop(black_box(distances(&graph, 0, &mut workspace)))));
        }
        let meshes = whole.len();
        let (median, slowest) = (quantile(&mut whole, 0.5), quantile(&mut whole, 1.0));
        let bare = quantile(&mut bare, 0.5);
        println!(
            "| {size} | {meshes} | {median:.1} | {slowest:.1} | {bare:.2} | {:.1} |",
            median / bare
        );
    }
}

/// In milliseconds.
fn median_of_five(mut run: impl FnMut()) -> f64 {
    let mut times = [0.0; 5].map(|_: f64| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    });
    quantile(&mut times, 0.5)
}
