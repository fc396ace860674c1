//! One row for each mesh.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use mocapd_body::extremity::find;
use mocapd_body::geodesic::{Adjacency, Graph, Workspace, distances};

use crate::read;
use crate::score::{self, Limit};

/// Number of runs. The fastest counts, since other work on the machine only ever adds time.
const RUN_COUNT: usize = 5;

pub(crate) fn print(
    meshes: &[PathBuf],
    filter: &str,
    out: &mut impl Write,
) -> Result<(), Box<dyn std::error::Error>> {
    writeln!(out, "{:32} {:>5} {:>6} {:>5}  ends", "mesh", "euler", "ms", "ratio")?;
    let [mut right, mut strictly, mut refused, mut wrong] = [0; 4];
    for path in meshes.iter().filter(|path| path.to_string_lossy().contains(filter)) {
        let (mesh, truth) = read::body(path)?;
        let adjacency = Adjacency::new(&mesh)?;
        let mut workspace = Workspace::default();
        let graph = Graph::with_short_cuts(&mesh, &adjacency);
        let ends = find(&mesh, &graph, &mut workspace);
        let whole_ms = fastest_ms(|| {
            let adjacency = Adjacency::new(&mesh)?;
            let graph = Graph::with_short_cuts(&mesh, &adjacency);
            std::hint::black_box(find(&mesh, &graph, &mut Workspace::default()).ok());
            Ok::<_, Box<dyn std::error::Error>>(())
        })?;
        let edges = Graph::along_edges(&mesh, &adjacency);
        let bare_ms = fastest_ms(|| {
            std::hint::black_box(distances(&edges, 0, &mut Workspace::default()));
            Ok::<_, Box<dyn std::error::Error>>(())
        })?;
        let euler = adjacency.euler_characteristic();
        write!(out, "{:32} {euler:5} {whole_ms:6.2} {:5.1}  ", truth.name, whole_ms / bare_ms)?;
        match ends {
            Ok(ends) => {
                let score = |limit| score::right(&mesh, &truth, &ends.extremities, limit);
                let outcome = match (score(Limit::ByJoint), score(Limit::Strict)) {
                    (Some(true), Some(true)) => "right, strictly",
                    (Some(true), _) => "right",
                    (Some(false), _) => "WRONG",
                    (None, _) => "found",
                };
                strictly += i32::from(outcome == "right, strictly");
                right += i32::from(outcome.starts_with("right"));
                wrong += i32::from(outcome == "WRONG");
                let (misfit, confidence) = (ends.misfit.rms, ends.confidence());
                write!(
                    out,
                    "{outcome}, by {:?}, misfit {misfit:.2}, margin {:.2}, confidence {confidence:.2}, persistence",
                    ends.mode, ends.margin
                )?;
                for part in ends.persistence {
                    write!(out, " {part:.3}")?;
                }
                writeln!(out)?;
            }
            Err(refusal) => {
                refused += 1;
                writeln!(out, "refused: {}: {refusal:?}", refusal.code())?;
            }
        }
    }
    writeln!(
        out,
        "{right} right, {strictly} of them with every known joint within 12 % of stature of its end, \
         {refused} refused, {wrong} wrong"
    )?;
    Ok(())
}

fn fastest_ms<E>(mut run: impl FnMut() -> Result<(), E>) -> Result<f64, E> {
    let mut least = f64::INFINITY;
    for _ in 0..RUN_COUNT {
        let start = Instant::now();
        run()?;
        least = least.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(least)
}
