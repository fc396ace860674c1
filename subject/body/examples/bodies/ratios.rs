//! Statistics of the ratios between the extremities of a body.

use std::io::Write;
use std::path::PathBuf;

use mocapd_body::extremity::find;
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};

use crate::read;
use crate::score::{self, Limit};

/// Prints mean and standard deviation of each measure over the meshes of the two average shapes whose extremities are
/// named correctly, and the number of the others.
pub(crate) fn print(
    meshes: &[PathBuf],
    out: &mut impl Write,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut rows = Vec::new();
    let mut left_out = 0;
    for path in meshes {
        let (mesh, truth) = read::body(path)?;
        if !["mh_mavg", "mh_favg"].iter().any(|shape| truth.name.starts_with(shape)) {
            continue;
        }
        let graph = Graph::with_short_cuts(&mesh, &Adjacency::new(&mesh)?);
        let ends = find(&mesh, &graph, &mut Workspace::default());
        let named = ends.ok().filter(|ends| {
            score::right(&mesh, &truth, &ends.extremities, Limit::ByJoint) == Some(true)
        });
        match named {
            Some(ends) => rows.push(ends.misfit.measures),
            None => left_out += 1,
        }
    }
    writeln!(out, "{} bodies, {left_out} left out", rows.len())?;
    let count = rows.len() as f64;
    for measure in 0..rows.first().map_or(0, |row| row.len()) {
        let values = || rows.iter().map(|row| row[measure]);
        let mean = values().sum::<f64>() / count;
        let sd = (values().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        writeln!(out, "prior({mean:.3}, {sd:.3})")?;
    }
    Ok(())
}
