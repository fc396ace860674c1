//! Reads motion files of other tools, and imports them as takes.

use std::{
    io::Write,
    path::Path,
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, ensure};
use mocapd_acquire::{
    files, header,
    pipeline::{
        TakeAccount,
        offline::{self, SourceFailed},
    },
};
use mocapd_codec::{Effort, Settings};
use mocapd_take::{
    foreign::tolerance::AnalogTolerance,
    interchange::{Format, MotionReader, ReadOptions, ReaderSettings},
    motion::{FrameSource, Motion, MotionInfo},
    record::{Header, ImportSource, KeyDistance, Subject},
};

use super::{
    batch::Input,
    paths::{self, InputFormat},
    remote,
};

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
            InputFormat::Take => {
                Err(paths::unknown_ending(&input.name, ".c3d, .trc, .tsv or .csv"))
            }
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
    let (name, info) = (source.name.display(), reader.info());
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
    /// Effort of the encoder.
    pub(super) effort: Effort,
    /// Distance of key stretches, where it was chosen.
    pub(super) key_distance: Option<KeyDistance>,
    /// Tolerances of analog channels.
    pub(super) analog: AnalogTolerance,
    /// Unit and up axis.
    pub(super) options: ReadOptions,
    /// Whether everything but trajectories is left out.
    pub(super) drops_foreign: bool,
    /// The subject of the takes.
    pub(super) subject: Option<Subject>,
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
        let info = reader.info_mut();
        let mut foreign_dropped = Vec::new();
        if settings.drops_foreign {
            foreign_dropped.extend(info.foreign.drain(..).map(|part| part.kind));
        }
        settings.analog.apply(info, files::scratch).with_context(|| reading(&input.name))?;
        info.subject.clone_from(&settings.subject);
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
        let ImportSettings { codec, options, subject, .. } = self.settings;
        let name = &self.input.name;
        let mut header = header_of(self.reader.info(), name, codec);
        header.set_effort(self.settings.effort);
        let n_frames = self.reader.info().n_frames;
        if let Some(distance) = self.settings.key_distance {
            header.set_key_distance(distance, n_frames);
        }
        let tolerances = self.settings.analog.0.iter().map(ToString::to_string);
        header.set_analog_tolerances(tolerances);
        header.settings.extend(options.settings());
        if self.settings.drops_foreign {
            header.settings.push(("drop_foreign".to_owned(), "true".to_owned()));
        }
        header.set_source_bytes(remote::len_bytes(&self.input.path)?);
        header
            .set_import_id(self.reader.bytes(), subject.as_ref())
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
