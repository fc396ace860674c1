//! The results of a study as tables: Markdown for people, CSV for programs.

mod markdown;

use std::collections::BTreeSet;

use mocapd_take::escape::to_cell;

use crate::{
    phases::Phase,
    study::{self, Findings, Method, Piece, Results, Sum},
};

pub use self::markdown::markdown;

/// A table with a header row.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn new<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rule = "|---".repeat(self.head.len()) + "|\n";
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        line(&self.head) + &rule + &rows
    }
}

/// A value with two decimals, as in the paper; `-` if there is none.
fn figure(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

/// A value with three significant digits, for quantities of any magnitude.
fn short(value: f64) -> String {
    match value.abs() {
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.1}"),
        v if v >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

fn ratio(sum: Option<&Sum>) -> String {
    sum.and_then(Sum::ratio).map_or_else(|| "-".to_owned(), |ratio| format!("{} : 1", short(ratio)))
}

/// The columns of table 1 that have results, preceded by standing.
fn columns(findings: &Findings) -> Vec<Piece> {
    let standing = Piece::Phase(Phase::Standing);
    let is_there = |piece: &Piece| {
        let mut tolerances = findings.tolerances_mm.iter();
        tolerances.any(|&mm| findings.sum(*piece, Method::WorstSample, mm).is_some())
    };
    [standing].into_iter().chain(study::COLUMNS).filter(is_there).collect()
}

/// A CSV cell: six decimals, or empty.
fn number(value: Option<f64>) -> String {
    value.map(|value| format!("{value:.6}")).unwrap_or_default()
}

const COUNTS: &str = "rows,samples,kept,key_rows,sr1,sr2";

/// CSV of all trials together, with the paper's SR2.
#[must_use]
pub fn csv(findings: &Findings) -> String {
    let mut out = format!(
        "piece,resampler,tolerance_mm,pieces,async_wins,{COUNTS},paper_sr2,raw_bytes,file_bytes,ratio,max_error_mm\n"
    );
    let cells = findings.trials.iter().flat_map(|trial| &trial.cells);
    let keys: BTreeSet<(Piece, Method)> = cells.map(|cell| (cell.piece, cell.method)).collect();
    for (piece, method) in keys {
        for tolerance_mm in tolerances(findings, piece) {
            let Some(sum) = findings.sum(piece, method, tolerance_mm) else { continue };
            let is_published = method == Method::WorstSample || method == Method::Exhaustive;
            let paper = study::sr2(piece, tolerance_mm).filter(|_| is_published);
            let Sum { n, wins, max_error_mm, .. } = sum;
            out += &format!(
                "{},{},{tolerance_mm},{n},{wins},{},{},{},{},{}\n",
                piece.name(),
                method.name(),
                counts(&sum),
                number(paper),
                bytes(&sum),
                number(sum.ratio()),
                number(Some(max_error_mm)),
            );
        }
    }
    out
}

/// CSV of each trial.
#[must_use]
pub fn trials_csv(findings: &Findings) -> String {
    let mut out =
        format!("file,piece,resampler,tolerance_mm,{COUNTS},raw_bytes,file_bytes,max_error_mm\n");
    for Results { name, cells, .. } in &findings.trials {
        for cell in cells {
            let sum = Sum { counts: cell.counts, file_bytes: cell.file_bytes, ..Sum::default() };
            out += &format!(
                "{},{},{},{},{},{},{}\n",
                quoted(name),
                cell.piece.name(),
                cell.method.name(),
                cell.tolerance_mm,
                counts(&sum),
                bytes(&sum),
                number(Some(cell.max_error_mm)),
            );
        }
    }
    out
}

fn tolerances(findings: &Findings, piece: Piece) -> Vec<f64> {
    match piece {
        Piece::First(_) => findings.prefix_tolerances_mm.clone(),
        _ => findings.tolerances_mm.clone(),
    }
}

fn counts(sum: &Sum) -> String {
    let c = &sum.counts;
    let (sr1, sr2) = (number(c.sr1()), number(c.sr2()));
    format!("{},{},{},{},{sr1},{sr2}", c.rows, c.samples, c.kept, c.key_rows)
}

/// The CSV cells of raw and file bytes; the latter is empty for a piece that was not coded on its own.
fn bytes(sum: &Sum) -> String {
    let raw = 12 * sum.counts.samples;
    if sum.file_bytes == 0 { format!("{raw},") } else { format!("{raw},{}", sum.file_bytes) }
}

fn quoted(name: &str) -> String {
    let name = to_cell(name);
    if name.contains([',', '"']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.into_owned()
    }
}

/// Whether a claim of the paper holds for the takes of the study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// The claim.
    pub claim: &'static str,
    /// Whether it holds at every tolerance; `None` if the takes cannot decide it.
    pub holds: Option<bool>,
    /// The figures for or against it, by tolerance.
    pub figures: String,
}

/// The verdicts on all claims, in the order of the paper.
#[must_use]
pub fn verdicts(findings: &Findings) -> Vec<Verdict> {
    vec![lowest(findings), highest(findings), rising(findings), asynchronous_wins(findings)]
}

/// SR2 by phase at a tolerance, for the phases that have results.
fn by_phase(findings: &Findings, tolerance_mm: f64) -> Vec<(Phase, f64)> {
    let sr2 = |phase: Phase| {
        let sum = findings.sum(Piece::Phase(phase), Method::WorstSample, tolerance_mm)?;
        Some((phase, sum.counts.sr2()?))
    };
    Phase::ALL.into_iter().filter(|&phase| phase != Phase::Standing).filter_map(sr2).collect()
}

/// The verdict on a claim about the order of the phases: at each tolerance, the phase that `choose` selects must be one
/// of `expected`.
fn order(
    findings: &Findings,
    claim: &'static str,
    choose: impl Fn(&[(Phase, f64)]) -> Option<(Phase, f64)>,
    expected: &[Phase],
) -> Verdict {
    let mut figures = Vec::new();
    let mut holds = None;
    for &mm in &findings.tolerances_mm {
        let phases = by_phase(findings, mm);
        let decides = phases.len() > 1 && phases.iter().any(|(phase, _)| expected.contains(phase));
        if let Some((phase, sr2)) = choose(&phases).filter(|_| decides) {
            let is_so = expected.contains(&phase);
            holds = Some(holds.unwrap_or(true) && is_so);
            figures.push(format!("{mm} mm: {} ({sr2:.2})", phase.name()));
        }
    }
    Verdict { claim, holds, figures: figures.join(", ") }
}

fn lowest(findings: &Findings) -> Verdict {
    order(
        findings,
        "the take-off compresses least",
        |phases| phases.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)),
        &[Phase::TakeOff],
    )
}

