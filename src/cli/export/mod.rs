//! `export`: converts takes to formats of other tools.

mod format;
mod page;

use std::{
    io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write},
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::{self, Kept, NewRecording},
    parallel_frames::ParallelFrames,
};
use mocapd_service::units;
use mocapd_store::is_url;
use mocapd_take::{
    TakeFrames, TakeMap,
    foreign::ForeignPart,
    interchange::{Format, InterchangeError, RotatedFrames, bids, mot, npz, write_c3d},
    motion::{FrameSource, UpAxis},
    record::Ledger,
    sampled::SampledPart,
};
use serde::Serialize;

use self::{
    format::{CroppedFrames, EscapedLabels, FormatArgs, FormatName},
    page::PageAccuracy,
};
use super::{
    batch::{
        self, Batch, Destination, Figures, FileKinds, FileReport, InputArgs, Inputs, Job, outputs,
    },
    output::{plain, plain_path},
    paths,
    remote::{self, OutputFile},
    values::{self, TimeOrFormat, bytes, count, split_to, time_or_format},
};

/// Size of the output buffer: so large that the cost of system calls is negligible.
const BUFFER_BYTES: usize = 1 << 20;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or folders with takes; `-` reads a take from standard input
    #[arg(required = true, value_name = "TAKE")]
    takes: Vec<PathBuf>,
    /// The file to write: .c3d, .trc, .tsv (QTM), .csv, .npz, .xdf, .mot (force plates), .html (a page that plays
    /// the motion and the rigid bodies) or, if built in, .parquet or
    /// .mcap. All but .trc, .tsv, .mot and .html have the sampled channels and the poses of rigid bodies, too: .csv and
    /// .parquet in files beside it. It must not exist. For several takes the folder to write into, with `--to FORMAT`; a file there that has
    /// the same content is left as it is. With `--to bids` the dataset to create or to add to. `-` writes to standard
    /// output [default: beside each take]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    format: FormatArgs,
    /// Rotate the takes by 90 degrees so that this axis points up: x, y or z [default: for mot y, else as in the take]
    #[arg(long, value_name = "AXIS", value_parser = values::up_axis)]
    up: Option<UpAxis>,
    /// Export frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Export frames before this time; or, if the value is the name of a format, the same as --format: --to c3d
    #[arg(long, value_name = "TIME|FORMAT", allow_hyphen_values = true, value_parser = time_or_format::<FormatName>(), hide_possible_values = true)]
    to: Vec<TimeOrFormat<FormatName>>,
    /// Print one JSON document, or one per line for several takes
    #[arg(long)]
    json: bool,
}

/// The settings shared by all takes.
struct ExportPlan<'a> {
    args: &'a Args,
    format: Format,
    /// The end of the range of time.
    end: Option<Duration>,
    /// Whether outputs that exist are compared rather than refused, and their folders created.
    is_folder: bool,
    /// Held while a recording is added to a data set, one at a time.
    dataset: Mutex<()>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let (end, to_format) = split_to(&args.to)?;
    let name = args.format.name(to_format)?;
    let inputs = batch::inputs::find(&args.takes, &args.input, FileKinds::Takes, None)?;
    let destination = match &args.output {
        // All takes become one data set, which is a folder.
        Some(path) if name == Some(FormatName::Bids) && !paths::is_dash(path) => {
            Destination::File(path.clone())
        }
        None if name == Some(FormatName::Bids) => {
            bail!(UsageError("name the BIDS dataset, a folder: give -o FOLDER".to_owned()));
        }
        output => Destination::of(output.as_deref(), &inputs)?,
    };
    let (format, paths_of_outputs) = plan_outputs(args, name, &destination, &inputs)?;
    format.check_built()?;
    if let (Format::Bids, Destination::File(path) | Destination::Folder(path)) =
        (format, &destination)
        && is_url(path)
    {
        let message = "a BIDS dataset is a folder of this machine: export it there, and copy it";
        bail!(UsageError(message.to_owned()));
    }
    match &destination {
        Destination::File(path) if format == Format::Bids => {
            // Before a take is read.
            if let ([input], true) = (inputs.files.as_slice(), inputs.is_single) {
                drop(NewRecording::begin(path, &args.format.names(&input.relative)?)?);
            }
        }
        Destination::File(path) => paths::check_output(path)?,
        Destination::Stdout if format == Format::Bids => {
            bail!(UsageError("a BIDS dataset is a folder: give -o FOLDER".to_owned()));
        }
        Destination::Stdout => paths::check_stdout(args.json)?,
        Destination::Folder(_) | Destination::Beside => {}
    }
    let is_folder = matches!(destination, Destination::Folder(_) | Destination::Beside);
    let batch = Batch {
        inputs: &inputs,
        outputs: &paths_of_outputs,
        json: args.json,
        text_to_stderr: true,
        lines_to_stderr: false,
        threads: batch::thread_count(None),
        doing: "exporting",
        done: "exported",
        is_compression: false,
    };
    let plan = ExportPlan { args, format, end, is_folder, dataset: Mutex::new(()) };
    batch::run(&batch, |job| plan.export(job))
}

