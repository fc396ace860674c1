//! How far the paper's method comes: its own ends, and its joints when the ends are given to it.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use mocapd_subject::body::extremity::find;
use mocapd_subject::body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_subject::body::paper::joints;
use mocapd_subject::body::{Joint, Joints, Side};

use crate::read::{self, Truth};
use crate::score;

/// Prints on how many meshes the paper's own ends are right, and the errors of its joints in per cent of stature.
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
        let own = own.and_then(|own| score::right(&mesh, &truth, &own.extremities));
        right += i32::from(own == Some(true));
        let graph = Graph::with_short_cuts(&mesh, &Adjacency::new(&mesh)?);
        let Ok(ends) = find(&mesh, &graph, &mut Workspace::default()) else { continue };
        let Ok(paper) = joints(&mesh, 0, Some(ends.extremities)) else { continue };
        given += 1;
        for (name, error) in apart(&paper.joints, &truth) {
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

/// The distance of each joint to the true one, the sides taken in the way that fits the hands and the feet, each, better.
fn apart(found: &Joints, truth: &Truth) -> Vec<(&'static str, f64)> {
    type Pair = (&'static str, fn(Side) -> Joint);
    let arm: [Pair; 3] =
        [("shoulder", Joint::Shoulder), ("elbow", Joint::Elbow), ("wrist", Joint::Wrist)];
    let leg: [Pair; 3] = [("hip", Joint::Hip), ("knee", Joint::Knee), ("ankle", Joint::Ankle)];
    let single = [("head_top", Joint::Head), ("neck", Joint::Throat), ("root", Joint::Pelvis)];
    let known = |name: &str| truth.joints.as_ref().and_then(|known| known.get(name));
    let pair = |(name, joint)| {
        let at = found.estimates.get(&joint)?.position;
        Some((name, score::distance(*known(name)?, at)))
    };
    let mut all: Vec<_> = single.into_iter().filter_map(pair).collect();
    for limb in [arm, leg] {
        let ways = [["L", "R"], ["R", "L"]].map(|sides| {
            let mut errors = Vec::new();
            for (name, joint) in limb {
                for (side, letter) in [Side::Left, Side::Right].into_iter().zip(sides) {
                    let Some(estimate) = found.estimates.get(&joint(side)) else { continue };
                    let Some(at) = known(&format!("{name}.{letter}")) else { continue };
                    errors.push((name, score::distance(*at, estimate.position)));
                }
            }
            errors
        });
        let sum = |errors: &[(&str, f64)]| errors.iter().map(|(_, error)| error).sum::<f64>();
        let [one, other] = ways;
        all.extend(if sum(&one) <= sum(&other) { one } else { other });
    }
    all
}
