//! `verify`: checks that takes are intact and consistent, and compares them with originals.

mod against;
mod limbs;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    clock::LineDeviation,
    files::CountingFile,
    inspect::{Finding, Summary, Verdict},
    ledger::TakeHealth,
};
use mocapd_service::units;
use mocapd_take::{interchange::Format, record::Ledger};
use serde::Serialize;

pub(super) use self::against::{AgainstReport, against};
use self::{
    against::{DerivativesReport, SentReport, derivatives, sent_log},
    limbs::{LimbsReport, limbs_of},
};
use super::{
    batch::{self, Batch, Figures, FileKinds, FileReport, InputArgs, Job},
    ledger::{self, DamageReport},
    motion_file_reports,
    output::{plain, plain_path},
    paths::{self, InputFormat, InputFormatName},
    remote,
    values::count,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input, and of files whose extension does not show it
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take; or a folder with an original of the
    /// same name for each take; or for a recording the log of the simulated device, of `mocapd-sim serve --log` or
    /// `--batch-log`
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// With --against, also report errors of velocities and accelerations, low-passed at this cutoff: 6Hz
    #[arg(long, value_name = "HZ", requires = "against", value_parser = units::frequency_hz)]
    cutoff: Option<f64>,
    /// Compare limb lengths with a skeleton.json, or with the take's own skeleton, and find swapped labels
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    skeleton: Option<Option<PathBuf>>,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct VerifyReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    intact: bool,
    health: TakeHealth,
    /// Why the recording ended, if the take states it.
    ending: Option<&'static str>,
    ledger_closes: Option<bool>,
    problems: Vec<String>,
    contradictions: Vec<String>,
    frames: u64,
    damage: Vec<DamageReport>,
    markers: Vec<VerifiedMarkerReport>,
    samples: u64,
    tolerance_mm: f64,
    stated_max_error_mm: f64,
    /// The clock line, fitted again to the observations in the take and compared with the stored one.
    clock: Option<LineDeviation>,
    against: Option<AgainstReport>,
    sent: Option<SentReport>,
    derivatives: Option<DerivativesReport>,
    limbs: Option<LimbsReport>,
}

#[derive(Debug, Serialize)]
struct VerifiedMarkerReport {
    label: String,
    frames_damaged: u64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let is_file = |path: &&PathBuf| !path.is_dir() && !paths::is_take(path);
    if let Some(original) = args.against.as_ref().filter(is_file) {
        paths::input_format(original)?;
    }
    let format = args.format.map(Into::into);
    // Exports next to the takes in a folder have no original.
    let compares = args.against.is_some() || args.skeleton.is_some();
    let kinds = if compares { FileKinds::Takes } else { FileKinds::Both };
    let inputs = batch::inputs::find(&args.files, &args.input, kinds, format)?;
    let batch = Batch::of_reports(&inputs, args.json, ["verifying", "verified"]);
    batch::run(&batch, |job| match job.input.format()? {
        InputFormat::Take => verify(args, job),
        InputFormat::MotionFile(_) if compares => {
            let name = job.input.name.display();
            bail!(UsageError(format!(
                "{name} is not a take: --against and --skeleton are for takes; import it first"
            )))
        }
        InputFormat::MotionFile(_) => motion_file_reports::verify(job),
    })
}

fn verify(args: &Args, job: &Job<'_>) -> anyhow::Result<FileReport> {
    let (take, name) = (&job.input.path, job.input.name.display());
    let reading = || format!("cannot read {name}");
    let file = remote::open(take)?;
    let bytes_read = file.len_bytes().with_context(reading)?;
    let phase = job.phase("verifying", bytes_read);
    let file = CountingFile::new(file, &phase.counter);
    let summary = Summary::read(BufReader::new(file)).with_context(reading)?;
    drop(phase);
    let verdict = Verdict::of(&summary);
    // A ledger that does not close is reported with details below.
    let is_printed = |finding: &&Finding<'_>| !matches!(finding, Finding::LedgerOpen);
    let printed: Vec<String> =
        verdict.problems.iter().filter(is_printed).map(ToString::to_string).collect();
    let mut report = VerifyReport::new(&job.input.name, &summary, verdict);
    let original = args.against.as_ref().map(|original| original_of(original, job)).transpose()?;
    if let Some(original) = &original
        && let Some(log) = sent_log(original)?
    {
        if args.cutoff.is_some() {
            bail!(UsageError(
                "--cutoff is for motions, but the original is a log: omit it".to_owned()
            ));
        }
        report.sent = Some(SentReport::new(take, &log)?);
    } else if let Some(original) = &original {
        report.against = Some(against(take, original, summary.take.header.tolerance_mm)?);
        if let Some(cutoff_hz) = args.cutoff {
            report.derivatives = Some(derivatives(take, original, cutoff_hz)?);
        }
    }
    if let Some(skeleton) = &args.skeleton {
        report.limbs = Some(limbs_of(take, skeleton.as_deref())?);
    }
    if !job.is_json {
        printed.iter().for_each(|problem| job.notify(problem));
    }
    for message in ledger::missing_messages(&job.input.name, &summary, !job.is_json) {
        job.notify(&message);
    }
    // With swapped labels or bones that do not fit, every sample is there, but some have the wrong label, or a wrong
    // position: reported like lost data.
    let misfits = report.limbs.as_ref().map(LimbsReport::contradictions).unwrap_or_default();
    misfits.iter().for_each(|misfit| job.notify(misfit));
    Ok(FileReport {
        failure: report.failure(original.as_deref()),
        data_lost: report.health != TakeHealth::Complete || !report.intact || !misfits.is_empty(),
        text: report.text(),
        line: report.line(),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.frames as f64 / summary.take.header.rate_hz,
            bytes_read,
            ..Figures::default()
        },
    })
}

