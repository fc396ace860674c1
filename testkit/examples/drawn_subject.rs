//! Writes a synthetic body scan and portrait, to try out the preparation of a subject.
//!
//! `cargo run --release -p mocapd-testkit --example drawn_subject FOLDER [SEED]` writes `scan.obj` (metres, arms away
//! from the body) and `portrait.png` to a folder.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use mocapd_body::Mesh;
use mocapd_testkit::{
    photograph::Scene,
    synthetic_body::{BodyOptions, Pose, body},
};

/// Outer interocular distance: that of a portrait which fills a screen.
const INTEROCULAR_PX: f64 = 120.0;

/// Triangles of the scan: a fifth of a typical scanner's.
const N_FACES: usize = 10_000;

fn obj(mesh: &Mesh) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    for [x, y, z] in &mesh.positions {
        writeln!(text, "v {x} {y} {z}")?;
    }
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|corner| corner + 1);
        writeln!(text, "f {a} {b} {c}")?;
    }
    Ok(text)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args_os().skip(1);
    let folder = args.next().ok_or("missing FOLDER: drawn_subject FOLDER [SEED]")?;
    let seed = match args.next() {
        Some(seed) => seed.to_str().ok_or("SEED must be a number")?.parse()?,
        None => 5,
    };
    let (mesh, _) = body(seed, Pose::A, BodyOptions { n_faces: N_FACES, turned: false });
    std::fs::write(Path::new(&folder).join("scan.obj"), obj(&mesh)?)?;
    Scene::portrait(seed, INTEROCULAR_PX, 0.0)
        .render()?
        .image
        .save(Path::new(&folder).join("portrait.png"))?;
    Ok(())
}