/// The format and the paths of the outputs.
///
/// # Errors
/// A usage error if the format is neither given nor that of the output's extension.
fn plan_outputs(
    args: &Args,
    name: Option<FormatName>,
    destination: &Destination,
    inputs: &Inputs,
) -> anyhow::Result<(Format, Vec<PathBuf>)> {
    if let Destination::File(path) = destination {
        return Ok((args.format.of(name, path)?, vec![path.clone(); inputs.files.len()]));
    }
    let Some(name) = name else {
        bail!(UsageError("no format: give one with --to, such as --to c3d".to_owned()));
    };
    let extension = name.extension();
    let format = args.format.of(Some(name), Path::new(extension))?;
    Ok((format, destination.paths(inputs, extension)?))
}

/// The report of `export`, documented in docs/json.md.
#[derive(Debug, Serialize)]
struct ExportReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    /// Files of analog channels and force plates beside the output.
    sampled_files: Vec<String>,
    /// Whether the output, and the files beside it, existed with the same content.
    unchanged: bool,
    frames: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    output_bytes: u64,
    /// Frames that the recording lost: gaps in the output.
    frames_lost: u64,
    /// Content of the take that the format cannot hold.
    not_supported: Vec<String>,
    /// With `--up`: content that was not rotated.
    not_rotated: Vec<String>,
    /// For `html`: how far positions on the page can be from the original.
    page: Option<PageAccuracy>,
    problems: Vec<String>,
}

/// The result of one attempt to write an output.
struct Attempt {
    frames: u64,
    written: Written,
    not_supported: Vec<String>,
    not_rotated: Vec<String>,
}

/// An output that was written.
struct Written {
    kept: Kept,
    /// Its size; 0 for a folder.
    bytes: u64,
    /// Files of analog channels and force plates beside it.
    sampled_files: Vec<PathBuf>,
    /// Remarks on its content.
    remarks: Vec<String>,
    /// For a page, its accuracy.
    page: Option<PageAccuracy>,
}

