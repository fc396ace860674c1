//! `subject body`.

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
    Repaired, Survey, Unit,
    picture::{Drawing, svg},
    read, repair,
    skeleton::{Method, ScanJoints, Skeleton, Source},
};

use super::Chosen;
use crate::cli::{
    output::Progress,
    output::{print, print_json_text, say, tell},
    paths, plot,
    whole::{name, write_new},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Scans of one person, .obj, .ply, .stl or .off, each in any pose
    #[arg(required = true, value_name = "SCAN")]
    scans: Vec<PathBuf>,
    /// The skeleton to write; it must not exist. - writes to standard output, and the table to standard error
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The unit of the scans, m, cm, mm or in [default: what the file says, or what makes it a body]
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    unit: Option<Unit>,
    /// How joints are found: ours, or as Yu et al. 2008 print it
    #[arg(long, value_enum, default_value_t = Chosen::Default)]
    method: Chosen,
    /// A picture of what was found in the first scan, .svg or .png; it must not exist
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print the skeleton as JSON
    #[arg(long)]
    json: bool,
}

/// Ends that are told less surely than this want a look: arms that have grown to the trunk gave 0.14.
const DOUBTED: f64 = 0.5;

/// Most scans of one person: what a skeleton names as its sources.
const SCANS_MAX: usize = 64;

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if args.scans.len() > SCANS_MAX {
        return Err(UsageError(format!(
            "{} scans were given: {SCANS_MAX} are enough of anybody",
            args.scans.len()
        ))
        .into());
    }
    let to_stdout = args.output.as_deref().is_some_and(paths::is_stdout);
    let output = args.output.as_deref().filter(|_| !to_stdout);
    output.map(paths::check_output).transpose()?;
    args.picture.as_deref().map(plot::check_output).transpose()?;
    if let (Some(output), Some(drawing)) = (output, &args.picture)
        && paths::are_one(output, drawing)
    {
        let message =
            format!("{}: the skeleton and its picture would be one file", output.display());
        return Err(UsageError(message).into());
    }
    let method = match args.method {
        Chosen::Default => Method::Default,
        Chosen::Paper => Method::Paper,
    };
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow("finding joints", &counter, args.scans.len() as u64);
    let mut scans = Vec::with_capacity(args.scans.len());
    let mut first = None;
    for path in &args.scans {
        let (repaired, scan, survey) = survey(path, args.unit, method)?;
        scans.push(scan);
        first.get_or_insert((path, repaired, survey));
        counter.fetch_add(1, Ordering::Relaxed);
    }
    drop(progress);
    let skeleton = Skeleton::new(method, &scans).context("no scan was given")?;
    if skeleton.bones.is_empty() {
        bail!("no bone has a length of a body: say in which --unit the scan is");
    }
    let from = scans.iter().map(|scan| scan.notes.len()).sum();
    skeleton.notes.iter().skip(from).for_each(|note| say(note));
    if let (Some(drawing), Some((path, repaired, survey))) = (&args.picture, first) {
        let survey = survey.with_levels(&repaired.mesh);
        plot::write(drawing, &picture(&name(path), &repaired, &survey, &skeleton))?;
    }
    if let Some(output) = output {
        write_new(output, skeleton.to_json().as_bytes())?;
    }
    match (args.json, to_stdout) {
        (false, false) => print(&table(&skeleton))?,
        (json, _) => {
            print_json_text(&skeleton.to_json())?;
            if !json {
                tell(&table(&skeleton));
            }
        }
    }
    Ok(Outcome::Done)
}

fn survey(
    path: &Path,
    unit: Option<Unit>,
    method: Method,
) -> anyhow::Result<(Repaired, ScanJoints, Survey)> {
    let shown = path.display();
    let bytes = files::read_bounded(path, read::BYTES_MAX)?;
    let scan = read::read(&bytes, &name(path)).with_context(|| format!("cannot read {shown}"))?;
    let repaired =
        repair::repair(scan, unit).with_context(|| format!("{shown} is no body scan"))?;
    for note in &repaired.notes {
        say(&format!("{shown}: {note}"));
    }
    let survey = match Survey::new(&repaired.mesh, method) {
        Ok(survey) => survey,
        Err(refusal) => bail!("{shown}: no skeleton ({}): {refusal}", refusal.code()),
    };
    let mut notes: Vec<String> = repaired.notes.iter().map(ToString::to_string).collect();
    notes.extend(repaired.unit_ambiguity(survey.body_scale).iter().map(ToString::to_string));
    notes.extend(survey.notes.iter().map(ToString::to_string));
    if survey.in_contact {
        notes.push(
            "limbs touch: joints near the contact are unsure, as told by their +- mm".to_owned(),
        );
    }
    if survey.confidence < DOUBTED {
        notes.push(
            "head, hands and feet are not told surely, as where limbs touch: look at the picture \
             before you trust a joint"
                .to_owned(),
        );
    }
    if !survey.joints.sides_told {
        notes.push("left and right could not be told: the sides may be exchanged".to_owned());
    }
    notes.iter().skip(repaired.notes.len()).for_each(|note| say(&format!("{shown}: {note}")));
    let scan = ScanJoints {
        source: Source::new(&name(path), &bytes, &repaired),
        joints: survey.joints.clone(),
        unit: repaired.unit,
        notes,
    };
    Ok((repaired, scan, survey))
}

/// What people read.
fn table(skeleton: &Skeleton) -> String {
    let mut out = String::new();
    if let Some(stature_mm) = skeleton.stature_mm {
        let sigma = skeleton.stature_uncertainty_mm;
        let sigma = sigma.map_or_else(String::new, |mm| format!(" +- {mm:.0}"));
        out += &format!("stature {stature_mm:.0}{sigma} mm, out of the bones\n");
    }
    let sides = if skeleton.sides_told { "" } else { " (l_ and r_ may be exchanged)" };
    out += &format!("\nbone                 length mm   +- mm{sides}\n");
    for bone in &skeleton.bones {
        out += &format!(
            "{:<20} {:>9.1} {:>7.1}",
            bone.name,
            bone.length_mm,
            bone.uncertainty_mm.unwrap_or_default()
        );
        if let Some(spread_mm) = bone.spread_mm {
            out += &format!("   spread {spread_mm:.1} mm over {} scans", bone.scans);
        }
        out.push('\n');
    }
    out += "\njoint                   x mm      y mm      z mm   +- mm\n";
    for joint in &skeleton.joints {
        let [x, y, z] = joint.position_mm.unwrap_or_default();
        out += &format!(
            "{:<18} {x:>9.1} {y:>9.1} {z:>9.1} {:>7.1}\n",
            joint.name,
            joint.uncertainty_mm.unwrap_or_default()
        );
    }
    out
}

fn unit(text: &str) -> Result<Unit, String> {
    Unit::from_name(text).ok_or_else(|| format!("'{text}' is not m, cm, mm or in"))
}

/// The picture, as SVG. `survey` has the levels where the surface has those of a body.
fn picture(name: &str, repaired: &Repaired, survey: &Survey, skeleton: &Skeleton) -> String {
    let is_paper = skeleton.method == Method::Paper.name();
    let method = if is_paper { "as Yu et al. 2008" } else { "default method" };
    let title = format!("{name}, {method}");
    let mut drawing = Drawing {
        title: &title,
        mesh: Some(&repaired.mesh),
        unit: Some(repaired.unit),
        joints: survey.joints.clone(),
        skeleton: Some(skeleton),
        ..Drawing::default()
    };
    if let Some(levels) = &survey.levels {
        drawing.trace(levels);
    }
    svg(&drawing)
}
