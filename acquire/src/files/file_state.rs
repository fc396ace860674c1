//! Detects what other programs do to a file while it is written.

use std::{fs::File, os::fd::AsRawFd, path::PathBuf};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What happened to the file of a take while it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FileState {
    /// The file has its name and the length that was written.
    #[default]
    InPlace,
    /// The file has no name any more; its folder may be gone too.
    Removed,
    /// The file, or a folder above it, was renamed.
    Renamed,
    /// Another program truncated it.
    Truncated,
    /// Its file system was unmounted, or another one was mounted over it.
    Unmounted,
}

impl FileState {
    /// All states, indexed by their codes.
    const ALL: [Self; 5] =
        [Self::InPlace, Self::Removed, Self::Renamed, Self::Truncated, Self::Unmounted];

    /// Whether a take in this file has to end: in the other states writing continues.
    #[must_use]
    pub fn ends_take(self) -> bool {
        matches!(self, Self::Truncated | Self::Unmounted)
    }

    pub(crate) fn code(self) -> u8 {
        self as u8
    }

    pub(crate) fn from_code(code: u8) -> Self {
        Self::ALL.get(usize::from(code)).copied().unwrap_or_default()
    }
}

/// Details of a file that is not where it was created, or not as long as what was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DisplacedFile {
    /// What happened.
    pub state: FileState,
    /// The path at which it was created.
    pub created_as: PathBuf,
    /// Its present path, if known.
    pub now_at: Option<PathBuf>,
    /// Path at which users with permission can open it while this process has it open.
    pub open_at: PathBuf,
    /// Bytes in the file, and bytes written.
    pub bytes: (u64, u64),
}

impl DisplacedFile {
    /// What happened and what to do, for a take that is still being recorded.
    #[must_use]
    pub fn message(&self) -> String {
        let Self { created_as, open_at, bytes: (found, written), .. } = self;
        let (take, open_at) = (created_as.display(), open_at.display());
        match self.state {
            FileState::InPlace => format!("the take {take} is back at its path"),
            FileState::Removed => format!(
                "the take {take} was removed during the recording, which continues in {open_at}; a copy is saved at the end, if its folder still exists. To save one now: cp {open_at} NEW.take"
            ),
            FileState::Renamed => format!(
                "the take {take} was renamed during the recording, which continues in {}, open as {open_at}. To copy it before the end: cp {open_at} NEW.take",
                self.now_at
                    .as_ref()
                    .map_or("a file whose name is unknown".into(), |p| p.to_string_lossy())
            ),
            FileState::Truncated => format!(
                "the take {take} was cut short by another program, from {written} to {found} bytes: it ends here; `mocapd recover {take} -o NEW.take` recovers what is left, if its header is intact"
            ),
            FileState::Unmounted => format!(
                "the file system of the take {take} was unmounted, or another one was mounted over it: the take ends here, and is complete on that file system"
            ),
        }
    }
}

/// The file of a take that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SettledFile {
    /// What happened to it.
    pub state: FileState,
    /// Where it is now, or where its copy is if it was removed. `None` if it has no name.
    pub path: Option<PathBuf>,
    /// Details, if it is not in its place.
    pub displaced: Option<DisplacedFile>,
    /// Why a removed file could not be copied.
    pub problem: Option<String>,
}

impl SettledFile {
    /// What happened; `None` when nothing did.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        let displaced = self.displaced.as_ref()?;
        let take = displaced.created_as.display();
        Some(match (self.state, &self.path, &self.problem) {
            (FileState::Removed, Some(copy), _) => format!(
                "the take {take} was removed during the recording, and was saved as {}",
                copy.display()
            ),
            (FileState::Removed, None, problem) => format!(
                "the take {take} was removed during the recording, and could not be saved: {}",
                problem.as_deref().unwrap_or("unknown reason")
            ),
            (FileState::Renamed, Some(path), _) => format!(
                "the take {take} was renamed during the recording: it is now {}",
                path.display()
            ),
            (FileState::Renamed, None, _) => {
                format!("the take {take} was renamed during the recording: its new name is unknown")
            }
            _ => displaced.message(),
        })
    }
}

/// Whether the file's mount is in the mount table. Counts as mounted when the kernel does not say.
pub(super) fn is_mounted(file: &File) -> bool {
    let info = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", file.as_raw_fd()));
    let mounts = std::fs::read_to_string("/proc/self/mountinfo");
    let (Ok(info), Ok(mounts)) = (info, mounts) else { return true };
    mount_of(&info).is_none_or(|id| is_listed(id, &mounts))
}

/// The id of the mount through which the file was opened.
fn mount_of(fdinfo: &str) -> Option<&str> {
    fdinfo.lines().find_map(|line| line.strip_prefix("mnt_id:")).map(str::trim)
}

/// Whether the mount id begins a line of the mount table.
fn is_listed(id: &str, mountinfo: &str) -> bool {
    mountinfo.lines().any(|line| line.split(' ').next() == Some(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_file_is_mounted() {
        assert!(is_mounted(&tempfile::tempfile().unwrap()));
        assert_eq!(mount_of("pos:\t0\nflags:\t0100001\nmnt_id:\t29\nino:\t5\n"), Some("29"));
        assert_eq!(mount_of("pos:\t0\n"), None);
        let mounts = "21 1 8:1 / / rw\n29 21 0:25 / /run rw\n";
        assert!(is_listed("29", mounts) && !is_listed("2", mounts) && !is_listed("30", mounts));
    }
}
