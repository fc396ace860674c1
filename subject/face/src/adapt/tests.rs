use super::*;
use crate::model::{Camera, FeatureId, FitOptions, Landmark, Model, OUTER_EYES_MM};
use mocapd_testkit::random::Random;

/// Radius of the multiquadric.
const WIDTHS: [f64; 4] = [1.0, 0.3, 0.05, 0.0];

fn scattered<const D: usize>(noise: &mut Random, count: usize) -> Vec<[f64; D]> {
    (0..count).map(|_| std::array::from_fn(|_| 2.0 * noise.unit() - 1.0)).collect()
}

#[test]
fn nodes_go_exactly_to_their_targets_in_every_family() {
    let mut noise = Random::new(1);
    for d in WIDTHS {
        let nodes: Vec<[f64; 2]> = scattered(&mut noise, 53);
        let targets: Vec<[f64; 2]> = scattered(&mut noise, 53);
        let map = RadialMap::new(d, &nodes, &targets).unwrap();
        for (x, y) in nodes.iter().zip(&targets) {
            let at = map.at(x);
            assert!(
                (at[0] - y[0]).abs() < 1e-9 && (at[1] - y[1]).abs() < 1e-9,
                "{d}: {at:?} {y:?}"
            );
        }
    }
}

#[test]
fn affine_maps_are_reproduced_everywhere() {
    let mut noise = Random::new(2);
    let affine = |x: &[f64; 3]| {
        [3.0 * x[0] - 0.5 * x[1] + x[2] + 40.0, 0.2 * x[0] + 2.0 * x[1] - 7.0, x[0] + x[1] + x[2]]
    };
    for d in WIDTHS {
        let nodes: Vec<[f64; 3]> = scattered(&mut noise, 40);
        let targets: Vec<_> = nodes.iter().map(affine).collect();
        let map = RadialMap::new(d, &nodes, &targets).unwrap();
        for x in scattered(&mut noise, 100) {
            let x: [f64; 3] = x;
            for (a, b) in map.at(&x.map(|v| 3.0 * v)).iter().zip(affine(&x.map(|v| 3.0 * v))) {
                assert!((a - b).abs() < 1e-7, "{d}: {a} {b}");
            }
        }
    }
}

#[test]
fn weights_meet_the_side_conditions() {
    let mut noise = Random::new(3);
    for d in WIDTHS {
        let nodes: Vec<[f64; 2]> = scattered(&mut noise, 30);
        let targets: Vec<[f64; 1]> = scattered(&mut noise, 30);
        let map = RadialMap::new(d, &nodes, &targets).unwrap();
        let size: f64 = map.weights.iter().map(|w| w[0].abs()).sum();
        for p in [|_: &[f64; 2]| 1.0, |x: &[f64; 2]| x[0], |x: &[f64; 2]| x[1]] {
            let sum: f64 = nodes.iter().zip(&map.weights).map(|(x, w)| w[0] * p(x)).sum();
            assert!(sum.abs() < 1e-12 * size, "{d}: {sum} of {size}");
        }
    }
}

/// Two nodes on a line, derived by hand: φ = √(1+r²), F(±1) = ±1, F(0) = 2 has ω = (-c, 2c, -c) by symmetry.
#[test]
fn three_nodes_match_the_solution_by_hand() {
    let map = RadialMap::new(1.0, &[[-1.0], [0.0], [1.0]], &[[-1.0], [2.0], [1.0]]).unwrap();
    // The even part is E(x) = c (2φ(x) - φ(x-1) - φ(x+1)) + e with E(±1) = 0 and E(0) = 2.
    let (at_0, at_1) = (2.0 - 2.0 * 2f64.sqrt(), 2.0 * 2f64.sqrt() - 1.0 - 5f64.sqrt());
    let c = 2.0 / (at_0 - at_1);
    for (weight, expected) in map.weights.iter().zip([-c, 2.0 * c, -c]) {
        assert!((weight[0] - expected).abs() < 1e-12, "{weight:?} {expected}");
    }
    let phi = |r: f64| (1.0 + r * r).sqrt();
    let x = 0.37;
    let expected = c * (2.0 * phi(x) - phi(x - 1.0) - phi(x + 1.0)) - c * at_1 + x;
    assert!((map.at(&[x])[0] - expected).abs() < 1e-12);
}

#[test]
fn degenerate_nodes_are_refused() {
    let square = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let map = |nodes: &[[f64; 2]]| RadialMap::new(1.0, nodes, nodes).unwrap_err();
    assert_eq!(map(&square[..2]), AdaptError::Nodes { found: 2, least: 3, most: 1000 });
    assert_eq!(map(&[square[0], square[1], square[2], square[1]]), AdaptError::Duplicate(1, 3));
    assert_eq!(map(&[[2.0, 2.0]; 4]), AdaptError::Duplicate(0, 1));
    assert_eq!(map(&[[0.0, 1.0], [1.0, 3.0], [2.0, 5.0], [7.0, 15.0]]), AdaptError::Flat);
    assert_eq!(map(&[square[0], square[1], [f64::NAN, 0.0], square[3]]), AdaptError::NotFinite(2));
    let missing = RadialMap::new(1.0, &square, &square[..3]).unwrap_err();
    assert_eq!(missing, AdaptError::Count { nodes: 4, targets: 3 });
    for d in [-1.0, f64::INFINITY, f64::NAN] {
        assert!(matches!(RadialMap::new(d, &square, &square), Err(AdaptError::Basis(_))), "{d}");
    }
}

