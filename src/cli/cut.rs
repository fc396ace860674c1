//! `cut`: copies a part of a take into a new take; and what it shares with other commands on whole takes: reading
//! takes, and writing a new one.

use std::{
    io::{BufReader, BufWriter},
    ops::Range,
    path::{Path, PathBuf},
    str::FromStr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::{Context, bail, ensure};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::{self, CountingFile},
    header::SOFTWARE,
    ledger::LedgerDocument,
};
use mocapd_service::units;
use mocapd_take::{
    TakeError,
    edit::{CutReport, EditContext, SourceTake, cut},
    motion::frame_at,
};
use serde::Serialize;

use super::{
    batch::outputs::{self, SeekWrite},
    output::{Progress, notify, plain_path, print, print_json},
    paths, remote,
    values::{bytes, count, thousands},
};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Stretches within the range are copied. Two kinds of frames are stored as float32, because no lossy \
    resampler could encode them again to the same positions: those before the first key stretch of the range (at most \
    10 s, or 5 min of an import where nothing moves), and those of its last stretch, if that is only partly in the range. With --whole-stretches the range is \
    extended so that everything is copied."
)]
pub(crate) struct Args {
    /// The take; it is not changed
    take: PathBuf,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Keep frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Keep frames before this time
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    to: Option<Duration>,
    /// Keep frames from A on and before B: 1200..2400, 1200.. or ..2400. They are counted from 0, even if the
    /// imported file numbers them otherwise
    #[arg(long, value_name = "A..B", conflicts_with_all = ["from", "to"])]
    frames: Option<FrameRange>,
    /// Extend the range to whole stretches, so that all frames are copied
    #[arg(long)]
    whole_stretches: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Frames from one number to before another, or to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FrameRange {
    start: u64,
    end: Option<u64>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (start, end) = text.split_once("..")?;
            let start = if start.is_empty() { 0 } else { start.parse().ok()? };
            let end = if end.is_empty() { None } else { Some(end.parse().ok()?) };
            Some(Self { start, end })
        };
        parse().ok_or_else(|| format!("expected frames such as 1200..2400, found '{text}'"))
    }
}

#[derive(Debug, Serialize)]
struct CutPartReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    first_frame: u64,
    frames: u64,
    take_frames: u64,
    seconds: f64,
    markers: usize,
    frames_copied: u64,
    frames_stored_exactly: u64,
    samples: u64,
    file_bytes: u64,
    left_out: Vec<String>,
    ledger: LedgerDocument,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if args.from.is_none() && args.to.is_none() && args.frames.is_none() {
        bail!(UsageError("no range: give --from, --to or --frames".to_owned()));
    }
    paths::check_take_output(&args.output)?;
    let name = args.take.display();
    let sources = read_sources(&[&args.take])?;
    let Some(source) = sources.first() else { bail!("cannot read {name}") };
    let requested = range(args, source).with_context(|| name.to_string())?;
    let counted = Arc::default();
    let mut rows = requested.clone();
    if args.whole_stretches {
        let reading = || format!("cannot read {name}");
        rows = source
            .whole_stretches(open_counted(&args.take, &counted)?, &requested)
            .with_context(reading)?;
    }
    let input = open_counted(&args.take, &counted)?;
    let n_rows = rows.end - rows.start;
    let written = write_take(&args.output, "cutting", n_rows, |out, context| {
        cut(source, input, rows.clone(), out, context)
    })?;
    let more = n_rows - (requested.end - requested.start);
    if more > 0 {
        let frames = count(more, "frame");
        notify(&format!("{name}: {frames} added to the range, to copy whole stretches"));
    }
    notify_left_out(&args.output, &written.left_out);
    let report = CutPartReport::new(args, source, rows.start, written);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::Done)
}

/// The frames to keep.
///
/// # Errors
/// If the take has no frames; a usage error if none is in the range.
fn range(args: &Args, source: &SourceTake) -> anyhow::Result<Range<u64>> {
    let map = source.map();
    let (n_rows, rate_hz) = (map.n_rows, map.header.rate_hz);
    ensure!(n_rows > 0, "the take has no frames: nothing to cut");
    let at = |time: Duration| frame_at(time, rate_hz);
    let (start, end) = match args.frames {
        Some(FrameRange { start, end }) => (start, end),
        None => (args.from.map_or(0, at), args.to.map(at)),
    };
    let is_backwards = end.is_some_and(|end| end < start);
    let end = end.unwrap_or(n_rows).min(n_rows);
    if start >= end {
        let (frames, length_s) = (count(n_rows, "frame"), n_rows as f64 / rate_hz);
        let why = if is_backwards { ", which ends before it begins" } else { "" };
        bail!(UsageError(format!(
            "no frames in the range{why}: the take has {frames}, {length_s:.3} s"
        )));
    }
    Ok(start..end)
}

