//! The results of a study as Markdown.

use std::fmt::Write;

use mocapd_take::escape::visible;

use super::{Table, columns, figure, ratio, short, verdicts};
use crate::{
    phases::Phase,
    study::{self, EXHAUSTIVE_FRAMES_MAX, Findings, Method, Piece},
};

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