/// The original of a take: the file given with `--against`, or the file of the take's name in that folder.
///
/// # Errors
/// If the folder has no such file, or several.
fn original_of(against: &Path, job: &Job<'_>) -> anyhow::Result<PathBuf> {
    if !against.is_dir() {
        return Ok(against.to_owned());
    }
    let stem = against.join(&job.input.relative).with_extension("");
    let folder = stem.parent().unwrap_or(against);
    let take = job.input.path.canonicalize().ok();
    let is_original = |path: &PathBuf| {
        let is_motion = Format::from_extension(path).is_some_and(Format::is_read);
        path.file_stem() == stem.file_name()
            && (is_motion || paths::is_take(path))
            && path.is_file()
            && path.canonicalize().ok() != take
    };
    let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries.filter(is_original).collect();
    found.sort();
    match <[PathBuf; 1]>::try_from(found) {
        Ok([original]) => Ok(original),
        Err(found) if found.is_empty() => bail!(
            "{} has no original: expected {} with .c3d, .trc, .tsv, .csv or .take",
            job.input.name.display(),
            stem.display()
        ),
        Err(found) => {
            let found: Vec<String> = found.iter().map(|path| path.display().to_string()).collect();
            bail!(
                "{} has several originals: {}; give one with --against FILE",
                job.input.name.display(),
                found.join(", ")
            )
        }
    }
}

impl VerifyReport {
    fn new(take: &Path, summary: &Summary, verdict: Verdict<'_>) -> Self {
        let header = &summary.take.header;
        let problems: Vec<String> = verdict.problems.iter().map(ToString::to_string).collect();
        let Verdict { contradictions, clock, .. } = verdict;
        let channels = summary.take.channels.iter().zip(&summary.per_channel);
        let markers = channels.map(|(channel, found)| VerifiedMarkerReport {
            label: channel.label.clone(),
            frames_damaged: found.rows_damaged,
        });
        Self {
            take: take.to_owned(),
            intact: problems.is_empty(),
            health: summary.health(),
            ending: summary.take.ending.as_ref().map(|ending| ending.kind.name()),
            ledger_closes: summary.take.ledger.as_ref().map(Ledger::closes),
            problems,
            contradictions,
            frames: summary.take.n_rows,
            damage: DamageReport::all(&summary.take.damage),
            markers: markers.collect(),
            samples: summary.samples(),
            tolerance_mm: header.tolerance_mm,
            stated_max_error_mm: summary.max_error_mm(),
            clock,
            against: None,
            sent: None,
            derivatives: None,
            limbs: None,
        }
    }

    /// Why the check failed, if a comparison or the take itself shows that it is wrong.
    fn failure(&self, original: Option<&Path>) -> Option<String> {
        let take = self.take.display();
        if let Some(original) = original {
            let original = original.display();
            if self.against.as_ref().is_some_and(|against| !against.is_within()) {
                return Some(format!("{take} differs from {original}"));
            }
            if self.sent.as_ref().is_some_and(|sent| !sent.is_complete()) {
                return Some(format!("{take} does not account for everything in {original}"));
            }
        }
        let contradiction = self.contradictions.first()?;
        Some(format!("{take} contradicts itself: {contradiction}"))
    }

    /// The report in one line.
    fn line(&self) -> String {
        let against = self.against.as_ref().map_or_else(String::new, AgainstReport::short);
        let sent = self.sent.as_ref().map_or_else(String::new, SentReport::short);
        format!("{}{against}{sent}\n", self.head())
    }

    fn head(&self) -> String {
        let state = match (self.contradictions.is_empty(), self.intact) {
            (false, _) => "CONTRADICTS ITSELF",
            (true, true) => "intact",
            (true, false) => "NOT INTACT",
        };
        let ending = self.ending.map_or_else(String::new, |ending| format!(" ({ending})"));
        format!(
            "{}: {state}, {}{ending}, {}, {}; checked every checksum, block and ledger",
            plain_path(&self.take),
            self.health.name(),
            count(self.frames, "frame"),
            count(self.samples, "sample")
        )
    }

    /// The whole report.
    fn text(&self) -> String {
        let mut out = self.head() + "\n";
        if let Some(LineDeviation { offset_us: apart_us, drift_ppm: apart_ppm, .. }) = &self.clock {
            out += &format!(
                "clock line refitted to the stored observations: {apart_us:+.1} us and {apart_ppm:+.3} ppm apart\n"
            );
        }
        for line in ledger::damage_lines(&self.damage) {
            out += &format!("lost {line}\n");
        }
        let damaged = self.markers.iter().map(|m| (m.label.as_str(), m.frames_damaged));
        out += &ledger::damage_by_marker(&damaged.collect::<Vec<_>>());
        for contradiction in &self.contradictions {
            out += &format!("CONTRADICTION: {}\n", plain(contradiction));
        }
        if let Some(against) = &self.against {
            out += &against.text(self.tolerance_mm);
        }
        out += &self.sent.as_ref().map(SentReport::text).unwrap_or_default();
        out += &self.derivatives.as_ref().map(DerivativesReport::text).unwrap_or_default();
        out += &self.limbs.as_ref().map(LimbsReport::text).unwrap_or_default();
        out
    }
}
