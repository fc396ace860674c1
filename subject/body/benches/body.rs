//! Time to compute joints from a mesh in memory, on one core.
//!
//! `cargo bench -p mocapd-body --bench body -- [--rounds 5] [PART_OF_NAME...]`
//!
//! The bodies are generated with the numbers of faces that have a limit; if `MOCAPD_BODIES` names a folder of OBJ
//! files, they are read from there. A round is one run of the whole method on each mesh, from adjacency to joints, and
//! one run of Dijkstra's algorithm along the edges of the same mesh from one vertex. CPU time is measured, because wall
//! time depends on other work on the machine. The processes still share caches; that slows down both runs, but not
//! their ratio.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]

use std::{
    error::Error,
    fs,
    hint::black_box,
    path::{Path, PathBuf},
};

use mocapd_body::{
    Mesh, ScanAnalysis,
    geodesic::{Adjacency, Graph, Workspace, distances},
    read::read,
    skeleton::Method,
};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};
use rustix::time::{ClockId, clock_gettime};

/// Limits: a mesh with at most this many faces takes at most this many milliseconds.
const BARS_MS: [(usize, f64); 3] = [(5_500, 10.0), (11_000, 20.0), (17_000, 40.0)];
/// Face counts of the generated bodies, to within a tenth.
const GENERATED: [usize; 3] = [5_000, 10_000, 16_843];

fn main() -> Result<(), Box<dyn Error>> {
    let (mut rounds, mut names) = (5, Vec::new());
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--rounds" => rounds = args.next().ok_or("--rounds needs a number")?.parse()?,
            word if word.starts_with('-') => return Err(format!("unknown option {word}").into()),
            word => names.push(word.to_owned()),
        }
    }
    let mut meshes = match std::env::var("MOCAPD_BODIES") {
        Ok(folder) => recorded(Path::new(&folder))?,
        Err(_) => generated(),
    };
    meshes.retain(|(name, _)| names.is_empty() || names.iter().any(|part| name.contains(part)));
    println!(
        "| mesh | faces | gives | median of {rounds}, ms | fastest | bar | one Dijkstra, ms | ratio |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut over = 0;
    for (name, mesh) in &meshes {
        over += usize::from(!row(name, mesh, rounds)?);
    }
    println!("\n{over} of {} meshes took longer than their bar.", meshes.len());
    Ok(())
}

/// Prints a row and returns whether the median is within the limit.
fn row(name: &str, mesh: &Mesh, rounds: usize) -> Result<bool, Box<dyn Error>> {
    let edges = Graph::along_edges(mesh, &Adjacency::new(mesh)?);
    let (mut whole, mut bare) = (Vec::new(), Vec::new());
    let mut gives = String::new();
    for _ in 0..rounds.max(1) {
        let begin_ms = busy_ms();
        let analysis = black_box(ScanAnalysis::new(black_box(mesh), Method::Default));
        whole.push(busy_ms() - begin_ms);
        gives = analysis.map_or_else(|reason| reason.code().to_owned(), |_| "joints".to_owned());
        let begin_ms = busy_ms();
        black_box(distances(&edges, 0, &mut Workspace::default()));
        bare.push(busy_ms() - begin_ms);
    }
    let (median_ms, fastest_ms) = median_and_least(&mut whole);
    let (bare_ms, _) = median_and_least(&mut bare);
    let faces = mesh.triangles.len();
    let bar = BARS_MS.iter().find(|(most, _)| faces <= *most).map(|(_, ms)| *ms);
    let ratio = median_ms / bare_ms;
    let shown = bar.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.0}"));
    println!(
        "| {name} | {faces} | {gives} | {median_ms:.2} | {fastest_ms:.2} | {shown} | {bare_ms:.3} | {ratio:.1} |"
    );
    Ok(bar.is_none_or(|ms| median_ms <= ms))
}

/// CPU time of this thread.
fn busy_ms() -> f64 {
    let spent = clock_gettime(ClockId::ThreadCPUTime);
    spent.tv_sec as f64 * 1e3 + spent.tv_nsec as f64 / 1e6
}

fn median_and_least(times: &mut [f64]) -> (f64, f64) {
    times.sort_by(f64::total_cmp);
    let at = |index: usize| times.get(index).copied().unwrap_or(f64::NAN);
    (at(times.len() / 2), at(0))
}

fn generated() -> Vec<(String, Mesh)> {
    let sizes = GENERATED.into_iter().zip(1_u64..);
    let one = |(n_faces, seed): (usize, u64), pose: Pose| {
        let (mesh, _) = body(seed, pose, BodyOptions { n_faces, turned: true });
        (format!("{pose:?}, seed {seed}"), mesh)
    };
    sizes.flat_map(|size| Pose::ALL.map(|pose| one(size, pose))).collect()
}

fn recorded(folder: &Path) -> Result<Vec<(String, Mesh)>, Box<dyn Error>> {
    let mut meshes = Vec::new();
    for path in obj_files(folder)? {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        meshes.push((name, read(&fs::read(&path)?, "mesh.obj")?.mesh));
    }
    Ok(meshes)
}

/// All OBJ files below a folder, sorted by name.
fn obj_files(folder: &Path) -> Result<Vec<PathBuf>, std::io::Error> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            found.extend(obj_files(&path)?);
        } else if path.extension().is_some_and(|ending| ending == "obj") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}
