//! Cuts limbs off bodies, and reports joints with a large error but a small standard deviation: the criterion of
//! `docs/subject-body.md`.
//!
//!     MOCAPD_BODIES=... cargo run --release -p mocapd-body --features measure --example cut_limbs [-- CUTS_A_BODY [FIRST_SEED [PART_OF_A_NAME]]]
//!
//! Twenty cuts of each of ten bodies: generated ones, or, if `MOCAPD_BODIES` names a folder, every other one from
//! there. Bodies and cuts are derived from seeds, starting with the first seed (default 0). With a part of a name, all
//! matching bodies are used. A line is printed for each whole body and for each cut.
#![expect(clippy::print_stdout, reason = "what an example is for")]

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::repair;
use mocapd_body::skeleton::Method;
use mocapd_body::{Estimate, Joint, Joints, Mesh, ScanAnalysis, Side};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body, cut_limb};

#[path = "../bodies/read.rs"]
mod read;

/// No joint may have an error above this, in parts of stature, if its stated standard deviation is below [`SURE`].
const FAR: f64 = 0.1;
const SURE: f64 = 0.03;
const BODIES: usize = 10;
const CUTS: u64 = 20;

struct Body {
    name: String,
    mesh: Mesh,
    truth: Joints,
    stature: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let cuts = match std::env::args().nth(1) {
        Some(number) => number.parse()?,
        None => CUTS,
    };
    let first = match std::env::args().nth(2) {
        Some(seed) => seed.parse()?,
        None => 0,
    };
    let part = std::env::args().nth(3);
    let mut bodies = generated(first);
    if let Ok(folder) = std::env::var("MOCAPD_BODIES") {
        let scans = scans(Path::new(&folder))?;
        match &part {
            Some(_) => bodies.extend(scans),
            // Equal numbers of both, with the scans spread evenly over the folder.
            None => {
                let every = (scans.len() / (BODIES / 2)).max(1);
                bodies.truncate(BODIES / 2);
                let skipped = (first % every as u64) as usize;
                bodies.extend(scans.into_iter().skip(skipped).step_by(every));
            }
        }
    }
    match &part {
        Some(part) => bodies.retain(|body| body.name.contains(part)),
        None => bodies.truncate(BODIES),
    }
    let (mut count, mut wrong) = (BTreeMap::<&str, u32>::new(), 0);
    for (at, body) in bodies.iter().enumerate() {
        for seed in
            (0..=cuts).map(|cut| cut.checked_sub(1).map(|cut| first + at as u64 * cuts + cut))
        {
            let (mesh, what) = match seed.map(|seed| cut_limb(&body.mesh, &body.truth, seed)) {
                None => (body.mesh.clone(), "whole".to_owned()),
                Some(None) => {
                    *count.entry("no such cut").or_default() += 1;
                    continue;
                }
                Some(Some((mesh, cut))) => {
                    let end = if cut.capped { "capped" } else { "open" };
                    (mesh, format!("{:?} {:?} {:.0} deg {end}", cut.side, cut.part, cut.tilt_deg))
                }
            };
            let kind = match evaluate(body, mesh) {
                Err(reason) => {
                    println!("{}: {what}: refused, {reason}", body.name);
                    "refused"
                }
                Ok((notes, far)) => {
                    println!("{}: {what}: {notes:?}{far}", body.name);
                    wrong += u32::from(seed.is_some() && !far.is_empty());
                    if notes.contains(&"limb-cut-off") { "noticed" } else { "not noticed" }
                }
            };
            *count.entry(if seed.is_some() { kind } else { "whole bodies" }).or_default() += 1;
        }
    }
    println!(
        "{count:?}; {wrong} cuts leave a joint more than 10 % of stature off at less than 3 %"
    );
    Ok(())
}