fn turned_face() -> (&'static Model, Camera, Vec<[f64; 3]>) {
    let model = Model::generic().unwrap();
    let camera = Camera {
        scale_px_per_mm: 1.4,
        yaw_deg: 24.0,
        pitch_deg: 6.0,
        roll_deg: -11.0,
        origin_px: [300.0, 260.0],
    };
    let person = model.shape(&[1.1, -0.7, 0.9, 0.4, -1.2, 0.3, 0.8]);
    (model, camera, person)
}

fn points(model: &Model, camera: &Camera, person: &[[f64; 3]]) -> Vec<[f64; 3]> {
    camera.project(&model.feature_points(person, &camera.rotation()))
}

#[test]
fn features_of_an_adapted_face_lie_on_the_points() {
    let (model, camera, person) = turned_face();
    let seen = points(model, &camera, &person);
    let given: Vec<_> = FeatureId::all()
        .zip(&seen)
        .map(|(id, p)| Landmark { id, xy_px: [p[0], p[1]], confidence: 1.0 })
        .collect();
    for width in [Width::PAPER, Width::default(), Width::OuterEyes(1.0)] {
        let adapted = adapt(model, &model.vertices, &camera, &given, width, Depth::Model).unwrap();
        let interocular_px = camera.scale_px_per_mm * OUTER_EYES_MM;
        for Landmark { id, xy_px: at, .. } in &given[FeatureId::CONTOUR..] {
            let vertex = adapted.vertices_px[model.features[id.name()]];
            let off = (vertex[0] - at[0]).hypot(vertex[1] - at[1]) / interocular_px;
            assert!(off < 1e-9, "{}: {off} io", id.name());
        }
    }
}

/// Adaptation moves every vertex, not just the features, closer to its true position on this person.
#[test]
fn vertices_between_the_features_improve() {
    let (model, camera, person) = turned_face();
    let truth = camera.project(&person);
    let seen = points(model, &camera, &person);
    let given: Vec<_> = FeatureId::all()
        .zip(&seen)
        .map(|(id, p)| Landmark { id, xy_px: [p[0], p[1]], confidence: 1.0 })
        .collect();
    let interocular_px = camera.scale_px_per_mm * OUTER_EYES_MM;
    let error = |vertices: &[[f64; 3]], axes: std::ops::Range<usize>| {
        let off = |(v, t): (&[f64; 3], &[f64; 3])| {
            axes.clone().map(|axis| (v[axis] - t[axis]).powi(2)).sum::<f64>().sqrt()
        };
        vertices.iter().zip(&truth).map(off).sum::<f64>() / truth.len() as f64 / interocular_px
    };
    let before = camera.project(&model.vertices);
    let paper = adapt(model, &model.vertices, &camera, &given, Width::PAPER, Depth::Model).unwrap();
    assert!(error(&paper.vertices_px, 0..2) < 0.6 * error(&before, 0..2));
    // With depths the third dimension improves, too.
    let depths: Vec<_> = seen.iter().map(|p| p[2]).collect();
    let deep = adapt(model, &model.vertices, &camera, &given, Width::PAPER, Depth::Points(&depths))
        .unwrap();
    assert!(error(&deep.vertices_px, 2..3) < 0.7 * error(&paper.vertices_px, 2..3));
    // A fitted shape is a better starting point than the average.
    let fit = model.fit_shape(&given, &FitOptions::default()).unwrap();
    let fitted =
        adapt(model, &fit.vertices_mm, &fit.camera, &given, Width::PAPER, Depth::Model).unwrap();
    assert!(error(&fitted.vertices_px, 0..2) < error(&paper.vertices_px, 0..2));
}

/// Why the paper's d = 1 cannot be in units of the eye distance (docs/subject-face-model.md has these figures).
#[test]
fn a_basis_much_wider_than_features_are_apart_overshoots() {
    let (model, camera, person) = turned_face();
    let truth = camera.project(&person);
    let seen = points(model, &camera, &person);
    let given: Vec<_> = FeatureId::all()
        .zip(&seen)
        .map(|(id, p)| Landmark { id, xy_px: [p[0], p[1]], confidence: 1.0 })
        .collect();
    let interocular_px = camera.scale_px_per_mm * OUTER_EYES_MM;
    let error = |vertices: &[[f64; 3]]| {
        let off = |(v, t): (&[f64; 3], &[f64; 3])| (v[0] - t[0]).hypot(v[1] - t[1]);
        let sum: f64 = vertices.iter().zip(&truth).map(off).sum();
        100.0 * sum / truth.len() as f64 / interocular_px
    };
    let adapted = |d: f64| {
        let width = Width::OuterEyes(d);
        adapt(model, &model.vertices, &camera, &given, width, Depth::Model).unwrap()
    };
    let before = error(&camera.project(&model.vertices));
    println!("not adapted: {before:.2} % io");
    for d in [1.0, 0.5, 0.2, 0.1, 0.05, 1.0 / interocular_px, 0.0] {
        println!("d = {d:.3} io: {:.2} % io", error(&adapted(d).vertices_px));
    }
    assert!(error(&adapted(1.0).vertices_px) > 10.0 * before);
    assert!(error(&adapted(0.05).vertices_px) < 0.5 * before);
}
