//! `study`: repeats the tables and figures of Shi et al. 2012 on other takes. docs/json.md documents its report.

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
    ReportError,
    decoded::DecodedTake,
    labels,
    phases::{self, Phase},
    plot::{PosePlot, TrajectoryPlot, by_phase, pose, trajectory},
    study::{self, Coder, Findings, Method, Options, Piece, Trial, measure, tables, work},
};
use mocapd_service::units;
use mocapd_take::{escape::to_cell, motion::Motion};
use serde::Serialize;

use super::{
    motion_files::{file_name, header_of, read_samples, write_new},
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
    for (name, svg) in figures(trials, findings)? {
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
fn trials(paths: &[PathBuf], phases: Option<&Path>) -> anyhow::Result<Vec<Trial>> {
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
fn phases_csv(trials: &[Trial]) -> String {
    let mut out = "file,phase,first_frame\n".to_owned();
    for trial in trials {
        for part in trial.phases.iter().flatten() {
            let name = to_cell(&trial.name);
            out += &format!("{name},{},{}\n", part.phase.name(), part.frames.start);
        }
    }
    out
}

#[derive(Debug, Serialize)]
struct StudyReport {
    cutoff_hz: f64,
    takes: Vec<TakeReport>,
    cells: Vec<CellReport>,
    claims: Vec<ClaimReport>,
    derivatives: Vec<DerivativeReport>,
}

#[derive(Debug, Serialize)]
struct TakeReport {
    file: String,
    frames: u64,
    rate_hz: f64,
    markers: u64,
    phases: Vec<PhaseReport>,
    no_phases: Option<String>,
}

#[derive(Debug, Serialize)]
struct PhaseReport {
    phase: &'static str,
    first_frame: u64,
    frames: u64,
}

#[derive(Debug, Serialize)]
struct CellReport {
    piece: String,
    resampler: String,
    tolerance_mm: f64,
    pieces: u64,
    asynchronous_wins: u64,
    rows: u64,
    samples: u64,
    kept: u64,
    key_rows: u64,
    sr1: Option<f64>,
    sr2: Option<f64>,
    paper_sr2: Option<f64>,
    file_bytes: Option<u64>,
    ratio: Option<f64>,
    max_error_mm: f64,
}

#[derive(Debug, Serialize)]
struct ClaimReport {
    claim: &'static str,
    holds: Option<bool>,
    figures: String,
}

#[derive(Debug, Serialize)]
struct DerivativeReport {
    resampler: String,
    tolerance_mm: f64,
    velocity_rms_mm_s: f64,
    velocity_max_mm_s: f64,
    acceleration_rms_mm_s2: f64,
    acceleration_max_mm_s2: f64,
}

impl StudyReport {
    fn new(trials: &[Trial], findings: &Findings) -> Self {
        let of = |tables::Verdict { claim, holds, figures }| ClaimReport { claim, holds, figures };
        Self {
            cutoff_hz: findings.cutoff_hz,
            takes: trials.iter().map(TakeReport::new).collect(),
            cells: cells(findings),
            claims: tables::verdicts(findings).into_iter().map(of).collect(),
            derivatives: derivatives(findings),
        }
    }
}

impl TakeReport {
    fn new(trial: &Trial) -> Self {
        let phases = trial.phases.iter().flatten().map(|part| PhaseReport {
            phase: part.phase.name(),
            first_frame: part.frames.start as u64,
            frames: part.frames.len() as u64,
        });
        Self {
            file: trial.name.clone(),
            frames: trial.motion.n_frames() as u64,
            rate_hz: trial.motion.info.rate_hz,
            markers: trial.motion.info.markers.len() as u64,
            phases: phases.collect(),
            no_phases: trial.phases.as_ref().err().cloned(),
        }
    }
}

fn cells(findings: &Findings) -> Vec<CellReport> {
    let mut cells = Vec::new();
    let measured = findings.trials.iter().flat_map(|trial| &trial.cells);
    let keys: std::collections::BTreeSet<(Piece, Method)> =
        measured.map(|cell| (cell.piece, cell.method)).collect();
    for (piece, method) in keys {
        let tolerances = match piece {
            Piece::First(_) => &findings.prefix_tolerances_mm,
            _ => &findings.tolerances_mm,
        };
        for &tolerance_mm in tolerances {
            let Some(sum) = findings.sum(piece, method, tolerance_mm) else { continue };
            let counts = sum.counts;
            cells.push(CellReport {
                piece: piece.name(),
                resampler: method.name(),
                tolerance_mm,
                pieces: sum.n,
                asynchronous_wins: sum.wins,
                rows: counts.rows,
                samples: counts.samples,
                kept: counts.kept,
                key_rows: counts.key_rows,
                sr1: counts.sr1(),
                sr2: counts.sr2(),
                paper_sr2: study::sr2(piece, tolerance_mm),
                file_bytes: (sum.file_bytes > 0).then_some(sum.file_bytes),
                ratio: sum.ratio(),
                max_error_mm: sum.max_error_mm,
            });
        }
    }
    cells
}

fn derivatives(findings: &Findings) -> Vec<DerivativeReport> {
    let mut found = Vec::new();
    for method in Method::ALL {
        for &tolerance_mm in &findings.tolerances_mm {
            if let Some(error) = findings.derivatives(method, tolerance_mm) {
                found.push(DerivativeReport {
                    resampler: method.name(),
                    tolerance_mm,
                    velocity_rms_mm_s: error.velocity_mm_s.rms(),
                    velocity_max_mm_s: error.velocity_mm_s.max(),
                    acceleration_rms_mm_s2: error.acceleration_mm_s2.rms(),
                    acceleration_max_mm_s2: error.acceleration_mm_s2.max(),
                });
            }
        }
    }
    found
}

/// Tolerance (`ErrLim`) of the paper's figures, mm.
const TOLERANCE_MM: f64 = 5.0;

/// Number of stick figures in figure 3.
const MOMENTS: usize = 8;

/// The figures: file names and SVG.
///
/// # Errors
/// If a figure cannot be drawn.
fn figures(trials: &[Trial], findings: &Findings) -> anyhow::Result<Vec<(String, String)>> {
    let mut figures = Vec::new();
    match by_phase(findings) {
        Ok(svg) => figures.push(("sr2-by-phase.svg".to_owned(), svg)),
        Err(ReportError::Nothing(_)) => {}
        Err(error) => return Err(error.into()),
    }
    let Some(trial) = trials.iter().find(|trial| trial.phases.is_ok()) else { return Ok(figures) };
    let settings =
        Settings { kind: Method::WorstSample.kind(), tolerance: Tolerance::from_mm(TOLERANCE_MM)? };
    let take = InMemory.take(&trial.motion, &settings).map_err(|error| anyhow!(error))?;
    let decoded = DecodedTake::read(&take[..])?;
    let original = Some(&trial.motion);
    let labels = trial.motion.info.labels();
    let marker = wrist(&labels);
    let up = mocapd_report::up::Up::of(&decoded.motion, None);
    let mut moments = Vec::new();
    for part in trial.phases.iter().flatten() {
        let rows = (part.frames.start, part.frames.end);
        if !matches!(part.phase, Phase::Standing | Phase::Walking) {
            moments.push(part.frames.clone());
        }
        let spec = TrajectoryPlot { name: &trial.name, take: &decoded, original, marker, rows, up };
        match trajectory(&spec) {
            Ok(svg) => {
                let name = part.phase.name().replace(' ', "-");
                let figure = format!("figure-2-{name}.svg");
                // Only the first of each phase, if a take has several jumps.
                if !figures.iter().any(|(there, _)| *there == figure) {
                    figures.push((figure, svg));
                }
            }
            Err(ReportError::Nothing(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    if let Some((from, to)) = moments.first().zip(moments.last()) {
        let span = to.end - 1 - from.start;
        let rows: Vec<usize> =
            (0..MOMENTS).map(|i| from.start + i * span / (MOMENTS - 1)).collect();
        let bones = labels::marker_lines(&labels);
        let spec = PosePlot {
            name: &trial.name,
            take: &decoded,
            original,
            rows: &rows,
            bones: &bones,
            limbs: &[],
            faces: &[],
            front: None,
            up,
        };
        figures.push(("figure-3.svg".to_owned(), pose(&spec)?));
    }
    Ok(figures)
}

/// The column of a wrist, which the paper shows; without one, the first marker.
fn wrist(labels: &[String]) -> usize {
    let plain = |label: &String| label.to_lowercase().replace(['_', '-', ' '], "");
    let find = |name: &str| labels.iter().position(|label| plain(label).ends_with(name));
    ["rwrist", "rightwrist", "wrist", "rwra", "rwri"].into_iter().find_map(find).unwrap_or(0)
}
