//! Names takes after subject, session and trial, with a count that continues: `S01_session1_jump_003`.
//!
//! The count continues from the names in the folder and in the trash, and from a file of the last counts: takes that
//! were moved elsewhere do not make their names free again.

use std::{
    collections::BTreeMap,
    fs,
    io::{ErrorKind, Write},
    path::Path,
};

use anyhow::Context;
use mocapd_acquire::files;
use mocapd_take::record::Subject;
use serde::{Deserialize, Serialize};

use super::EngineOptions;
use crate::{
    config::is_refused_in_name,
    control::{NAME_PART_BYTES_MAX, Refusal, RefusalKind, Start},
    status::TrialNames,
    take_files::{TEMPORARY_PREFIX, TRASH},
};

/// Digits of a count at most; a longer number is part of another name.
const DIGITS_MAX: usize = 9;
const COUNT_MAX: u64 = 999_999_999;

/// The file of the last counts, in the takes' folder.
const COUNTS: &str = ".mocapd-counts.json";

/// Names whose counts are kept: years of sessions. Of others the count continues from the folder alone.
const COUNTS_MAX: usize = 1000;

/// Longest file of counts that is read: each entry has a name of at most 182 bytes twice, as a whole and in its parts, six
/// times as many in JSON, and two numbers.
const COUNTS_BYTES_MAX: usize = COUNTS_MAX * 2400;

/// Most files of a folder that are looked at, as for the list of takes.
const FILES_MAX: usize = 100_000;

/// The last counts, by the name without its count.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
struct TrialCounts(BTreeMap<String, LastCount>);

#[derive(Debug, Clone, Serialize, Deserialize)]
struct LastCount {
    count: u64,
    used_unix_ms: i64,
    /// Of what the name consists; an earlier version did not keep it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    names: Option<TrialNames>,
}

impl TrialNames {
    /// The names of a start; `None` if it has none.
    ///
    /// # Errors
    /// A part cannot be part of a file name.
    pub(super) fn of_start(
        start: &Start,
        options: &EngineOptions,
    ) -> Result<Option<Self>, Refusal> {
        let given = |part: &Option<String>| part.clone().unwrap_or_default();
        let mut names = Self {
            subject: given(&start.subject),
            session: given(&start.session),
            trial: given(&start.trial),
        };
        if names == Self::default() {
            return Ok(None);
        }
        if names.subject.is_empty()
            && let Some(subject) = &options.subject
        {
            names.subject.clone_from(&subject.name);
        }
        let subject = if start.subject.is_some() { "subject" } else { "configured subject.name" };
        for (what, part) in
            [(subject, &names.subject), ("session", &names.session), ("trial", &names.trial)]
        {
            check_part(what, part)?;
        }
        Ok(Some(names))
    }

    /// The names that were used last in a folder, for a service that has just started; `None` if that is not known.
    pub(super) fn last(folder: &Path) -> Option<Self> {
        let counts = TrialCounts::read(folder).ok()?;
        let last = counts.0.into_values().max_by_key(|last| last.used_unix_ms)?;
        // Anybody can have written the file.
        last.names.filter(|names| {
            let parts = [&names.subject, &names.session, &names.trial];
            parts.iter().all(|part| check_part("name", part).is_ok())
        })
    }

    /// The name without its count.
    fn base(&self) -> String {
        let parts = [&self.subject, &self.session, &self.trial];
        let given: Vec<&str> =
            parts.into_iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
        given.join("_")
    }

    /// The next name that no take has, or had as far as is known.
    ///
    /// # Errors
    /// The folder cannot be read, or all counts are used.
    pub(super) fn next_name(&self, folder: &Path) -> Result<String, Refusal> {
        let base = self.base();
        // If the counts cannot be read, the reply says so once the take has begun.
        let known = TrialCounts::read(folder).unwrap_or_default();
        let known = known.0.get(&base).map_or(0, |last| last.count);
        let in_folder = last_count(folder, &base, false).map_err(|error| {
            let message = format!("cannot read the folder {}: {error}", folder.display());
            Refusal::new(RefusalKind::Disk, message)
        })?;
        // Usually there is no trash.
        let in_trash = last_count(&folder.join(TRASH), &base, true).unwrap_or(0);
        let count = known.max(in_folder).max(in_trash).saturating_add(1);
        if count > COUNT_MAX {
            let message = format!("all counts of {base} are used: choose another name");
            return Err(Refusal::new(RefusalKind::Exists, message));
        }
        Ok(format!("{base}_{count:03}"))
    }

