//! Reads takes and motion files of other tools, whole into memory for commands that analyse a motion, or piece by
//! piece to import them as takes; and writes the output of such commands.

use std::{
    io::{BufReader, Write},
    path::Path,
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::Context;
use mocapd_acquire::{
    files::{self, CountingFile},
    header::SOFTWARE,
    pipeline::{
        TakeAccount,
        offline::{self, SourceFailed},
    },
    threads,
};
use mocapd_body::skeleton::Skeleton;
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_report::{
    decoded::DecodedTake,
    limbs::{Limb, limbs},
};
use mocapd_service::subject;
use mocapd_take::{
    TakeFrames,
    foreign::analog::{AnalogSamples, is_needed},
    import::{self, ImportSettings},
    interchange::{Format, MotionReader, ReadOptions, ReaderSettings},
    motion::{FrameSource, Motion, MotionInfo},
    record::Header,
};

use super::{
    batch::{Input, Job},
    output::notify,
    paths::{self, InputFormat},
    remote::{self, OutputFile},
};

/// Reads a motion file.
///
/// # Errors
/// If it cannot be read, has no markers or frames, or an implausible frame rate.
pub(super) fn read_motion(path: &Path) -> anyhow::Result<Motion> {
    read_motion_with(path, &ReadOptions::default())
}

/// Reads a motion file with a given unit and up axis.
///
/// # Errors
/// As [`read_motion`].
fn read_motion_with(path: &Path, options: &ReadOptions) -> anyhow::Result<Motion> {
    let source = MotionSource::file(path)?;
    let reader = open_motion(&source, options, true, &Arc::default())?;
    reader.into_motion().with_context(|| reading(path))
}

/// A motion file, its format, and its name in messages.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionSource<'a> {
    path: &'a Path,
    name: &'a Path,
    format: Format,
}

impl<'a> MotionSource<'a> {
    /// The file at a path, in the format of its extension.
    ///
    /// # Errors
    /// If it is a folder; a usage error for an unknown extension.
    pub(super) fn file(path: &'a Path) -> anyhow::Result<Self> {
        Ok(Self { path, name: path, format: paths::input_format(path)? })
    }

    /// A file that a command was given.
    ///
    /// # Errors
    /// A usage error for an unknown extension, or a take.
    pub(super) fn of(input: &'a Input) -> anyhow::Result<Self> {
        match input.format()? {
            InputFormat::MotionFile(format) => {
                Ok(Self { path: &input.path, name: &input.name, format })
            }
            InputFormat::Take => Err(paths::already_a_take(&input.name)),
        }
    }
}

/// Opens a motion file with a given unit and up axis, to read its frames one after another. The content of foreign
/// parts is kept if `keeps_foreign`. `bytes_read` counts the bytes of all passes over the file.
///
/// # Errors
/// As [`read_motion`].
pub(super) fn open_motion(
    source: &MotionSource<'_>,
    options: &ReadOptions,
    keeps_foreign: bool,
    bytes_read: &Arc<AtomicU64>,
) -> anyhow::Result<MotionReader<'static>> {
    let settings = ReaderSettings {
        options: *options,
        keeps_foreign,
        new_scratch: &files::scratch,
        bytes_read: Arc::clone(bytes_read),
    };
    let reader = MotionReader::open(source.format, remote::open(source.path)?, &settings)
        .with_context(|| reading(source.name))?;
    import::check(reader.info(), &source.name.display().to_string())?;
    Ok(reader)
}

fn reading(path: &Path) -> String {
    format!("cannot read {}", path.display())
}

/// The header of a take made from a file, without its id.
pub(super) fn header_of(motion: &MotionInfo, file: &Path, codec: &Settings) -> Header {
    import::header_of(motion, codec, SOFTWARE, file_name(file))
}

/// A file that was opened for import.
#[derive(Debug)]
pub(super) struct Import<'a> {
    settings: &'a ImportSettings,
    input: &'a Input,
    reader: MotionReader<'static>,
    /// Kinds of the foreign parts that are left out.
    pub(super) foreign_dropped: Vec<String>,
}

impl<'a> Import<'a> {
    /// Opens a file, and reads everything but its frames. `bytes_read` counts the bytes of all passes over it: for its
    /// description, its hash and its frames.
    ///
    /// # Errors
    /// As [`read_motion`].
    pub(super) fn open(
        input: &'a Input,
        settings: &'a ImportSettings,
        bytes_read: &Arc<AtomicU64>,
    ) -> anyhow::Result<Self> {
        let source = MotionSource::of(input)?;
        let keeps_foreign = !settings.drops_foreign;
        let mut reader = open_motion(&source, &settings.options, keeps_foreign, bytes_read)?;
        let foreign_dropped = settings
            .apply(reader.info_mut(), files::scratch)
            .with_context(|| format!("cannot import {}", input.name.display()))?;
        Ok(Self { settings, input, reader, foreign_dropped })
    }

