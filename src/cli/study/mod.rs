//! `study`: the tables and figures of Shi et al. 2012, on takes that are given.

mod report;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, anyhow};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files, pipeline::offline, threads};
use mocapd_codec::{Settings, Tolerance};
use mocapd_report::{
    phases::{self, Phase},
    study::{Coder, Findings, Options, Trial, measure, tables, work},
};
use mocapd_service::units;
use mocapd_take::{escape::to_cell, motion::Motion};

use self::report::Report;
use super::{
    original::header_of,
    output::Progress,
    output::{print, print_json},
    whole::write_new,
};
use crate::cli::{
    output::say,
    values,
    whole::{name, read_samples},
};

/// Most samples of all takes together: they are in memory at once, 1.2 GB.
const SAMPLES_MAX: usize = 100_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv and .csv files: a trial each
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Folder for the tables (`study.md`, `study.csv`, `trials.csv`, `phases.csv`) and figures; it must not exist
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The phases of each trial, where the ones that are found will not do: `file,phase,first_frame`
    #[arg(long, value_name = "FILE")]
    phases: Option<PathBuf>,
    /// Tolerances of the first table [default: those of the paper, 1mm,5mm,10mm,15mm,20mm]
    #[arg(long, value_name = "LENGTH,...", value_delimiter = ',', value_parser = values::tolerance)]
    tolerances: Vec<Tolerance>,
    /// On how many of the trials the exhaustive reading of step 2 is tried, too, on pieces of up to 256 frames
    #[arg(long, value_name = "N", default_value_t = 10)]
    exhaustive: usize,
    /// Cutoff of the low-pass filter before velocities and accelerations
    #[arg(long, value_name = "HZ", default_value = "6Hz", value_parser = units::frequency_hz)]
    cutoff: f64,
    /// Threads, a trial each; the figures are the same for any number [default: one a core, at most 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print one JSON document in place of Markdown
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if let Some(out) = args.out.as_deref().filter(|out| out.symlink_metadata().is_ok()) {
        return Err(files::NameTaken { path: out.to_owned() }.into());
    }
    let trials = trials(&args.files, args.phases.as_deref())?;
    let samples: usize = trials.iter().map(|trial| trial.motion.positions_mm.len()).sum();
    if samples > SAMPLES_MAX {
        return Err(UsageError(format!(
            "{samples} samples are more than fit into memory ({SAMPLES_MAX}): study fewer takes at a time"
        ))
        .into());
    }
    let options = options(args);
    let findings = study(&trials, &options, args)?;
    if let Some(out) = &args.out {
        write_out(out, &trials, &findings)?;
    }
    if args.json {
        print_json(&Report::new(&trials, &findings))?;
    } else {
        print(&tables::markdown(&findings))?;
    }
    Ok(Outcome::Done)
}

fn options(args: &Args) -> Options {
    let mut options = Options { cutoff_hz: args.cutoff, ..Options::default() };
    if !args.tolerances.is_empty() {
        options.tolerances_mm = args.tolerances.iter().map(|tolerance| tolerance.mm()).collect();
        options.tolerances_mm.sort_by(f64::total_cmp);
        options.tolerances_mm.dedup();
    }
    options
}

/// Trials are shared out to threads; their results come in order.
fn study(trials: &[Trial], options: &Options, args: &Args) -> anyhow::Result<Findings> {
    let n = trials.len();
    // Evenly spread over the trials, so that every subject has a part in it.
    let wanted = args.exhaustive.min(n);
    let is_compared = |i: usize| i * wanted / n != (i + 1) * wanted / n;
    let total = (0..n).map(|i| work(&trials[i], options, is_compared(i))).sum();
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow("resampling", &counter, total);
    let workers = args.threads.map_or_else(threads::default_workers, usize::from);
    let mut findings = Findings {
        tolerances_mm: options.tolerances_mm.clone(),
        prefix_tolerances_mm: options.prefix_tolerances_mm.clone(),
        prefixes: options.prefixes.clone(),
        cutoff_hz: options.cutoff_hz,
        trials: Vec::with_capacity(n),
    };
    let worker = || {
        |&i: &usize| {
            let trial = &trials[i];
            measure(trial, options, is_compared(i), &InMemory, &counter)
                .map_err(|error| anyhow!("{}: {error}", trial.name))
        }
    };
    offline::in_order(0..n, workers, worker, |_, results| {
        findings.trials.push(results);
        Ok(())
    })?;
    drop(progress);
    Ok(findings)
}