    /// Notes that a take has got this name.
    ///
    /// # Errors
    /// The file of counts cannot be read or written.
    pub(super) fn note(&self, name: &str, folder: &Path, now_unix_ms: i64) -> anyhow::Result<()> {
        let base = self.base();
        let Some(count) = count_in(name, &base) else { return Ok(()) };
        // Counts that cannot be read are left as they are.
        let mut counts = TrialCounts::read(folder)?;
        let count = counts.0.get(&base).map_or(count, |last| last.count.max(count));
        let names = Some(self.clone());
        counts.0.insert(base, LastCount { count, used_unix_ms: now_unix_ms, names });
        while counts.0.len() > COUNTS_MAX {
            let oldest = counts.0.iter().min_by_key(|(_, last)| last.used_unix_ms);
            let Some(oldest) = oldest.map(|(base, _)| base.clone()) else { break };
            counts.0.remove(&oldest);
        }
        counts.write(folder)
    }

    /// The subject to store in a take: the configured one, or one of another name, to whom the configured skeleton and
    /// face do not belong. With a remark if they are left out.
    pub(super) fn subject(
        &self,
        configured: Option<&Subject>,
    ) -> (Option<Subject>, Option<String>) {
        if self.subject.is_empty() || configured.is_some_and(|it| it.name == self.subject) {
            return (configured.cloned(), None);
        }
        let remark = configured.filter(|it| !it.documents.is_empty()).map(|configured| {
            format!(
                "the take is of {}, so the configured skeleton and face of {} are not stored in it",
                self.subject,
                if configured.name.is_empty() { "another subject" } else { &configured.name }
            )
        });
        let subject = Subject { name: self.subject.clone(), documents: Vec::new() };
        (Some(subject), remark)
    }
}

impl TrialCounts {
    /// Reads the counts; none if there is no file.
    fn read(folder: &Path) -> anyhow::Result<Self> {
        let path = folder.join(COUNTS);
        if path.symlink_metadata().is_err_and(|error| error.kind() == ErrorKind::NotFound) {
            return Ok(Self::default());
        }
        let bytes = files::read_bounded(&path, COUNTS_BYTES_MAX)?;
        serde_json::from_slice(&bytes).with_context(|| format!("{} is damaged", path.display()))
    }

    fn write(&self, folder: &Path) -> anyhow::Result<()> {
        let path = folder.join(COUNTS);
        let writing = || format!("cannot write {}", path.display());
        // Removed when the service starts, if a kill leaves it.
        let temporary = tempfile::Builder::new().prefix(TEMPORARY_PREFIX).tempfile_in(folder);
        let mut file = temporary.with_context(writing)?;
        serde_json::to_writer(&mut file, self).with_context(writing)?;
        file.flush().with_context(writing)?;
        file.as_file().sync_all().with_context(writing)?;
        file.persist(&path).with_context(writing)?;
        Ok(())
    }
}

fn check_part(what: &str, part: &str) -> Result<(), Refusal> {
    let invalid = |message: String| Err(Refusal::new(RefusalKind::Invalid, message));
    if part.len() > NAME_PART_BYTES_MAX {
        return invalid(format!(
            "the {what} has {} bytes; at most {NAME_PART_BYTES_MAX} fit into the names of takes",
            part.len()
        ));
    }
    if part.starts_with(['.', '-', ' ']) || part.ends_with(' ') {
        return invalid(format!(
            "the {what} {part:?} begins with '.', '-' or ' ', or ends with ' ': remove these"
        ));
    }
    if let Some(wrong) = part.chars().find(|&c| is_refused_in_name(c)) {
        return invalid(format!(
            "the {what} cannot contain {wrong:?}, as it becomes part of a file name"
        ));
    }
    Ok(())
}

/// The largest count of a name among the takes of a folder; 0 if there is none.
fn last_count(folder: &Path, base: &str, is_trash: bool) -> std::io::Result<u64> {
    let mut last = 0;
    for entry in fs::read_dir(folder)?.take(FILES_MAX).flatten() {
        let name = entry.file_name();
        let Some(name) = name.to_str() else { continue };
        // In the trash, times come first.
        let name = if is_trash { name.split_once('.').map_or("", |(_, name)| name) } else { name };
        last = last.max(count_in(name, base).unwrap_or(0));
    }
    Ok(last)
}