    /// The description of the file.
    pub(super) fn info(&self) -> &MotionInfo {
        self.reader.info()
    }

    /// The description, when there is nothing to write.
    pub(super) fn into_info(mut self) -> MotionInfo {
        std::mem::take(self.reader.info_mut())
    }

    /// The header of the take, with its id, which depends on every byte of the file.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(super) fn header(&mut self) -> anyhow::Result<Header> {
        let (settings, name) = (self.settings, &self.input.name);
        let mut header = settings.header(self.reader.info(), SOFTWARE, file_name(name));
        header.set_source_bytes(remote::len_bytes(&self.input.path)?);
        header
            .set_import_id(self.reader.bytes(), settings.subject.as_ref())
            .with_context(|| reading(name))?;
        Ok(header)
    }

    /// Writes the take to `out`, whose name is `output`. `samples` counts the samples encoded, missing ones included.
    ///
    /// # Errors
    /// If the file cannot be read or has changed, the codec refuses, or the take cannot be written.
    pub(super) fn write(
        mut self,
        header: &Header,
        n_workers: usize,
        samples: &AtomicU64,
        out: impl Write,
        output: &Path,
    ) -> anyhow::Result<(MotionInfo, TakeAccount)> {
        let written = offline::write_frames(&mut self.reader, header, n_workers, samples, out);
        let (account, _) = written.map_err(|error| {
            let is_of_source = error.is::<SourceFailed>();
            error.context(if is_of_source {
                reading(&self.input.name)
            } else {
                format!("cannot write {}", output.display())
            })
        })?;
        Ok((self.into_info(), account))
    }
}

/// Decodes a take. Damage is reported on stderr, and the lost samples are gaps.
///
/// # Errors
/// If it cannot be read.
pub(super) fn read_take(path: &Path) -> anyhow::Result<DecodedTake> {
    let file = BufReader::new(remote::open(path)?);
    let take =
        DecodedTake::read(file).with_context(|| format!("cannot read {}", path.display()))?;
    for problem in &take.problems {
        notify(&format!("{}: {problem}", path.display()));
    }
    Ok(take)
}

/// Opens the motion file of a job. Also returns its size in bytes.
///
/// # Errors
/// If it cannot be read.
pub(super) fn open_motion_input(job: &Job<'_>) -> anyhow::Result<(MotionReader<'static>, u64)> {
    let n_bytes = remote::len_bytes(&job.input.path).unwrap_or_default();
    let phase = job.phase("reading", n_bytes);
    let source = MotionSource::of(job.input)?;
    let reader = open_motion(&source, &ReadOptions::default(), true, &phase.counter)?;
    Ok((reader, n_bytes))
}

/// Reads a take or a motion file for a plot. Also returns its size in bytes. No sample of a motion file is a knot.
///
/// # Errors
/// If it cannot be read.
pub(super) fn read_picture_source(job: &Job<'_>) -> anyhow::Result<(DecodedTake, u64)> {
    if let InputFormat::MotionFile(_) = job.input.format()? {
        let (reader, n_bytes) = open_motion_input(job)?;
        let name = job.input.name.display();
        let motion = reader.into_motion().with_context(|| format!("cannot read {name}"))?;
        let kept = vec![vec![false; motion.n_frames()]; motion.info.markers.len()];
        let take = DecodedTake { motion, kept, settings: None, problems: Vec::new() };
        return Ok((take, n_bytes));
    }
    let file = remote::open(&job.input.path)?;
    let n_bytes = file.len_bytes()?;
    let phase = job.phase("reading", n_bytes);
    let take = DecodedTake::read(BufReader::new(CountingFile::new(file, &phase.counter)))
        .with_context(|| format!("cannot read {}", job.input.name.display()))?;
    take.problems.iter().for_each(|problem| job.notify(&problem.to_string()));
    Ok((take, n_bytes))
}

/// The motion of a take or a motion file, and the settings that the take was coded with.
///
/// # Errors
/// If it cannot be read.
pub(super) fn read_samples(path: &Path) -> anyhow::Result<(Motion, Option<Settings>)> {
    if paths::is_take(path) {
        let take = read_take(path)?;
        return Ok((take.motion, take.settings));
    }
    Ok((read_motion(path)?, None))
}

/// The analog samples of a file in a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AnalogSize {
    /// Number of samples, over all channels.
    pub(super) samples: u64,
    /// Bytes that a take needs for them, with the parameters that describe them.
    pub(super) bytes: u64,
}

