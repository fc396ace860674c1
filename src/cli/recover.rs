//! `recover`: writes new takes from what can be read of truncated or damaged ones.

use std::{
    fmt::Write,
    io::BufWriter,
    path::{Path, PathBuf},
};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    files::{CountingFile, Kept},
    header::SOFTWARE,
    ledger::LedgerDocument,
};
use mocapd_take::recovery::{ChunkKindCount, RecoveryScan, repair_start};
use serde::Serialize;

use super::{
    batch::{self, Batch, Destination, Figures, FileKinds, FileReport, InputArgs, Job, outputs},
    remote,
};
use crate::cli::{
    ledger::{self, DamageReport},
    output::plain,
    values::{bytes, count, thousands},
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
    let paths_of_outputs = destination.take_paths(&inputs, args.json)?;
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
    let output = job.output.context("no output name: please report this bug")?;
    let reading = || format!("cannot read {name}");
    let file = remote::open(&job.input.path)?;
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

#[derive(Debug, Serialize)]
struct RecoverReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    lost: bool,
    finished: bool,
    problems: Vec<String>,
    chunks: Vec<ChunkReport>,
    frames: u64,
    frames_recovered: u64,
    frames_damaged: u64,
    samples: u64,
    damage: Vec<DamageReport>,
    markers: Vec<RecoveredMarkerReport>,
    take_bytes: u64,
    discarded_bytes: u64,
    output_bytes: u64,
    ledger: LedgerDocument,
}

#[derive(Debug, Serialize)]
struct ChunkReport {
    kind: &'static str,
    recovered: u64,
    discarded: u64,
}

#[derive(Debug, Serialize)]
struct RecoveredMarkerReport {
    label: String,
    samples: u64,
    frames_damaged: u64,
}

impl RecoverReport {
    fn new(
        [take, output]: [&Path; 2],
        scan: &RecoveryScan,
        problems: Vec<String>,
        take_bytes: u64,
        output_bytes: u64,
    ) -> Self {
        let chunk = |count: &ChunkKindCount| ChunkReport {
            kind: count.kind.name(),
            recovered: count.recovered,
            discarded: count.discarded,
        };
        let there = |count: &&ChunkKindCount| count.recovered + count.discarded > 0;
        let channels = scan.channels.iter().zip(&scan.per_channel);
        let markers = channels.map(|(channel, found)| RecoveredMarkerReport {
            label: channel.label.clone(),
            samples: found.samples,
            frames_damaged: found.rows_damaged,
        });
        Self {
            take: take.to_owned(),
            output: output.to_owned(),
            lost: scan.lost_anything(),
            finished: scan.finished,
            problems,
            chunks: scan.kinds.iter().filter(there).map(chunk).collect(),
            frames: scan.rows,
            frames_recovered: scan.recorded,
            frames_damaged: scan.rows_damaged(),
            samples: scan.per_channel.iter().map(|channel| channel.samples).sum(),
            damage: DamageReport::all(&scan.damage),
            markers: markers.collect(),
            take_bytes,
            discarded_bytes: scan.discarded_bytes,
            output_bytes,
            ledger: LedgerDocument::from(&scan.ledger),
        }
    }

    /// The report in one line.
    fn line(&self) -> String {
        format!(
            "{}: {} of {}, {}, {} of the {} read\n",
            plain(&self.output.display().to_string()),
            count(self.frames_recovered, "frame"),
            count(self.markers.len() as u64, "marker"),
            count(self.samples, "sample"),
            bytes(self.take_bytes.saturating_sub(self.discarded_bytes)),
            bytes(self.take_bytes),
        )
    }

    /// The whole report.
    fn text(&self) -> String {
        let mut out = self.line();
        writeln!(out, "{:<15} {:>10} {:>10}", "chunks", "recovered", "discarded").ok();
        for ChunkReport { kind, recovered, discarded } in &self.chunks {
            let (recovered, discarded) = (thousands(*recovered), thousands(*discarded));
            writeln!(out, "  {kind:<13} {recovered:>10} {discarded:>10}").ok();
        }
        let (recovered, damaged) =
            (thousands(self.frames_recovered), thousands(self.frames_damaged));
        writeln!(out, "  {:<13} {recovered:>10} {damaged:>10}", "frames").ok();
        for line in ledger::damage_lines(&self.damage) {
            writeln!(out, "lost {line}").ok();
        }
        let damaged = self.markers.iter().map(|m| (m.label.as_str(), m.frames_damaged));
        out += &ledger::damage_by_marker(&damaged.collect::<Vec<_>>());
        out
    }
}
