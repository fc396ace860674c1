//! `verify`: checks that a take is intact and consistent, and compares it with an original.

mod against;
mod derivatives;
mod limbs;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    clock::LineDeviation,
    files::SparseFile,
    health::TakeHealth,
    inspect::Summary,
    verdict::{Finding, Verdict},
};
use mocapd_service::units;
use mocapd_take::record::Ledger;
use serde::Serialize;

pub(super) use self::against::AgainstReport;
use self::{
    against::against,
    derivatives::{DerivativesReport, derivatives},
    limbs::{LimbsReport, limbs_of},
};
use super::{
    damage::{self, DamageReport},
    output::{notify, plain, plain_path, print, print_json},
    paths,
    values::count,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// With --against, also report errors of velocities and accelerations, low-passed at this cutoff: 6Hz
    #[arg(long, value_name = "HZ", requires = "against", value_parser = units::frequency_hz)]
    cutoff: Option<f64>,
    /// Compare limb lengths with a skeleton.json, or with the take's own skeleton, and find swapped labels
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    skeleton: Option<Option<PathBuf>>,
    /// Print one JSON document
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
    derivatives: Option<DerivativesReport>,
    limbs: Option<LimbsReport>,
}

#[derive(Debug, Serialize)]
struct VerifiedMarkerReport {
    label: String,
    frames_damaged: u64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reading = || format!("cannot read {}", args.take.display());
    if let Some(original) = args.against.as_ref().filter(|path| !paths::is_take(path)) {
        paths::input_format(original)?;
    }
    let summary =
        Summary::read(BufReader::new(SparseFile::open(&args.take)?)).with_context(reading)?;
    let verdict = Verdict::of(&summary);
    // A ledger that does not close is reported with details below.
    let is_printed = |finding: &&Finding<'_>| !matches!(finding, Finding::LedgerOpen);
    let printed: Vec<String> =
        verdict.problems.iter().filter(is_printed).map(ToString::to_string).collect();
    let mut report = VerifyReport::new(&args.take, &summary, verdict);
    if let Some(original) = &args.against {
        report.against = Some(against(&args.take, original, summary.take.header.tolerance_mm)?);
        if let Some(cutoff_hz) = args.cutoff {
            report.derivatives = Some(derivatives(&args.take, original, cutoff_hz)?);
        }
    }
    if let Some(skeleton) = &args.skeleton {
        report.limbs = Some(limbs_of(&args.take, skeleton.as_deref())?);
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
        for problem in printed {
            notify(&format!("{}: {problem}", args.take.display()));
        }
    }
    damage::notify_losses(&args.take, &summary, !args.json);
    if let Some(original) = &args.against
        && !report.against.as_ref().is_some_and(AgainstReport::is_within)
    {
        bail!("{} differs from {}", args.take.display(), original.display());
    }
    if let Some(contradiction) = report.contradictions.first() {
        bail!("{} contradicts itself: {contradiction}", args.take.display());
    }
    // With swapped labels or bones that do not fit, every sample is there, but some have the wrong label, or a wrong
    // position: reported like lost data.
    let misfits = report.limbs.as_ref().map(LimbsReport::contradictions).unwrap_or_default();
    for misfit in &misfits {
        notify(&format!("{}: {misfit}", args.take.display()));
    }
    let is_complete = report.health == TakeHealth::Complete && report.intact;
    Ok(Outcome::of(!is_complete || !misfits.is_empty()))
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
            derivatives: None,
            limbs: None,
        }
    }

    fn text(&self) -> String {
        let state = if self.intact { "intact" } else { "NOT INTACT" };
        let ending = self.ending.map_or_else(String::new, |ending| format!(" ({ending})"));
        let mut out = format!(
            "{}: {state}, {}{ending}, {}, {}; checked every checksum, block and ledger\n",
            plain_path(&self.take),
            self.health.name(),
            count(self.frames, "frame"),
            count(self.samples, "sample")
        );
        if let Some(LineDeviation { offset_us: apart_us, drift_ppm: apart_ppm, .. }) = &self.clock {
            out += &format!(
                "clock line refitted to the stored observations: {apart_us:+.1} us and {apart_ppm:+.3} ppm apart\n"
            );
        }
        for line in damage::lines(&self.damage) {
            out += &format!("lost {line}\n");
        }
        let damaged = self.markers.iter().map(|m| (m.label.as_str(), m.frames_damaged));
        out += &damage::by_marker(&damaged.collect::<Vec<_>>());
        for contradiction in &self.contradictions {
            out += &format!("CONTRADICTION: {}\n", plain(contradiction));
        }
        if let Some(against) = &self.against {
            out += &against.text(self.tolerance_mm);
        }
        out += &self.derivatives.as_ref().map(DerivativesReport::text).unwrap_or_default();
        out += &self.limbs.as_ref().map(LimbsReport::text).unwrap_or_default();
        out
    }
}
