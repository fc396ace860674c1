//! The trash: a folder in that of the takes, in which each take has the name `TIME-AGE.NAME.take`.
//!
//! TIME is when the take was moved there, in milliseconds since 1970. Whether its time there is over is decided by AGE,
//! a clock of the trash in milliseconds, which a wrong clock of the machine cannot set forward by more than
//! four days: what was removed cannot be had back.

use std::{
    fs::{self, DirEntry},
    io::{self, Write},
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::files;
use serde::{Deserialize, Serialize};

use super::{
    TEMPORARY_PREFIX, files_of, move_both,
    notes::{NOTES_SUFFIX, notes_path},
};
use crate::{
    control::{Refusal, RefusalKind},
    finished::TrashedTake,
};

/// The folder of the trash, in that of the takes.
pub const TRASH: &str = ".trash";

/// The file of its clock, in it.
const CLOCK: &str = ".mocapd-trash.json";

/// Longest file of the clock that is read: it has two numbers.
const CLOCK_BYTES_MAX: usize = 1024;

/// The most that the clock of the trash advances between two looks: a rig that was off over a long weekend keeps its
/// takes no longer for it, and a clock that was set by years removes none.
const STEP_MAX: Duration = Duration::from_secs(4 * 86_400);

/// Time after which the clock is stored again: a crash keeps takes that much longer.
const STORE_INTERVAL_MS: i64 = 600_000;

/// Digits of both times in a name, at least.
const TIME_DIGITS: usize = 13;

/// Names that are tried for a take: each is taken only if a take of the name was moved there in the same millisecond.
const NAMES_MAX: i64 = 100;

/// The clock of the trash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct TrashClock {
    /// Its time.
    age_ms: i64,
    /// The machine's clock then.
    unix_ms: i64,
}

impl TrashClock {
    /// The clock as stored, and as it is now. A clock that is lost continues from the newest take.
    fn read(trash: &Path, now_unix_ms: i64) -> (Option<Self>, Self) {
        let read = files::read_bounded(&trash.join(CLOCK), CLOCK_BYTES_MAX).ok();
        let stored: Option<Self> = read.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let newest = || files_of(trash).filter_map(|entry| Some(EntryName::parse(&entry)?.age_ms));
        let from = stored
            .unwrap_or_else(|| Self { age_ms: newest().max().unwrap_or(0), unix_ms: now_unix_ms });
        let step_max = i64::try_from(STEP_MAX.as_millis()).unwrap_or(i64::MAX);
        let step = now_unix_ms.saturating_sub(from.unix_ms).clamp(0, step_max);
        (stored, Self { age_ms: from.age_ms.saturating_add(step), unix_ms: now_unix_ms })
    }

    fn store(self, trash: &Path) -> io::Result<()> {
        let mut file = tempfile::Builder::new().prefix(TEMPORARY_PREFIX).tempfile_in(trash)?;
        serde_json::to_writer(&mut file, &self)?;
        file.flush()?;
        file.as_file().sync_all()?;
        file.persist(trash.join(CLOCK)).map_err(|error| error.error)?;
        Ok(())
    }
}

/// The name of a file in the trash.
#[derive(Debug)]
struct EntryName {
    unix_ms: i64,
    age_ms: i64,
    name: String,
    /// The name without its extension.
    id: String,
    is_take: bool,
}

impl EntryName {
    /// `None` for a file that the service has not moved there.
    fn parse(entry: &DirEntry) -> Option<Self> {
        Self::of(entry.file_name().to_str()?)
    }

    fn of(file: &str) -> Option<Self> {
        let (id, is_take) = match file.strip_suffix(".take") {
            Some(id) => (id, true),
            None => (file.strip_suffix(NOTES_SUFFIX)?, false),
        };
        let (times, name) = id.split_once('.')?;
        let (unix_ms, age_ms) = times.split_once('-')?;
        let time = |text: &str| {
            let is_time =
                text.len() >= TIME_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
            text.parse().ok().filter(|_| is_time)
        };
        Some(Self {
            unix_ms: time(unix_ms)?,
            age_ms: time(age_ms)?,
            name: name.to_owned(),
            id: id.to_owned(),
            is_take,
        })
    }

