//! Invariance of the joints to rotation, scale and resolution.

use mocapd_body::{Joints, Mesh};
use nalgebra::{Rotation3, Vector3};

use crate::case::{Case, distance, skeleton};

/// Differences between joints of rotated, translated and scaled meshes and equally transformed joints of the originals.
pub(crate) fn moved(cases: &[Case]) {
    let turn = Rotation3::from_euler_angles(0.7, -2.1, 1.3);
    let (shift, factor) = (Vector3::new(31.0, -7.5, 400.0), 1000.0);
    let place = |at: [f64; 3]| -> [f64; 3] { ((turn * Vector3::from(at)) * factor + shift).into() };
    let (mut most, mut meshes) = (0.0_f64, 0);
    for case in cases.iter().step_by(4) {
        let Ok(before) = &case.found else { continue };
        let positions = case.mesh.positions.iter().map(|at| place(*at)).collect();
        let turned = Mesh { positions, triangles: case.mesh.triangles.clone() };
        let Ok(after) = skeleton(&turned) else {
            println!("{}: refused when turned.", case.name);
            continue;
        };
        for (joint, estimate) in &before.estimates {
            let Some(again) = after.estimates.get(joint) else { continue };
            let moved = distance(place(estimate.position), again.position) / factor / case.stature;
            most = most.max(moved);
        }
        meshes += 1;
    }
    println!("Joints of {meshes} meshes move by at most {most:.1e} of stature.");
}

/// Differences between joints of meshes of one body in different numbers of triangles.
pub(crate) fn remeshed(cases: &[Case]) {
    println!("| body | faces | mean, % of stature | most | which |\n|---|---|---|---|---|");
    for (index, case) in cases.iter().enumerate() {
        let Some((body, faces)) = case.name.rsplit_once('_') else { continue };
        for other in &cases[..index] {
            let Some((same, others)) = other.name.rsplit_once('_') else { continue };
            let (Ok(one), Ok(two)) = (&case.found, &other.found) else { continue };
            if same == body && case.truth == other.truth {
                let (mean, most, which) = differences(one, two, case.stature);
                println!("| {body} | {others}, {faces} | {mean:.2} | {most:.2} | {which} |");
            }
        }
    }
}

/// Mean and largest distance of the joints of two results, in percent of stature, and the joint that differs most.
fn differences(one: &Joints, two: &Joints, stature: f64) -> (f64, f64, String) {
    let moved: Vec<(f64, String)> = one
        .estimates
        .iter()
        .filter_map(|(joint, a)| {
            let b = two.estimates.get(joint)?;
            Some((100.0 * distance(a.position, b.position) / stature, format!("{joint:?}")))
        })
        .collect();
    let mean = moved.iter().map(|error| error.0).sum::<f64>() / moved.len().max(1) as f64;
    let most = moved.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
    (mean, most.0, most.1)
}