impl CutPartReport {
    fn new(args: &Args, source: &SourceTake, first_frame: u64, written: CutReport) -> Self {
        let map = source.map();
        Self {
            take: args.take.clone(),
            output: args.output.clone(),
            first_frame,
            frames: written.rows,
            take_frames: map.n_rows,
            seconds: written.rows as f64 / map.header.rate_hz,
            markers: written.n_channels,
            frames_copied: written.rows_copied,
            frames_stored_exactly: written.rows_exact,
            samples: written.ledger.samples_present,
            file_bytes: written.bytes,
            left_out: written.left_out,
            ledger: LedgerDocument::from(&written.ledger),
        }
    }

    fn text(&self) -> String {
        let last = self.first_frame + self.frames.saturating_sub(1);
        let exact = match self.frames_stored_exactly {
            0 => String::new(),
            n => format!(", {} stored as float32 (--whole-stretches copies all)", thousands(n)),
        };
        format!(
            "{}: frames {} to {} of {}, {}, {}: {} copied{exact}\n",
            plain_path(Path::new(&self.output)),
            thousands(self.first_frame),
            thousands(last),
            thousands(self.take_frames),
            count(self.markers as u64, "marker"),
            bytes(self.file_bytes),
            thousands(self.frames_copied),
        )
    }
}

/// Opens a take. `read` counts its bytes.
pub(super) fn open_counted(
    path: &Path,
    read: &Arc<AtomicU64>,
) -> anyhow::Result<BufReader<CountingFile>> {
    Ok(BufReader::new(CountingFile::new(remote::open(path)?, read)))
}

/// Reads everything of the takes at `paths` but their samples, and checks every checksum.
///
/// # Errors
/// If one cannot be read, is damaged or was cut off.
pub(super) fn read_sources(paths: &[impl AsRef<Path>]) -> anyhow::Result<Vec<SourceTake>> {
    remote::fetch(paths)?;
    let mut bytes = 0;
    for path in paths {
        bytes += remote::len_bytes(path.as_ref())?;
    }
    let read = Arc::new(AtomicU64::new(0));
    let _progress = Progress::follow("reading", &read, bytes);
    let source = |path: &Path| {
        let reading = || format!("cannot read {}", path.display());
        SourceTake::read(&mut open_counted(path, &read)?).with_context(reading)
    };
    paths.iter().map(|path| source(path.as_ref())).collect()
}

/// Writes a new take of `rows` rows atomically: under its name there is the whole take or none.
///
/// # Errors
/// If it exists or cannot be written, and the errors of `edit`.
pub(super) fn write_take<T>(
    to: &Path,
    what: &'static str,
    rows: u64,
    edit: impl FnOnce(&mut BufWriter<&mut dyn SeekWrite>, &EditContext<'_>) -> Result<T, TakeError>,
) -> anyhow::Result<T> {
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow(what, &counter, rows);
    let on_rows = |rows| counter.store(rows, Ordering::Relaxed);
    let context =
        EditContext { software: SOFTWARE, new_scratch: &files::scratch, on_rows: &on_rows };
    let (written, _) = outputs::write_whole(to, false, |out| {
        let mut out = BufWriter::new(out);
        let written = edit(&mut out, &context);
        drop(progress);
        written.with_context(|| format!("cannot write {}", to.display()))
    })?;
    Ok(written)
}

/// Reports what the new take lacks.
pub(super) fn notify_left_out(output: &Path, left_out: &[String]) {
    if !left_out.is_empty() {
        notify(&format!("{}: left out: {}", output.display(), left_out.join(", ")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_frames() {
        let range = |start, end| Ok(FrameRange { start, end });
        assert_eq!("12..34".parse(), range(12, Some(34)));
        assert_eq!("12..".parse(), range(12, None));
        assert_eq!("..34".parse(), range(0, Some(34)));
        for text in ["", "12", "a..b", "-1..3", "1..2..3", "1...3", "12..34f"] {
            let refused = text.parse::<FrameRange>();
            assert!(refused.is_err_and(|message| message.contains(text)), "{text}");
        }
    }
}