fn highest(findings: &Findings) -> Verdict {
    order(
        findings,
        "walking or settling compresses most",
        |phases| phases.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)),
        &[Phase::Walking, Phase::Settling],
    )
}

fn rising(findings: &Findings) -> Verdict {
    let mut falls = Vec::new();
    let mut compared = false;
    let phases = Phase::ALL.map(Piece::Phase);
    for piece in phases.into_iter().chain([Piece::Whole]) {
        for pair in findings.tolerances_mm.windows(2) {
            let sr2 = |mm| findings.sum(piece, Method::WorstSample, mm)?.counts.sr2();
            let (from_mm, to_mm, name) = (pair[0], pair[1], piece.name());
            if let (Some(a), Some(b)) = (sr2(from_mm), sr2(to_mm)) {
                compared = true;
                if b < a {
                    falls.push(format!("{name}: {a:.2} at {from_mm} mm, {b:.2} at {to_mm} mm"));
                }
            }
        }
    }
    Verdict {
        claim: "a larger tolerance compresses more",
        holds: compared.then_some(falls.is_empty()),
        figures: if falls.is_empty() {
            "in every phase and for whole takes".to_owned()
        } else {
            falls.join("; ")
        },
    }
}

fn asynchronous_wins(findings: &Findings) -> Verdict {
    let mut figures = Vec::new();
    let mut holds = None;
    for &mm in &findings.tolerances_mm {
        if let Some(sum) = findings.sum(Piece::Whole, Method::WorstSample, mm) {
            holds = Some(holds.unwrap_or(true) && sum.wins == sum.n);
            figures.push(format!("{mm} mm: {} of {} trials", sum.wins, sum.n));
        }
    }
    Verdict {
        claim: "asynchronous resampling needs fewer items than synchronous (10)",
        holds,
        figures: figures.join(", "),
    }
}
