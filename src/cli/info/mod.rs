//! `info`: shows what is in takes and motion files.

mod report;
mod sampled;
mod subject;
mod text;

use std::{io::BufReader, path::PathBuf};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    files::{CountingFile, SparseFile},
    health::TakeHealth,
    inspect::Summary,
};

use self::{
    report::InfoReport,
    text::{line, text},
};
use super::{
    batch::{self, Batch, Figures, FileKinds, FileReport, InputArgs, Job},
    damage, motion_file_reports,
    paths::{InputFormat, InputFormatName},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    /// List the markers: samples, gaps, kept samples and the largest error of each; --json always does
    #[arg(long)]
    markers: bool,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.format.map(Into::into);
    let inputs = batch::inputs::find(&args.files, &args.input, FileKinds::Both, format)?;
    let batch = Batch::of_reports(&inputs, args.json, ["reading", "read"]);
    batch::run(&batch, |job| match job.input.format()? {
        InputFormat::Take => take_info(job, args.markers),
        InputFormat::MotionFile(_) => motion_file_reports::info(job),
    })
}

/// Reads a take. Its samples are decoded only if it does not state their statistics, or if anything in it is damaged.
///
/// # Errors
/// When it cannot be read, or is not a take.
fn take_info(job: &Job<'_>, all_markers: bool) -> anyhow::Result<FileReport> {
    let reading = || format!("cannot read {}", job.input.name.display());
    let file = SparseFile::open(&job.input.path)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    let phase = job.phase("reading", file_bytes);
    let file = BufReader::new(CountingFile::new(file, &phase.counter));
    let summary = Summary::read_stated(file).with_context(reading)?;
    drop(phase);
    let report = InfoReport::new(&job.input.name, &summary, file_bytes);
    if !job.is_json {
        report.problems.iter().for_each(|problem| job.notify(problem));
    }
    for message in damage::losses(&job.input.name, &summary, !job.is_json) {
        job.notify(&message);
    }
    Ok(FileReport {
        data_lost: report.health != TakeHealth::Complete || !report.problems.is_empty(),
        text: text(&report, all_markers),
        line: line(&report),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.seconds,
            bytes_read: file_bytes,
            ..Figures::default()
        },
        ..FileReport::default()
    })
}