impl ExportPlan<'_> {
    fn export(&self, job: &Job<'_>) -> anyhow::Result<FileReport> {
        let (args, format) = (self.args, self.format);
        let name = job.input.name.display();
        let output = job.output.context("no output name: please report this bug")?;
        let reading = || format!("cannot read {name}");
        job.input.check_is_no_motion_file()?;
        let file = remote::open(&job.input.path)?;
        let bytes_read = file.len_bytes().with_context(reading)?;
        let is_restored = |kind: &str| format.restores(kind);
        let mut frames = TakeFrames::open_with(BufReader::new(file), is_restored, files::scratch)
            .with_context(reading)?;
        let again = BufReader::new(remote::open(&job.input.path)?);
        frames.open_recording(again, args.format.resample).with_context(reading)?;
        let n_sampled_rows = frames.map().n_sampled_rows.unwrap_or_default();
        let range = format::range(frames.info(), n_sampled_rows, args.from, self.end)
            .with_context(|| name.to_string())?;
        if args.up.is_some() && frames.info().up == UpAxis::Unknown {
            bail!(UsageError(format!(
                "{name} states no up axis, so --up cannot rotate it: import its file again with --up; for recordings see `mocapd record --up`"
            )));
        }
        let of_take = frames.info().up;
        let mut parallel = ParallelFrames::start(
            &remote::local(&job.input.path)?,
            &frames,
            range.start,
            job.threads,
        )?;
        let attempt = match &mut parallel {
            None => None,
            Some(parallel) => match self.attempt(parallel, &range, job, output) {
                // The take turned out to be damaged: the sequential reader accounts for what is missing. The failed
                // attempt left no file.
                Err(_) if parallel.is_damaged() => None,
                tried => Some(tried?),
            },
        };
        let mut attempt = match attempt {
            Some(attempt) => attempt,
            None => {
                frames.seek(range.start)?;
                self.attempt(&mut frames, &range, job, output)?
            }
        };
        attempt.written.remarks.extend(remark_on_axes(format, of_take, args.up));
        attempt.written.remarks.extend(remark_on_bounds(
            format,
            frames.map(),
            &attempt.not_supported,
        ));
        attempt.written.remarks.iter().for_each(|remark| job.notify_of(output, remark));
        let report = ExportReport::new(job, output, &frames, attempt);
        report.notify(job);
        if let Some(page) = &report.page {
            job.notify_of(output, &page.to_string());
        }
        Ok(FileReport {
            data_lost: !report.problems.is_empty(),
            text: String::new(),
            line: report.line(),
            json: job.json(&report)?,
            figures: Figures {
                frames: report.frames,
                seconds: report.seconds,
                bytes_read,
                bytes_written: report.output_bytes,
                is_unchanged: report.unchanged,
            },
            ..FileReport::default()
        })
    }

    /// Writes the frames of `range` from `source`, which is at the first of them.
    fn attempt(
        &self,
        source: &mut dyn FrameSource,
        range: &Range<u64>,
        job: &Job<'_>,
        output: &Path,
    ) -> anyhow::Result<Attempt> {
        let n_frames = range.end - range.start;
        // A pass over the frames, and one for each table of sampled channels.
        let n_passes = 1 + self.format.sampled_tables(source.info())?.len() as u64;
        let phase = job.phase("exporting", n_frames.saturating_mul(n_passes));
        let mut cropped = CroppedFrames::new(source, range, Arc::clone(&phase.counter));
        let is_turned = self.format == Format::Mot && cropped.info().up != UpAxis::Unknown;
        let up = self.args.up.or(is_turned.then_some(UpAxis::Y));
        let mut not_supported = self.format.leaves_out(cropped.info(), up.is_some());
        if paths::is_dash(output) && self.format.has_sampled_files() {
            let tables = self.format.sampled_tables(cropped.info())?;
            not_supported.extend(tables.iter().map(|table| {
                format!("{} (needs a separate file: give -o FILE)", table.kind().description())
            }));
        }
        let mut not_rotated = Vec::new();
        let mut rotated;
        let frames: &mut dyn FrameSource = match up {
            None => &mut cropped,
            Some(up) => {
                rotated =
                    RotatedFrames::new(&mut cropped, up)?.context("the take states no up axis")?;
                if self.format == Format::C3d {
                    not_rotated = rotated.not_rotated();
                }
                &mut rotated
            }
        };
        let written = if self.args.format.for_spreadsheet {
            self.write(&mut EscapedLabels::new(frames), job, output)?
        } else {
            self.write(frames, job, output)?
        };
        Ok(Attempt { frames: n_frames, written, not_supported, not_rotated })
    }

    /// Writes an output whole or not at all.
    fn write(
        &self,
        frames: &mut dyn FrameSource,
        job: &Job<'_>,
        output: &Path,
    ) -> anyhow::Result<Written> {
        if self.format == Format::Bids {
            let _one_at_a_time = self.dataset.lock();
            write_folder(frames, &self.args.format.names(&job.input.relative)?, output)?;
            let (sampled_files, remarks) = (Vec::new(), self.remarks(frames)?);
            return Ok(Written { kept: Kept::New, bytes: 0, sampled_files, remarks, page: None });
        }
        let writing = || format!("cannot write {}", output.display());
        // The additional files get their names before the output: if the output exists, so do they.
        let mut sampled = SampledFiles::default();
        let mut page = None;
        let ((bytes, mut remarks), mut kept) =
            outputs::write_whole(output, self.is_folder, |out| {
                let mut buffered = BufWriter::with_capacity(BUFFER_BYTES, &mut *out);
                let remarks = if self.format == Format::Mot {
                    mot::write(frames, &mut buffered, self.args.format.baseline())
                        .with_context(writing)?
                } else if self.format == Format::Html {
                    page = Some(self.write_page(frames, job, &mut buffered).with_context(writing)?);
                    Vec::new()
                } else if self.format == Format::C3d {
                    write_c3d(frames, &mut buffered).with_context(writing)?
                } else {
                    write_frames(frames, self.format, &mut buffered).with_context(writing)?;
                    Vec::new()
                };
                buffered.flush().with_context(writing)?;
                drop(buffered);
                if self.format.has_sampled_files() && !paths::is_dash(output) {
                    out.sync().with_context(writing)?;
                    sampled.write(self, frames, output)?;
                }
                Ok((out.seek(SeekFrom::End(0))?, remarks))
            })?;
        remarks.extend(self.remarks(frames)?);
        if sampled.kept.iter().any(|(_, kept)| *kept == Kept::New) {
            kept = Kept::New;
        }
        let bytes = bytes + sampled.bytes;
        let sampled_files = std::mem::take(&mut sampled.kept).into_iter().map(|(path, _)| path);
        Ok(Written { kept, bytes, sampled_files: sampled_files.collect(), remarks, page })
    }

    /// Remarks on the analog channels and force plates of an output.
    fn remarks(&self, frames: &dyn FrameSource) -> anyhow::Result<Vec<String>> {
        let mut remarks: Vec<String> = Vec::new();
        for table in self.format.sampled_tables(frames.info())? {
            for warning in table.warnings() {
                if !remarks.contains(warning) {
                    remarks.push(warning.clone());
                }
            }
        }
        Ok(remarks)
    }
}

