//! For programs: one line a piece, method and tolerance.

use std::collections::BTreeSet;

use mocapd_take::escape::to_cell;

use super::{number, paper};
use crate::study::{Findings, Method, Piece, Results, Sum};

const COUNTS: &str = "rows,samples,kept,key_rows,sr1,sr2";

/// All trials together, and what the paper has.
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
            let paper = paper::sr2(piece, tolerance_mm).filter(|_| is_published);
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

/// Each trial by itself.
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

/// What was not coded on its own has no bytes of its own.
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
