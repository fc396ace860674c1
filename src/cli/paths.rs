//! Paths as arguments: what their endings mean, and where nothing may be written.

use std::{fs::Metadata, os::unix::fs::MetadataExt, path::Path};

use mocapd::outcome::UsageError;
use mocapd_acquire::files::{FileError, NewFile, folder_of};
use mocapd_drivers::plain_file::NotAFile;
use mocapd_take::interchange::Format;

/// The format of a file to read, by its ending.
///
/// # Errors
/// That it is a folder, or a usage error that lists the endings.
pub(super) fn input_format(path: &Path) -> anyhow::Result<Format> {
    if path.is_dir() {
        return Err(FileError::NotAFile(path.to_owned(), NotAFile::Folder).into());
    }
    Format::from_extension(path)
        .filter(|format| format.is_read())
        .ok_or_else(|| unknown_ending(path, ".c3d, .trc, .tsv or .csv"))
}

/// The format of a file to write, by its ending.
///
/// # Errors
/// A usage error that lists the endings.
pub(super) fn output_format(path: &Path) -> anyhow::Result<Format> {
    Format::from_extension(path).ok_or_else(|| {
        unknown_ending(
            path,
            ".c3d, .trc, .tsv, .csv, .npz, .xdf, .parquet or .mcap, or say --format (bids is a folder)",
        )
    })
}

fn unknown_ending(path: &Path, endings: &str) -> anyhow::Error {
    let message = format!("{}: the ending tells the format: use {endings}", path.display());
    UsageError(message).into()
}

/// Whether its name ends like that, in letters of either case.
pub(super) fn ends_in(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// Whether it is called a take.
pub(super) fn is_take(path: &Path) -> bool {
    ends_in(path, "take")
}

/// Says early what creating a take at `path` would meet: before a device is woken or a file is read.
///
/// # Errors
/// A usage error when it is called after another format; what [`check_output`] finds.
pub(super) fn check_take_output(path: &Path) -> anyhow::Result<()> {
    if Format::from_extension(path).is_some() {
        return Err(UsageError(format!(
            "{}: a take is written, so call it .take; `mocapd export` makes other formats of it",
            path.display()
        ))
        .into());
    }
    check_output(path)
}

/// Whether two files that do not exist yet would be one: whatever their folders are called.
pub(super) fn are_one(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| folder(path).map(|folder| (folder.dev(), folder.ino()));
    let is_same_folder = place(one).is_some_and(|found| place(other) == Some(found));
    one == other || (is_same_folder && one.file_name() == other.file_name())
}

/// Whether what grows at one path takes room from the other.
pub(super) fn are_on_one_disk(one: &Path, other: &Path) -> bool {
    let disk = |path: &Path| folder(path).map(|folder| folder.dev());
    disk(one).is_some_and(|found| disk(other) == Some(found))
}

/// The folder that a file would be in.
fn folder(path: &Path) -> Option<Metadata> {
    folder_of(path).metadata().ok()
}

/// Whether it stands for standard output, where a command has data for it.
pub(super) fn is_stdout(path: &Path) -> bool {
    path == Path::new("-")
}

/// Says early what creating a file at `path` would meet.
///
/// # Errors
/// That something is there already, or that nothing can be created in that folder; a usage error for `-`, which is no file.
pub(super) fn check_output(path: &Path) -> anyhow::Result<()> {
    if is_stdout(path) {
        let message = "- stands for standard output, which this is not written to: name a file (./- for one of that name)";
        return Err(UsageError(message.to_owned()).into());
    }
    let folder = folder_of(path);
    if !folder.exists() {
        return Err(FileError::NoFolder(folder.to_owned()).into());
    }
    NewFile::create(path).map(drop)
}
