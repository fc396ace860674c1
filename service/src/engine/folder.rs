//! The takes in the service's folder: lists them; rates, renames, trashes and restores them; removes those whose time in the
//! trash is over; and recovers those that a kill or power cut left without an end, when the service starts.
//!
//! A take that is being written, recovered, uploaded or removed is refused. Whoever works on a take by its name claims
//! the name; names are claimed and changed under one lock, so that neither works on a name that the other changes.

use std::{
    collections::{HashMap, HashSet},
    ffi::{OsStr, OsString},
    fs::{self, Metadata},
    io::BufWriter,
    os::unix::{ffi::OsStrExt, fs::MetadataExt},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::{Duration, SystemTime},
};

use anyhow::Context;
use mocapd_acquire::{
    files::{FileId, NewFile, SparseFile, is_being_written},
    header::SOFTWARE,
    ledger::TakeHealth,
    pipeline::lock,
};
use mocapd_drivers::plain_file;
use mocapd_take::{
    TakeEnds, TakeError,
    record::EndingKind,
    recovery::{RecoveryScan, repair_start},
};

use super::{Inner, session::unix_ms, uploads};
use crate::{
    control::{Refusal, RefusalKind},
    finished::{
        EditNotes, MovedTake, NOTES_BYTES_MAX, Rename, Restore, TakeNotes, TakeRating, Trash,
        TrashedTake,
    },
    status::{ServiceEventKind, TakeSummary},
    take_files::{
        self,
        notes::{self, NOTES_SUFFIX},
        trash,
    },
    take_name,
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

/// Time between two looks at the trash.
const EXPIRY_INTERVAL: Duration = Duration::from_secs(60);

/// Names that are in use, and renames that the uploads do not know of yet.
#[derive(Debug, Default)]
pub(super) struct TakeClaims(Mutex<Claimed>);

#[derive(Debug, Default)]
pub(super) struct Claimed {
    /// What is done with the take of each name.
    names: HashMap<String, &'static str>,
    /// Counts the changes of names.
    changes: u64,
    /// Old and new names that the uploads do not know of yet; empty without an archive.
    renamed: Vec<(String, String)>,
}

/// Keeps a name claimed until it is dropped.
#[derive(Debug)]
pub(super) struct Claim<'a> {
    claims: &'a TakeClaims,
    name: String,
}