    fn trashed(self, bytes: u64, keep: Duration) -> TrashedTake {
        let keep_ms = i64::try_from(keep.as_millis()).unwrap_or(i64::MAX);
        TrashedTake {
            id: self.id,
            name: self.name,
            bytes,
            trashed_unix_ms: self.unix_ms,
            removed_unix_ms: self.unix_ms.saturating_add(keep_ms),
        }
    }
}

/// The folder of the trash; `None` if there is none, or a link in its place, which could lead anywhere.
#[must_use]
pub fn folder_of_trash(folder: &Path) -> Option<PathBuf> {
    let trash = folder.join(TRASH);
    trash.symlink_metadata().is_ok_and(|found| found.is_dir()).then_some(trash)
}

/// Moves a take and its notes to the trash.
///
/// # Errors
/// There is no such take, or it cannot be moved; the message says where it is if it has moved without its notes.
pub fn trash(
    folder: &Path,
    name: &str,
    now_unix_ms: i64,
    keep: Duration,
) -> Result<TrashedTake, Refusal> {
    let from = super::path_of(folder, name)?;
    let name = from.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let failed = |error: &io::Error| super::cannot("move", &name, "the trash", error);
    match fs::create_dir(folder.join(TRASH)) {
        Ok(()) => files::sync_name(&folder.join(TRASH)),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(failed(&error)),
    }
    let Some(trash) = folder_of_trash(folder) else {
        let message =
            format!("{} is not a folder: move it elsewhere", folder.join(TRASH).display());
        return Err(Refusal::new(RefusalKind::Conflict, message));
    };
    let (stored, clock) = TrashClock::read(&trash, now_unix_ms);
    if stored.is_none() {
        clock.store(&trash).map_err(|error| failed(&error))?;
    }
    let bytes = from.symlink_metadata().map_or(0, |found| found.len());
    let mut moved = Err(io::ErrorKind::AlreadyExists.into());
    for ms in now_unix_ms..now_unix_ms.saturating_add(NAMES_MAX) {
        let id = format!("{ms:0TIME_DIGITS$}-{:0TIME_DIGITS$}.{name}", clock.age_ms);
        let to = trash.join(format!("{id}.take"));
        moved = move_both(&from, &to).map(|()| EntryName::of(&format!("{id}.take")));
        if !moved.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AlreadyExists) {
            break;
        }
    }
    let entry = moved.map_err(|error| failed(&error))?;
    entry.map(|entry| entry.trashed(bytes, keep)).ok_or_else(|| {
        Refusal::new(RefusalKind::Internal, "the take has no time in the trash: report this bug")
    })
}

/// The takes in the trash, newest first, at most `limit`.
#[must_use]
pub fn trashed(folder: &Path, keep: Duration, limit: usize) -> Vec<TrashedTake> {
    let files = folder_of_trash(folder).into_iter().flat_map(|trash| files_of(&trash));
    let take = |entry: DirEntry| {
        let name = EntryName::parse(&entry).filter(|name| name.is_take)?;
        Some(name.trashed(entry.metadata().map_or(0, |found| found.len()), keep))
    };
    let mut takes: Vec<_> = files.filter_map(take).collect();
    takes.sort_by(|a, b| (b.trashed_unix_ms, &b.id).cmp(&(a.trashed_unix_ms, &a.id)));
    takes.truncate(limit);
    takes
}

/// What left the trash.
#[derive(Debug, Default)]
pub struct Removed {
    /// The names of the takes, and their bytes.
    pub takes: Vec<(String, u64)>,
    /// What could not be removed, and why: the first of all.
    pub problem: Option<String>,
}

