//! Comparison with surfaces whose geodesics are known.

use std::f64::consts::PI;

use mocapd_testkit::random::Random;
use proptest::prelude::*;

use super::*;
use crate::Mesh;

/// A tube of radius 1 along z, of square cells cut along one diagonal, open at both ends.
fn tube(around: u32, along: u32) -> Mesh {
    let step = 2.0 * PI / f64::from(around);
    let point = |row: u32, column: u32| {
        let angle = step * f64::from(column);
        [angle.cos(), angle.sin(), step * f64::from(row)]
    };
    let positions = (0..along).flat_map(|row| (0..around).map(move |column| point(row, column)));
    let at = |row: u32, column: u32| row * around + column % around;
    let cells = (0..along - 1).flat_map(|row| (0..around).map(move |column| (row, column)));
    let triangles = cells.flat_map(|(row, column)| {
        let [a, b] = [at(row, column), at(row, column + 1)];
        let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
        [[a, b, d], [a, d, c]]
    });
    Mesh { positions: positions.collect(), triangles: triangles.collect() }
}

/// A sphere of radius 1, of rows of latitude, its points moved by up to a quarter of a cell.
fn sphere(rows: u32, seed: u64) -> Mesh {
    let around = 2 * rows;
    let mut random = Random::new(seed);
    let mut positions = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    for row in 1..rows {
        for column in 0..around {
            let mut moved = |cell: u32| f64::from(cell) + random.between(-0.25, 0.25);
            let [down, turn] =
                [moved(row), moved(column)].map(|cells| PI * cells / f64::from(rows));
            positions.push([down.sin() * turn.cos(), down.sin() * turn.sin(), down.cos()]);
        }
    }
    Mesh { positions, ..crate::tests::sphere(rows) }
}

/// Mean and maximum of `found / exact` over the vertices that are not near the source.
fn overestimate(found: &[f64], exact: impl Fn(usize) -> f64) -> (f64, f64) {
    let ratios = found.iter().enumerate().filter(|(vertex, _)| exact(*vertex) > 0.3);
    let ratios: Vec<f64> = ratios.map(|(vertex, found)| found / exact(vertex)).collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    (mean, ratios.iter().copied().fold(0.0, f64::max))
}

fn arc(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| a[axis] * b[axis]).sum::<f64>().clamp(-1.0, 1.0).acos()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn shortcuts_approximate_the_arcs_of_a_sphere(seed: u64, rows in 16_u32..28, source in 0_u32..400) {
        let mesh = sphere(rows, seed);
        let adjacency = Adjacency::new(&mesh).unwrap();
        prop_assert_eq!(adjacency.euler_characteristic(), 2);
        let exact = |vertex: usize| arc(mesh.positions[source as usize], mesh.positions[vertex]);
        let mut workspace = Workspace::default();
        let edges = distances(&Graph::along_edges(&mesh, &adjacency), source, &mut workspace);
        let cuts = distances(&Graph::with_short_cuts(&mesh, &adjacency), source, &mut workspace);
        prop_assert!(edges.iter().zip(&cuts).all(|(edge, cut)| cut <= edge));
        let ((edge_mean, edge_max), (cut_mean, cut_max)) =
            (overestimate(&edges, exact), overestimate(&cuts, exact));
        // Chords are shorter than arcs, by 1 - x^2 / 24 of them; so the ratio may fall a little short of one.
        prop_assert!((0.99..1.06).contains(&cut_mean), "{cut_mean}");
        // The slivers around the poles make single paths long; they remain no longer than along edges.
        prop_assert!(cut_max <= edge_max, "{cut_max} of {edge_max}");
        // From a pole the edges already lie along the arcs, so little can be gained.
        let nearer = cut_mean - 1.0 < 0.7 * (edge_mean - 1.0) || edge_mean < 1.02;
        prop_assert!(nearer, "{cut_mean} of {edge_mean}");
    }

    #[test]
    fn shortcuts_approximate_the_helices_of_a_tube(around in 20_u32..40, start in 0_u32..20) {
        let mesh = tube(around, 60);
        let source = 10 * around + start;
        let adjacency = Adjacency::new(&mesh).unwrap();
        let exact = |vertex: usize| {
            let (a, b) = (mesh.positions[source as usize], mesh.positions[vertex]);
            arc([a[0], a[1], 0.0], [b[0], b[1], 0.0]).hypot(a[2] - b[2])
        };
        let graph = Graph::with_short_cuts(&mesh, &adjacency);
        let (mean, max) = overestimate(&distances(&graph, source, &mut Workspace::default()), exact);
        // Where the cells have no diagonal, the worst direction is midway between a row and a shortcut: 1 / cos(45 / 2
        // deg).
        prop_assert!((0.99..1.05).contains(&mean), "{mean}");
        prop_assert!(max < 1.083, "{max}");
    }

    #[test]
    fn distances_are_a_metric(seed: u64, [a, b, c] in [0_u32..400, 0..400, 0..400]) {
        let mesh = sphere(16, seed);
        let adjacency = Adjacency::new(&mesh).unwrap();
        let graph = Graph::with_short_cuts(&mesh, &adjacency);
        let mut workspace = Workspace::default();
        let [from_a, from_b] = [a, b].map(|source| distances(&graph, source, &mut workspace));
        let [a, b, c] = [a, b, c].map(|vertex| vertex as usize);
        prop_assert!((from_a[b] - from_b[a]).abs() < 1e-12);
        prop_assert!(from_a[c] <= from_a[b] + from_b[c] + 1e-12);
        prop_assert_eq!(from_a[a], 0.0);
    }

    #[test]
    fn several_sources_give_the_minimum(seed: u64, a in 0_u32..400, b in 0_u32..400) {
        let mesh = sphere(16, seed);
        let adjacency = Adjacency::new(&mesh).unwrap();
        let graph = Graph::along_edges(&mesh, &adjacency);
        let mut workspace = Workspace::default();
        let [one, other] = [a, b].map(|source| distances(&graph, source, &mut workspace));
        let both = distances_from(&graph, [(a, 0.0), (b, 0.0)], &mut workspace);
        prop_assert!(both.iter().zip(one.iter().zip(&other)).all(|(both, (a, b))| *both == a.min(*b)));
    }
    #[test]
    fn a_reused_workspace_gives_the_same_distances(seed: u64, sources in prop::collection::vec(0_u32..400, 1..6)) {
        let mesh = sphere(16, seed);
        let adjacency = Adjacency::new(&mesh).unwrap();
        let mut used = Workspace::default();
        for graph in [Graph::with_short_cuts(&mesh, &adjacency), Graph::along_edges(&mesh, &adjacency)] {
            for source in &sources {
                let fresh = distances(&graph, *source, &mut Workspace::default());
                prop_assert_eq!(distances(&graph, *source, &mut used), fresh);
            }
        }
    }
}

