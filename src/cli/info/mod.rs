//! `info`: shows what is in a take.

mod report;
mod subject;
mod text;

use std::{io::BufReader, path::PathBuf};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{files::SparseFile, health::TakeHealth, inspect::Summary};

use self::{report::InfoReport, text::text};
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
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reading = || format!("cannot read {}", args.take.display());
    let file = SparseFile::open(&args.take)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    let summary = Summary::read(BufReader::new(file)).with_context(reading)?;
    let report = InfoReport::new(&args.take, &summary, file_bytes);
    if args.json {
        print_json(&report)?;
    } else {
        print(&text(&report))?;
        for problem in &report.problems {
            notify(&format!("{}: {problem}", args.take.display()));
        }
    }
    damage::notify_losses(&args.take, &summary, !args.json);
    Ok(Outcome::of(report.health != TakeHealth::Complete || !report.problems.is_empty()))
}
