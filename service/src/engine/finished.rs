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

use super::{Inner, status::unix_ms};
use crate::{
    control::{Refusal, RefusalKind, Request},
    finished::{
        EditNotes, MovedTake, NOTES_BYTES_MAX, Rename, Restore, TakeNotes, TakeRating, TrashedTake,
    },
    status::ServiceEventKind,
    take_files::{self, notes},
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
    /// Old and new names. Read by the uploads within seconds, and empty without an archive.
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

    /// Runs `read` while no name changes, and returns the renames before.
    pub(super) fn while_names_stay<T>(
        &self,
        read: impl FnOnce() -> T,
    ) -> (T, Vec<(String, String)>) {
        let mut claimed = lock(&self.0);
        let found = read();
        (found, std::mem::take(&mut claimed.renamed))
    }

    fn forget_renames(&self) {
        lock(&self.0).renamed.clear();
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        lock(&self.claims.0).names.remove(&self.name);
    }
}

/// Removes takes from the trash until the service stops.
pub(super) fn run(inner: &Arc<Inner>) {
    while !inner.is_stopping() {
        let options = Arc::clone(&inner.core().options);
        let (folder, keep) = (&options.take.directory, options.take.trash_keep);
        for (name, removed) in take_files::remove_expired(folder, unix_ms(), keep) {
            let (kind, message) = match removed {
                Ok(message) => (ServiceEventKind::TakeChanged, message),
                Err(message) => (ServiceEventKind::Warning, message),
            };
            inner.publish(kind, &message, Some(&name));
        }
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
        if edit.text.as_ref().is_some_and(|it| it.len() > NOTES_BYTES_MAX || it.contains('\0')) {
            return invalid(format!("notes may have at most {NOTES_BYTES_MAX} bytes and no NUL"));
        }
        if edit.rating.is_none() && edit.text.is_none() {
            return invalid("send a rating, a text, or both".to_owned());
        }
        let claimed = lock(&self.claims.0);
        let path = self.unused_take(&claimed, name)?;
        let edited = notes::edit(&path, edit.rating, edit.text.as_deref(), unix_ms());
        drop(claimed);
        let notes =
            edited.map_err(|error| Refusal::new(RefusalKind::Conflict, format!("{error:#}")))?;
        let name = stem(&path);
        let message =
            format!("{name}: rating {}, notes of {} bytes", notes.rating.name(), notes.text.len());
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&name));
        Ok(notes)
    }

    pub(super) fn rename_take(&self, name: &str, rename: &Rename) -> Result<MovedTake, Refusal> {
        let folder = self.core().options.take.directory.clone();
        let mut claimed = lock(&self.claims.0);
        let from = stem(&self.unused_take(&claimed, name)?);
        let mut moved = take_files::rename(&folder, &from, &rename.to)?;
        let upload = self.uploads.upload_of(&from);
        if let Some(url) = upload {
            claimed.renamed.push((from.clone(), moved.name.clone()));
            moved.remarks.push(format!("the archive keeps it as {url}"));
        }
        drop(claimed);
        if let Some(last) = self.core().last_take.as_mut().filter(|last| last.name == from) {
            last.name.clone_from(&moved.name);
        }
        let message = format!("the take {from} is now {}", moved.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&moved.name));
        Ok(moved)
    }

    pub(super) fn trash_take(
        &self,
        name: &str,
        _request: &Request,
    ) -> Result<TrashedTake, Refusal> {
        let options = Arc::clone(&self.core().options);
        let (folder, keep) = (&options.take.directory, options.take.trash_keep);
        let claimed = lock(&self.claims.0);
        self.unused_take(&claimed, name)?;
        let trashed = take_files::trash(folder, name, unix_ms(), keep)?;
        drop(claimed);
        let mut core = self.core();
        core.last_take.take_if(|last| last.name == trashed.name);
        drop(core);
        let message = format!("the take {} was moved to the trash", trashed.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&trashed.name));
        Ok(trashed)
    }

    pub(super) fn restore_take(&self, id: &str, restore: &Restore) -> Result<MovedTake, Refusal> {
        let folder = self.core().options.take.directory.clone();
        let claimed = lock(&self.claims.0);
        let moved = take_files::restore(&folder, id, restore.to.as_deref())?;
        drop(claimed);
        let message = format!("the take {} was restored from the trash", moved.name);
        self.publish(ServiceEventKind::TakeChanged, &message, Some(&moved.name));
        Ok(moved)
    }

    pub(super) fn list_trash(&self, limit: usize) -> Vec<TrashedTake> {
        let options = Arc::clone(&self.core().options);
        take_files::trashed(&options.take.directory, options.take.trash_keep, limit)
    }

    /// The path of a finished take that nobody uses.
    fn unused_take(&self, claimed: &Claimed, name: &str) -> Result<PathBuf, Refusal> {
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