#[test]
fn a_hole_leaves_edges_with_one_triangle() {
    let mut mesh = sphere(16, 1);
    mesh.triangles.remove(40);
    let adjacency = Adjacency::new(&mesh).unwrap();
    let open = adjacency.edges().iter().filter(|edge| edge.triangles[1] == NONE).count();
    assert_eq!((open, adjacency.euler_characteristic()), (3, 1));
}

#[test]
fn disconnected_pieces_are_infinitely_far() {
    let mesh = Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [5.0; 3]],
        triangles: vec![[0, 1, 2]],
    };
    let graph = Graph::with_short_cuts(&mesh, &Adjacency::new(&mesh).unwrap());
    let found = distances(&graph, 0, &mut Workspace::default());
    assert_eq!(found, [0.0, 1.0, 1.0, f64::INFINITY]);
    assert!(distances(&graph, 9, &mut Workspace::default()).iter().all(|far| far.is_infinite()));
}

#[test]
fn broken_meshes_are_refused() {
    let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, f64::NAN, 0.0]];
    let cases = [
        Mesh { positions: positions.clone(), triangles: vec![[0, 1, 2]] },
        Mesh { positions: positions[..2].to_vec(), triangles: vec![[0, 1, 2]] },
        Mesh { positions: positions[..2].to_vec(), triangles: Vec::new() },
    ];
    for mesh in cases {
        assert_eq!(Adjacency::new(&mesh).unwrap_err().code(), "broken-mesh");
    }
}

#[test]
fn an_unsuitable_sweep_order_only_costs_time() {
    // A comb: a path along it needs more sweeps than the limit.
    let steps = 400_u32;
    let edges = (1..steps).map(|at| GraphEdge { ends: [at - 1, at], length: 1.0 });
    let line = Graph::new(steps as usize, edges);
    let shuffled = |at: u32| (at * 7919) % steps;
    let edge = |at: u32| GraphEdge { ends: [shuffled(at - 1), shuffled(at)], length: 1.0 };
    let comb = Graph::new(steps as usize, (1..steps).map(edge));
    let mut workspace = Workspace::default();
    assert_eq!(distances(&line, 0, &mut workspace)[steps as usize - 1], f64::from(steps - 1));
    let found = distances(&comb, shuffled(0), &mut workspace);
    assert!((0..steps).all(|at| found[shuffled(at) as usize] == f64::from(at)));
}
