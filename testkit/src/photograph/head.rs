//! Draws the surfaces of a head: the face, and the hair, ears, neck and shoulders around it.

use std::collections::BTreeSet;

use mocapd_face::model::{Camera, Model};

use super::paint::{FaceLayout, Palette};
use super::raster::{Canvas, Colour, Fragment, Vertex, unit};

/// An ellipsoid in the frame of the average head, millimetres.
struct Ellipsoid {
    middle: [f64; 3],
    radii: [f64; 3],
}

/// A little larger than the skull: it emerges from the forehead at the hairline, and covers the temples.
const HAIR: Ellipsoid = Ellipsoid { middle: [0.0, 24.0, -92.0], radii: [81.0, 103.0, 92.0] };
const EARS: [Ellipsoid; 2] = [
    Ellipsoid { middle: [-77.0, -18.0, -84.0], radii: [8.0, 30.0, 17.0] },
    Ellipsoid { middle: [77.0, -18.0, -84.0], radii: [8.0, 30.0, 17.0] },
];
const NECK: Ellipsoid = Ellipsoid { middle: [0.0, -150.0, -82.0], radii: [55.0, 120.0, 50.0] };
const SHOULDERS: Ellipsoid =
    Ellipsoid { middle: [0.0, -268.0, -100.0], radii: [215.0, 105.0, 70.0] };
/// Distance of the mouth cavity behind the inner edge of the lips.
const CAVITY_DEPTH_MM: f64 = 5.0;
const MOUTH_COLOUR: Colour = [0.05, 0.012, 0.012];
/// Segments around an ellipsoid; half as many from pole to pole.
const AROUND: usize = 40;

pub(super) fn draw(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    palette: &Palette,
    canvas: &mut Canvas,
) {
    // Shoulders do not turn with the head.
    let upright =
        Camera { yaw_deg: 0.3 * camera.yaw_deg, pitch_deg: 0.0, roll_deg: 0.0, ..*camera };
    ellipsoid(&SHOULDERS, 1.0, &upright, canvas, |p| palette.lit(palette.clothes, p.normal));
    let stretch = width(vertices_mm) / width(&model.vertices);
    // The neck is in the shadow of the chin.
    let shaded = |shade: f64| palette.skin.map(|c| shade * c);
    ellipsoid(&NECK, stretch, camera, canvas, |p| palette.lit(shaded(0.75), p.normal));
    for ear in &EARS {
        ellipsoid(ear, stretch, camera, canvas, |p| palette.lit(shaded(0.9), p.normal));
    }
    ellipsoid(&HAIR, stretch, camera, canvas, |point| strands(palette, point));
    mouth_cavity(model, vertices_mm, camera, canvas);
    face(model, vertices_mm, camera, palette, canvas);
}

fn face(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    palette: &Palette,
    canvas: &mut Canvas,
) {
    let projected = camera.project(vertices_mm);
    let normals = normals(model, &projected);
    let layout = FaceLayout::new(model);
    let pupils: Vec<_> =
        ["right_pupil", "left_pupil"].iter().filter_map(|name| model.features.get(*name)).collect();
    for triangle in &model.triangles {
        let corners = triangle.map(|v| Vertex {
            projected: projected[v],
            normal: normals[v],
            place: model.vertices[v],
        });
        if triangle.iter().any(|v| pupils.contains(&v)) {
            canvas.triangle(&corners, |point| palette.eye(&layout, point));
        } else {
            canvas.triangle(&corners, |point| palette.face(&layout, point));
        }
    }
}

/// One normal per vertex, averaged over the adjacent triangles by area, in the camera's frame.
fn normals(model: &Model, projected: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut sums = vec![[0.0; 3]; projected.len()];
    for &triangle in &model.triangles {
        // In a picture y points down, in the camera's frame up.
        let [a, b, c] = triangle.map(|v| [projected[v][0], -projected[v][1], projected[v][2]]);
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

fn ellipsoid(
    shape: &Ellipsoid,
    stretch: f64,
    camera: &Camera,
    canvas: &mut Canvas,
    paint: impl Fn(&Fragment) -> Colour,
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
            std::array::from_fn(|axis| shape.middle[axis] + shape.radii[axis] * direction[axis]);
        let at = [stretch * at[0], at[1], at[2]];
        let normal: [f64; 3] = std::array::from_fn(|axis| direction[axis] / shape.radii[axis]);
        let normal = rotation * nalgebra::Vector3::from(normal);
        Vertex { projected: camera.project(&[at])[0], normal: unit(normal.into()), place: at }
    };
    for i in 0..AROUND {
        for j in 0..AROUND / 2 {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(corner);
            canvas.triangle(&[a, b, c], &paint);
            canvas.triangle(&[a, c, d], &paint);
        }
    }
}

/// Colour of the hair, in streaks from the crown.
fn strands(palette: &Palette, point: &Fragment) -> Colour {
    let streak = 1.0 + 0.3 * (1.3 * point.place[0] + 0.4 * (0.3 * point.place[1]).sin()).sin();
    palette.lit(palette.hair.map(|c| c * streak), point.normal)
}

fn width(vertices: &[[f64; 3]]) -> f64 {
    let x = || vertices.iter().map(|v| v[0]);
    x().fold(f64::NEG_INFINITY, f64::max) - x().fold(f64::INFINITY, f64::min)
}

/// Closes the opening between the lips with a dark surface.
fn mouth_cavity(model: &Model, vertices_mm: &[[f64; 3]], camera: &Camera, canvas: &mut Canvas) {
    let edges = opening(model);
    let ring = edges.iter().map(|&[a, _]| vertices_mm[a]);
    let count = ring.len().max(1) as f64;
    let sum = ring.fold([0.0; 3], |s, v| std::array::from_fn(|axis| s[axis] + v[axis]));
    let middle = sum.map(|s| s / count);
    let corner = |[x, y, z]: [f64; 3]| {
        let projected = camera.project(&[[x, y, z - CAVITY_DEPTH_MM]])[0];
        Vertex { projected, normal: [0.0, 0.0, 1.0], place: [x, y, z] }
    };
    for [a, b] in edges {
        canvas.triangle(&[vertices_mm[a], vertices_mm[b], middle].map(corner), |_| MOUTH_COLOUR);
    }
}

/// Boundary edges of the mesh around the mouth: edges of only one triangle, nearer to the mouth than its corners.
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