/// Measures the analog samples of a take or a motion file; `None` if it has none. `motion` is its content, whose
/// foreign parts are removed.
///
/// # Errors
/// If a take cannot be read or written.
pub(super) fn measure_analog(
    path: &Path,
    motion: &mut Motion,
) -> anyhow::Result<Option<AnalogSize>> {
    let mut foreign = std::mem::take(&mut motion.info.foreign);
    if paths::is_take(path) {
        foreign = read_analog_info(path)?.foreign;
    }
    foreign.retain(|part| is_needed(&part.kind));
    let settings = Settings { kind: ResamplerKind::Fast, tolerance: Tolerance::from_mm(1.0)? };
    let header = header_of(&motion.info, path, &settings);
    let bytes_of = |motion: &Motion| -> anyhow::Result<u64> {
        let workers = threads::default_workers();
        let (written, _) =
            offline::write_take(motion, &header, workers, &AtomicU64::new(0), std::io::sink())?;
        Ok(written.file_bytes)
    };
    motion.info.foreign = foreign;
    let samples = AnalogSamples::open(&motion.info)?.map(|samples| {
        let per_frame = (samples.channels().len() * samples.samples_per_frame()) as u64;
        samples.n_frames().saturating_mul(per_frame)
    });
    let with = samples.map(|_| bytes_of(motion)).transpose();
    motion.info.foreign.clear();
    let (Some(samples), Some(with)) = (samples, with?) else { return Ok(None) };
    Ok(Some(AnalogSize { samples, bytes: with.saturating_sub(bytes_of(motion)?) }))
}

/// The description of a take with the parts that analog samples and force plates need.
///
/// # Errors
/// If it cannot be read.
pub(super) fn read_analog_info(take: &Path) -> anyhow::Result<MotionInfo> {
    let file = BufReader::new(remote::open(take)?);
    let reading = || format!("cannot read {}", take.display());
    let mut frames =
        TakeFrames::open_with(file, is_needed, files::scratch).with_context(reading)?;
    let again = BufReader::new(remote::open(take)?);
    frames.open_recording(again, false).with_context(reading)?;
    Ok(frames.info().clone())
}

/// The motion of an original, and its settings if it is itself a take.
pub(super) type Original = (Motion, Option<Settings>);

/// The motion of a take's original: either another take, with its settings, or a motion file, read with the options
/// with which the take was imported.
///
/// # Errors
/// If the original or the take cannot be read.
pub(super) fn read_original(take: &Path, original: &Path) -> anyhow::Result<Original> {
    if paths::is_take(original) {
        return read_samples(original);
    }
    let frames = TakeFrames::open(BufReader::new(remote::open(take)?))
        .with_context(|| format!("cannot read {}", take.display()))?;
    Ok((read_motion_with(original, &read_options(&frames))?, None))
}

/// The options with which a take was imported.
pub(super) fn read_options(take: &dyn FrameSource) -> ReadOptions {
    let settings = take.take().map(|take| ReadOptions::from_settings(&take.header.settings));
    settings.unwrap_or_default()
}

/// The name of a file, without its folders.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Writes a new file atomically: completely or not at all.
///
/// # Errors
/// If it exists or cannot be written.
pub(super) fn write_new(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(bytes).with_context(|| format!("cannot write {}", path.display()))?;
    file.keep()
}

/// A skeleton, and those of its bones whose ends are markers of a take.
#[derive(Debug)]
pub(super) struct TakeLimbs {
    pub(super) skeleton: Skeleton,
    pub(super) limbs: Vec<Limb>,
    /// The columns of all markers of the subject.
    pub(super) columns: Vec<usize>,
}

/// The limbs by the skeleton in `file`, else by the take's own; `None` if there is no skeleton.
///
/// # Errors
/// If the skeleton cannot be read.
pub(super) fn limbs_of_take(
    motion: &Motion,
    file: Option<&Path>,
) -> anyhow::Result<Option<TakeLimbs>> {
    let own = motion.info.subject.as_ref();
    let skeleton = match file {
        Some(path) => Some(subject::read(path, Skeleton::from_json)?.1),
        None => subject::skeleton(own)?,
    };
    let Some(skeleton) = skeleton else { return Ok(None) };
    let labels: Vec<&str> =
        motion.info.markers.iter().map(|marker| marker.label.as_str()).collect();
    let name = own.map_or("", |subject| subject.name.as_str());
    let (limbs, columns) = limbs(&skeleton.bones, &labels, name);
    Ok(Some(TakeLimbs { skeleton, limbs, columns }))
}
