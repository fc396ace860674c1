//! The report of `study`, documented in docs/json.md, and its figures.

use anyhow::anyhow;
use mocapd_codec::{Settings, Tolerance};
use mocapd_report::{
    ReportError,
    decoded::DecodedTake,
    labels,
    phases::Phase,
    plot::{PosePlot, TrajectoryPlot, by_phase, pose, trajectory},
    study::{Coder, Findings, Method, Piece, Trial, paper, tables},
};
use serde::Serialize;

use super::InMemory;

#[derive(Debug, Serialize)]
pub(super) struct StudyReport {
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
    pub(super) fn new(trials: &[Trial], findings: &Findings) -> Self {
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
                paper_sr2: paper::sr2(piece, tolerance_mm),
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
pub(super) fn figures(
    trials: &[Trial],
    findings: &Findings,
) -> anyhow::Result<Vec<(String, String)>> {
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
