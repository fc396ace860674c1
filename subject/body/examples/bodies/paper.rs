//! Results of the paper's method: its own extremities, and its joints when the extremities are given.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use mocapd_body::extremity::find;
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_body::paper::joints;

use crate::read;
use crate::score::{self, Limit};

/// Prints on how many meshes the paper's own extremities are right, and the errors of its joints in per cent of
/// stature.
pub(crate) fn print(
    meshes: &[PathBuf],
    filter: &str,
    out: &mut impl Write,
) -> Result<(), Box<dyn std::error::Error>> {
    let [mut right, mut known, mut given] = [0; 3];
    let mut errors: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for path in meshes.iter().filter(|path| path.to_string_lossy().contains(filter)) {
        let (mesh, truth) = read::body(path)?;
        if truth.joints.is_none() {
            continue;
        }
        known += 1;
        let own = joints(&mesh, 0, None).ok();
        let own = own.and_then(|own| score::right(&mesh, &truth, &own.extremities, Limit::ByJoint));
        right += i32::from(own == Some(true));
        let graph = Graph::with_short_cuts(&mesh, &Adjacency::new(&mesh)?);
        let Ok(ends) = find(&mesh, &graph, &mut Workspace::default()) else { continue };
        let Ok(paper) = joints(&mesh, 0, Some(ends.extremities)) else { continue };
        given += 1;
        for (name, error) in score::joint_errors(&paper.joints, &truth) {
            errors.entry(name).or_default().push(100.0 * error / truth.stature_m);
        }
    }
    writeln!(out, "{known} bodies: own ends right on {right}; joints of {given} with ends given")?;
    for (name, errors) in &mut errors {
        errors.sort_by(f64::total_cmp);
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let rms =
            (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
        let at = |part: f64| errors[((errors.len() - 1) as f64 * part) as usize];
        let (count, median, p95) = (errors.len(), at(0.5), at(0.95));
        writeln!(
            out,
            "{name:9} {count:4} mean {mean:5.1} rms {rms:5.1} median {median:5.1} p95 {p95:5.1} %"
        )?;
    }
    Ok(())
}
