//! Reading motion files of other tools, and importing them as takes.

use std::{
    io::BufWriter,
    path::Path,
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, ensure};
use mocapd_acquire::{
    files::{self, NewFile, SparseFile},
    header,
    pipeline::{
        TakeAccount,
        offline::{self, SourceFailed},
    },
};
use mocapd_codec::Settings;
use mocapd_take::{
    interchange::{MotionReader, ReadOptions, ReaderSettings},
    motion::{FrameSource, Motion, MotionInfo},
    record::{Header, ImportSource, Subject},
};

use super::paths;

/// Plausible frame rates, Hz: from time lapse to ballistics.
const RATE_HZ: std::ops::RangeInclusive<f64> = 0.001..=1e6;

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
pub(super) fn read_motion_with(path: &Path, options: &ReadOptions) -> anyhow::Result<Motion> {
    let reader = open_motion(path, options, true, &Arc::default())?;
    reader.into_motion().with_context(|| reading(path))
}

/// Opens a motion file with a given unit and up axis, to read its frames one after another. The content of foreign
/// parts is kept if `keeps_foreign`. `bytes_read` counts the bytes of all passes over the file.
///
/// # Errors
/// As [`read_motion`].
pub(super) fn open_motion(
    path: &Path,
    options: &ReadOptions,
    keeps_foreign: bool,
    bytes_read: &Arc<AtomicU64>,
) -> anyhow::Result<MotionReader<'static>> {
    let format = paths::input_format(path)?;
    let settings = ReaderSettings {
        options: *options,
        keeps_foreign,
        new_scratch: &files::scratch,
        bytes_read: Arc::clone(bytes_read),
    };
    let reader = MotionReader::open(format, SparseFile::open(path)?, &settings)
        .with_context(|| reading(path))?;
    let (name, info) = (path.display(), reader.info());
    let rate_hz = info.rate_hz;
    ensure!(!info.markers.is_empty(), "{name} has no markers: nothing to import");
    ensure!(info.n_frames > 0, "{name} has no frames: nothing to import");
    ensure!(
        RATE_HZ.contains(&rate_hz),
        "{name} has a rate of {rate_hz:e} Hz, expected {} to {}: correct the rate in the file",
        RATE_HZ.start(),
        RATE_HZ.end()
    );
    Ok(reader)
}

fn reading(path: &Path) -> String {
    format!("cannot read {}", path.display())
}

/// The header of a take made from a file, without its id.
pub(super) fn header_of(motion: &MotionInfo, file: &Path, codec: &Settings) -> Header {
    let info = motion;
    let mut header = header::of_import(codec, info.rate_hz);
    header.up_axis = info.up;
    let n_frames = usize::try_from(info.n_frames).unwrap_or(usize::MAX);
    header.stretch_rows =
        offline::stretch_rows(codec, info.rate_hz, n_frames, info.markers.len()) as u32;
    header.channels = header::channels(&info.markers);
    header.source = Some(ImportSource {
        format: info.source.format.clone(),
        file: file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        unit: info.source.unit.clone(),
        factor: info.source.factor,
        first_frame: info.source.first_frame,
        warnings: info.source.warnings.clone(),
    });
    header
}

/// How files are imported.
#[derive(Debug)]
pub(super) struct ImportSettings {
    /// Resampler and tolerance.
    pub(super) codec: Settings,
    /// Unit and up axis.
    pub(super) options: ReadOptions,
    /// Whether everything but trajectories is left out.
    pub(super) drops_foreign: bool,
    /// The subject of the takes.
    pub(super) subject: Option<Subject>,
    /// Number of resampler threads.
    pub(super) n_workers: usize,
}

/// Counters of a running import.
#[derive(Debug, Default)]
pub(super) struct ImportProgress {
    /// Bytes read of the file. It is read three times: for its description, its hash and its frames.
    pub(super) bytes_read: Arc<AtomicU64>,
    /// Samples encoded, missing ones included.
    pub(super) samples: Arc<AtomicU64>,
}

/// A file that was opened for import.
#[derive(Debug)]
pub(super) struct Import<'a> {
    settings: &'a ImportSettings,
    file: &'a Path,
    reader: MotionReader<'static>,
    progress: &'a ImportProgress,
    /// Kinds of the foreign parts that are left out.
    pub(super) foreign_dropped: Vec<String>,
}

impl<'a> Import<'a> {
    /// Opens a file, and reads everything but its frames.
    ///
    /// # Errors
    /// As [`read_motion`].
    pub(super) fn open(
        file: &'a Path,
        settings: &'a ImportSettings,
        progress: &'a ImportProgress,
    ) -> anyhow::Result<Self> {
        let keeps_foreign = !settings.drops_foreign;
        let mut reader = open_motion(file, &settings.options, keeps_foreign, &progress.bytes_read)?;
        let info = reader.info_mut();
        let mut foreign_dropped = Vec::new();
        if settings.drops_foreign {
            foreign_dropped.extend(info.foreign.drain(..).map(|part| part.kind));
        }
        info.subject.clone_from(&settings.subject);
        Ok(Self { settings, file, reader, progress, foreign_dropped })
    }

    /// The description of the file.
    pub(super) fn info(&self) -> &MotionInfo {
        self.reader.info()
    }

    /// Writes the take. After an error there is no file `to`.
    ///
    /// # Errors
    /// If the file cannot be read or has changed, the codec refuses, or the take cannot be written.
    pub(super) fn write(mut self, to: &Path) -> anyhow::Result<(MotionInfo, TakeAccount)> {
        let ImportSettings { codec, options, subject, n_workers, .. } = self.settings;
        let mut header = header_of(self.reader.info(), self.file, codec);
        header.settings.extend(options.settings());
        if self.settings.drops_foreign {
            header.settings.push(("drop_foreign".to_owned(), "true".to_owned()));
        }
        header
            .set_import_id(self.reader.bytes(), subject.as_ref())
            .with_context(|| reading(self.file))?;
        let writing = || format!("cannot write {}", to.display());
        let mut output = NewFile::create(to).with_context(writing)?;
        let out = BufWriter::new(&mut output);
        let samples = &self.progress.samples;
        let written = offline::write_frames(&mut self.reader, &header, *n_workers, samples, out);
        let (account, out) = written.map_err(|error| {
            let is_of_source = error.is::<SourceFailed>();
            error.context(if is_of_source { reading(self.file) } else { writing() })
        })?;
        drop(out);
        output.keep().with_context(writing)?;
        Ok((std::mem::take(self.reader.info_mut()), account))
    }
}