fn generated(first: u64) -> Vec<Body> {
    let poses = [Pose::A, Pose::Down, Pose::Walk, Pose::Sit, Pose::Squat];
    let each = (0..BODIES).map(|at| {
        let (seed, pose) = (first + at as u64, poses[at % poses.len()]);
        let (mesh, truth) = body(seed, pose, BodyOptions::default());
        let upright = body(seed, Pose::A, BodyOptions { n_faces: 500, turned: false }).1;
        let stature = upright.estimates[&Joint::Head].position[1];
        Body { name: format!("generated_{seed}_{pose:?}"), mesh, truth, stature }
    });
    each.collect()
}

fn scans(folder: &Path) -> Result<Vec<Body>, Box<dyn Error>> {
    let mut found = Vec::new();
    for path in read::all(folder)? {
        let (mesh, known) = read::body(&path)?;
        if let Some(joints) = &known.joints {
            let truth = truth(joints);
            found.push(Body { name: known.name, mesh, truth, stature: known.stature_m });
        }
    }
    Ok(found)
}

/// The codes of the notes, and the joints with a large error but a small standard deviation.
fn evaluate(body: &Body, mesh: Mesh) -> Result<(Vec<&'static str>, String), String> {
    let scan = Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() };
    let repaired = repair(scan, None).map_err(|error| error.to_string())?;
    let analysis = ScanAnalysis::new(&repaired.mesh, Method::Default);
    let analysis = analysis.map_err(|refusal| refusal.code().to_owned())?;
    let errors = |swapped: bool| {
        analysis.joints.estimates.iter().filter_map(move |(joint, found)| {
            let joint = if swapped { other_side(*joint) } else { *joint };
            let known = body.truth.estimates.get(&joint)?;
            let error = distance(known.position, found.position) / body.stature;
            Some((joint, error, found.sigma / body.stature))
        })
    };
    // If the sides are undetermined, either assignment is accepted.
    let sum = |swapped: bool| errors(swapped).map(|(_, error, _)| error).sum::<f64>();
    let swapped = !analysis.joints.sides_told && sum(true) < sum(false);
    let far = errors(swapped).filter(|(_, error, sigma)| *error > FAR && *sigma < SURE);
    let far = far.map(|(joint, error, sigma)| {
        format!(" {joint:?} {:.1} % off at {:.1} %", 100.0 * error, 100.0 * sigma)
    });
    Ok((analysis.notes.iter().map(|note| note.code).collect(), far.collect()))
}

fn truth(known: &BTreeMap<String, [f64; 3]>) -> Joints {
    let mut joints = Joints { sides_told: true, ..Joints::default() };
    let mut add = |joint: Joint, name: &str| {
        if let Some(&position) = known.get(name) {
            joints.estimates.insert(joint, Estimate { position, sigma: 0.0 });
        }
    };
    add(Joint::Head, "head_top");
    add(Joint::Throat, "neck");
    for (side, letter) in [(Side::Left, "L"), (Side::Right, "R")] {
        add(Joint::Shoulder(side), &format!("shoulder.{letter}"));
        add(Joint::Elbow(side), &format!("elbow.{letter}"));
        add(Joint::Wrist(side), &format!("wrist.{letter}"));
        add(Joint::Hip(side), &format!("hip.{letter}"));
        add(Joint::Knee(side), &format!("knee.{letter}"));
        add(Joint::Ankle(side), &format!("ankle.{letter}"));
    }
    joints
}

fn other_side(joint: Joint) -> Joint {
    let other = |side| if side == Side::Left { Side::Right } else { Side::Left };
    match joint {
        Joint::Shoulder(side) => Joint::Shoulder(other(side)),
        Joint::Elbow(side) => Joint::Elbow(other(side)),
        Joint::Wrist(side) => Joint::Wrist(other(side)),
        Joint::Hip(side) => Joint::Hip(other(side)),
        Joint::Knee(side) => Joint::Knee(other(side)),
        Joint::Ankle(side) => Joint::Ankle(other(side)),
        Joint::Head | Joint::Throat | Joint::Pelvis => joint,
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}
