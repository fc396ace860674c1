//! `gaps`: the gaps of each marker of takes and motion files, as a summary, and one by one as CSV.

use std::{
    fmt::Write as _,
    io::{self, BufReader, BufWriter, Write as _},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::gaps::{Gap, GapCause, GapReader, GapSummary, MarkerGaps, gaps_of_frames};
use mocapd_take::{
    TakeMap,
    interchange::{column_labels, csv_cell},
    motion::{FrameSource, Marker, MotionInfo},
    record::{Channel, Header, ImportSource},
};
use serde::Serialize;

use super::{
    batch::{self, Batch, Figures, FileKinds, FileReport, InputArgs, Job},
    motion_files::open_motion_input,
    output::{plain, plain_path, print_exact},
    paths::{self, InputFormat, InputFormatName},
    remote::{self, OutputFile},
    values::{LABEL_COLUMNS_MAX, count, thousands},
};

/// The columns of the CSV.
const CSV_HEADER: &str = "marker,first_frame,frames,start_s,seconds,cause\n";
/// Bytes of CSV per write.
const PRINTED_BYTES: usize = 1 << 16;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input, and of files whose extension does not show it
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    /// Write one row per gap to this CSV file, which must not exist; `-` for standard output. For several files it has a
    /// column for the name of the file
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct GapsReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    frames: u64,
    rate_hz: f64,
    seconds: f64,
    gaps: u64,
    samples: u64,
    samples_missing: u64,
    causes: Vec<CauseReport>,
    markers: Vec<MarkerGapsReport>,
    problems: Vec<String>,
}

#[derive(Debug, Serialize)]
struct MarkerGapsReport {
    label: String,
    samples: u64,
    seen_percent: f64,
    gaps: u64,
    frames_missing: u64,
    longest: Option<LongestGapReport>,
    causes: Vec<CauseReport>,
}

#[derive(Debug, Serialize)]
struct LongestGapReport {
    from_frame: u64,
    frames: u64,
    from_s: f64,
    seconds: f64,
}

/// Missing samples with a cause.
#[derive(Debug, Serialize)]
struct CauseReport {
    cause: &'static str,
    samples: u64,
}

/// Where the rows of the CSV go.
enum CsvOutput {
    Nowhere,
    Stdout(String),
    File(BufWriter<OutputFile>),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.format.map(Into::into);
    let inputs = batch::inputs::find(&args.files, &args.input, FileKinds::Both, format)?;
    let csv = CsvOutput::create(args)?;
    let is_stdout = matches!(csv, CsvOutput::Stdout(_));
    let name_column = if inputs.is_single { "" } else { "file," };
    let csv = Mutex::new(csv);
    lock(&csv).put(&format!("{name_column}{CSV_HEADER}"))?;
    let mut batch = Batch::of_reports(&inputs, args.json, ["reading", "read"]);
    if args.output.is_some() {
        // The rows of a file follow those of the file before it.
        batch.threads = 1;
    }
    batch.lines_to_stderr = is_stdout;
    let outcome = batch::run(&batch, |job| {
        let mut report = file_gaps(job, &csv)?;
        if is_stdout && job.is_single {
            report.text.clear();
        }
        Ok(report)
    })?;
    csv.into_inner().unwrap_or_else(PoisonError::into_inner).finish()?;
    Ok(outcome)
}

fn lock(csv: &Mutex<CsvOutput>) -> MutexGuard<'_, CsvOutput> {
    csv.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads the gaps of a file.
