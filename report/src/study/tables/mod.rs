//! What a study found, as tables: Markdown for people, CSV for programs.

mod csv;
mod markdown;
mod verdicts;

use std::fmt::Write;

use super::{Findings, Method, Piece, Sum, paper};

pub use self::{
    csv::{csv, trials_csv},
    markdown::markdown,
    verdicts::{Verdict, verdicts},
};

/// A table with a heading.
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

/// Two digits behind the point, as the paper has them; nothing for what there is not.
fn figure(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

/// Three figures: for lengths, speeds and ratios that are small here and large there.
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

/// The columns of table 1, and standing still where somebody does.
fn columns(findings: &Findings) -> Vec<Piece> {
    use crate::phases::Phase;
    let standing = Piece::Phase(Phase::Standing);
    let is_there = |piece: &Piece| {
        let mut tolerances = findings.tolerances_mm.iter();
        tolerances.any(|&mm| findings.sum(*piece, Method::WorstSample, mm).is_some())
    };
    [standing].into_iter().chain(paper::COLUMNS).filter(is_there).collect()
}

/// A sum that there is, as a CSV line wants it.
fn number(value: Option<f64>) -> String {
    let mut out = String::new();
    if let Some(value) = value {
        // Writing to a String does not fail.
        write!(out, "{value:.6}").ok();
    }
    out
}