/// The files of analog channels and force plates that accompany an output. New ones are removed on drop.
#[derive(Default)]
struct SampledFiles {
    kept: Vec<(PathBuf, Kept)>,
    bytes: u64,
}

impl SampledFiles {
    fn write(
        &mut self,
        plan: &ExportPlan<'_>,
        frames: &dyn FrameSource,
        output: &Path,
    ) -> anyhow::Result<()> {
        let mut files = Vec::new();
        for mut table in plan.format.sampled_tables(frames.info())? {
            if plan.args.format.for_spreadsheet {
                table.rename(format::escape);
            }
            let path = paths::sampled_path(output, table.kind());
            let writing = || format!("cannot write {}", path.display());
            let mut file = match plan.is_folder {
                true => OutputFile::create_or_compare(&path)?,
                false => OutputFile::create(&path)?,
            };
            let mut buffered = BufWriter::with_capacity(BUFFER_BYTES, &mut file);
            plan.format.write_sampled(&mut table, frames, &mut buffered).with_context(writing)?;
            buffered.flush().with_context(writing)?;
            drop(buffered);
            self.bytes += file.seek(SeekFrom::End(0)).with_context(writing)?;
            file.sync().with_context(writing)?;
            files.push((path, file));
        }
        // All are complete, so an export that is interrupted before this moment leaves none.
        for (path, file) in files {
            let kept = match plan.is_folder {
                true => file.keep_or_compare()?,
                false => file.keep().map(|()| Kept::New)?,
            };
            self.kept.push((path, kept));
        }
        Ok(())
    }
}

impl Drop for SampledFiles {
    fn drop(&mut self) {
        for (path, _) in self.kept.iter().filter(|(_, kept)| *kept == Kept::New) {
            // The output itself failed, with a message of its own.
            let _removed = remote::remove(path);
        }
    }
}

/// A remark on the axes of an export whose format requires an up axis that the user did not give.
fn remark_on_axes(format: Format, of_take: UpAxis, given: Option<UpAxis>) -> Option<String> {
    match of_take.name() {
        _ if format != Format::Mot || given.is_some() || of_take == UpAxis::Y => None,
        Some(axis) => Some(format!(
            "rotated from {axis} up to y up, as OpenSim expects: export the markers with --up y"
        )),
        None => Some(
            "the take states no up axis, so its axes were kept; OpenSim expects y up".to_owned(),
        ),
    }
}

/// The largest number of channels that a remark names.
const NAMED_MAX: usize = 3;

