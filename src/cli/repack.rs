//! `repack`: writes takes again in fewer bytes.

use std::{
    fs::File,
    io::{self, BufReader, BufWriter, Seek},
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files, header::SOFTWARE};
use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    edit::{
        EditContext, RepackReport as Repacked, RepackSettings, SourceTake, check_repacked, repack,
    },
    record::{Header, KeyDistance},
};
use serde::Serialize;

use super::{
    batch::{
        self, Batch, Destination, Figures, FileKinds, FileReport, InputArgs, Job,
        outputs::{self, SeekWrite},
    },
    cut::open_counted,
    output::plain_path,
    remote,
    values::{bytes, default_effort, key_distance, resampler, thousands, tolerance},
};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "What a take decodes to stays the same, bit for bit, unless --tolerance is given, and is compared before the new take gets its name: \
    samples, gaps, lost frames, times, events, markers, parts of the imported file, observations of the clocks, ledger, \
    and the errors that its blocks state. Only a \
    lossless take can be encoded with another resampler, tolerance or effort; for others, import the source again."
)]
pub(crate) struct Args {
    /// Takes, or folders with takes; they are not changed. `-` reads a take from standard input
    #[arg(required = true, value_name = "TAKE")]
    takes: Vec<PathBuf>,
    /// The take to write, which must not exist, or the folder for several takes; `-` writes to standard output
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Of a lossless take: largest allowed distance between a sample and its reconstruction: 0.5mm, 100um, 2cm
    #[arg(long, value_name = "LENGTH", value_parser = tolerance, allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// Of a lossless take: dense or fast, with --tolerance, or lossless or lossless:predictive [default: dense with
    /// --tolerance, else lossless:predictive]
    #[arg(long, value_name = "NAME", value_parser = resampler(), hide_possible_values = true)]
    resampler: Option<ResamplerKind>,
    /// Of a lossless take, with --tolerance: effort of the resampler dense, 1 to 9 [default: 3]
    #[arg(long, value_name = "N", value_parser = str::parse::<Effort>)]
    effort: Option<Effort>,
    /// Of a lossless take that was imported: longest time from one key stretch to the next, as for `mocapd import`
    #[arg(long, value_name = "TIME", value_parser = key_distance, allow_hyphen_values = true)]
    keys: Option<KeyDistance>,
    /// Write a copy of a take that cannot be made smaller, as always to a folder or to standard output
    #[arg(long)]
    copy: bool,
    /// Print one JSON document, or one per line for several takes
    #[arg(long)]
    json: bool,
}

impl Args {
    /// How lossless takes are encoded.
    ///
    /// # Errors
    /// A usage error for options that contradict each other.
    fn settings(&self) -> anyhow::Result<RepackSettings> {
        let usage = |message: String| Err(UsageError(message).into());
        let default = match self.tolerance {
            Some(_) => ResamplerKind::Dense,
            None => ResamplerKind::LosslessPredictive,
        };
        let kind = self.resampler.unwrap_or(default);
        if !kind.is_live() {
            return usage(format!(
                "{kind} needs the whole take: export it, and import that with {kind}"
            ));
        }
        let tolerance = match self.tolerance {
            Some(_) if kind.is_lossless() => {
                return usage("a lossless take has no tolerance: omit --tolerance".to_owned());
            }
            None if !kind.is_lossless() => {
                return usage(format!("{kind} needs a tolerance: give --tolerance"));
            }
            Some(tolerance) => tolerance,
            None => Tolerance::from_mm(Tolerance::MAX_MM)?,
        };
        let effort = match self.effort {
            Some(_) if kind != ResamplerKind::Dense => {
                return usage(match self.tolerance {
                    Some(_) => format!("--effort is for the resampler dense: omit it with {kind}"),
                    None => "--effort is for lossless takes that become takes of the resampler dense: give --tolerance, \
                             too, or omit it"
                        .to_owned(),
                });
            }
            Some(effort) => effort,
            None if kind == ResamplerKind::Dense => default_effort()?,
            None => Effort::MIN,
        };
        Ok(RepackSettings { codec: Settings { kind, tolerance }, effort, keys: self.keys })
    }

    /// Whether the take is to be encoded in a certain way, be it smaller or not.
    fn asks_for_settings(&self) -> bool {
        self.tolerance.is_some()
            || self.resampler.is_some()
            || self.effort.is_some()
            || self.keys.is_some()
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let settings = args.settings()?;
    let inputs = batch::inputs::find(&args.takes, &args.input, FileKinds::Takes, None)?;
    let destination = Destination::of(Some(&args.output), &inputs)?;
    let paths_of_outputs = destination.take_paths(&inputs, args.json)?;
    let batch = Batch {
        inputs: &inputs,
        outputs: &paths_of_outputs,
        json: args.json,
        text_to_stderr: destination == Destination::Stdout,
        lines_to_stderr: false,
        threads: batch::thread_count(None),
        doing: "repacking",
        done: "repacked",
        is_compression: true,
    };
    batch::run(&batch, |job| repack_one(args, &settings, job, &destination))
}

fn context(on_rows: &dyn Fn(u64)) -> EditContext<'_> {
    EditContext { software: SOFTWARE, new_scratch: &files::scratch, on_rows }
}