/// Removes the takes whose time in the trash is over, and their notes.
#[must_use]
pub fn remove_expired(folder: &Path, now_unix_ms: i64, keep: Duration) -> Removed {
    let mut removed = Removed::default();
    let Some(trash) = folder_of_trash(folder) else { return removed };
    let mut note = |path: &Path, error: &io::Error| {
        let message = || format!("cannot change {}: {error}", path.display());
        removed.problem.get_or_insert_with(message);
    };
    let (stored, clock) = TrashClock::read(&trash, now_unix_ms);
    let is_due = |stored: TrashClock| (clock.unix_ms - stored.unix_ms).abs() >= STORE_INTERVAL_MS;
    if stored.is_none_or(is_due)
        && let Err(error) = clock.store(&trash)
    {
        note(&trash.join(CLOCK), &error);
        return removed;
    }
    let keep_ms = i64::try_from(keep.as_millis()).unwrap_or(i64::MAX);
    let is_over = |entry: &EntryName| clock.age_ms.saturating_sub(entry.age_ms) >= keep_ms;
    let mut takes = Vec::new();
    for (entry, file) in files_of(&trash).filter_map(|it| Some((EntryName::parse(&it)?, it))) {
        if !is_over(&entry) {
            continue;
        }
        let (path, bytes) = (file.path(), file.metadata().map_or(0, |found| found.len()));
        // The notes go with their take, and those without one by themselves.
        let notes = if entry.is_take { notes_path(&path) } else { path.clone() };
        match fs::remove_file(&path) {
            Ok(()) if entry.is_take => takes.push((entry.name, bytes)),
            Err(error) if error.kind() != io::ErrorKind::NotFound => note(&path, &error),
            _ => {}
        }
        if entry.is_take
            && let Err(error) = fs::remove_file(&notes)
            && error.kind() != io::ErrorKind::NotFound
        {
            note(&notes, &error);
        }
    }
    removed.takes = takes;
    removed
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_MS: i64 = 86_400_000;
    const KEEP: Duration = Duration::from_secs(30 * 86_400);

    #[test]
    fn only_names_that_the_service_gave_are_in_the_trash() {
        let id = "1796000000000-0000000000007.a.b";
        let entry = EntryName::of(&format!("{id}.take")).unwrap();
        assert_eq!(
            (entry.unix_ms, entry.age_ms, entry.name.as_str()),
            (1_796_000_000_000, 7, "a.b")
        );
        assert!(!EntryName::of(&format!("{id}.notes.json")).unwrap().is_take);
        for file in [
            "2026.11.29-walk.take",
            "3.jump.take",
            "x.take",
            "1796000000000.a.take",
            "1796000000000-7.a.take",
            "-1796000000000-0000000000007.a.take",
            "1796000000000-0000000000007.txt",
        ] {
            assert!(EntryName::of(file).is_none(), "{file}");
        }
    }

    #[test]
    fn a_clock_that_is_set_removes_nothing_early() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let put = |name: &str, now| {
            fs::write(path.join(format!("{name}.take")), "take").unwrap();
            trash(path, name, now, KEEP).unwrap()
        };
        let look = |now: i64| remove_expired(path, now, KEEP).takes.len();
        // The rig has started with a clock of the past, and gets the time.
        let (past, now) = (1_700_000_000_000, 1_796_000_000_000);
        put("a", past);
        assert_eq!(look(past + 60_000), 0);
        assert_eq!(look(now), 0);
        // Set forward by years and back.
        assert_eq!((look(now + 3000 * DAY_MS), look(now)), (0, 0));
        // A week away counts as four days; so far there were two such steps.
        for day in 1..=21 {
            assert_eq!(look(now + day * DAY_MS), 0, "{day}");
        }
        assert_eq!(trashed(path, KEEP, 9).len(), 1);
        assert_eq!(look(now + 23 * DAY_MS), 1);
        // A clock of the trash that is lost continues.
        put("b", now + 24 * DAY_MS);
        fs::remove_file(path.join(TRASH).join(CLOCK)).unwrap();
        assert_eq!(look(now + 25 * DAY_MS), 0);
        for day in 26..=54 {
            assert_eq!(look(now + day * DAY_MS), 0, "{day}");
        }
        assert_eq!(look(now + 55 * DAY_MS), 1);
    }

    #[test]
    fn a_link_in_place_of_the_trash_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        fs::create_dir(path.join("other")).unwrap();
        let old = path.join("other/0000000000001-0000000000001.a.take");
        fs::write(&old, "take").unwrap();
        std::os::unix::fs::symlink("other", path.join(TRASH)).unwrap();
        assert_eq!(remove_expired(path, i64::MAX, Duration::ZERO).takes.len(), 0);
        assert!(old.exists() && trashed(path, KEEP, 9).is_empty());
    }
}
