//! `export`: converts a take to a format of other tools.

mod crop;
mod format;
mod spreadsheet;

use std::{
    io::{BufReader, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::{self, NewFile, NewRecording, SparseFile},
    parallel_frames::ParallelFrames,
    threads,
};
use mocapd_service::units;
use mocapd_take::{
    TakeFrames, TakeMap,
    foreign::force_plates::Baseline,
    interchange::{Direction, Format, InterchangeError, RotatedFrames, bids, mot, npz},
    motion::{FrameSource, UpAxis},
    record::Ledger,
};

use self::{crop::CroppedFrames, format::FormatArgs, spreadsheet::EscapedLabels};
use super::{output::Progress, output::notify, paths, values::count};

/// Size of the output buffer: so large that the cost of system calls is negligible.
const BUFFER_BYTES: usize = 1 << 20;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The file to write: .c3d, .trc, .tsv (QTM), .csv, .npz, .xdf, .mot (force plates) or, if built in, .parquet or
    /// .mcap. It must not exist. With `--format bids` the folder to create, or a data set to add to
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    format: FormatArgs,
    /// Rotate the take by 90 degrees so that this axis points up: x, y or z [default: for mot y, else as in the take]
    #[arg(long, value_name = "AXIS", value_parser = axis)]
    up: Option<UpAxis>,
    /// Export frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Export frames before this time
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    to: Option<Duration>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.format.of(&args.output)?;
    format.check_built()?;
    check_output(args, format)?;
    let name = args.take.display();
    let reading = || format!("cannot read {name}");
    let file = SparseFile::open(&args.take)?;
    let is_restored = |kind: &str| format.restores(kind);
    let mut frames = TakeFrames::open_with(BufReader::new(file), is_restored, files::scratch)
        .with_context(reading)?;
    let n_sampled_rows = frames.map().n_sampled_rows.unwrap_or_default();
    let range = crop::range(frames.info(), n_sampled_rows, args.from, args.to)
        .with_context(|| name.to_string())?;
    if args.up.is_some() && frames.info().up == UpAxis::Unknown {
        bail!(UsageError(format!(
            "{name} states no up axis, so --up cannot rotate it: import its file again with --up"
        )));
    }
    let of_take = frames.info().up;
    let is_turned = format == Format::Mot && of_take != UpAxis::Unknown;
    let up = args.up.or(is_turned.then_some(UpAxis::Y));
    let mut parallel =
        ParallelFrames::start(&args.take, &frames, range.start, threads::default_workers())?;
    let (mut left_out, mut not_rotated, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
    let mut export = |source: &mut dyn FrameSource| -> anyhow::Result<()> {
        let counter = Arc::new(AtomicU64::new(0));
        let mut cropped = CroppedFrames::new(source, &range, Arc::clone(&counter));
        left_out = format.leaves_out(cropped.info(), up.is_some());
        let _progress = Progress::follow("exporting", &counter, cropped.info().n_frames);
        let mut turned;
        let frames: &mut dyn FrameSource = match up {
            None => &mut cropped,
            Some(up) => {
                turned =
                    RotatedFrames::new(&mut cropped, up)?.context("the take states no up axis")?;
                not_rotated = turned.not_rotated();
                &mut turned
            }
        };
        remarks = write_output(frames, format, args)?;
        Ok(())
    };
    let done = match &mut parallel {
        None => false,
        Some(parallel) => match export(parallel) {
            // The take turned out to be damaged: the sequential reader accounts for what is missing. The failed attempt
            // left no file.
            Err(_) if parallel.is_damaged() => false,
            tried => tried.map(|()| true)?,
        },
    };
    if !done {
        frames.seek(range.start)?;
        export(&mut frames)?;
    }
    if !left_out.is_empty() {
        let output = args.output.display();
        notify(&format!("{output}: not supported by the format: {}", left_out.join(", ")));
    }
    remarks.extend(remark_on_axes(format, of_take, args.up));
    for remark in remarks {
        notify(&format!("{}: {remark}", args.output.display()));
    }
    not_rotated.retain(|_| format == Format::C3d);
    if !not_rotated.is_empty() {
        notify(&format!("{}: not rotated: {}", args.output.display(), not_rotated.join(", ")));
    }
    report_losses(args, frames.map());
    for problem in frames.problems() {
        notify(&format!("{name}: {problem}"));
    }
    Ok(Outcome::of(!frames.problems().is_empty()))
}

/// A remark on the axes of an export whose format demands an axis that the user did not give.
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

/// Reports how many frames the take lost while it was recorded.
fn report_losses(args: &Args, take: &TakeMap) {
    let n_lost = take.ledger.as_ref().map_or(0, Ledger::frames_lost);
    if n_lost > 0 {
        // Other programs cannot distinguish them from occluded markers.
        notify(&format!(
            "{}: {} lost while recording; in {} they are gaps, like occluded markers",
            args.take.display(),
            count(n_lost, "frame"),
            args.output.display()
        ));
    }
}

/// Parses the axis to point up.
fn axis(text: &str) -> Result<UpAxis, String> {
    let direction: Direction = text.parse()?;
    if direction.is_negative() {
        return Err(format!("expected x, y or z, found '{text}'"));
    }
    Ok(direction.axis())
}

/// Checks that the output can be created, before the take is read.
fn check_output(args: &Args, format: Format) -> anyhow::Result<()> {
    if format != Format::Bids || paths::is_stdout(&args.output) {
        return paths::check_output(&args.output);
    }
    NewRecording::begin(&args.output, &args.format.names(&args.take)?).map(drop)
}

/// Writes the output in its format. Returns remarks on its content.
fn write_output(
    frames: &mut dyn FrameSource,
    format: Format,
    args: &Args,
) -> anyhow::Result<Vec<String>> {
    let output = &args.output;
    match format {
        Format::Bids => write_folder(frames, &args.format.names(&args.take)?, output)?,
        Format::Mot => return write_loads(frames, args.format.baseline(), output),
        _ if args.format.for_spreadsheet => {
            write(&mut EscapedLabels::new(frames), format, output)?;
        }
        _ => write(frames, format, output)?,
    }
    Ok(Vec::new())
}

/// Writes a file atomically: under its name there is the whole file or none.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    format: Format,
    path: &Path,
) -> anyhow::Result<()> {
    write_whole(path, |out| match format {
        Format::Npz => npz::write(frames, out),
        _ => format.write(frames, out),
    })
}

/// Writes the loads of force plates like [`write`]. Returns remarks on them.
fn write_loads(
    frames: &mut dyn FrameSource,
    baseline: Baseline,
    path: &Path,
) -> anyhow::Result<Vec<String>> {
    write_whole(path, |out| mot::write(frames, out, baseline))
}

fn write_whole<T>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut NewFile>) -> Result<T, InterchangeError>,
) -> anyhow::Result<T> {
    let mut output = NewFile::create(path)?;
    let mut out = BufWriter::with_capacity(BUFFER_BYTES, &mut output);
    let writing = || format!("cannot write {}", path.display());
    let written = write(&mut out).with_context(writing)?;
    out.flush().with_context(writing)?;
    drop(out);
    output.keep()?;
    Ok(written)
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
