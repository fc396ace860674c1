//! The results of a study as tables: Markdown for people, CSV for programs.

use std::{collections::BTreeSet, fmt::Write};

use mocapd_take::escape::{to_cell, visible};

use crate::{
    phases::Phase,
    study::{self, EXHAUSTIVE_FRAMES_MAX, Findings, Method, Piece, Results, Sum},
};

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

/// Maximum number of trials that are listed one by one.
const LISTED_MAX: usize = 20;

/// All tables of the study.
#[must_use]
pub fn markdown(findings: &Findings) -> String {
    let n = findings.trials.len();
    let mut out =
        format!("# The study of Shi et al. 2012, on {n} take{}\n\n", if n == 1 { "" } else { "s" });
    out += "SR1 and SR2 are ratios of stored items, as in the paper: a position counts as one item, and so does a time.\n\
            They differ from ratios on disk, which are given as well: raw float32 bytes to the bytes of the whole take.\n\
            Items and bytes are summed over all takes that have the phase, and then divided.\n\n";
    section(&mut out, "The takes", &takes(findings));
    let title = "Table 1: SR2 by phase, each phase resampled on its own (here / paper)";
    section(&mut out, title, &table_1(findings));
    section(&mut out, "SR2 by phase, within the resampling of the whole take", &within(findings));
    section(&mut out, "Claims of the paper", &claims(findings));
    section(&mut out, "Synchronous against asynchronous, whole takes", &rivals(findings));
    section(&mut out, "Both readings of step 2 of the method", &readings(findings));
    section(&mut out, "Ratios on disk: raw float32 to take", &on_disk(findings));
    let title = "Table 2: SR2 of the first frames, by their number (here / paper)";
    section(&mut out, title, &table_2(findings));
    section(&mut out, "Velocity and acceleration, whole takes", &derivatives(findings));
    out
}

fn section(out: &mut String, title: &str, body: &str) {
    if !body.is_empty() {
        // Writing to a String does not fail.
        write!(out, "## {title}\n\n{body}\n").ok();
    }
}

fn takes(findings: &Findings) -> String {
    let mut out = String::new();
    let n = findings.trials.len();
    if n <= LISTED_MAX {
        let mut table = Table::new(["take", "frames", "Hz", "markers", "phases and their frames"]);
        for trial in &findings.trials {
            let phases = match &trial.phases {
                Ok(phases) => {
                    let phases = phases.iter().map(|(phase, n)| format!("{} {n}", phase.name()));
                    phases.collect::<Vec<_>>().join(", ")
                }
                Err(why) => format!("none: {why}"),
            };
            let [frames, markers] = [trial.frames, trial.markers].map(|n| n.to_string());
            let rate_hz = ((trial.rate_hz * 1000.0).round() / 1000.0).to_string();
            table.row([visible(&trial.name).into_owned(), frames, rate_hz, markers, phases]);
        }
        out += &table.markdown();
        out.push('\n');
    }
    let mut table = Table::new(["phase", "takes", "frames", "shortest", "longest"]);
    for phase in Phase::ALL {
        let all = findings.trials.iter().flat_map(|trial| trial.phases.iter().flatten());
        let these = all.filter(|(found, _)| *found == phase);
        let lengths: Vec<usize> = these.map(|(_, frames)| *frames).collect();
        if let (Some(&min), Some(&max)) = (lengths.iter().min(), lengths.iter().max()) {
            let frames: usize = lengths.iter().sum();
            let [n, frames, min, max] = [lengths.len(), frames, min, max].map(|n| n.to_string());
            table.row([phase.name().to_owned(), n, frames, min, max]);
        }
    }
    let frames: u64 = findings.trials.iter().map(|trial| trial.frames).sum();
    let without = findings.trials.iter().filter(|trial| trial.phases.is_err()).count();
    write!(out, "Takes: {n}, without phases: {without}; frames: {frames}.\n\n").ok();
    if !table.rows.is_empty() {
        out += &table.markdown();
    }
    out
}

fn tolerance(mm: f64) -> String {
    format!("{mm} mm")
}

