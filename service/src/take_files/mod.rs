//! The files of finished takes in a folder: a take and its notes are renamed, moved to the trash and back together.
//!
//! Nothing is replaced. The take moves first, then its notes; notes whose take a crash has moved without them are found
//! by what they state about it, when the service starts.

pub mod notes;
pub mod trash;

use std::{
    collections::HashMap,
    fs::{self, DirEntry},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::files::{rename_new, sync_name};

pub use self::trash::TRASH;
use self::{
    notes::{NOTES_SUFFIX, TakeIdentity, notes_path},
    trash::folder_of_trash,
};
use crate::{
    control::{Refusal, RefusalKind},
    finished::MovedTake,
    take_name,
};

/// Begins the names of temporary files; those that a killed service left are removed when it starts.
pub const TEMPORARY_PREFIX: &str = ".mocapd-new-";

/// Most files of a folder that are looked at, as for the list of takes.
const FILES_MAX: usize = 100_000;

/// Most messages of a repair: a folder of other files must not fill the log.
const MESSAGES_MAX: usize = 20;

/// The path of a take by its name.
///
/// # Errors
/// No take of that name exists, or the name could lead out of the folder.
pub fn path_of(folder: &Path, name: &str) -> Result<PathBuf, Refusal> {
    let name = take_name::check(name)?;
    // The name as listed, or else as a file name.
    for name in [Some(name), take_name::strip_extension(name)].into_iter().flatten() {
        let path = folder.join(format!("{name}.take"));
        // A link could lead out of the folder.
        if path.symlink_metadata().is_ok_and(|file| file.is_file()) {
            return Ok(path);
        }
    }
    Err(Refusal::new(RefusalKind::NotFound, format!("there is no take called {name}")))
}

/// Renames a take and its notes.
///
/// # Errors
/// A name is invalid or taken, or there is no such take; the message says where it is if it has moved without its notes.
pub fn rename(folder: &Path, name: &str, to: &str) -> Result<MovedTake, Refusal> {
    let from = path_of(folder, name)?;
    let to = take_name::normalised(to)?;
    let path = folder.join(format!("{to}.take"));
    move_both(&from, &path).map_err(|error| cannot("rename", name, to, &error))?;
    Ok(MovedTake { name: to.to_owned(), path, remarks: Vec::new() })
}

/// Moves a take and its notes from the trash back: the one with this id, or else the newest of this name.
///
/// # Errors
/// There is no such take in the trash, or its name is taken; the message says where it is if it has moved without its
/// notes.
pub fn restore(folder: &Path, id: &str, to: Option<&str>) -> Result<MovedTake, Refusal> {
    let takes = trash::trashed(folder, Duration::ZERO, usize::MAX);
    let take = takes.iter().find(|take| take.id == id);
    let take = take.or_else(|| takes.iter().find(|take| take.name == id));
    let (Some(take), Some(trash)) = (take, folder_of_trash(folder)) else {
        let message = format!("there is no take {id} in the trash");
        return Err(Refusal::new(RefusalKind::NotFound, message));
    };
    let from = trash.join(format!("{}.take", take.id));
    // Its own name was given by somebody before.
    let name = to.map_or_else(|| take_name::check(&take.name), take_name::normalised)?;
    let path = folder.join(format!("{name}.take"));
    move_both(&from, &path).map_err(|error| cannot("restore", &take.name, name, &error))?;
    Ok(MovedTake { name: name.to_owned(), path, remarks: Vec::new() })
}

/// Repairs what a crash between the move of a take and that of its notes has left: notes without a take go to the take
/// that they state. Returns messages about what was repaired, and about notes that have no take.
#[must_use]
pub fn repair(folder: &Path) -> Vec<String> {
    let folders: Vec<PathBuf> =
        [folder.to_owned()].into_iter().chain(folder_of_trash(folder)).collect();
    for folder in &folders {
        remove_temporary(folder);
    }
    let paths = || folders.iter().flat_map(|folder| files_of(folder)).map(|entry| entry.path());
    let lacks_take = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.ends_with(NOTES_SUFFIX) && take_path(path).symlink_metadata().is_err()
    };
    let orphans: Vec<PathBuf> = paths().filter(lacks_take).collect();
    if orphans.is_empty() {
        return Vec::new();
    }
    let mut takes: HashMap<u64, Vec<PathBuf>> = HashMap::new();
    for path in paths().filter(|path| path.extension().is_some_and(|it| it == "take")) {
        if let Ok(found) = path.symlink_metadata() {
            takes.entry(found.len()).or_default().push(path);
        }
    }
    let mut messages: Vec<String> = orphans
        .iter()
        .map(|orphan| match notes::stated_identity(orphan) {
            Ok(identity) => match find_take(&takes, &identity) {
                Some(take) => adopt(orphan, take),
                None => format!("{} has no take: it is left as it is", orphan.display()),
            },
            Err(error) => format!("{} has no take: {error:#}", orphan.display()),
        })
        .collect();
    let n_more = messages.len().saturating_sub(MESSAGES_MAX);
    messages.truncate(MESSAGES_MAX);
    if n_more > 0 {
        messages.push(format!("{n_more} more files of notes had no take"));
    }
    messages
}

