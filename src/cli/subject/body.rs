//! `subject body`: joint centres and bone lengths from body scans.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files;
use mocapd_body::{
    Repaired, ScanAnalysis, Unit,
    picture::{Drawing, svg},
    read, repair,
    skeleton::{Method, ScanJoints, Skeleton, Source},
};

use super::MethodArg;
use crate::cli::{
    motion_files::{file_name, write_new},
    output::{Progress, eprint, notify, print, print_json_text},
    paths, plot,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Body scans of one person: .obj, .ply, .stl or .off, in any pose
    #[arg(required = true, value_name = "SCAN")]
    scans: Vec<PathBuf>,
    /// The skeleton to write; it must not exist. With - it goes to standard output, and the table to standard error
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Unit of the scans: m, cm, mm or in [default: as stated in the file, or inferred from the size of the body]
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    unit: Option<Unit>,
    /// Method to locate the joints: that of mocapd, or that of the paper (Yu et al. 2008)
    #[arg(long, value_enum, default_value_t = MethodArg::Default)]
    method: MethodArg,
    /// Write a picture of the joints in the first scan to this file, .svg or .png; it must not exist
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print the skeleton as JSON
    #[arg(long)]
    json: bool,
}

/// Below this confidence in head, hands and feet the user is warned: arms merged with the trunk gave 0.14.
const CONFIDENCE_MIN: f64 = 0.5;

/// Maximum number of scans of one person: the limit on the sources of a skeleton.
const SCANS_MAX: usize = 64;

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let n_scans = args.scans.len();
    if n_scans > SCANS_MAX {
        bail!(UsageError(format!("{n_scans} scans are too many: give at most {SCANS_MAX}")));
    }
    let to_stdout = args.output.as_deref().is_some_and(paths::is_dash);
    let output = args.output.as_deref().filter(|_| !to_stdout);
    output.map(paths::check_output).transpose()?;
    args.picture.as_deref().map(plot::check_output).transpose()?;
    if let (Some(output), Some(drawing)) = (output, &args.picture)
        && paths::are_one(output, drawing)
    {
        let message = format!("{}: --output and --picture name the same file", output.display());
        return Err(UsageError(message).into());
    }
    let method = match args.method {
        MethodArg::Default => Method::Default,
        MethodArg::Paper => Method::Paper,
    };
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow("finding joints", &counter, n_scans as u64);
    let mut scans = Vec::with_capacity(n_scans);
    let mut first = None;
    for path in &args.scans {
        let (repaired, scan, analysis) = analyse(path, args.unit, method)?;
        scans.push(scan);
        first.get_or_insert((path, repaired, analysis));
        counter.fetch_add(1, Ordering::Relaxed);
    }
    drop(progress);
    let skeleton = Skeleton::new(method, &scans).context("no scan was given")?;
    if skeleton.bones.is_empty() {
        bail!("no bone has a plausible length: give the unit of the scan with --unit");
    }
    let from = scans.iter().map(|scan| scan.notes.len()).sum();
    skeleton.notes.iter().skip(from).for_each(|note| notify(note));
    if let (Some(drawing), Some((path, repaired, analysis))) = (&args.picture, first) {
        let analysis = analysis.with_levels(&repaired.mesh);
        plot::write(drawing, &picture(&file_name(path), &repaired, &analysis, &skeleton))?;
    }
    if let Some(output) = output {
        write_new(output, skeleton.to_json().as_bytes())?;
    }
    match (args.json, to_stdout) {
        (false, false) => print(&table(&skeleton))?,
        (json, _) => {
            print_json_text(&skeleton.to_json())?;
            if !json {
                eprint(&table(&skeleton));
            }
        }
    }
    Ok(Outcome::Done)
}

