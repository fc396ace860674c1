//! The files of finished takes in a folder: a take and its notes are renamed, moved to the trash and back together.
//!
//! Nothing is replaced. The take moves first, then its notes; notes whose take a crash has moved without them are found
//! by what they state about it, when the service starts.

pub mod notes;

use std::{
    fs::{self, DirEntry},
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::files::{rename_new, sync_name};

use self::notes::{NOTES_SUFFIX, TakeIdentity, notes_path};
use crate::{
    control::{Refusal, RefusalKind},
    finished::{MovedTake, TrashedTake},
    take_name,
};

/// The folder of the trash, in that of the takes.
pub const TRASH: &str = ".trash";

/// Most files of a folder that are looked at, as for the list of takes.
const FILES_MAX: usize = 100_000;

/// Names that are tried for a take in the trash: each is taken only if a take of the name was moved there in the same
/// millisecond.
const TRASH_NAMES_MAX: i64 = 100;

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
/// A name is invalid or taken, or there is no such take; nothing has changed then.
pub fn rename(folder: &Path, name: &str, to: &str) -> Result<MovedTake, Refusal> {
    let from = path_of(folder, name)?;
    let to = take_name::normalised(to)?;
    let path = folder.join(format!("{to}.take"));
    move_both(&from, &path).map_err(|error| cannot("rename", name, to, &error))?;
    Ok(MovedTake { name: to.to_owned(), path, remarks: Vec::new() })
}

/// Moves a take and its notes to the trash.
///
/// # Errors
/// There is no such take, or it cannot be moved; nothing has changed then.
pub fn trash(
    folder: &Path,
    name: &str,
    now_unix_ms: i64,
    keep: Duration,
) -> Result<TrashedTake, Refusal> {
    let from = path_of(folder, name)?;
    let name = from.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let trash = folder.join(TRASH);
    let failed = |error: &io::Error| cannot("move", &name, "the trash", error);
    match fs::create_dir(&trash) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(failed(&error)),
        _ if trash.symlink_metadata().is_ok_and(|found| found.is_dir()) => sync_name(&trash),
        _ => {
            let message = format!("{} is not a folder: move it elsewhere", trash.display());
            return Err(Refusal::new(RefusalKind::Conflict, message));
        }
    }
    let mut moved = Err(io::ErrorKind::AlreadyExists.into());
    for ms in now_unix_ms..now_unix_ms.saturating_add(TRASH_NAMES_MAX) {
        let to = trash.join(format!("{ms}.{name}.take"));
        moved = move_both(&from, &to).map(|()| to);
        if !moved.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AlreadyExists) {
            break;
        }
    }
    let to = moved.map_err(|error| failed(&error))?;
    trashed_take(&to, keep)
        .ok_or_else(|| Refusal::new(RefusalKind::Internal, "the moved take is not in the trash"))
}

/// The takes in the trash, newest first, at most `limit`.
#[must_use]
pub fn trashed(folder: &Path, keep: Duration, limit: usize) -> Vec<TrashedTake> {
    let files = files_of(&folder.join(TRASH));
    let mut takes: Vec<_> = files.filter_map(|entry| trashed_take(&entry.path(), keep)).collect();
    takes.sort_by(|a, b| (b.trashed_unix_ms, &b.id).cmp(&(a.trashed_unix_ms, &a.id)));
    takes.truncate(limit);
    takes
}

/// Moves a take and its notes from the trash back: the one with this id, or else the newest of this name.
///
/// # Errors
/// There is no such take in the trash, or its name is taken; nothing has changed then.
pub fn restore(folder: &Path, id: &str, to: Option<&str>) -> Result<MovedTake, Refusal> {
    let takes = trashed(folder, Duration::ZERO, usize::MAX);
    let of_name = |take: &&TrashedTake| take.name == id;
    let take = takes.iter().find(|take| take.id == id).or_else(|| takes.iter().find(of_name));
    let Some(take) = take else {
        let message = format!("there is no take {id} in the trash");
        return Err(Refusal::new(RefusalKind::NotFound, message));
    };
    let from = folder.join(TRASH).join(format!("{}.take", take.id));
    let name = take_name::normalised(to.unwrap_or(&take.name))?;
    let path = folder.join(format!("{name}.take"));
    move_both(&from, &path).map_err(|error| cannot("restore", &take.name, name, &error))?;
    Ok(MovedTake { name: name.to_owned(), path, remarks: Vec::new() })
}

