//! `recover`: writes new takes from what can be read of truncated or damaged ones.

mod report;

use std::{io::BufWriter, path::PathBuf};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    files::{CountingFile, Kept, SparseFile},
    header::SOFTWARE,
};
use mocapd_take::recovery::{RecoveryScan, repair_start};

use self::report::RecoverReport;
use super::{
    batch::{self, Batch, Destination, Figures, FileKinds, FileReport, InputArgs, Job, outputs},
    paths,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Truncated or damaged takes, or folders with takes; they are not changed. `-` reads a take from standard input
    #[arg(required = true, value_name = "TAKE")]
    takes: Vec<PathBuf>,
    /// The take to write, which must not exist, or the folder for several takes; `-` writes to standard output
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Print one JSON document, or one per line for several takes
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let inputs = batch::inputs::find(&args.takes, &args.input, FileKinds::Takes, None)?;
    let destination = Destination::of(Some(&args.output), &inputs)?;
    let paths_of_outputs = destination.paths(&inputs, "take")?;
    match &destination {
        Destination::File(path) => paths::check_take_output(path)?,
        Destination::Stdout => paths::check_stdout(args.json)?,
        Destination::Folder(_) | Destination::Beside => {}
    }
    let is_folder = matches!(destination, Destination::Folder(_));
    let batch = Batch {
        inputs: &inputs,
        outputs: &paths_of_outputs,
        json: args.json,
        text_to_stderr: destination == Destination::Stdout,
        lines_to_stderr: false,
        threads: batch::thread_count(None),
        doing: "recovering",
        done: "recovered",
        is_compression: false,
    };
    batch::run(&batch, |job| recover(job, is_folder))
}

fn recover(job: &Job<'_>, is_folder: bool) -> anyhow::Result<FileReport> {
    let name = job.input.name.display();
    let output = job.output.context("no output was planned")?;
    let reading = || format!("cannot read {name}");
    let file = SparseFile::open(&job.input.path)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    // The file is read twice: to scan it and to copy it.
    let phase = job.phase("recovering", 2 * file_bytes);
    let counting = CountingFile::new(file, &phase.counter);
    let (mut input, repaired) = repair_start(counting).with_context(reading)?;
    let scan = RecoveryScan::read(&mut input).with_context(reading)?;
    let (written, kept) = outputs::write_whole(output, is_folder, |out| {
        scan.write(&mut input, BufWriter::new(out), SOFTWARE)
            .with_context(|| format!("cannot write {}", output.display()))
    })?;
    drop(phase);

    let problems: Vec<String> =
        repaired.iter().chain(&scan.problems).map(ToString::to_string).collect();
    let report =
        RecoverReport::new([&job.input.name, output], &scan, problems, file_bytes, written);
    if !job.is_json {
        report.problems.iter().for_each(|problem| job.notify(problem));
    }
    if scan.lost_anything() {
        job.notify(&scan.loss_summary());
    }
    Ok(FileReport {
        data_lost: scan.lost_anything(),
        text: report.text(),
        line: report.line(),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames_recovered,
            seconds: report.frames_recovered as f64 / scan.header.rate_hz,
            bytes_read: file_bytes,
            bytes_written: written,
            is_unchanged: kept == Kept::Unchanged,
        },
        ..FileReport::default()
    })
}
