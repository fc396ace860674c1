//! Prints the landmarks of meshes with known joints, one JSON object per line, for `benches/subject/learn.py`: for each
//! mesh in its original build and in others.
//!
//!     MOCAPD_BODIES=... cargo run --release -p mocapd-body --features measure --example body_landmarks -- mh_mavg mh_favg
#![expect(clippy::print_stdout, reason = "what an example is for")]

use std::error::Error;
use std::path::Path;

use mocapd_body::extremity;
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_body::locate::{Half, Landmarks, refine_ends};
use mocapd_body::{Mesh, Refusal};
use nalgebra::Vector3;
use serde_json::{Value, json};

mod build;
#[path = "../bodies/read.rs"]
mod read;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::var("MOCAPD_BODIES")
        .map_err(|_| "set MOCAPD_BODIES to the folder of meshes with known joints")?;
    let names: Vec<String> = std::env::args().skip(1).collect();
    for path in read::all(Path::new(&folder))? {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if !names.iter().any(|start| name.starts_with(start)) {
            continue;
        }
        let (mesh, truth) = read::body(&path)?;
        let Some(joints) = truth.joints else { continue };
        for build in build::builds() {
            let (mesh, joints) = build::changed(&mesh, &joints, &build)?;
            let Some(found) = landmarks(&mesh)? else { continue };
            let half = |half: &Half| {
                let [arm, leg] = &half.sections;
                json!({
                    "arm": points(&half.arm),
                    "leg": points(&half.leg),
                    "arm_line": points(&arm.centre),
                    "arm_girth": arm.perimeter,
                    "leg_line": points(&leg.centre),
                    "leg_girth": leg.perimeter,
                })
            };
            let line = json!({
                "name": truth.name,
                "build": build.name,
                "stature": truth.stature_m,
                "joints": joints,
                "scale": found.scale,
                "halves": found.halves.each_ref().map(half),
                "head": points(&found.head),
            });
            println!("{line}");
        }
    }
    Ok(())
}

fn landmarks(mesh: &Mesh) -> Result<Option<Landmarks>, Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    let mut workspace = Workspace::default();
    // A build that is refused as a body is not learned from.
    let Ok(ends) = extremity::find(mesh, &graph, &mut workspace) else { return Ok(None) };
    let refined = refine_ends(&graph, &ends.extremities, ends.fields, &ends.spread, &mut workspace);
    Ok(Landmarks::new(mesh, &refined.fields()))
}

fn points(points: &[Vector3<f64>]) -> Value {
    points.iter().map(|at| json!([at.x, at.y, at.z])).collect()
}
