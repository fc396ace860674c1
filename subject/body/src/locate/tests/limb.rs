//! Level-set curves and bends of a tube, and joints located by the girth of the limb around them.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::{
    Mesh,
    locate::{
        limb::{self, LEVELS, Sections, Window, bend, level, wrist},
        model::{GIRTHS, Measure},
    },
};

const ROUND: usize = 24;
const LENGTH: f64 = 0.6;
const RADIUS: f64 = 0.03;

/// A tube of [`LENGTH`] that bends by `angle` at `knot`, with the distance along it from its start.
fn tube(knot: f64, angle: f64, radius: impl Fn(f64) -> f64) -> (Mesh, Vec<f64>) {
    let rings = 200;
    let (mut mesh, mut field) = (Mesh::default(), Vec::new());
    for ring in 0..=rings {
        let along = LENGTH * f64::from(ring) / f64::from(rings);
        let behind = (along - knot).max(0.0);
        let centre = Vector3::new(behind * angle.sin(), 0.0, along - behind + behind * angle.cos());
        let across = Vector3::new(centre.z, 0.0, -centre.x).cross(&Vector3::y()).normalize();
        let across = if behind > 0.0 {
            Vector3::new(angle.cos(), 0.0, -angle.sin())
        } else {
            -across.cross(&Vector3::y())
        };
        for step in 0..ROUND {
            let (sin, cos) = (TAU * step as f64 / ROUND as f64).sin_cos();
            let at = centre + (across * cos + Vector3::y() * sin) * radius(along);
            mesh.positions.push(at.into());
            field.push(along);
            if ring > 0 {
                let (a, b) = (step as u32, ((step + 1) % ROUND) as u32);
                let (low, high) = ((ring as u32 - 1) * ROUND as u32, ring as u32 * ROUND as u32);
                mesh.triangles.push([low + a, low + b, high + b]);
                mesh.triangles.push([low + a, high + b, high + a]);
            }
        }
    }
    (mesh, field)
}

fn sections(mesh: &Mesh, field: &[f64]) -> Sections {
    Sections::new(mesh, field, &vec![1.0; field.len()], 1.0, 0.9).unwrap()
}

fn window() -> Window {
    Window { line: [0.05, 0.55], joint: [0.15, 0.45], prior: 0.33, weight: 1e-3, rounded: 0.01 }
}

#[test]
fn a_level_curve_of_a_tube_is_its_circle() {
    let (mesh, field) = tube(LENGTH, 0.0, |_| RADIUS);
    let sections = sections(&mesh, &field);
    let circle = 2.0 * ROUND as f64 * RADIUS * (std::f64::consts::PI / ROUND as f64).sin();
    for index in 5..95 {
        assert!((sections.perimeter[index] - circle).abs() < 1e-3 * circle, "level {index}");
        let middle = sections.centre_at(level(index));
        assert!((middle - Vector3::new(0.0, 0.0, level(index))).norm() < 1e-9, "level {index}");
    }
}

#[test]
fn a_surface_without_weight_has_no_sections() {
    let (mesh, field) = tube(LENGTH, 0.0, |_| RADIUS);
    assert!(Sections::new(&mesh, &field, &vec![0.0; field.len()], 1.0, 0.9).is_none());
    let nowhere = vec![f64::INFINITY; field.len()];
    assert!(Sections::new(&mesh, &nowhere, &vec![1.0; field.len()], 1.0, 0.9).is_none());
}

#[test]
fn weighting_one_half_moves_the_centroid_into_it() {
    let (mesh, field) = tube(LENGTH, 0.0, |_| RADIUS);
    let weights: Vec<f64> =
        mesh.positions.iter().map(|at| f64::from(u8::from(at[1] > 0.0))).collect();
    let sections = Sections::new(&mesh, &field, &weights, 1.0, 0.9).unwrap();
    let half_circle = 2.0 * RADIUS / std::f64::consts::PI;
    assert!((sections.centre_at(0.3).y - half_circle).abs() < 0.1 * half_circle);
}

#[test]
fn the_bend_of_a_tube_is_found() {
    for angle in [0.4_f64, 0.8, 1.2] {
        let (mesh, field) = tube(0.25, angle, |_| RADIUS);
        let found = bend(&sections(&mesh, &field), &window(), |_| 0.0).unwrap();
        assert!((found.level - 0.25).abs() < 0.012, "{angle}: {}", found.level);
    }
}

#[test]
fn a_straight_tube_bends_at_the_average_place_and_less_certainly() {
    let straight = tube(0.25, 0.0, |_| RADIUS);
    let bent = tube(0.25, 0.8, |_| RADIUS);
    let found = bend(&sections(&straight.0, &straight.1), &window(), |_| 0.0).unwrap();
    let surer = bend(&sections(&bent.0, &bent.1), &window(), |_| 0.0).unwrap();
    assert!((found.level - window().prior).abs() < 1e-6, "{}", found.level);
    assert!(limb::elbow_sigma(found.sharpness) > 2.0 * limb::elbow_sigma(surer.sharpness));
}

#[test]
fn the_marks_of_an_arm_are_where_it_narrows_bends_and_widens() {
    // A hand and a forearm of average girth with the wrist at 0.14, and a trunk from 0.39 on.
    let radius = |along: f64| arm_girth(along, 0.14) / TAU + (along - 0.37).max(0.0);
    let (mesh, field) = tube(0.27, 0.9, radius);
    let marks = limb::arm(&sections(&mesh, &field), 0.96).unwrap();
    assert!((marks.narrow - 0.14).abs() < 0.004, "{marks:?}");
    assert!((marks.hinge - 0.27).abs() < 0.012, "{marks:?}");
    assert!((0.37..0.40).contains(&marks.root), "{marks:?}");
}

