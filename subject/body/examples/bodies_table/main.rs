//! Measures the default method on meshes with known joints, and prints the tables of `docs/subject-body.md`.
//!
//!     MOCAPD_BODIES=... cargo run --release -p mocapd-body --features measure --example bodies_table [-- START_OF_NAME...]
//!
//! Without names, all meshes are measured; those that the constants were learned from get tables of their own.
#![expect(clippy::print_stdout, reason = "what an example is for")]

use std::error::Error;
use std::path::Path;

mod case;
mod invariance;
mod paper;
#[path = "../bodies/read.rs"]
mod read;
#[path = "../bodies/score.rs"]
mod score;
mod table;
mod timing;

use case::Case;
use table::{Group, is_development, pose_class};

/// Title of the section on test bodies.
const REPORTED: &str = "Not learned from";

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::var("MOCAPD_BODIES")
        .map_err(|_| "set MOCAPD_BODIES to the folder of meshes with known joints")?;
    let names: Vec<String> = std::env::args().skip(1).collect();
    let mut cases = Vec::new();
    for path in read::all(Path::new(&folder))? {
        let (mesh, truth) = read::body(&path)?;
        if names.is_empty() || names.iter().any(|start| truth.name.starts_with(start)) {
            cases.extend(Case::measure(mesh, &truth));
        }
    }
    let (learned, reported): (Vec<&Case>, Vec<&Case>) =
        cases.iter().partition(|case| is_development(&case.name));
    for (title, cases) in [(REPORTED, reported), ("Learned from", learned)] {
        if !cases.is_empty() {
            println!("## {title}\n");
            report(&cases);
            if title == REPORTED {
                table::lengths_within(&cases);
            }
            println!();
        }
    }
    println!("## Turned, moved, scaled\n");
    invariance::moved(&cases);
    println!("\n## The same body in other triangles\n");
    invariance::remeshed(&cases);
    println!("\n## Time\n");
    timing::print(&cases);
    Ok(())
}

fn report(cases: &[&Case]) {
    let by_pose = Group::by(cases, |case| pose_class(&case.name));
    let by_shape = Group::by(cases, |case| table::shape(&case.name));
    table::joints("pose", &by_pose);
    table::joints("shape", &by_shape);
    paper::print_comparison("pose", &by_pose);
    paper::print_comparison("shape", &by_shape);
    table::totals(cases);
    table::worst(cases);
}
