//! Reading motion files of other tools, and the header of a take made from one.

use std::{io::Read, path::Path};

use anyhow::{Context, ensure};
use mocapd_acquire::{files, header, pipeline::offline};
use mocapd_codec::Settings;
use mocapd_take::{
    interchange::{Format, ReadOptions},
    motion::Motion,
    record::{Header, ImportSource},
};

use super::{
    batch::Input,
    paths::{self, InputFormat},
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
    let InputFormat::MotionFile(format) = InputFormat::of(path)? else {
        return Err(paths::unknown_ending(path, ".c3d, .trc, .tsv or .csv"));
    };
    Ok(read(path, path, format, options)?.0)
}

/// Reads a motion file that a command was given; also returns its bytes.
///
/// # Errors
/// As [`read_motion`].
pub(super) fn read_motion_and_bytes(
    input: &Input,
    options: &ReadOptions,
) -> anyhow::Result<(Motion, Vec<u8>)> {
    match input.format()? {
        InputFormat::MotionFile(format) => read(&input.path, &input.name, format, options),
        InputFormat::Take => Err(paths::unknown_ending(&input.name, ".c3d, .trc, .tsv or .csv")),
    }
}

/// Reads a motion file of this format, and returns its bytes, too. Messages have its `name`.
fn read(
    path: &Path,
    name: &Path,
    format: Format,
    options: &ReadOptions,
) -> anyhow::Result<(Motion, Vec<u8>)> {
    let name = name.display();
    let mut bytes = Vec::new();
    let reading = || format!("cannot read {name}");
    files::open(path)?.read_to_end(&mut bytes).with_context(reading)?;
    let motion = format.read_with(&bytes, options).with_context(reading)?;
    let rate_hz = motion.info.rate_hz;
    ensure!(!motion.info.markers.is_empty(), "{name} has no markers: nothing to import");
    ensure!(motion.n_frames() > 0, "{name} has no frames: nothing to import");
    ensure!(
        RATE_HZ.contains(&rate_hz),
        "{name} has a rate of {rate_hz:e} Hz, expected {} to {}: correct the rate in the file",
        RATE_HZ.start(),
        RATE_HZ.end()
    );
    Ok((motion, bytes))
}

/// The header of a take made from a file, without its id.
pub(super) fn header_of(motion: &Motion, file: &Path, codec: &Settings) -> Header {
    let info = &motion.info;
    let mut header = header::of_import(codec, info.rate_hz);
    header.up_axis = info.up;
    header.stretch_rows =
        offline::stretch_rows(codec, info.rate_hz, motion.n_frames(), info.markers.len()) as u32;
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