/// A remark on analog samples that are not those of the source, unless the format has none.
fn remark_on_bounds(format: Format, take: &TakeMap, not_supported: &[String]) -> Option<String> {
    // The loads of plates in .mot come from analog samples, of which others are left out.
    if format != Format::Mot && not_supported.iter().any(|what| what.contains("analog")) {
        return None;
    }
    let groups = take.foreign.iter().filter_map(ForeignPart::sampled).flat_map(SampledPart::groups);
    let groups = groups.map(|found| &found.group).filter(|group| !group.has_poses());
    let channels = groups
        .flat_map(|group| group.channels.iter().enumerate().map(move |(i, c)| (group.bound(i), c)));
    let inexact: Vec<String> = channels
        .filter(|(bound, _)| *bound > 0.0)
        .map(|(bound, channel)| {
            let (name, unit) = (plain(&channel.name), plain(&channel.unit));
            format!("{name} within {:.3e} {unit}", bound * channel.scale.abs())
        })
        .collect();
    let more = match inexact.len().saturating_sub(NAMED_MAX) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let named: Vec<&str> = inexact.iter().take(NAMED_MAX).map(|text| text.trim_end()).collect();
    (!inexact.is_empty()).then(|| {
        format!(
            "analog channels that the import stored within a tolerance: {}{more}",
            named.join(", ")
        )
    })
}

impl ExportReport {
    fn new<R: Read + Seek>(
        job: &Job<'_>,
        output: &Path,
        frames: &TakeFrames<R>,
        attempt: Attempt,
    ) -> Self {
        let (take, info) = (frames.map(), frames.info());
        Self {
            take: job.input.name.clone(),
            output: output.to_owned(),
            sampled_files: attempt
                .written
                .sampled_files
                .iter()
                .map(|path| path.to_string_lossy().into_owned())
                .collect(),
            unchanged: attempt.written.kept == Kept::Unchanged,
            frames: attempt.frames,
            seconds: attempt.frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            output_bytes: attempt.written.bytes,
            frames_lost: take.ledger.as_ref().map_or(0, Ledger::frames_lost),
            not_supported: attempt.not_supported,
            not_rotated: attempt.not_rotated,
            page: attempt.written.page,
            problems: frames.problems().iter().map(ToString::to_string).collect(),
        }
    }

    /// Reports what the output lacks.
    fn notify(&self, job: &Job<'_>) {
        let output = self.output.display();
        if !self.not_supported.is_empty() {
            job.notify_of(
                &self.output,
                &format!("not supported by the format: {}", self.not_supported.join(", ")),
            );
        }
        if !self.not_rotated.is_empty() {
            job.notify_of(&self.output, &format!("not rotated: {}", self.not_rotated.join(", ")));
        }
        if self.frames_lost > 0 {
            // Other programs cannot distinguish them from occluded markers.
            let lost = count(self.frames_lost, "frame");
            job.notify(&format!(
                "{lost} lost while recording; in {output} they are gaps, like occluded markers"
            ));
        }
        self.problems.iter().for_each(|problem| job.notify(problem));
    }

    fn line(&self) -> String {
        let size = if self.output_bytes > 0 {
            format!(", {}", bytes(self.output_bytes))
        } else {
            String::new()
        };
        let names = std::iter::once(plain_path(&self.output));
        let names: Vec<String> = names
            .chain(self.sampled_files.iter().map(|name| plain_path(Path::new(name))))
            .collect();
        format!(
            "{}: {} of {}{size}{}{}\n",
            names.join(", "),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            self.page.as_ref().map(|page| format!("; {page}")).unwrap_or_default(),
            if self.unchanged { "; unchanged" } else { "" },
        )
    }
}

/// Writes a file atomically: completely or not at all.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    format: Format,
    path: &Path,
) -> anyhow::Result<()> {
    let writing = || format!("cannot write {}", path.display());
    outputs::write_whole(path, false, |out| {
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, out);
        write_frames(frames, format, &mut out).with_context(writing)?;
        out.flush().with_context(writing)
    })?;
    Ok(())
}

/// Writes all frames to an output.
fn write_frames(
    frames: &mut dyn FrameSource,
    format: Format,
    out: &mut (impl Write + Seek),
) -> Result<(), InterchangeError> {
    match format {
        Format::Npz => npz::write(frames, out),
        _ => format.write(frames, out),
    }
}

/// Writes a data set, or adds a recording to one: all of its files or none.
fn write_folder(
    frames: &mut dyn FrameSource,
    names: &bids::BidsLabels,
    path: &Path,
) -> anyhow::Result<()> {
    let mut output = NewRecording::begin(path, names)?;
    let writing = || format!("cannot write {}", path.display());
    bids::write(frames, names, &mut output).with_context(writing)?;
    output.keep()
}