/// A take without notes that has this identity, of those with each size: of several copies the one that was moved last.
fn find_take<'a>(
    takes: &'a HashMap<u64, Vec<PathBuf>>,
    identity: &TakeIdentity,
) -> Option<&'a PathBuf> {
    let is_it = |take: &&PathBuf| {
        notes_path(take).symlink_metadata().is_err()
            && TakeIdentity::of(take).is_ok_and(|found| found == *identity)
    };
    // A rename changes the status of a file, and not its content.
    let changed = |take: &&PathBuf| {
        take.symlink_metadata().map_or((0, 0), |found| (found.ctime(), found.ctime_nsec()))
    };
    takes.get(&identity.take_bytes)?.iter().filter(is_it).max_by_key(changed)
}

/// Removes temporary files that a killed process left.
fn remove_temporary(folder: &Path) {
    for entry in files_of(folder) {
        if entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) {
            fs::remove_file(entry.path()).ok();
        }
    }
}

fn adopt(orphan: &Path, take: &Path) -> String {
    let to = notes_path(take);
    match rename_new(orphan, &to) {
        Ok(()) => format!(
            "the notes {} were left behind when their take was moved, and are now {}",
            orphan.display(),
            to.display()
        ),
        Err(error) => {
            format!("the notes {} cannot become {}: {error}", orphan.display(), to.display())
        }
    }
}

/// Moves a take and its notes to another name that neither has yet; or neither of them.
fn move_both(from: &Path, to: &Path) -> io::Result<()> {
    let (notes, notes_to) = (notes_path(from), notes_path(to));
    if notes_to.symlink_metadata().is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    rename_new(from, to)?;
    if notes.symlink_metadata().is_ok()
        && let Err(error) = rename_new(&notes, &notes_to)
    {
        return Err(match rename_new(to, from) {
            Ok(()) => error,
            Err(_) => io::Error::other(format!(
                "the notes did not follow: {error}; the take is {} now, and the next start of the service repairs it",
                to.display()
            )),
        });
    }
    sync_name(to);
    sync_name(from);
    Ok(())
}

fn cannot(what: &str, name: &str, to: &str, error: &io::Error) -> Refusal {
    match error.kind() {
        io::ErrorKind::AlreadyExists => {
            let message =
                format!("a take called {to}, or notes for it, exist: choose another name");
            Refusal::new(RefusalKind::Exists, message)
        }
        io::ErrorKind::NotFound => {
            Refusal::new(RefusalKind::NotFound, format!("there is no take called {name}"))
        }
        _ => Refusal::new(RefusalKind::Disk, format!("cannot {what} {name} to {to}: {error}")),
    }
}

/// The path of the take that notes lie beside.
fn take_path(notes: &Path) -> PathBuf {
    let name = notes.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let stem = name.strip_suffix(NOTES_SUFFIX).unwrap_or(&name);
    notes.with_file_name(format!("{stem}.take"))
}

/// The plain files of a folder; none if it cannot be read.
fn files_of(folder: &Path) -> impl Iterator<Item = DirEntry> + use<> {
    let entries = fs::read_dir(folder).into_iter().flatten().take(FILES_MAX).flatten();
    entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()))
}
