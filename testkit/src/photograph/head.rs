//! The surfaces of a head: the face, and what it needs around it to look like one.

use std::collections::BTreeSet;

use mocapd_face::model::{Camera, Model};

use super::paint::{Look, Pattern};
use super::raster::{Canvas, Colour, Corner, Spot, unit};

/// An ellipsoid of the average head, in its millimetres.
struct Ball {
    middle: [f64; 3],
    radii: [f64; 3],
}

/// A little larger than the skull: it comes through the forehead at the hairline, and covers the temples.
const HAIR: Ball = Ball { middle: [0.0, 24.0, -92.0], radii: [81.0, 103.0, 92.0] };
const EARS: [Ball; 2] = [
    Ball { middle: [-77.0, -18.0, -84.0], radii: [8.0, 30.0, 17.0] },
    Ball { middle: [77.0, -18.0, -84.0], radii: [8.0, 30.0, 17.0] },
];
const NECK: Ball = Ball { middle: [0.0, -150.0, -82.0], radii: [55.0, 120.0, 50.0] };
const SHOULDERS: Ball = Ball { middle: [0.0, -268.0, -100.0], radii: [215.0, 105.0, 70.0] };
/// How far behind the lips' inner edge the hollow of the mouth lies.
const HOLLOW_MM: f64 = 5.0;
const MOUTH_COLOUR: Colour = [0.05, 0.012, 0.012];
/// Triangles around a ball, and half as many from pole to pole.
const AROUND: usize = 40;

pub(super) fn draw(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    look: &Look,
    canvas: &mut Canvas,
) {
    // Shoulders do not turn with the head.
    let upright =
        Camera { yaw_deg: 0.3 * camera.yaw_deg, pitch_deg: 0.0, roll_deg: 0.0, ..*camera };
    ball(&SHOULDERS, 1.0, &upright, canvas, |spot| look.lit(look.clothes, spot.normal));
    let stretch = width(vertices_mm) / width(&model.vertices);
    // Under the chin it is darker.
    ball(&NECK, stretch, camera, canvas, |spot| look.lit(look.skin.map(|c| 0.75 * c), spot.normal));
    for ear in &EARS {
        ball(ear, stretch, camera, canvas, |spot| {
            look.lit(look.skin.map(|c| 0.9 * c), spot.normal)
        });
    }
    ball(&HAIR, stretch, camera, canvas, |spot| strands(look, spot));
    hollow(model, vertices_mm, camera, canvas);
    face(model, vertices_mm, camera, look, canvas);
}

fn face(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    look: &Look,
    canvas: &mut Canvas,
) {
    let seen = camera.project(vertices_mm);
    let normals = normals(model, &seen);
    let pattern = Pattern::new(model);
    let pupils: Vec<_> =
        ["right_pupil", "left_pupil"].iter().filter_map(|name| model.features.get(*name)).collect();
    for triangle in &model.triangles {
        let corners = triangle.map(|v| Corner {
            seen: seen[v],
            normal: normals[v],
            place: model.vertices[v],
        });
        if triangle.iter().any(|v| pupils.contains(&v)) {
            canvas.triangle(&corners, |spot| look.eye(&pattern, spot));
        } else {
            canvas.triangle(&corners, |spot| look.face(&pattern, spot));
        }
    }
}

/// A normal a vertex, from the triangles around it by their areas, in the camera's frame.
fn normals(model: &Model, seen: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut sums = vec![[0.0; 3]; seen.len()];
    for &triangle in &model.triangles {
        // y of a picture points down, that of the camera's frame up.
        let [a, b, c] = triangle.map(|v| [seen[v][0], -seen[v][1], seen[v][2]]);
        let (u, v): ([f64; 3], [f64; 3]) =
            (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        for vertex in triangle {
            for axis in 0..3 {
                sums[vertex][axis] += n[axis];
            }
        }
    }
    sums.into_iter().map(unit).collect()
}

fn ball(
    ball: &Ball,
    stretch: f64,
    camera: &Camera,
    canvas: &mut Canvas,
    paint: impl Fn(&Spot) -> Colour,
) {
    let place = |i: usize, j: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / AROUND as f64).sin_cos();
        let (up, out) = (std::f64::consts::TAU * j as f64 / AROUND as f64).sin_cos();
        let (up, out) = (-out, up);
        [out * sin, up, out * cos]
    };
    let rotation = camera.rotation();
    let corner = |(i, j): (usize, usize)| {
        let direction = place(i, j);
        let at: [f64; 3] =
            std::array::from_fn(|axis| ball.middle[axis] + ball.radii[axis] * direction[axis]);
        let at = [stretch * at[0], at[1], at[2]];
        let normal: [f64; 3] = std::array::from_fn(|axis| direction[axis] / ball.radii[axis]);
        let normal = rotation * nalgebra::Vector3::from(normal);
        Corner { seen: camera.project(&[at])[0], normal: unit(normal.into()), place: at }
    };
    for i in 0..AROUND {
        for j in 0..AROUND / 2 {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(corner);
            canvas.triangle(&[a, b, c], &paint);
            canvas.triangle(&[a, c, d], &paint);
        }
    }
}

/// Hair in streaks from the crown.
fn strands(look: &Look, spot: &Spot) -> Colour {
    let streak = 1.0 + 0.3 * (1.3 * spot.place[0] + 0.4 * (0.3 * spot.place[1]).sin()).sin();
    look.lit(look.hair.map(|c| c * streak), spot.normal)
}

fn width(vertices: &[[f64; 3]]) -> f64 {
    let x = || vertices.iter().map(|v| v[0]);
    x().fold(f64::NEG_INFINITY, f64::max) - x().fold(f64::INFINITY, f64::min)
}

/// Closes the opening between the lips with darkness.
fn hollow(model: &Model, vertices_mm: &[[f64; 3]], camera: &Camera, canvas: &mut Canvas) {
    let edges = opening(model);
    let ring = edges.iter().map(|&[a, _]| vertices_mm[a]);
    let count = ring.len().max(1) as f64;
    let sum = ring.fold([0.0; 3], |s, v| std::array::from_fn(|axis| s[axis] + v[axis]));
    let middle = sum.map(|s| s / count);
    let corner = |[x, y, z]: [f64; 3]| {
        let seen = camera.project(&[[x, y, z - HOLLOW_MM]])[0];
        Corner { seen, normal: [0.0, 0.0, 1.0], place: [x, y, z] }
    };
    for [a, b] in edges {
        canvas.triangle(&[vertices_mm[a], vertices_mm[b], middle].map(corner), |_| MOUTH_COLOUR);
    }
}

/// The edges of a single triangle that are nearer to the mouth than its corners are.
fn opening(model: &Model) -> Vec<[usize; 2]> {
    let at = |name: &str| {
        model.features.get(name).and_then(|&v| model.vertices.get(v)).copied().unwrap_or_default()
    };
    let (right, left) = (at("mouth_right"), at("mouth_left"));
    let reach = (left[0] - right[0]) / 2.0 + 1.0;
    let near = |v: usize| {
        let d = [
            model.vertices[v][0] - (left[0] + right[0]) / 2.0,
            model.vertices[v][1] - (left[1] + right[1]) / 2.0,
        ];
        d[0].hypot(d[1]) < reach
    };
    let directed: BTreeSet<[usize; 2]> =
        model.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    directed
        .iter()
        .copied()
        .filter(|&[a, b]| !directed.contains(&[b, a]) && near(a) && near(b))
        .collect()
}
