//! Paths as arguments: formats by extension, and checks of output paths.

use std::{
    fs::Metadata,
    io::{self, IsTerminal},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use mocapd::outcome::UsageError;
use mocapd_acquire::files::{FileError, NewFile, folder_of};
use mocapd_drivers::plain_file::NotAFile;
use mocapd_store::without_secrets;
use mocapd_take::interchange::{Format, SampledKind};

use super::remote;

/// The format of a file to read, by its extension.
///
/// # Errors
/// If it is a folder; a usage error that lists the extensions.
pub(super) fn input_format(path: &Path) -> anyhow::Result<Format> {
    if path.is_dir() {
        return Err(FileError::NotAFile(path.to_owned(), NotAFile::Folder).into());
    }
    if is_take(path) {
        return Err(already_a_take(path));
    }
    Format::from_extension(path)
        .filter(|format| format.is_read())
        .ok_or_else(|| unknown_ending(path, ".c3d, .trc, .tsv or .csv"))
}

/// The usage error for a take where a file of another program is read.
pub(super) fn already_a_take(path: &Path) -> anyhow::Error {
    let message = "is a take already: expected a .c3d, .trc, .tsv or .csv file";
    UsageError(format!("{} {message}", path.display())).into()
}

/// The format of a file that a command reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum InputFormat {
    /// A take.
    Take,
    /// A motion file of another tool.
    MotionFile(Format),
}

impl InputFormat {
    /// The format of a file, by its extension.
    ///
    /// # Errors
    /// If it is a folder; a usage error that lists the extensions.
    pub(crate) fn of(path: &Path) -> anyhow::Result<Self> {
        if is_take(path) { Ok(Self::Take) } else { input_format(path).map(Self::MotionFile) }
    }
}

/// Names of the formats that `--format` has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum InputFormatName {
    Take,
    C3d,
    Trc,
    Tsv,
    Csv,
}

impl From<InputFormatName> for InputFormat {
    fn from(name: InputFormatName) -> Self {
        match name {
            InputFormatName::Take => Self::Take,
            InputFormatName::C3d => Self::MotionFile(Format::C3d),
            InputFormatName::Trc => Self::MotionFile(Format::Trc),
            InputFormatName::Tsv => Self::MotionFile(Format::Tsv),
            InputFormatName::Csv => Self::MotionFile(Format::Csv),
        }
    }
}

/// The format of a file to write, by its extension.
///
/// # Errors
/// A usage error that lists the extensions.
pub(super) fn output_format(path: &Path) -> anyhow::Result<Format> {
    let endings = ".c3d, .trc, .tsv, .csv, .npz, .xdf, .mot, .html, .parquet or .mcap, or give --format (bids is a folder)";
    Format::from_extension(path).ok_or_else(|| unknown_ending(path, endings))
}

/// The usage error for a file whose extension is not one of `endings`.
pub(super) fn unknown_ending(path: &Path, endings: &str) -> anyhow::Error {
    let path = path.to_string_lossy();
    let message = format!("{}: unknown file extension: use {endings}", without_secrets(&path));
    UsageError(message).into()
}

/// Whether a path has this extension, in upper or lower case.
pub(super) fn ends_in(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// Whether a path has the extension of a take.
pub(super) fn is_take(path: &Path) -> bool {
    ends_in(path, "take")
}

/// Checks that a take can be created at `path`, before a device is opened or a file is read.
///
/// # Errors
/// A usage error if it does not have the extension of a take; the errors of [`check_output`].
pub(super) fn check_take_output(path: &Path) -> anyhow::Result<()> {
    if Format::from_extension(path).is_some() {
        anyhow::bail!(UsageError(format!(
            "{}: the output is a take: use .take; `mocapd export` converts takes to other formats",
            without_secrets(&path.to_string_lossy())
        )));
    }
    if !is_take(path) && !is_dash(path) {
        return Err(unknown_ending(path, ".take"));
    }
    check_output(path)
}

/// Whether two paths of files that do not exist yet lead to the same file, with links in their folders resolved.
pub(super) fn are_one(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| folder(path).map(|folder| (folder.dev(), folder.ino()));
    let is_same_folder = place(one).is_some_and(|found| place(other) == Some(found));
    one == other || (is_same_folder && one.file_name() == other.file_name())
}

/// A path with its symbolic links resolved, as far as its folders exist: paths of one file compare equal, even before it
/// exists.
pub(super) fn resolved(path: &Path) -> PathBuf {
    let mut missing = Vec::new();
    let mut at = path;
    while let Some(name) = at.file_name() {
        missing.push(name);
        at = folder_of(at);
        if let Ok(real) = at.canonicalize() {
            return missing.iter().rev().fold(real, |path, name| path.join(name));
        }
    }
    path.to_owned()
}

/// The file beside an export that has its analog channels or force plates: `run.analog.csv` beside `run.csv`.
pub(super) fn sampled_path(output: &Path, kind: SampledKind) -> PathBuf {
    let extension = output.extension().unwrap_or_default().to_string_lossy();
    output.with_extension(format!("{}.{extension}", kind.name()))
}

/// Whether a path is one of [`sampled_path`].
pub(super) fn is_sampled(path: &Path) -> bool {
    let kind = path.file_stem().and_then(|stem| Path::new(stem).extension());
    kind.and_then(|kind| SampledKind::from_name(kind.to_str()?)).is_some()
}

/// Whether two files are on the same file system.
pub(super) fn are_on_one_disk(one: &Path, other: &Path) -> bool {
    let disk = |path: &Path| folder(path).map(|folder| folder.dev());
    disk(one).is_some_and(|found| disk(other) == Some(found))
}

/// The metadata of a file's folder.
fn folder(path: &Path) -> Option<Metadata> {
    folder_of(path).metadata().ok()
}

/// Whether a path means standard input or output.
pub(super) fn is_dash(path: &Path) -> bool {
    path == Path::new("-")
}

/// Checks that the only output may go to standard output.
///
/// # Errors
/// A usage error for a terminal, and with an option that prints a report there.
pub(super) fn check_stdout(json: bool) -> anyhow::Result<()> {
    if json {
        let message = "standard output is the file: omit --json, or give -o FILE";
        return Err(UsageError(message.to_owned()).into());
    }
    if io::stdout().is_terminal() {
        let message =
            "standard output is this terminal: redirect it to a file or a pipe, or give -o FILE";
        return Err(UsageError(message.to_owned()).into());
    }
    Ok(())
}

/// Checks that a file can be created at `path`.
///
/// # Errors
/// If something exists there, or nothing can be created in its folder; a usage error for `-`.
pub(super) fn check_output(path: &Path) -> anyhow::Result<()> {
    if is_dash(path) {
        let message = "cannot write to standard output: name a file (./- for a file named -)";
        return Err(UsageError(message.to_owned()).into());
    }
    if let Some(url) = remote::url_of(path)? {
        return remote::check_output(&url);
    }
    let folder = folder_of(path);
    if !folder.exists() {
        return Err(FileError::NoFolder(folder.to_owned()).into());
    }
    NewFile::create(path).map(drop)
}
