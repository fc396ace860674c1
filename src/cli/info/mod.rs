//! `info`: shows what is in a take.

mod report;
mod subject;
mod text;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{files::SparseFile, health::TakeHealth, inspect::Summary};

use self::report::InfoReport;
use super::{
    damage,
    output::{notify, print, print_json},
};

/// Widest label column of a table, in characters; a longer label shifts its own line.
const LABEL_COLUMNS_MAX: usize = 64;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// List the markers: samples, gaps, kept samples and the largest error of each; --json always does
    #[arg(long)]
    markers: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let (report, summary) = report(&args.take)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&text::text(&report, args.markers))?;
        for problem in &report.problems {
            notify(&format!("{}: {problem}", args.take.display()));
        }
    }
    damage::notify_losses(&args.take, &summary, !args.json);
    Ok(report.outcome())
}

/// Reads a take. Its samples are decoded only if it does not state their statistics, or if anything in it is damaged.
///
/// # Errors
/// When it cannot be read, or is not a take.
fn report(take: &Path) -> anyhow::Result<(InfoReport, Summary)> {
    let reading = || format!("cannot read {}", take.display());
    let file = SparseFile::open(take)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    let summary = Summary::read_stated(BufReader::new(file)).with_context(reading)?;
    Ok((InfoReport::new(take, &summary, file_bytes), summary))
}

impl InfoReport {
    /// Whether the take lacks anything.
    fn outcome(&self) -> Outcome {
        Outcome::of(self.health != TakeHealth::Complete || !self.problems.is_empty())
    }
}