/// Removes the takes whose time in the trash is over, and their notes. Returns a message for each take, and for each
/// that could not be removed.
#[must_use]
pub fn remove_expired(
    folder: &Path,
    now_unix_ms: i64,
    keep: Duration,
) -> Vec<(String, Result<String, String>)> {
    let mut removed = Vec::new();
    for entry in files_of(&folder.join(TRASH)) {
        let path = entry.path();
        let file_name = entry.file_name().to_string_lossy().into_owned();
        let is_take = file_name.ends_with(".take");
        let stem = file_name.strip_suffix(".take").or(file_name.strip_suffix(NOTES_SUFFIX));
        let Some((ms, name)) = stem.and_then(parse_id) else { continue };
        if removed_after(ms, keep) > now_unix_ms {
            continue;
        }
        let bytes = entry.metadata().map_or(0, |found| found.len());
        match fs::remove_file(&path) {
            Ok(()) if is_take => {
                let message = format!(
                    "the take {name} was removed from the trash after its time, and with it {bytes} bytes"
                );
                removed.push((name.to_owned(), Ok(message)));
            }
            Ok(()) => {}
            // The notes went with their take.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => {
                let message = format!("cannot remove {} from the trash: {error}", path.display());
                removed.push((name.to_owned(), Err(message)));
            }
        }
    }
    removed
}

/// Repairs what a crash between the move of a take and that of its notes has left: notes without a take go to the take
/// that they state. Returns messages about what was repaired, and about notes that have no take.
#[must_use]
pub fn repair(folder: &Path) -> Vec<String> {
    notes::remove_temporary(folder);
    let folders = [folder.to_owned(), folder.join(TRASH)];
    let names = |suffix: &'static str| {
        let files = folders.iter().flat_map(|folder| files_of(folder)).map(|entry| entry.path());
        files.filter(move |path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(suffix))
        })
    };
    let lacks_take = |notes: &PathBuf| take_path(notes).symlink_metadata().is_err();
    let orphans: Vec<PathBuf> = names(NOTES_SUFFIX).filter(lacks_take).collect();
    if orphans.is_empty() {
        return Vec::new();
    }
    let takes: Vec<PathBuf> = names(".take").collect();
    let mut messages = Vec::new();
    for orphan in &orphans {
        let message = match notes::stated_identity(orphan) {
            Ok(identity) => match find_take(&takes, &identity) {
                Some(take) => adopt(orphan, take),
                None => format!("{} has no take: it is left as it is", orphan.display()),
            },
            Err(error) => format!("{} has no take: {error:#}", orphan.display()),
        };
        messages.push(message);
    }
    let n_more = messages.len().saturating_sub(MESSAGES_MAX);
    messages.truncate(MESSAGES_MAX);
    if n_more > 0 {
        messages.push(format!("{n_more} more files of notes have no take"));
    }
    messages
}

/// A take without notes that has this identity.
fn find_take<'a>(takes: &'a [PathBuf], identity: &TakeIdentity) -> Option<&'a PathBuf> {
    takes.iter().find(|take| {
        take.symlink_metadata().is_ok_and(|it| it.is_file() && it.len() == identity.take_bytes)
            && notes_path(take).symlink_metadata().is_err()
            && TakeIdentity::of(take).is_ok_and(|found| found == *identity)
    })
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
        // If this fails as well, the next start repairs it.
        rename_new(to, from).ok();
        return Err(error);
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

fn trashed_take(path: &Path, keep: Duration) -> Option<TrashedTake> {
    let id = path.file_name()?.to_str()?.strip_suffix(".take")?;
    let (trashed_unix_ms, name) = parse_id(id)?;
    Some(TrashedTake {
        id: id.to_owned(),
        name: name.to_owned(),
        bytes: path.symlink_metadata().map_or(0, |found| found.len()),
        trashed_unix_ms,
        removed_unix_ms: removed_after(trashed_unix_ms, keep),
    })
}

/// When a take came to the trash, and its name, from its name there.
fn parse_id(id: &str) -> Option<(i64, &str)> {
    let (ms, name) = id.split_once('.')?;
    let is_number = ms.bytes().all(|byte| byte.is_ascii_digit());
    Some((ms.parse().ok().filter(|_| is_number)?, name))
}

fn removed_after(trashed_unix_ms: i64, keep: Duration) -> i64 {
    trashed_unix_ms.saturating_add(i64::try_from(keep.as_millis()).unwrap_or(i64::MAX))
}
