//! Takes and files of the field alike, read whole, for what looks at all of a motion at once.

use std::{io::BufReader, path::Path};

use anyhow::Context;
use mocapd_acquire::files::{NewFile, SparseFile};
use mocapd_codec::Settings;
use mocapd_report::coded::Coded;
use mocapd_take::{
    TakeFrames,
    interchange::ReadOptions,
    motion::{FrameSource, Motion},
};

use super::{
    original::{read_motion, read_motion_with},
    output::say,
    paths,
};

/// A take, with what it keeps. What is damaged in it is said, and is gaps.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn read_coded(path: &Path) -> anyhow::Result<Coded> {
    let file = BufReader::new(SparseFile::open(path)?);
    let coded = Coded::read(file).with_context(|| format!("cannot read {}", path.display()))?;
    for problem in &coded.problems {
        say(&format!("{}: {problem}", path.display()));
    }
    Ok(coded)
}

/// The samples of a take or of a file of the field, and what the take was coded with.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn read_samples(path: &Path) -> anyhow::Result<(Motion, Option<Settings>)> {
    if paths::is_take(path) {
        let coded = read_coded(path)?;
        return Ok((coded.motion, coded.settings));
    }
    Ok((read_motion(path)?, None))
}

/// The samples of a take's original: a take, with what that was coded with, or a file of the field, read as the take was
/// imported from it.
///
/// # Errors
/// Why it, or the take, cannot be read.
pub(super) fn read_original(
    take: &Path,
    original: &Path,
) -> anyhow::Result<(Motion, Option<Settings>)> {
    if paths::is_take(original) {
        return read_samples(original);
    }
    let frames = TakeFrames::open(BufReader::new(SparseFile::open(take)?))
        .with_context(|| format!("cannot read {}", take.display()))?;
    Ok((read_motion_with(original, &read_options(&frames))?, None))
}

/// What a take's file was read with when it was imported.
pub(super) fn read_options(take: &dyn FrameSource) -> ReadOptions {
    let settings = take.take().map(|take| ReadOptions::from_settings(&take.header.settings));
    settings.unwrap_or_default()
}

/// The name of a file without its folders.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Writes a whole file under its own name, or none.
///
/// # Errors
/// That it exists, or the disk's.
pub(super) fn write_new(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut file = NewFile::create(path)?;
    std::io::Write::write_all(&mut file, bytes)
        .with_context(|| format!("cannot write {}", path.display()))?;
    file.keep()
}