fn table_1(findings: &Findings) -> String {
    let columns = columns(findings);
    let names = columns.iter().map(|piece| piece.name());
    let mut table = Table::new(["tolerance".to_owned()].into_iter().chain(names));
    for &mm in &findings.tolerances_mm {
        let cell = |&piece: &Piece| {
            let sum = findings.sum(piece, Method::WorstSample, mm);
            let here = figure(sum.and_then(|sum| sum.counts.sr2()));
            format!("{here} / {}", figure(study::sr2(piece, mm)))
        };
        table.row([tolerance(mm)].into_iter().chain(columns.iter().map(cell)));
    }
    table.markdown()
        + "\nThe first and the last sample are always kept, so that a phase of n frames has an SR2 of at most (N + 1) n / (4 N), here "
        + &caps(findings, &columns)
        + ".\n"
}

/// The highest possible SR2 of each phase without gaps, given that its ends are always kept.
fn caps(findings: &Findings, columns: &[Piece]) -> String {
    let Some(&mm) = findings.tolerances_mm.first() else { return String::new() };
    let cells = || findings.trials.iter().flat_map(|trial| &trial.cells);
    let cap = |&piece: &Piece| {
        let same = cells().filter(|cell| {
            (cell.piece, cell.method) == (piece, Method::WorstSample) && cell.tolerance_mm == mm
        });
        let (mut all, mut ends) = (0, 0);
        for counts in same.map(|cell| cell.counts).filter(|counts| counts.rows > 0) {
            all += counts.original_items();
            // A phase of one frame has one end.
            ends += 2 * counts.rows.min(2) * counts.samples / counts.rows;
        }
        Some(format!("{} {:.1}", piece.name(), crate::decoded::ratio(all, ends)?))
    };
    columns.iter().filter_map(cap).collect::<Vec<_>>().join(", ")
}

fn within(findings: &Findings) -> String {
    let is_there = |&phase: &Phase| {
        let mm = findings.tolerances_mm.first().copied().unwrap_or(0.0);
        findings.sum(Piece::Within(phase), Method::WorstSample, mm).is_some()
    };
    let phases: Vec<Phase> = Phase::ALL.into_iter().filter(is_there).collect();
    if phases.is_empty() {
        return String::new();
    }
    let names = phases.iter().map(|phase| phase.name().to_owned());
    let mut table = Table::new(["tolerance".to_owned()].into_iter().chain(names));
    for &mm in &findings.tolerances_mm {
        let cell = |&phase: &Phase| {
            let sum = findings.sum(Piece::Within(phase), Method::WorstSample, mm);
            figure(sum.and_then(|sum| sum.counts.sr2()))
        };
        table.row([tolerance(mm)].into_iter().chain(phases.iter().map(cell)));
    }
    table.markdown()
        + "\nHere the first and the last sample of a phase need not be kept, which would limit the ratio of short phases.\n"
}

fn claims(findings: &Findings) -> String {
    let mut table = Table::new(["claim", "here", "figures"]);
    for verdict in verdicts(findings) {
        let holds = match verdict.holds {
            Some(true) => "holds",
            Some(false) => "does not hold",
            None => "undecided",
        };
        table.row([verdict.claim.to_owned(), holds.to_owned(), verdict.figures]);
    }
    table.markdown()
}

fn rivals(findings: &Findings) -> String {
    let mut table = Table::new([
        "tolerance",
        "SR1",
        "SR2",
        "asynchronous wins",
        "on disk, `sync`",
        "on disk, `spline`",
        "on disk, `dense`",
    ]);
    for &mm in &findings.tolerances_mm {
        let sum = |method| findings.sum(Piece::Whole, method, mm);
        let Some(spline) = sum(Method::WorstSample) else { continue };
        table.row([
            tolerance(mm),
            figure(spline.counts.sr1()),
            figure(spline.counts.sr2()),
            format!("{} of {}", spline.wins, spline.n),
            ratio(sum(Method::Sync).as_ref()),
            ratio(Some(&spline)),
            ratio(sum(Method::Dense).as_ref()),
        ]);
    }
    table.markdown()
}

fn readings(findings: &Findings) -> String {
    let mut table = Table::new([
        "piece",
        "tolerance",
        "SR2, `worst-sample`",
        "SR2, `exhaustive`",
        "samples kept",
        "on disk, `worst-sample`",
        "on disk, `exhaustive`",
    ]);
    let mut n = 0;
    for piece in columns(findings) {
        for &mm in &findings.tolerances_mm {
            let sum = |method| findings.sum_of_compared(piece, method, mm);
            let Some((worst, all)) = sum(Method::WorstSample).zip(sum(Method::Exhaustive)) else {
                continue;
            };
            n = n.max(all.n);
            table.row([
                piece.name(),
                tolerance(mm),
                figure(worst.counts.sr2()),
                figure(all.counts.sr2()),
                format!("{} / {}", worst.counts.kept, all.counts.kept),
                ratio(Some(&worst)),
                ratio(Some(&all)),
            ]);
        }
    }
    if table.rows.is_empty() {
        return String::new();
    }
    let mut out = table.markdown();
    out += &format!(
        "\nMeasured on at most {n} takes, and on pieces of up to {EXHAUSTIVE_FRAMES_MAX} frames: the exhaustive search is slow.\n"
    );
    out
}