impl TakeClaims {
    /// Claims a name for something that is done with its take; `None` if it is in use.
    pub(super) fn claim(&self, name: &str, what: &'static str) -> Option<Claim<'_>> {
        let mut claimed = lock(&self.0);
        if claimed.names.contains_key(name) {
            return None;
        }
        claimed.names.insert(name.to_owned(), what);
        Some(Claim { claims: self, name: name.to_owned() })
    }

    /// A number that changes whenever a name does.
    pub(super) fn changes(&self) -> u64 {
        lock(&self.0).changes
    }

    /// The renames since the last call, if no name has changed since `changes`.
    pub(super) fn renames_up_to(&self, changes: u64) -> Option<Vec<(String, String)>> {
        let mut claimed = lock(&self.0);
        (claimed.changes == changes).then(|| std::mem::take(&mut claimed.renamed))
    }

    fn forget_renames(&self) {
        lock(&self.0).renamed.clear();
    }
}

impl Claimed {
    /// Refuses a name with whose take something is done.
    fn check_free(&self, name: &str) -> Result<(), Refusal> {
        let name = take_name::strip_extension(name).unwrap_or(name);
        match self.names.get(name) {
            Some(what) => Err(Refusal::conflict(format!(
                "{name} is being {what}: try again when that is done"
            ))),
            None => Ok(()),
        }
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        lock(&self.claims.0).names.remove(&self.name);
    }
}

/// Removes takes from the trash until the service stops.
pub(super) fn empty_trash(inner: &Arc<Inner>) {
    let mut problem = None;
    while !inner.is_stopping() {
        let options = Arc::clone(&inner.core().options);
        let (folder, keep) = (&options.take.directory, options.take.trash_keep);
        // Not while a take is restored.
        let claimed = lock(&inner.claims.0);
        let removed = trash::remove_expired(folder, unix_ms(), keep);
        drop(claimed);
        for (name, bytes) in removed.takes {
            let message = format!(
                "the take {name} was removed from the trash after its time: {bytes} bytes are free"
            );
            inner.publish(ServiceEventKind::TakeChanged, &message, Some(&name));
        }
        // Once, not with every look.
        if let Some(message) = removed.problem.as_ref().filter(|_| problem != removed.problem) {
            inner.publish(ServiceEventKind::Warning, message, None);
        }
        problem = removed.problem;
        inner.wait_while(EXPIRY_INTERVAL, |core| Arc::ptr_eq(&core.options, &options));
    }
}

/// Repairs what a crash has left, and reports it. Must be called before a take is started.
pub(super) fn repair(inner: &Inner) {
    let folder = inner.core().options.take.directory.clone();
    for message in take_files::repair(&folder) {
        inner.publish(ServiceEventKind::Warning, &message, None);
    }
}

impl Inner {
    pub(super) fn edit_notes(&self, name: &str, edit: &EditNotes) -> Result<TakeNotes, Refusal> {
        let invalid = |message: String| Err(Refusal::new(RefusalKind::Invalid, message));
        if edit.rating == Some(TakeRating::Unknown) {
            return invalid("a rating is good, bad or none".to_owned());
        }
        let text = edit.text.as_ref().map(|text| text.replace("\r\n", "\n"));
        let is_text = |text: &String| {
            let is_refused = |c: char| c.is_control() && c != '\n' && c != '\t';
            text.len() <= NOTES_BYTES_MAX && !text.contains(is_refused)
        };
        if text.as_ref().is_some_and(|text| !is_text(text)) {
            return invalid(format!(
                "notes may have at most {NOTES_BYTES_MAX} bytes, and no control characters but line ends and tabs"
            ));
        }
        if edit.rating.is_none() && text.is_none() {
            return invalid("send a rating, a text, or both".to_owned());
        }
        let mut claimed = lock(&self.claims.0);
        let path = self.unused_take(&claimed, name, edit.take_id.as_deref())?;
        let name = stem(&path);
        claimed.names.insert(name.clone(), "rated");
        drop(claimed);
        // The disk may be slow to sync.
        let _claim = Claim { claims: &self.claims, name: name.clone() };
        let notes = notes::edit(&path, edit.rating, text.as_deref(), unix_ms())?;
        if let Some(last) = self.core().last_take.as_mut().filter(|last| last.name == name) {
            last.notes = Some(notes.clone());
        }
        let (rating, bytes) = (notes.rating.name(), notes.text.len());
        let message = format!("{name}: rating {rating}, notes of {bytes} bytes");
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&name));
        Ok(notes)
    }

    pub(super) fn rename_take(&self, name: &str, rename: &Rename) -> Result<MovedTake, Refusal> {
        let options = Arc::clone(&self.core().options);
        let folder = &options.take.directory;
        let mut claimed = lock(&self.claims.0);
        let from = stem(&self.unused_take(&claimed, name, rename.take_id.as_deref())?);
        claimed.check_free(&rename.to)?;
        let mut moved = take_files::rename(folder, &from, &rename.to)?;
        claimed.changes += 1;
        if options.archive.url.is_some() {
            claimed.renamed.push((from.clone(), moved.name.clone()));
            moved.remarks.extend(uploads::note_rename(self, folder, &from, &moved.name));
        }
        drop(claimed);
        if let Some(last) = self.core().last_take.as_mut().filter(|last| last.name == from) {
            last.name.clone_from(&moved.name);
        }
        let message = format!("the take {from} is now {}", moved.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&moved.name));
        Ok(moved)
    }

    pub(super) fn trash_take(&self, name: &str, request: &Trash) -> Result<TrashedTake, Refusal> {
        let options = Arc::clone(&self.core().options);
        let (folder, keep) = (&options.take.directory, options.take.trash_keep);
        let mut claimed = lock(&self.claims.0);
        self.unused_take(&claimed, name, request.take_id.as_deref())?;
        let trashed = trash::trash(folder, name, unix_ms(), keep)?;
        claimed.changes += 1;
        self.uploads.forget_take(&trashed.name);
        drop(claimed);
        let message = format!("the take {} was moved to the trash", trashed.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&trashed.name));
        Ok(trashed)
    }

    pub(super) fn restore_take(&self, id: &str, restore: &Restore) -> Result<MovedTake, Refusal> {
        let folder = self.core().options.take.directory.clone();
        let mut claimed = lock(&self.claims.0);
        if let Some(to) = &restore.to {
            claimed.check_free(to)?;
        }
        let moved = take_files::restore(&folder, id, restore.to.as_deref())?;
        claimed.changes += 1;
        drop(claimed);
        let message = format!("the take {} was restored from the trash", moved.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&moved.name));
        Ok(moved)
    }

    pub(super) fn list_trash(&self, limit: usize) -> Vec<TrashedTake> {
        let options = Arc::clone(&self.core().options);
        trash::trashed(&options.take.directory, options.take.trash_keep, limit)
    }

    /// The path of a finished take that nobody uses, and that has this id if one is given.
    fn unused_take(
        &self,
        claimed: &Claimed,
        name: &str,
        take_id: Option<&str>,
    ) -> Result<PathBuf, Refusal> {
        let path = self.path_of(name)?;
        let found = stem(&path);
        if let Some(what) = claimed.names.get(&found) {
            return Err(Refusal::conflict(format!(
                "{found} is being {what}: try again when that is done"
            )));
        }
        let unreadable = |error: std::io::Error| {
            Refusal::new(RefusalKind::Disk, format!("cannot read {}: {error}", path.display()))
        };
        let file = plain_file::open(&path).map_err(unreadable)?;
        let id = FileId::of(&file.metadata().map_err(unreadable)?);
        let is_mine = self.core().take.as_ref().is_some_and(|take| take.named.file == id);
        // By this service or by another recorder.
        if is_mine || is_being_written(&file) {
            return Err(Refusal::conflict(format!("{found} is being written: stop it first")));
        }
        if let Some(id) = take_id
            && summary_of(&path).is_none_or(|take| take.take_id != id)
        {
            let message = format!("another take is called {found} now: look at the list again");
            return Err(Refusal::conflict(message));
        }
        Ok(path)
    }

    /// Without an archive nobody reads the renames.
    pub(super) fn forget_renames(&self) {
        self.claims.forget_renames();
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Most takes that are recovered at startup. Older ones are left to `mocapd recover`.
const TAKES_MAX: usize = 64;

/// Newest takes among which those are looked for that were recovered already: as many summaries are cached.
const LISTED_MAX: usize = 4000;

/// Extension of recovered takes, before `.take`.
const RECOVERED: &str = "recovered";

/// Maximum number of recovered takes of one name.
const RECOVERED_MAX: u32 = 100;

/// Takes that are cut off and have not been recovered yet. Must be called before a take is started, because a take
/// in progress has no end either.
pub(super) fn cut_off(inner: &Inner) -> Vec<PathBuf> {
    let Ok(takes) = inner.list_takes(TAKES_MAX) else { return Vec::new() };
    let is_cut_off = |take: &TakeSummary| take.health == TakeHealth::CutOff && take.bytes > 0;
    // A recovered take that was uploaded and then removed here needs no other.
    let removed = uploads::removed_ids(&inner.core().options.take.directory);
    let takes =
        takes.into_iter().filter(is_cut_off).filter(|take| !removed.contains(&take.take_id));
    let cut_off: Vec<_> = takes.collect();
    if cut_off.is_empty() {
        return Vec::new();
    }
    let recovered = recovered_ids(inner);
    let open = cut_off.into_iter().filter(|take| !recovered.contains(&take.take_id));
    open.filter_map(|take| inner.path_of(&take.name).ok()).collect()
}

/// The ids of recovered takes, under whatever name, also in the trash.
fn recovered_ids(inner: &Inner) -> HashSet<String> {
    let folder = inner.core().options.take.directory.clone();
    let trashed = trash::trashed(&folder, Duration::ZERO, LISTED_MAX);
    let trash = folder.join(trash::TRASH);
    let trashed =
        trashed.iter().filter_map(|it| summary_of(&trash.join(format!("{}.take", it.id))));
    let listed = inner.list_takes(LISTED_MAX).unwrap_or_default();
    let is_recovered = |take: &TakeSummary| {
        take.health != TakeHealth::CutOff && take.ending == Some(EndingKind::CutOff)
    };
    let recovered = listed.into_iter().chain(trashed).filter(is_recovered);
    recovered.map(|take| take.take_id).filter(|id| !id.is_empty()).collect()
}

/// Possible paths of a recovered take: another take of the same name may have been recovered before.
fn recovered_paths(path: &Path) -> impl Iterator<Item = PathBuf> {
    (1..=RECOVERED_MAX).map(|number| {
        path.with_extension(match number {
            1 => format!("{RECOVERED}.take"),
            _ => format!("{RECOVERED}-{number}.take"),
        })
    })
}

/// Recovers each take into a new file; the original stays unchanged.
pub(super) fn recover_takes(inner: &Arc<Inner>, takes: Vec<PathBuf>) {
    for path in takes {
        if inner.is_stopping() {
            return;
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        // Renamed or trashed since: it is looked at again with the next start.
        let Some(_claim) = inner.claims.claim(&name, "recovered") else { continue };
        if path.symlink_metadata().is_err() {
            continue;
        }
        let output = recovered_paths(&path).find(|path| path.symlink_metadata().is_err());
        let Some(output) = output else { continue };
        let message = match recover(&path, &output) {
            Ok(losses) => {
                let to = output.file_stem().unwrap_or_default().to_string_lossy();
                format!("the take {name} was cut off; recovered as {to}: {losses}")
            }
            Err(error) => format!("the take {name} is cut off; recovery failed: {error:#}"),
        };
        inner.publish(ServiceEventKind::Warning, &message, Some(&name));
    }
}

fn recover(path: &Path, output: &Path) -> anyhow::Result<String> {
    let reading = || format!("cannot read {}", path.display());
    let (mut input, _) = repair_start(SparseFile::open(path)?).with_context(reading)?;
    let scan = RecoveryScan::read(&mut input).with_context(reading)?;
    let mut file = NewFile::create(output)?;
    scan.write(&mut input, BufWriter::new(&mut file), SOFTWARE)?;
    file.keep()?;
    let losses = scan.loss_summary();
    Ok(if scan.lost_anything() { losses } else { "nothing that was written is lost".to_owned() })
}
