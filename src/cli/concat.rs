//! `concat`: joins takes one after another.

use std::{collections::HashSet, fmt::Write, io, path::PathBuf, sync::Arc};

use anyhow::bail;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::ledger::LedgerDocument;
use mocapd_take::edit::{ConcatReport, Seam, SourceTake, check_joinable, concat};
use serde::Serialize;

use super::{
    batch::{FileKinds, inputs},
    cut::{notify_left_out, open_counted, read_sources, write_take},
    output::{notify, plain_path, print, print_json},
    paths,
    values::{bytes, count, thousands},
};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "All takes need the same markers (later takes may have more), rate, resampler, tolerance, \
    unit and up axis. Between takes of one recording, frames that are in none of them become lost frames of the new \
    take. An event marks the beginning of any other take."
)]
pub(crate) struct Args {
    /// The takes, in order, or folders, whose takes are joined in the order of their names; they are not changed
    #[arg(required = true, value_name = "TAKES")]
    takes: Vec<PathBuf>,
    /// With folders, also join the takes in their subfolders
    #[arg(short, long)]
    recursive: bool,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct JoinedReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    frames: u64,
    seconds: f64,
    markers: usize,
    samples: u64,
    file_bytes: u64,
    takes: Vec<JoinedTake>,
    left_out: Vec<String>,
    ledger: LedgerDocument,
}

#[derive(Debug, Serialize)]
struct JoinedTake {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    first_frame: u64,
    frames: u64,
    /// How it relates to the take before it.
    follows: &'static str,
    frames_missing_before: u64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let takes = takes(args)?;
    if takes.len() < 2 {
        bail!(UsageError("concat joins takes: name two or more".to_owned()));
    }
    paths::check_take_output(&args.output)?;
    let mut named = HashSet::new();
    for take in &takes {
        if !named.insert(take.canonicalize().unwrap_or_else(|_| take.clone())) {
            notify(&format!("{} is named twice", take.display()));
        }
    }
    let sources = read_sources(&takes)?;
    if let Err(mismatch) = check_joinable(&sources) {
        let name = |i: usize| takes.get(i).map(|path| plain_path(path)).unwrap_or_default();
        bail!("{} cannot follow {}: {mismatch}", name(mismatch.index), name(0));
    }
    let counted = Arc::default();
    let open = |i: usize| match takes.get(i) {
        Some(path) => open_counted(path, &counted).map_err(io::Error::other),
        None => Err(io::ErrorKind::NotFound.into()),
    };
    let rows = sources.iter().map(|source| source.map().n_rows).fold(0, u64::saturating_add);
    let written = write_take(&args.output, "joining", rows, |out, context| {
        concat(&sources, open, out, context)
    })?;
    notify_left_out(&args.output, &written.left_out);
    let report = JoinedReport::new(args, &takes, &sources, written);
    for JoinedTake { take, frames_missing_before, .. } in
        report.takes.iter().filter(|take| take.frames_missing_before > 0)
    {
        notify(&format!(
            "{}: {} of the recording before {} are in none of the takes: they are gaps, as if the device had been disconnected",
            args.output.display(),
            count(*frames_missing_before, "frame"),
            take.display()
        ));
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::Done)
}

/// The takes, those of folders in the order of their names. A take that is named itself may be named again.
fn takes(args: &Args) -> anyhow::Result<Vec<PathBuf>> {
    let mut takes = Vec::new();
    for named in &args.takes {
        if named.is_dir() {
            let folder = [named.clone()];
            let found = inputs::find_named(&folder, args.recursive, FileKinds::Takes)?;
            takes.extend(found.all()?.iter().map(|input| input.path.clone()));
        } else {
            takes.push(named.clone());
        }
    }
    Ok(takes)
}

impl JoinedReport {
    fn new(args: &Args, takes: &[PathBuf], sources: &[SourceTake], written: ConcatReport) -> Self {
        let take = |(i, path): (usize, &PathBuf)| {
            let seam = i.checked_sub(1).and_then(|before| written.seams.get(before));
            let (follows, frames_missing_before) = match seam {
                None => ("first", 0),
                Some(Seam::Continuous) => ("continuous", 0),
                Some(Seam::Missing(rows)) => ("frames missing", *rows),
                Some(Seam::Unknown) => ("unknown", 0),
            };
            JoinedTake {
                take: path.clone(),
                first_frame: written.first_rows.get(i).copied().unwrap_or_default(),
                frames: sources.get(i).map_or(0, |source| source.map().n_rows),
                follows,
                frames_missing_before,
            }
        };
        let takes = takes.iter().enumerate().map(take).collect();
        let rate_hz = sources.first().map_or(1.0, |source| source.map().header.rate_hz);
        Self {
            output: args.output.clone(),
            frames: written.rows,
            seconds: written.rows as f64 / rate_hz,
            markers: written.n_channels,
            samples: written.ledger.samples_present,
            file_bytes: written.bytes,
            takes,
            left_out: written.left_out,
            ledger: LedgerDocument::from(&written.ledger),
        }
    }

    /// A line for the new take, and one for each take in it.
    fn text(&self) -> String {
        let mut out = format!(
            "{}: {} of {}, {}\n",
            plain_path(&self.output),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            bytes(self.file_bytes),
        );
        for JoinedTake { take, first_frame, frames, follows, frames_missing_before } in &self.takes
        {
            let relation = match *follows {
                "frames missing" => {
                    format!(
                        ", after {} that are in none of the takes",
                        count(*frames_missing_before, "frame")
                    )
                }
                "unknown" => {
                    ", not known to continue the take before it; an event marks it".to_owned()
                }
                _ => String::new(),
            };
            let (first, frames) = (thousands(*first_frame), count(*frames, "frame"));
            writeln!(out, "  from frame {first}: {}, {frames}{relation}", plain_path(take)).ok();
        }
        out
    }
}
