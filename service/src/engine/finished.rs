//! Rates, renames, trashes and restores finished takes; and removes those whose time in the trash is over.
//!
//! A take that is being written, recovered, uploaded or removed is refused. Whoever works on a take by its name claims
//! the name; names are claimed and changed under one lock, so that neither works on a name that the other changes.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use mocapd_acquire::{
    files::{FileId, is_being_written},
    pipeline::lock,
};
use mocapd_drivers::plain_file;

use super::{Inner, folder::summary_of, status::unix_ms, uploads};
use crate::{
    control::{Refusal, RefusalKind},
    finished::{
        EditNotes, MovedTake, NOTES_BYTES_MAX, Rename, Restore, TakeNotes, TakeRating, Trash,
        TrashedTake,
    },
    status::ServiceEventKind,
    take_files::{self, notes, trash},
    take_name,
};

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
pub(super) fn run(inner: &Arc<Inner>) {
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