/// The count in a name, also in that of a recovered or saved take: `BASE_003.recovered`.
fn count_in(name: &str, base: &str) -> Option<u64> {
    let rest = name.strip_prefix(base)?.strip_prefix('_')?;
    let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
    let (digits, rest) = rest.split_at(end);
    let is_count =
        (1..=DIGITS_MAX).contains(&digits.len()) && (rest.is_empty() || rest.starts_with('.'));
    digits.parse().ok().filter(|_| is_count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(subject: &str, session: &str, trial: &str) -> TrialNames {
        let [subject, session, trial] = [subject, session, trial].map(str::to_owned);
        TrialNames { subject, session, trial }
    }

    #[test]
    fn a_count_continues_and_never_returns() {
        let folder = tempfile::tempdir().unwrap();
        let jump = names("S01", "session1", "jump");
        let next = || jump.next_name(folder.path()).unwrap();
        let add = |name: &str| fs::write(folder.path().join(name), b"").unwrap();
        assert_eq!(next(), "S01_session1_jump_001");
        add("S01_session1_jump_003.take");
        add("S01_session1_jump_0012.recovered.take");
        // None of these is a take of that trial.
        add("S01_session1_jump_077_b.take");
        add("S01_session1_jump_x.take");
        add("S01_session1_jump_12345678901234567890.take");
        add("S01_session1_jumping_099.take");
        assert_eq!(next(), "S01_session1_jump_013");
        fs::create_dir(folder.path().join(TRASH)).unwrap();
        add(&format!("{TRASH}/1796000000000.S01_session1_jump_040.take"));
        assert_eq!(next(), "S01_session1_jump_041");
        jump.note("S01_session1_jump_041", folder.path(), 5).unwrap();
        fs::remove_dir_all(folder.path().join(TRASH)).unwrap();
        assert_eq!(next(), "S01_session1_jump_042", "it was given before");
        assert_eq!(names("", "", "jump").next_name(folder.path()).unwrap(), "jump_001");
        // A smaller one that somebody chose does not count.
        jump.note("S01_session1_jump_002", folder.path(), 6).unwrap();
        assert_eq!(next(), "S01_session1_jump_042");
        // A file that is damaged is as none, and stays.
        add(COUNTS);
        assert_eq!(next(), "S01_session1_jump_013");
        jump.note("S01_session1_jump_013", folder.path(), 7).unwrap_err();
        assert_eq!(fs::read(folder.path().join(COUNTS)).unwrap(), b"");
        add("S01_session1_jump_999999999.take");
        assert_eq!(jump.next_name(folder.path()).unwrap_err().kind, RefusalKind::Exists);
    }

    #[test]
    fn the_names_of_the_last_take_are_known_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(TrialNames::last(folder.path()), None);
        names("S01", "session1", "jump").note("S01_session1_jump_001", folder.path(), 7).unwrap();
        names("S02", "", "walk").note("S02_walk_001", folder.path(), 9).unwrap();
        names("", "", "x").note("x_001", folder.path(), 8).unwrap();
        assert_eq!(TrialNames::last(folder.path()), Some(names("S02", "", "walk")));
        // The file of an earlier version, and one that somebody has written.
        let file = folder.path().join(COUNTS);
        fs::write(&file, r#"{"S01_jump":{"count":3,"used_unix_ms":1}}"#).unwrap();
        assert_eq!(TrialNames::last(folder.path()), None);
        let hostile = r#"{"a":{"count":3,"used_unix_ms":1,"names":{"subject":"../a","session":"","trial":""}}}"#;
        fs::write(&file, hostile).unwrap();
        assert_eq!(TrialNames::last(folder.path()), None);
    }

    #[test]
    fn the_file_of_counts_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let mut counts = TrialCounts::default();
        for n in 0..COUNTS_MAX as i64 {
            let long = format!("{n:04}{}", "\u{e9}".repeat(89));
            counts.0.insert(
                long,
                LastCount { count: COUNT_MAX, used_unix_ms: i64::MAX - n, names: None },
            );
        }
        counts.write(folder.path()).unwrap();
        assert_eq!(TrialCounts::read(folder.path()).unwrap().0.len(), COUNTS_MAX);
        names("", "", "jump").note("jump_007", folder.path(), i64::MAX).unwrap();
        let read = TrialCounts::read(folder.path()).unwrap();
        assert_eq!((read.0.len(), read.0["jump"].count), (COUNTS_MAX, 7));
    }

    #[test]
    fn hostile_parts_are_refused() {
        let long = "x".repeat(61);
        for bad in
            ["../x", "a/b", "a\\b", ".x", "-x", " x", "x ", "a\0b", "a\nb", "c:", "\u{202e}", &long]
        {
            assert_eq!(check_part("trial", bad).unwrap_err().kind, RefusalKind::Invalid, "{bad:?}");
        }
        for good in ["", "S01", "Max M\u{fc}ller", "left.shoe", "con", &long[..60]] {
            check_part("trial", good).unwrap();
        }
    }
}