fn on_disk(findings: &Findings) -> String {
    let methods = [Method::WorstSample, Method::Sync, Method::Dense];
    let mut head = vec!["piece".to_owned(), "tolerance".to_owned()];
    for method in methods {
        head.extend([format!("SR2, `{}`", method.name()), format!("on disk, `{}`", method.name())]);
    }
    let mut table = Table::new(head);
    for piece in columns(findings) {
        for &mm in &findings.tolerances_mm {
            let mut row = vec![piece.name(), tolerance(mm)];
            for method in methods {
                let sum = findings.sum(piece, method, mm);
                row.extend([figure(sum.and_then(|sum| sum.counts.sr2())), ratio(sum.as_ref())]);
            }
            table.row(row);
        }
    }
    table.markdown()
        + "\nEach phase is a separate take here, with its own header, ledger and index (about half a kilobyte).\n"
}

fn table_2(findings: &Findings) -> String {
    let lengths = findings.prefixes.iter().filter(|&&length| {
        let mm = findings.prefix_tolerances_mm.first().copied().unwrap_or(0.0);
        findings.sum(Piece::First(length), Method::WorstSample, mm).is_some()
    });
    let lengths: Vec<usize> = lengths.copied().collect();
    if lengths.is_empty() {
        return String::new();
    }
    let names = lengths.iter().map(ToString::to_string);
    let mut table = Table::new(["frames".to_owned()].into_iter().chain(names));
    let mut add = |name: String, cell: &dyn Fn(usize) -> String| {
        table.row([name].into_iter().chain(lengths.iter().map(|&length| cell(length))));
    };
    for &mm in &findings.prefix_tolerances_mm {
        let sum = |length, method| findings.sum(Piece::First(length), method, mm);
        let bytes = |length, method| ratio(sum(length, method).as_ref());
        add(format!("SR2, {mm} mm"), &|length| {
            let here = sum(length, Method::WorstSample).and_then(|sum| sum.counts.sr2());
            format!("{} / {}", figure(here), figure(study::sr2(Piece::First(length), mm)))
        });
        add(format!("on disk, `spline`, {mm} mm"), &|length| bytes(length, Method::WorstSample));
        add(format!("on disk, `dense`, {mm} mm"), &|length| bytes(length, Method::Dense));
        add(format!("takes, {mm} mm"), &|length| {
            sum(length, Method::WorstSample).map_or(0, |sum| sum.n).to_string()
        });
    }
    table.markdown()
}

fn derivatives(findings: &Findings) -> String {
    let mut table = Table::new([
        "resampler",
        "tolerance",
        "velocity, rms (mm/s)",
        "largest",
        "acceleration, rms (mm/s^2)",
        "largest",
    ]);
    let mut own = None;
    for method in [Method::WorstSample, Method::Dense] {
        for &mm in &findings.tolerances_mm {
            let Some(found) = findings.derivatives(method, mm) else { continue };
            own = Some(found);
            table.row([
                method.name(),
                tolerance(mm),
                short(found.velocity_mm_s.rms()),
                short(found.velocity_mm_s.max()),
                short(found.acceleration_mm_s2.rms()),
                short(found.acceleration_mm_s2.max()),
            ]);
        }
    }
    let Some(own) = own else { return String::new() };
    table.markdown()
        + &format!(
            "\nErrors after a zero-lag fourth-order Butterworth at {} Hz, the cutoff corrected for two passes, as lengths in 3D over all markers.\n\
             The original motion: velocity {} mm/s rms and {} at most, acceleration {} mm/s^2 rms and {} at most.\n",
            findings.cutoff_hz,
            short(own.original_velocity_mm_s.rms()),
            short(own.original_velocity_mm_s.max()),
            short(own.original_acceleration_mm_s2.rms()),
            short(own.original_acceleration_mm_s2.max()),
        )
}