/// Reads and repairs a scan and locates its joints; prints its notes.
fn analyse(
    path: &Path,
    unit: Option<Unit>,
    method: Method,
) -> anyhow::Result<(Repaired, ScanJoints, ScanAnalysis)> {
    let file = path.display();
    let bytes = files::read_bounded(path, read::BYTES_MAX)?;
    let scan =
        read::read(&bytes, &file_name(path)).with_context(|| format!("cannot read {file}"))?;
    let repaired =
        repair::repair(scan, unit).with_context(|| format!("{file} is not a body scan"))?;
    for note in &repaired.notes {
        notify(&format!("{file}: {note}"));
    }
    let analysis = match ScanAnalysis::new(&repaired.mesh, method) {
        Ok(analysis) => analysis,
        Err(refusal) => bail!("{file}: no skeleton ({}): {refusal}", refusal.code()),
    };
    let mut notes: Vec<String> = repaired.notes.iter().map(ToString::to_string).collect();
    notes.extend(repaired.unit_ambiguity(analysis.body_scale).iter().map(ToString::to_string));
    notes.extend(analysis.notes.iter().map(ToString::to_string));
    if analysis.in_contact {
        notes.push("limbs touch: joints near the contact are uncertain, see +- mm".to_owned());
    }
    if analysis.confidence < CONFIDENCE_MIN {
        notes.push(
            "head, hands and feet are uncertain, perhaps because limbs touch: check the joints with --picture"
                .to_owned(),
        );
    }
    if !analysis.joints.sides_told {
        notes.push("left and right are uncertain: they may be swapped".to_owned());
    }
    notes.iter().skip(repaired.notes.len()).for_each(|note| notify(&format!("{file}: {note}")));
    let scan = ScanJoints {
        source: Source::new(&file_name(path), &bytes, &repaired),
        joints: analysis.joints.clone(),
        unit: repaired.unit,
        notes,
    };
    Ok((repaired, scan, analysis))
}

/// An uncertainty in a table; `-` if it is unknown.
fn uncertainty(mm: Option<f64>) -> String {
    mm.map_or_else(|| "-".to_owned(), |mm| format!("{mm:.1}"))
}

/// The tables of bones and joints.
fn table(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    if let Some(stature_mm) = skeleton.stature_mm {
        let sigma = skeleton.stature_uncertainty_mm;
        let sigma = sigma.map_or_else(String::new, |mm| format!(" +- {mm:.0}"));
        out += &format!("stature {stature_mm:.0}{sigma} mm, from the bone lengths\n");
    }
    let sides = if skeleton.sides_told { "" } else { " (l_ and r_ may be swapped)" };
    out += &format!("\nbone                 length mm   +- mm{sides}\n");
    for bone in &skeleton.bones {
        let sigma = uncertainty(bone.uncertainty_mm);
        out += &format!("{:<20} {:>9.1} {sigma:>7}", bone.name, bone.length_mm);
        if let Some(spread_mm) = bone.spread_mm {
            out += &format!("   spread {spread_mm:.1} mm over {} scans", bone.scans);
        }
        out.push('\n');
    }
    out += "\njoint                   x mm      y mm      z mm   +- mm\n";
    for joint in &skeleton.joints {
        let [x, y, z] = joint.position_mm.unwrap_or_default();
        let (name, sigma) = (&joint.name, uncertainty(joint.uncertainty_mm));
        out += &format!("{name:<18} {x:>9.1} {y:>9.1} {z:>9.1} {sigma:>7}\n");
    }
    out
}

fn unit(text: &str) -> Result<Unit, String> {
    Unit::from_name(text).ok_or_else(|| format!("expected m, cm, mm or in, found '{text}'"))
}

/// The picture, as SVG; with level curves if `analysis` has those of a body.
fn picture(name: &str, scan: &Repaired, analysis: &ScanAnalysis, skeleton: &Skeleton) -> String {
    let is_paper = skeleton.method == Method::Paper.name();
    let method = if is_paper { "as Yu et al. 2008" } else { "default method" };
    let title = format!("{name}, {method}");
    let mut drawing = Drawing {
        title: &title,
        mesh: Some(&scan.mesh),
        unit: Some(scan.unit),
        joints: analysis.joints.clone(),
        skeleton: Some(skeleton),
        ..Drawing::default()
    };
    if let Some(levels) = &analysis.levels {
        drawing.trace(levels);
    }
    svg(&drawing)
}