fn file_gaps(job: &Job<'_>, csv: &Mutex<CsvOutput>) -> anyhow::Result<FileReport> {
    let name = &job.input.name;
    let reading = || format!("cannot read {}", name.display());
    let put = |rows: &GapRows, gap: &Gap| {
        let file = csv_cell(&name.to_string_lossy()).into_owned() + ",";
        let file = if job.is_single { String::new() } else { file };
        lock(csv).put(&format!("{file}{}", rows.row(gap))).map_err(io::Error::other)?;
        Ok(())
    };
    let (found, rows, bytes_read) = match job.input.format()? {
        InputFormat::Take => {
            let file = remote::open(&job.input.path)?;
            let bytes_read = file.len_bytes().with_context(reading)?;
            let reader = GapReader::open(BufReader::new(file)).with_context(reading)?;
            let rows = GapRows::new(reader.take());
            let phase = job.phase("reading", reader.take().n_rows);
            let found = reader.read(&phase.counter, |gap| put(&rows, gap));
            (found.with_context(reading)?, rows, bytes_read)
        }
        InputFormat::MotionFile(_) => {
            let (mut motion, bytes_read) = open_motion_input(job)?;
            let take = map_of(motion.info());
            let rows = GapRows::new(&take);
            let phase = job.phase("reading", take.n_rows);
            let found = gaps_of_frames(&mut motion, take, &phase.counter, |gap| put(&rows, gap));
            (found.with_context(reading)?, rows, bytes_read)
        }
    };
    let report = GapsReport::new(name, &found, &rows.labels);
    report.problems.iter().for_each(|problem| job.notify(problem));
    Ok(FileReport {
        data_lost: !report.problems.is_empty(),
        text: report.text(rows.first_frame),
        line: report.line(),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.seconds,
            bytes_read,
            ..Figures::default()
        },
        ..FileReport::default()
    })
}

/// A motion file as the map of a take.
fn map_of(info: &MotionInfo) -> TakeMap {
    let source = ImportSource { first_frame: info.source.first_frame, ..ImportSource::default() };
    let channel = |(column, marker): (usize, &Marker)| Channel {
        marker_id: column as u16,
        label: marker.label.clone(),
        labelled: marker.labelled,
    };
    TakeMap {
        header: Header { rate_hz: info.rate_hz, source: Some(source), ..Header::default() },
        channels: info.markers.iter().enumerate().map(channel).collect(),
        n_rows: info.n_frames,
        ..TakeMap::default()
    }
}

impl CsvOutput {
    fn create(args: &Args) -> anyhow::Result<Self> {
        Ok(match &args.output {
            None => Self::Nowhere,
            Some(path) if paths::is_dash(path) && args.json => {
                let message = "standard output cannot have both the CSV and the JSON document: name a file with -o";
                bail!(UsageError(message.to_owned()))
            }
            Some(path) if paths::is_dash(path) => Self::Stdout(String::new()),
            Some(path) if !paths::ends_in(path, "csv") => {
                return Err(paths::unknown_ending(path, ".csv"));
            }
            Some(path) => Self::File(BufWriter::new(OutputFile::create(path)?)),
        })
    }

    fn put(&mut self, text: &str) -> anyhow::Result<()> {
        match self {
            Self::Nowhere => {}
            Self::Stdout(buffer) => {
                buffer.push_str(text);
                if buffer.len() >= PRINTED_BYTES {
                    print_exact(buffer)?;
                    buffer.clear();
                }
            }
            Self::File(file) => {
                file.write_all(text.as_bytes()).context("cannot write the CSV file")?;
            }
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Nowhere => Ok(()),
            Self::Stdout(buffer) => print_exact(&buffer),
            Self::File(file) => {
                let file = file.into_inner().map_err(io::IntoInnerError::into_error);
                file.context("cannot write the CSV file")?.keep()
            }
        }
    }
}

/// The rows of the CSV: labels and frame numbers are those of an export to CSV.
struct GapRows {
    labels: Vec<String>,
    first_frame: u64,
    rate_hz: f64,
}

impl GapRows {
    fn new(take: &TakeMap) -> Self {
        let markers = take.channels.iter().map(Into::into).collect();
        let info = MotionInfo { markers, ..MotionInfo::default() };
        let source = take.header.source.as_ref();
        Self {
            labels: column_labels(&info),
            first_frame: source.map_or(1, |source| source.first_frame),
            rate_hz: take.header.rate_hz,
        }
    }

    fn row(&self, gap: &Gap) -> String {
        let causes: Vec<&str> = gap.causes.iter().map(GapCause::name).collect();
        format!(
            "{},{},{},{:.6},{:.6},{}\n",
            self.labels.get(gap.column).map(|label| csv_cell(label)).unwrap_or_default(),
            self.first_frame.saturating_add(gap.first_row),
            gap.rows,
            gap.first_row as f64 / self.rate_hz,
            gap.rows as f64 / self.rate_hz,
            causes.join(" + ")
        )
    }
}