fn repack_one(
    args: &Args,
    settings: &RepackSettings,
    job: &Job<'_>,
    destination: &Destination,
) -> anyhow::Result<FileReport> {
    let output = job.output.context("no output name: please report this bug")?;
    let reading = || format!("cannot read {}", job.input.name.display());
    job.input.check_is_no_motion_file()?;
    let path = &job.input.path;
    let read = Arc::default();
    let source = SourceTake::read(&mut open_counted(path, &read)?).with_context(reading)?;
    let header = &source.map().header;
    let is_lossless = header.codec().with_context(reading)?.kind.is_lossless();
    let settings = (is_lossless || args.asks_for_settings()).then_some(settings);
    let new = files::temporary()?;
    let written = {
        let phase = job.phase("repacking", source.map().n_rows);
        let on_rows = |rows| phase.counter.store(rows, Ordering::Relaxed);
        let input = open_counted(path, &read)?;
        repack(&source, input, settings, BufWriter::new(&new), &context(&on_rows))
            .with_context(|| format!("cannot repack {}", job.input.name.display()))?
    };
    let bytes_before = remote::len_bytes(path).with_context(reading)?;
    let is_smaller = written.bytes < bytes_before;
    let is_new = is_smaller || args.asks_for_settings();
    // A folder and standard output get every take, so that none is missing there.
    let is_written = is_new || args.copy || !matches!(destination, Destination::File(_));
    let is_folder = matches!(destination, Destination::Folder(_));
    if is_new {
        check(&source, &new, settings, job)?;
        write(output, is_folder, &mut &new)?;
    } else if is_written {
        write(output, is_folder, &mut remote::open(path)?)?;
    }
    let report = RepackReport::new(job, output, &written, bytes_before)
        .with_outcome(is_written, is_new, header);
    Ok(FileReport {
        text: report.text(),
        line: report.text(),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.seconds,
            bytes_read: bytes_before,
            bytes_written: if is_written { report.file_bytes } else { 0 },
            is_unchanged: !is_new,
        },
        ..FileReport::default()
    })
}

/// Compares the new take with the old one.
///
/// # Errors
/// If anything differs: a bug, after which nothing is written.
fn check(
    source: &SourceTake,
    new: &File,
    settings: Option<&RepackSettings>,
    job: &Job<'_>,
) -> anyhow::Result<()> {
    let _phase = job.phase("comparing", 1);
    (&mut &*new).rewind()?;
    let old = open_counted(&job.input.path, &Arc::default())?;
    let new = BufReader::new(new);
    let found = check_repacked(source, old, new, settings, &context(&|_| {}))?;
    if let Some(difference) = found {
        bail!(
            "{}: the repacked take differs, so nothing is written ({difference}): please report this bug",
            job.input.name.display()
        );
    }
    Ok(())
}

fn write(output: &Path, is_folder: bool, from: &mut (impl io::Read + Seek)) -> anyhow::Result<()> {
    from.rewind()?;
    let copy = |out: &mut dyn SeekWrite| Ok(io::copy(from, out)?);
    outputs::write_whole(output, is_folder, copy)?;
    Ok(())
}

#[derive(Debug, Serialize)]
struct RepackReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    /// Whether there is an output.
    written: bool,
    /// Whether it has other bytes than the take.
    repacked: bool,
    frames: u64,
    seconds: f64,
    markers: usize,
    stretches_before: u64,
    stretches: u64,
    bytes_before: u64,
    /// Of the new take; of the old one if that cannot be made smaller.
    file_bytes: u64,
    resampler: String,
    tolerance_mm: f64,
    effort: u8,
    format_version: u16,
    /// Whether every bit of the old take's positions is known.
    #[serde(skip)]
    was_lossless: bool,
}

impl RepackReport {
    fn new(job: &Job<'_>, output: &Path, written: &Repacked, bytes_before: u64) -> Self {
        let header = &written.header;
        Self {
            take: job.input.name.clone(),
            output: output.to_owned(),
            written: true,
            repacked: true,
            frames: written.rows,
            seconds: written.rows as f64 / header.rate_hz,
            markers: header.channels.len(),
            stretches_before: written.stretches[0],
            stretches: written.stretches[1],
            bytes_before,
            file_bytes: written.bytes,
            resampler: header.resampler.clone(),
            tolerance_mm: header.tolerance_mm,
            effort: header.effort().level(),
            format_version: header.codec_version,
            was_lossless: false,
        }
    }

    /// A take that is not written again is as it was, with the header `old`.
    fn with_outcome(self, written: bool, repacked: bool, old: &Header) -> Self {
        let was_lossless = old.codec().is_ok_and(|codec| codec.kind.is_lossless());
        if repacked {
            return Self { written, repacked, was_lossless, ..self };
        }
        Self {
            written,
            repacked,
            stretches: self.stretches_before,
            file_bytes: self.bytes_before,
            resampler: old.resampler.clone(),
            tolerance_mm: old.tolerance_mm,
            effort: old.effort().level(),
            format_version: old.codec_version,
            ..self
        }
    }

    fn text(&self) -> String {
        if !self.repacked {
            let copied = if self.written {
                format!("copied to {}", plain_path(&self.output))
            } else {
                "nothing is written (--copy writes a copy)".to_owned()
            };
            return format!(
                "{}: {}, cannot be made smaller: {copied}\n",
                plain_path(&self.take),
                bytes(self.bytes_before)
            );
        }
        let change = 100.0 * (self.file_bytes as f64 / self.bytes_before.max(1) as f64 - 1.0);
        format!(
            "{}: {} in place of {} ({change:+.1} %), {} in place of {} stretches; {}\n",
            plain_path(&self.output),
            bytes(self.file_bytes),
            bytes(self.bytes_before),
            thousands(self.stretches),
            thousands(self.stretches_before),
            match self.tolerance_mm {
                tolerance_mm if self.was_lossless && tolerance_mm > 0.0 =>
                    format!("every sample compared with the old take, and within {tolerance_mm} mm"),
                _ => "compared with the old take: no sample differs".to_owned(),
            },
        )
    }
}
