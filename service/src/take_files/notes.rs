//! The rating and notes of a take, in a file beside it: `T.notes.json` for `T.take`.
//!
//! The file states the take that it belongs to: its id, and a checksum of the ends of its file, which hold its header,
//! its ledger and its index. Beside any other take it is reported, and never replaced. The take's bytes are not touched.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use mocapd_acquire::files;
use mocapd_drivers::plain_file;
use mocapd_take::TakeEnds;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::TEMPORARY_PREFIX;
use crate::{
    control::{Refusal, RefusalKind},
    finished::{NOTES_BYTES_MAX, TakeNotes, TakeRating},
};

/// The end of the file's name, after the name of the take.
pub const NOTES_SUFFIX: &str = ".notes.json";

const FORMAT: &str = "mocapd-notes";
const VERSION: u32 = 1;

/// Longest file that is read: a byte of the notes has at most two in JSON, and the other fields have a few hundred.
const DOCUMENT_BYTES_MAX: usize = 8 * NOTES_BYTES_MAX;

/// Bytes of each end of a take that the checksum covers: read in a millisecond, however long the take is.
const END_BYTES: u64 = 64 << 10;

/// The content of the file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NotesDocument {
    format: String,
    version: u32,
    #[serde(flatten)]
    of: TakeIdentity,
    rating: TakeRating,
    text: String,
    changed_unix_ms: i64,
}

/// What identifies the file of a take.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TakeIdentity {
    /// Id of the take, 32 hexadecimal digits.
    take_id: String,
    /// Size of its file.
    pub(super) take_bytes: u64,
    /// SHA-256 of the first and of the last 65 536 bytes of its file, or of all of a shorter one.
    ends_sha256: String,
}

impl TakeIdentity {
    /// Reads the identity of a take.
    ///
    /// # Errors
    /// The file cannot be read, or has no header of a take.
    pub fn of(take: &Path) -> anyhow::Result<Self> {
        let reading = || format!("cannot read {}", take.display());
        let mut file = plain_file::open(take).with_context(reading)?;
        let take_id = TakeEnds::read(&mut file).with_context(reading)?.header.take_id_text();
        let take_bytes = file.metadata().with_context(reading)?.len();
        let mut digest = Sha256::new();
        let mut add = |file: &mut File, from: u64| -> anyhow::Result<()> {
            file.seek(SeekFrom::Start(from)).with_context(reading)?;
            let mut end = Vec::new();
            (&*file).take(END_BYTES).read_to_end(&mut end).with_context(reading)?;
            digest.update(&end);
            Ok(())
        };
        add(&mut file, 0)?;
        if take_bytes > END_BYTES {
            add(&mut file, (take_bytes - END_BYTES).max(END_BYTES))?;
        }
        let ends_sha256 = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { take_id, take_bytes, ends_sha256 })
    }
}

impl From<NotesDocument> for TakeNotes {
    fn from(document: NotesDocument) -> Self {
        let NotesDocument { rating, text, changed_unix_ms, .. } = document;
        Self { rating, text, changed_unix_ms, problem: None }
    }
}

/// The path of the notes of a take.
#[must_use]
pub fn notes_path(take: &Path) -> PathBuf {
    let mut name = take.file_stem().unwrap_or_default().to_owned();
    name.push(NOTES_SUFFIX);
    take.with_file_name(name)
}

/// The bytes of a file of notes, as they are.
///
/// # Errors
/// It is no plain file, is too large, or cannot be read.
pub fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    if !path.symlink_metadata()?.is_file() {
        bail!("it is not a plain file");
    }
    files::read_bounded(path, DOCUMENT_BYTES_MAX)
}

/// Reads a file of notes, whatever take it belongs to.
///
/// # Errors
/// It cannot be read, is damaged, or is of a later version. The message does not name the file.
fn read_document(path: &Path) -> anyhow::Result<NotesDocument> {
    let bytes = read_file(path)?;
    let value: serde_json::Value = serde_json::from_slice(&bytes).context("it is damaged")?;
    if value["format"] != FORMAT {
        bail!("it is not a file of notes of mocapd");
    }
    if value["version"] != VERSION {
        bail!("it is of another version of mocapd ({})", value["version"]);
    }
    let document: NotesDocument = serde_json::from_value(value).context("it is damaged")?;
    if document.rating == TakeRating::Unknown || document.text.len() > NOTES_BYTES_MAX {
        bail!("it is damaged");
    }
    Ok(document)
}

/// The identity that a file of notes states.
///
/// # Errors
/// As for [`read`].
pub(super) fn stated_identity(path: &Path) -> anyhow::Result<TakeIdentity> {
    Ok(read_document(path)?.of)
}

/// Reads the notes of a take; `None` if it has none.
///
/// # Errors
/// Their file is damaged, or belongs to another take: what is wrong, and what to do.
pub fn read(take: &Path) -> anyhow::Result<Option<NotesDocument>> {
    let path = notes_path(take);
    if path.symlink_metadata().is_err() {
        return Ok(None);
    }
    let stem = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let remedy = "it is left as it is: move it elsewhere to write new notes";
    let document = read_document(&path)
        .map_err(|error| anyhow!("{stem} cannot be used: {error:#}; {remedy}"))?;
    if document.of != TakeIdentity::of(take)? {
        bail!("{stem} belongs to another take, or this one has changed since; {remedy}");
    }
    Ok(Some(document))
}

/// The notes of a take for the list; `None` if it has none.
#[must_use]
pub fn listed(take: &Path) -> Option<TakeNotes> {
    match read(take) {
        Ok(document) => document.map(TakeNotes::from),
        Err(error) => {
            Some(TakeNotes { problem: Some(format!("{error:#}")), ..TakeNotes::default() })
        }
    }
}

/// Writes the notes of a take: they are complete on the disk, or as they were.
///
/// # Errors
/// They cannot be written, or the present ones cannot be read.
pub fn edit(
    take: &Path,
    rating: Option<TakeRating>,
    text: Option<&str>,
    now_unix_ms: i64,
) -> Result<TakeNotes, Refusal> {
    let refused = |kind| move |error: anyhow::Error| Refusal::new(kind, format!("{error:#}"));
    let before = read(take).map_err(refused(RefusalKind::Conflict))?;
    let is_new = before.is_none();
    let (old_rating, old_text) =
        before.map_or_else(Default::default, |before| (before.rating, before.text));
    let document = NotesDocument {
        format: FORMAT.to_owned(),
        version: VERSION,
        of: TakeIdentity::of(take).map_err(refused(RefusalKind::Disk))?,
        rating: rating.unwrap_or(old_rating),
        text: text.map_or(old_text, str::to_owned),
        changed_unix_ms: now_unix_ms,
    };
    write(&document, take, is_new).map_err(refused(RefusalKind::Disk))?;
    Ok(document.into())
}

fn write(document: &NotesDocument, take: &Path, is_new: bool) -> anyhow::Result<()> {
    let path = notes_path(take);
    let writing = || format!("cannot write {}", path.display());
    let mut file = tempfile::Builder::new()
        .prefix(TEMPORARY_PREFIX)
        .permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644))
        .tempfile_in(files::folder_of(take))
        .with_context(writing)?;
    serde_json::to_writer_pretty(&mut file, document).with_context(writing)?;
    file.write_all(b"\n").with_context(writing)?;
    file.as_file().sync_all().with_context(writing)?;
    if is_new {
        // One that another program has written meanwhile stays.
        file.persist_noclobber(&path).with_context(writing)?;
    } else {
        file.persist(&path).with_context(writing)?;
    }
    files::sync_name(&path);
    Ok(())
}