/// Takes as `import` would write them.
#[derive(Debug)]
pub(super) struct InMemory;

impl Coder for InMemory {
    fn take(&self, motion: &Motion, settings: &Settings) -> Result<Vec<u8>, String> {
        let header = header_of(motion, Path::new("study"), settings);
        let mut take = Vec::new();
        let written = offline::write_take(motion, &header, 1, &AtomicU64::new(0), &mut take);
        written.map_err(|error| format!("{error:#}"))?;
        Ok(take)
    }
}

fn write_out(out: &Path, trials: &[Trial], findings: &Findings) -> anyhow::Result<()> {
    fs::create_dir(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let write = |name: &str, text: &str| write_new(&out.join(name), text.as_bytes());
    write("study.md", &tables::markdown(findings))?;
    write("study.csv", &tables::csv(findings))?;
    write("trials.csv", &tables::trials_csv(findings))?;
    write("phases.csv", &phases_csv(trials))?;
    for (name, svg) in report::figures(trials, findings)? {
        write(&name, &svg)?;
    }
    Ok(())
}

/// Most bytes of a file of phases: a hundred thousand trials.
const PHASES_BYTES_MAX: usize = 1 << 26;

type Given = BTreeMap<String, Vec<(Phase, usize)>>;

/// Reads every file, and finds its phases where `given` does not say them.
///
/// # Errors
/// The first file that cannot be read; a usage error for phases of files that are not there.
pub(super) fn trials(paths: &[PathBuf], given: Option<&Path>) -> anyhow::Result<Vec<Trial>> {
    let given = given.map(read_phases).transpose()?.unwrap_or_default();
    let names: Vec<String> = paths.iter().map(|path| name(path)).collect();
    if let Some(stranger) = given.keys().find(|file| !names.contains(file)) {
        return Err(UsageError(format!(
            "the phases tell of {stranger}, which is not among the files: add it, or take its lines out"
        ))
        .into());
    }
    paths.iter().zip(names).map(|(path, name)| trial(path, name, &given)).collect()
}

fn trial(path: &Path, name: String, given: &Given) -> anyhow::Result<Trial> {
    let (motion, settings) = read_samples(path)?;
    if let Some(settings) = settings.filter(|settings| !settings.kind.is_lossless()) {
        say(&format!(
            "{}: a take within {} mm: its reconstruction is studied, not its original",
            path.display(),
            settings.tolerance.mm()
        ));
    }
    let starts = match given.get(&name) {
        Some(starts) => Ok(starts.clone()),
        None => phases::find(&motion).map_err(|none| none.to_string()),
    };
    if let Err(why) = &starts {
        say(&format!("{}: no phases, only the whole is studied: {why}", path.display()));
    }
    let phases = starts.map(|starts| phases::parts(&starts, motion.n_frames()));
    Ok(Trial { name, motion, phases })
}

fn read_phases(path: &Path) -> anyhow::Result<Given> {
    let text = String::from_utf8(files::read_bounded(path, PHASES_BYTES_MAX)?)
        .with_context(|| format!("{} is no text", path.display()))?;
    phases::parse(&text).map_err(|error| UsageError(format!("{}: {error}", path.display())).into())
}

/// The phases that were used, in the form in which they can be given.
pub(super) fn phases_csv(trials: &[Trial]) -> String {
    let mut out = "file,phase,first_frame\n".to_owned();
    for trial in trials {
        for part in trial.phases.iter().flatten() {
            let name = to_cell(&trial.name);
            out += &format!("{name},{},{}\n", part.phase.name(), part.frames.start);
        }
    }
    out
}
