//! The takes in the service's folder.

use std::{
    collections::{HashMap, HashSet},
    ffi::{OsStr, OsString},
    fs::{self, Metadata},
    os::unix::{ffi::OsStrExt, fs::MetadataExt},
    path::{Path, PathBuf},
    time::SystemTime,
};

use mocapd_acquire::{
    files::{FileId, is_being_written},
    ledger::TakeHealth,
    pipeline::lock,
};
use mocapd_drivers::plain_file;
use mocapd_take::{TakeEnds, TakeError};

use super::Inner;
use crate::{
    control::{Refusal, RefusalKind},
    status::TakeSummary,
    take_files::{
        self,
        notes::{self, NOTES_SUFFIX},
    },
};

/// Maximum number of files of the folder that are read: larger folders are not folders of takes.
const FILES_MAX: usize = 100_000;

/// Maximum number of cached summaries: four times the longest list. Each has some 300 bytes, and its notes at most 4096.
const CACHED_MAX: usize = 4000;

/// Summaries of files by path, valid while the stamp stays the same.
#[derive(Debug, Default)]
pub(super) struct SummaryCache(HashMap<PathBuf, (Stamps, TakeSummary)>);

/// Those of the file of a take, and of the file of its notes.
type Stamps = (FileStamp, Option<FileStamp>);

/// Identity, size and modification time: if they are unchanged, so is the content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FileStamp {
    file: FileId,
    bytes: u64,
    modified_ns: i128,
}

impl FileStamp {
    fn of(file: &Metadata) -> Self {
        Self {
            file: FileId::of(file),
            bytes: file.len(),
            modified_ns: i128::from(file.mtime()) * 1_000_000_000 + i128::from(file.mtime_nsec()),
        }
    }
}

impl SummaryCache {
    fn get(&self, path: &Path, stamps: Stamps) -> Option<TakeSummary> {
        let (known, summary) = self.0.get(path)?;
        (*known == stamps).then(|| summary.clone())
    }

    fn add(&mut self, listed: Vec<(PathBuf, Stamps, TakeSummary)>) {
        if self.0.len() + listed.len() > CACHED_MAX {
            let kept: HashSet<&PathBuf> = listed.iter().map(|(path, ..)| path).collect();
            self.0.retain(|path, _| kept.contains(path));
        }
        self.0.extend(listed.into_iter().map(|(path, stamps, summary)| (path, (stamps, summary))));
    }
}

impl Inner {
    pub(super) fn list_takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal> {
        let core = self.core();
        let directory = core.options.take.directory.clone();
        // Identified by the file, because its name may have changed.
        let open = core.take.as_ref().map(|take| take.named.file);
        let last = core.last_take.clone();
        drop(core);
        let cannot = |error: std::io::Error| {
            let message = format!("cannot read the folder {}: {error}", directory.display());
            Refusal::new(RefusalKind::Disk, message)
        };
        let mut found = Vec::new();
        let mut notes_of = HashMap::new();
        for entry in fs::read_dir(&directory).map_err(cannot)?.take(FILES_MAX).flatten() {
            let path = entry.path();
            let is_take = path.extension().is_some_and(|extension| extension == "take");
            let Ok(file) = entry.metadata() else { continue };
            if let Some(stem) = notes_stem(&entry.file_name()) {
                notes_of.insert(stem, FileStamp::of(&file));
            }
            if is_take && file.is_file() {
                let modified = file.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                found.push((modified, FileStamp::of(&file), path));
            }
        }
        found.sort_by(|(a, _, a_path), (b, _, b_path)| (b, b_path).cmp(&(a, a_path)));
        found.truncate(limit);
        let mut new = Vec::new();
        let mut summaries = Vec::with_capacity(found.len());
        for (modified, stamp, path) in found {
            let notes_stamp = path.file_stem().and_then(|stem| notes_of.get(stem)).copied();
            let stamps = (stamp, notes_stamp);
            if let Some(known) = lock(&self.summaries).get(&path, stamps) {
                summaries.push(known);
                continue;
            }
            let is_open = open == Some(stamp.file);
            let (mut summary, is_lasting) = summarise(&path, stamp.bytes, modified, is_open);
            summary.notes = notes_stamp.and_then(|_| notes::listed(&path));
            // Notes that cannot be read may be readable next time.
            let has_problem = summary.notes.as_ref().is_some_and(|it| it.problem.is_some());
            if is_lasting && !has_problem {
                new.push((path, stamps, summary.clone()));
            }
            summaries.push(summary);
        }
        lock(&self.summaries).add(new);
        // The reason why the latest take ended is known even if it could not be written.
        for summary in &mut summaries {
            if let Some(last) = last.as_ref().filter(|last| last.take_id == summary.take_id)
                && summary.ending.is_none()
                && !summary.is_open
            {
                summary.ending = last.ending;
                summary.ending_detail.clone_from(&last.ending_detail);
            }
        }
        self.uploads.complete(&mut summaries);
        Ok(summaries)
    }

    pub(super) fn path_of(&self, name: &str) -> Result<PathBuf, Refusal> {
        take_files::path_of(&self.core().options.take.directory.clone(), name)
    }
}

/// The name of the take whose notes the file has; `None` if it has none.
fn notes_stem(name: &OsStr) -> Option<OsString> {
    let stem = name.as_bytes().strip_suffix(NOTES_SUFFIX.as_bytes())?;
    Some(OsStr::from_bytes(stem).to_owned())
}

/// The summary of a closed file from its header and end; `None` if there is no file.
pub(super) fn summary_of(path: &Path) -> Option<TakeSummary> {
    let file = path.symlink_metadata().ok().filter(Metadata::is_file)?;
    let modified = file.modified().unwrap_or(SystemTime::UNIX_EPOCH);
    Some(summarise(path, file.len(), modified, false).0)
}

/// The summary of a file from its header and end, and whether it stays valid until the file changes.
pub(crate) fn summarise(
    path: &Path,
    bytes: u64,
    modified: SystemTime,
    is_open: bool,
) -> (TakeSummary, bool) {
    let since_1970 = modified.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let mut summary = TakeSummary {
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        bytes,
        modified_unix_ms: i64::try_from(since_1970.as_millis()).unwrap_or(i64::MAX),
        is_open,
        ..TakeSummary::default()
    };
    let opened = plain_file::open(path).map_err(TakeError::Io);
    let read = opened.and_then(|mut file| {
        let ends = TakeEnds::read(&mut file)?;
        // By this service or by another recorder.
        summary.is_open |= ends.end.is_none() && is_being_written(&file);
        Ok(ends)
    });
    let ends = match read {
        Ok(ends) => ends,
        // The disk may be able to read it next time.
        Err(TakeError::Io(_)) => return (summary, false),
        Err(_) => {
            summary.health = TakeHealth::Unreadable;
            return (summary, !is_open);
        }
    };
    let header = &ends.header;
    summary.markers = header.channels.len();
    summary.take_id = header.take_id_text();
    if summary.is_open {
        return (summary, false);
    }
    summary.health = TakeHealth::of_ends(&ends);
    if let Some(end) = &ends.end {
        // With those that appeared during the recording.
        summary.markers = end.channels.as_ref().map_or(summary.markers, Vec::len);
        summary.seconds = end.footer.n_rows as f64 / header.rate_hz;
        if let Some(ending) = &end.ending {
            summary.ending = Some(ending.kind);
            summary.ending_detail.clone_from(&ending.detail);
        }
    }
    (summary, true)
}