impl GapsReport {
    fn new(take: &Path, found: &GapSummary, labels: &[String]) -> Self {
        let (frames, rate_hz) = (found.take.n_rows, found.take.header.rate_hz);
        let marker = |(of, label): (&MarkerGaps, &String)| MarkerGapsReport {
            label: label.clone(),
            samples: of.samples,
            seen_percent: percent(of.samples, frames),
            gaps: of.gaps,
            frames_missing: of.rows,
            longest: of.longest.map(|gap| LongestGapReport {
                from_frame: gap.first_row,
                frames: gap.rows,
                from_s: gap.first_row as f64 / rate_hz,
                seconds: gap.rows as f64 / rate_hz,
            }),
            causes: CauseReport::all(|cause| of.rows_by_cause.get(cause as usize).copied()),
        };
        let sum = |of: fn(&MarkerGaps) -> u64| found.markers.iter().map(of).sum();
        let of_cause = |cause: GapCause| {
            found.markers.iter().map(|of| of.rows_by_cause.get(cause as usize).copied()).sum()
        };
        Self {
            take: take.to_owned(),
            frames,
            rate_hz,
            seconds: frames as f64 / rate_hz,
            gaps: sum(|of| of.gaps),
            samples: sum(|of| of.samples),
            samples_missing: sum(|of| of.rows),
            causes: CauseReport::all(of_cause),
            markers: found.markers.iter().zip(labels).map(marker).collect(),
            problems: found.take.problems.iter().map(ToString::to_string).collect(),
        }
    }

    /// The totals of a file in one line.
    fn line(&self) -> String {
        format!(
            "{}: {}, {} of {} missing, {} of {}\n",
            plain_path(&self.take),
            count(self.gaps, "gap"),
            thousands(self.samples_missing),
            count(self.samples.saturating_add(self.samples_missing), "sample"),
            count(self.frames, "frame"),
            count(self.markers.len() as u64, "marker"),
        )
    }

    /// Totals, and a table of the markers. Frames are numbered from `first_frame`, as in exports.
    fn text(&self, first_frame: u64) -> String {
        let Self { frames, rate_hz, seconds, .. } = self;
        let all = self.samples.saturating_add(self.samples_missing);
        let causes: Vec<String> = self.causes.iter().map(CauseReport::text).collect();
        let causes =
            if causes.is_empty() { String::new() } else { format!(": {}", causes.join(", ")) };
        let mut out = format!(
            "{}: {} of {} at {rate_hz} Hz, {seconds:.3} s\n{}, {} of {} missing{causes}\n",
            plain_path(&self.take),
            count(*frames, "frame"),
            count(self.markers.len() as u64, "marker"),
            count(self.gaps, "gap"),
            thousands(self.samples_missing),
            count(all, "sample")
        );
        let widths = self.markers.iter().map(|marker| plain(&marker.label).chars().count());
        let width = widths.max().unwrap_or(0).clamp(6, LABEL_COLUMNS_MAX);
        writeln!(
            out,
            "{:<width$} {:>8} {:>8} {:>10} {:>10} {:>10} {:>12}",
            "marker", "seen %", "gaps", "missing", "longest", "longest s", "at frame"
        )
        .ok();
        for marker in &self.markers {
            let (gaps, missing) = (thousands(marker.gaps), thousands(marker.frames_missing));
            let longest = marker.longest.as_ref().map_or_else(
                || format!("{:>10} {:>10} {:>12}", "-", "-", "-"),
                |LongestGapReport { from_frame, frames, seconds, .. }| {
                    let at = thousands(first_frame.saturating_add(*from_frame));
                    format!("{:>10} {seconds:>10.3} {at:>12}", thousands(*frames))
                },
            );
            let label = plain(&marker.label);
            writeln!(
                out,
                "{label:<width$} {:>8.2} {gaps:>8} {missing:>10} {longest}",
                marker.seen_percent
            )
            .ok();
        }
        out
    }
}

impl CauseReport {
    /// The causes with at least one missing sample.
    fn all(samples: impl Fn(GapCause) -> Option<u64>) -> Vec<Self> {
        let report = |cause: GapCause| {
            let samples = samples(cause).filter(|&samples| samples > 0)?;
            Some(Self { cause: cause.name(), samples })
        };
        GapCause::ALL.into_iter().filter_map(report).collect()
    }

    fn text(&self) -> String {
        format!("{} {}", thousands(self.samples), self.cause)
    }
}

/// `part` of `whole` in per cent; 100 if `whole` is 0.
fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 100.0 } else { 100.0 * part as f64 / whole as f64 }
}
