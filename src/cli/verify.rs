//! `verify`: whether a take is what it says, and how far it lies from an original.

use std::{io::BufReader, path::PathBuf};

use anyhow::{Context, bail};
use mocapd::{
    compare::{Difference, compare},
    files,
    inspect::Summary,
    outcome::Outcome,
};
use mocapd_take::{
    TakeFrames,
    motion::MotionFrames,
    record::Ledger,
};
use serde::Serialize;

use super::{
    import::read_motion,
    output::{print, print_json, say, thousands},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    take: PathBuf,
    intact: bool,
    ledger_closes: Option<bool>,
    problems: Vec<String>,
    tolerance_mm: f64,
    stated_max_error_mm: f64,
    against: Option<AgainstReport>,
}

#[derive(Debug, Serialize)]
pub(crate) struct AgainstReport {
    within_tolerance: bool,
    frames: u64,
    frames_missing: u64,
    labels_differing: Vec<String>,
    samples: u64,
    gaps_differing: u64,
    bits_differing: u64,
    max_error_mm: f64,
    rms_error_mm: f64,
    worst_frame: Option<u64>,
    worst_marker: Option<usize>,
    max_error_by_marker_mm: Vec<f64>,
}

impl AgainstReport {
    pub(crate) fn new(difference: Difference, tolerance_mm: f64) -> Self {
        Self {
            within_tolerance: difference.is_within(tolerance_mm),
            frames: difference.frames,
            frames_missing: difference.frames_missing,
            labels_differing: difference.labels_differing,
            samples: difference.samples,
            gaps_differing: difference.gaps_differing,
            bits_differing: difference.bits_differing,
            max_error_mm: difference.max_error_mm,
            rms_error_mm: difference.rms_error_mm,
            worst_frame: difference.worst.map(|worst| worst.0),
            worst_marker: difference.worst.map(|worst| worst.1),
            max_error_by_marker_mm: difference.max_error_by_marker_mm,
        }
    }

    /// Whether nothing differs but distances within the tolerance.
    pub(crate) fn is_within(&self) -> bool {
        self.within_tolerance
    }

    /// One line, and what is wrong beside the distances.
    pub(crate) fn words(&self, tolerance_mm: f64) -> String {
        let verdict = if self.within_tolerance { "within" } else { "NOT WITHIN" };
        let bound = if tolerance_mm > 0.0 {
            format!("{verdict} the tolerance of {tolerance_mm} mm")
        } else {
            format!("{} samples differ in a bit", thousands(self.bits_differing))
        };
        let mut out = format!(
            "against the original: {} samples of {} frames, max error {:.4} mm, rms {:.4} mm, {bound}\n",
            thousands(self.samples),
            thousands(self.frames),
            self.max_error_mm,
            self.rms_error_mm
        );
        if self.frames_missing > 0 {
            out += &format!("  {} frames are in one of the two only\n", self.frames_missing);
        }
        if self.gaps_differing > 0 {
            out += &format!("  {} samples are in one of the two only\n", self.gaps_differing);
        }
        if !self.labels_differing.is_empty() {
            out += &format!("  labels differ: {}\n", self.labels_differing.join(", "));
        }
        out
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reading = || format!("cannot read {}", args.take.display());
    let summary = Summary::read(BufReader::new(files::open(&args.take)?)).with_context(reading)?;
    let header = summary.header.as_ref().with_context(reading)?;
    let mut report = Report {
        take: args.take.clone(),
        intact: summary.problems.is_empty(),
        ledger_closes: summary.ledger.as_ref().map(Ledger::closes),
        problems: summary.problems.clone(),
        tolerance_mm: header.tolerance_mm,
        stated_max_error_mm: summary.max_error_mm(),
        against: None,
    };
    if report.ledger_closes == Some(false) {
        report.problems.push("the ledger does not close".to_owned());
    }
    if let Some(ledger) = &summary.ledger
        && summary.finished
        && ledger.samples_present != summary.samples()
    {
        report.problems.push(format!(
            "the ledger tells of {} samples, the take holds {}",
            ledger.samples_present,
            summary.samples()
        ));
    }
    if let Some(original) = &args.against {
        let frames =
            TakeFrames::open(BufReader::new(files::open(&args.take)?)).with_context(reading)?;
        let against = || format!("cannot read {}", original.display());
        let is_take = original.extension().is_some_and(|e| e.eq_ignore_ascii_case("take"));
        let difference = if is_take {
            let other = TakeFrames::open(BufReader::new(files::open(original)?));
            compare(frames, other.with_context(against)?)
        } else {
            compare(frames, MotionFrames::new(&read_motion(original)?))
        };
        let difference = difference.context("cannot compare")?;
        report.against = Some(AgainstReport::new(difference, header.tolerance_mm));
    }
    if args.json {
        print_json(&report)?;
    } else {
        let state = if report.problems.is_empty() { "intact" } else { "NOT INTACT" };
        print(&format!(
            "{}: {state}, {} frames, {} samples, every block's checksum and decoding checked\n",
            report.take.display(),
            thousands(summary.rows),
            thousands(summary.samples())
        ))?;
        if let Some(against) = &report.against {
            print(&against.words(report.tolerance_mm))?;
        }
        for problem in &report.problems {
            say(&format!("{}: {problem}", report.take.display()));
        }
    }
    if report.against.as_ref().is_some_and(|against| !against.within_tolerance) {
        bail!("the take differs from {}", args.against.iter().map(|p| p.display().to_string()).collect::<String>());
    }
    let lost = summary.ledger.as_ref().is_some_and(Ledger::lost_anything);
    Ok(Outcome::of(lost || !report.problems.is_empty()))
}
