//! `study`: repeats the tables and figures of Shi et al. 2012 on other takes.

mod report;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, anyhow, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files, pipeline::offline, threads};
use mocapd_codec::{Settings, Tolerance};
use mocapd_report::{
    phases::{self, Phase},
    study::{Coder, Findings, Options, Trial, measure, tables, work},
};
use mocapd_service::units;
use mocapd_take::{escape::to_cell, motion::Motion};

use self::report::StudyReport;
use super::{
    motion_files::{file_name, read_samples, write_new},
    original::header_of,
    output::{Progress, notify, print, print_json},
    values,
};

/// Maximum number of samples of all takes together, which are held in memory: 1.2 GB.
const SAMPLES_MAX: usize = 100_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files; each is a trial
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Folder to create for the tables (`study.md`, `study.csv`, `trials.csv`, `phases.csv`) and figures
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// CSV file with the phases of trials, instead of the detected ones: `file,phase,first_frame`
    #[arg(long, value_name = "FILE")]
    phases: Option<PathBuf>,
    /// Tolerances of table 1 [default: those of the paper, 1mm,5mm,10mm,15mm,20mm]
    #[arg(long, value_name = "LENGTH,...", value_delimiter = ',', value_parser = values::tolerance)]
    tolerances: Vec<Tolerance>,
    /// Number of trials to resample with spline:exhaustive as well, in pieces of up to 256 frames
    #[arg(long, value_name = "N", default_value_t = 10)]
    exhaustive: usize,
    /// Cutoff of the low-pass filter for velocities and accelerations
    #[arg(long, value_name = "HZ", default_value = "6Hz", value_parser = units::frequency_hz)]
    cutoff: f64,
    /// Number of threads; the results are the same for any number [default: one per core, at most 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print one JSON document instead of Markdown
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
        bail!(UsageError(format!(
            "{samples} samples do not fit into memory (at most {SAMPLES_MAX}): pass fewer takes at a time"
        )));
    }
    let options = options(args);
    let findings = study(&trials, &options, args)?;
    if let Some(out) = &args.out {
        write_out(out, &trials, &findings)?;
    }
    if args.json {
        print_json(&StudyReport::new(&trials, &findings))?;
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

/// Measures the trials on several threads; the results are in the order of the trials.
fn study(trials: &[Trial], options: &Options, args: &Args) -> anyhow::Result<Findings> {
    let n = trials.len();
    // Evenly spread over the trials, so that every subject is represented.
    let compared = args.exhaustive.min(n);
    let is_compared = |i: usize| i * compared / n != (i + 1) * compared / n;
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

/// Encodes takes in memory, as `import` would write them.
#[derive(Debug)]
pub(super) struct InMemory;

impl Coder for InMemory {
    fn take(&self, motion: &Motion, settings: &Settings) -> Result<Vec<u8>, String> {
        let header = header_of(&motion.info, Path::new("study"), settings);
        let mut take = Vec::new();
        let written = offline::write_take(motion, &header, 1, &AtomicU64::new(0), &mut take);
        written.map_err(|error| format!("{error:#}"))?;
        Ok(take)
    }
}

fn write_out(out: &Path, trials: &[Trial], findings: &Findings) -> anyhow::Result<()> {
    fs::create_dir(out).with_context(|| format!("cannot create the folder {}", out.display()))?;
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

/// Largest file of phases, in bytes: a hundred thousand trials fit.
const PHASES_BYTES_MAX: usize = 1 << 26;

/// By file name, each phase and its first frame.
type PhasesByFile = BTreeMap<String, Vec<(Phase, usize)>>;

/// Reads every file, and detects the phases of those that the file `phases` does not list.
///
/// # Errors
/// The first file that cannot be read; a usage error if `phases` lists a file that is not among them.
pub(super) fn trials(paths: &[PathBuf], phases: Option<&Path>) -> anyhow::Result<Vec<Trial>> {
    let listed = phases.map(read_phases).transpose()?.unwrap_or_default();
    let names: Vec<String> = paths.iter().map(|path| file_name(path)).collect();
    if let Some(unknown) = listed.keys().find(|file| !names.contains(file)) {
        bail!(UsageError(format!(
            "--phases lists {unknown}, which is not among the files: add it, or remove its lines"
        )));
    }
    paths.iter().zip(names).map(|(path, name)| trial(path, name, &listed)).collect()
}

fn trial(path: &Path, name: String, listed: &PhasesByFile) -> anyhow::Result<Trial> {
    let (motion, settings) = read_samples(path)?;
    if let Some(settings) = settings.filter(|settings| !settings.kind.is_lossless()) {
        notify(&format!(
            "{}: a take encoded within {} mm: the study uses its reconstruction, not its original",
            path.display(),
            settings.tolerance.mm()
        ));
    }
    let starts = match listed.get(&name) {
        Some(starts) => Ok(starts.clone()),
        None => phases::find(&motion).map_err(|none| none.to_string()),
    };
    if let Err(why) = &starts {
        notify(&format!("{}: no phases, studied only as a whole: {why}", path.display()));
    }
    let phases = starts.map(|starts| phases::parts(&starts, motion.n_frames()));
    Ok(Trial { name, motion, phases })
}

fn read_phases(path: &Path) -> anyhow::Result<PhasesByFile> {
    let text = String::from_utf8(files::read_bounded(path, PHASES_BYTES_MAX)?)
        .with_context(|| format!("{} is not a text file", path.display()))?;
    phases::parse(&text).map_err(|error| UsageError(format!("{}: {error}", path.display())).into())
}

/// The phases of the trials, in the form of `--phases`.
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