#[test]
fn the_marks_of_a_leg_move_with_the_heel_and_the_bend() {
    let at = |heel: f64, bend: f64| {
        let radius = move |along: f64| 0.025 + 0.015 * ((along - heel) / 0.01).tanh();
        let (mesh, field) = tube(bend, 1.2, radius);
        limb::leg(&sections(&mesh, &field)).unwrap()
    };
    let (near, far) = (at(0.11, 0.33), at(0.13, 0.33));
    assert!((far.narrow - near.narrow - 0.01).abs() < 0.002, "{near:?} {far:?}");
    assert!((near.hinge - 0.33).abs() < 0.015, "{near:?}");
    let farther = at(0.11, 0.37);
    assert!(farther.hinge - near.hinge > 0.012, "{near:?} {farther:?}");
}

#[test]
fn an_empty_window_has_no_bend() {
    let (mesh, field) = tube(LENGTH, 0.0, |_| RADIUS);
    let none = Window { line: [2.0, 3.0], ..window() };
    assert!(bend(&sections(&mesh, &field), &none, |_| 0.0).is_none());
    let none = Window { joint: [0.3, 0.2], ..window() };
    assert!(bend(&sections(&mesh, &field), &none, |_| 0.0).is_none());
    assert_eq!(sections(&mesh, &field).perimeter.len(), LEVELS);
}

/// Curve lengths of a straight leg of average girth whose knee is at the given distance from its end, multiplied by
/// `thicker` and tapered by `slope` per body scale.
fn leg(knee: f64, thicker: f64, slope: f64) -> Sections {
    let last = GIRTHS.knee.mean.len() - 1;
    let perimeter = |index: usize| {
        let along = level(index) - knee;
        let at = ((along + 0.12) / 0.012).clamp(0.0, last as f64);
        let (below, part) = (at.floor() as usize, at.fract());
        let above = (below + 1).min(last);
        let log =
            GIRTHS.knee.mean[below] + part * (GIRTHS.knee.mean[above] - GIRTHS.knee.mean[below]);
        thicker * (log + slope * along).exp()
    };
    let centre = |index: usize| Vector3::new(0.0, 0.0, level(index));
    Sections {
        perimeter: (0..LEVELS).map(perimeter).collect(),
        centre: (0..LEVELS).map(centre).collect(),
    }
}

#[test]
fn a_leg_of_average_girth_fits_only_at_its_knee() {
    let leg = leg(0.36, 1.0, 0.0);
    assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36) < 0.05);
    for away in [-0.04, -0.02, 0.02, 0.04] {
        assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36 + away) > 0.5, "{away}");
    }
}

#[test]
fn thick_and_tapered_legs_fit_equally_well() {
    for (thicker, slope) in [(1.5, 0.0), (0.7, 0.0), (1.0, 0.8), (1.3, -0.8)] {
        let misfit = GIRTHS.knee.misfit(&leg(0.36, thicker, slope).perimeter, 0.36);
        assert!(misfit < 1.0, "{thicker} {slope}: {misfit}");
    }
}

#[test]
fn the_girth_locates_the_knee_of_a_straight_leg() {
    for knee in [0.32, 0.344, 0.375] {
        let window = Window {
            line: [0.17, 0.53],
            joint: [0.28, 0.41],
            prior: 0.344,
            weight: 0.05,
            rounded: 0.0,
        };
        let leg = leg(knee, 1.2, 0.3);
        let of_girth = |at| 1e-5 * GIRTHS.knee.misfit(&leg.perimeter, at);
        let found = bend(&leg, &window, of_girth).unwrap();
        assert!(
            (found.level - knee).abs() < 0.5 * (knee - 0.344).abs() + 0.004,
            "{knee}: {}",
            found.level
        );
    }
}

#[test]
fn a_limb_without_curves_has_a_finite_misfit() {
    assert!(GIRTHS.knee.misfit(&[], 0.3).is_finite());
    assert!(GIRTHS.knee.misfit(&[0.0; 4], 0.3).is_finite());
}

/// Curve length at `along` on the mean arm whose wrist is at the given distance from its end.
fn arm_girth(along: f64, wrist: f64) -> f64 {
    let Measure::Length(average) = GIRTHS.wrist.measure else { panic!("{:?}", GIRTHS.wrist) };
    let last = GIRTHS.wrist.mean.len() - 1;
    let at = ((along - wrist - GIRTHS.wrist.first) / 0.012).clamp(0.0, last as f64);
    let (below, part) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(last);
    average
        * (GIRTHS.wrist.mean[below] + part * (GIRTHS.wrist.mean[above] - GIRTHS.wrist.mean[below]))
}

#[test]
fn a_layer_of_fat_does_not_move_the_wrist() {
    for (at, fat) in [(0.14, 0.0), (0.12, 0.0), (0.13, 0.004), (0.13, -0.002)] {
        let curve = |index| arm_girth(level(index), at) + TAU * fat;
        let perimeter: Vec<f64> = (0..LEVELS).map(curve).collect();
        let found = wrist(&perimeter).unwrap();
        assert!((found - at).abs() < 0.003, "{at} {fat}: {found}");
    }
}

#[test]
fn an_arm_without_curves_has_no_wrist() {
    assert!(wrist(&[]).is_none());
    assert!(wrist(&[0.0; LEVELS]).is_none_or(f64::is_finite));
}
