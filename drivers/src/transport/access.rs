//! Checks whether a device file can be opened, without opening it: opening a port raises DTR, which
//! resets some devices.

use std::{fs, os::unix::fs::MetadataExt, path::Path};

use rustix::fs::{Access as Want, major, minor};

use super::TransportError;

/// Result of checking access to a device.
#[derive(Debug)]
pub enum Access {
    /// Nothing visible from outside prevents opening.
    Accessible,
    /// The error that opening would return.
    Refused(TransportError),
}

/// Checks existence, permission and lock of a device file.
#[must_use]
pub fn access(path: &Path) -> Access {
    let device = path.display().to_string();
    if !path.exists() {
        return Access::Refused(TransportError::NotFound { device });
    }
    if rustix::fs::access(path, Want::READ_OK | Want::WRITE_OK).is_err() {
        let remedy = permission_remedy(path);
        return Access::Refused(TransportError::PermissionDenied { device, remedy });
    }
    match holder(path) {
        Some(holder) => Access::Refused(TransportError::Busy { device, holder: Some(holder) }),
        None => Access::Accessible,
    }
}

/// The command that gives the user permission to open `path`.
pub(super) fn permission_remedy(path: &Path) -> String {
    let by_rule = || "install mocapd's udev rules, or ask your administrator".to_owned();
    group_remedy(path).unwrap_or_else(by_rule)
}

/// The command to join the group that may open `path`; `None` if only root's group may.
pub(super) fn group_remedy(path: &Path) -> Option<String> {
    const GROUP_READ_WRITE: u32 = 0o060;
    let metadata = fs::metadata(path).ok()?;
    if metadata.gid() == 0 || metadata.mode() & GROUP_READ_WRITE != GROUP_READ_WRITE {
        return None;
    }
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let group = group_name(&groups, metadata.gid())?;
    Some(format!("`sudo usermod -aG {group} $USER`, then log in again"))
}

/// Finds the name of a group in the text of /etc/group (`name:password:gid:members`).
fn group_name(groups: &str, gid: u32) -> Option<&str> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(gid)).then_some(name)
    })
}

/// The program that holds a file lock on `path`. Programs that use the serialport crate, picocom and tio
/// lock the ports that they open.
pub(super) fn holder(path: &Path) -> Option<String> {
    let metadata = fs::metadata(path).ok()?;
    let locks = fs::read_to_string("/proc/locks").ok()?;
    let file =
        format!("{:02x}:{:02x}:{}", major(metadata.dev()), minor(metadata.dev()), metadata.ino());
    let process = lock_owner(&locks, &file)?;
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    Some(match name.trim() {
        "" => format!("process {process}"),
        name => format!("{name} (process {process})"),
    })
}

/// Finds the process that holds a lock in the text of /proc/locks
/// (`1: FLOCK  ADVISORY  WRITE 1234 00:05:678 0 EOF`, `proc_locks(5)`).
fn lock_owner(locks: &str, file: &str) -> Option<u32> {
    locks.lines().find_map(|line| {
        let mut fields = line.split_ascii_whitespace().skip(1);
        if fields.next() != Some("FLOCK") {
            return None;
        }
        let process = fields.nth(2)?.parse().ok()?;
        (fields.next() == Some(file)).then_some(process)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_is_found_by_its_number() {
        let groups = "root:x:0:\ndialout:x:20:anna\nbroken\n:x:\nplugdev:x:46:\n";
        assert_eq!(group_name(groups, 20), Some("dialout"));
        assert_eq!(group_name(groups, 46), Some("plugdev"));
        assert_eq!(group_name(groups, 5), None);
    }

    #[test]
    fn the_owner_of_a_lock_is_found() {
        let locks = "1: POSIX  ADVISORY  WRITE 11 00:05:678 0 EOF\n\
                     2: FLOCK  ADVISORY  WRITE 1234 00:05:678 0 EOF\n\
                     3: -> FLOCK  ADVISORY  WRITE 9 00:05:679 0 EOF\ngarbage\n";
        assert_eq!(lock_owner(locks, "00:05:678"), Some(1234));
        assert_eq!(lock_owner(locks, "00:05:679"), None, "a waiter holds nothing");
        assert_eq!(lock_owner(locks, "00:05:1"), None);
    }

    #[test]
    fn access_to_a_locked_file_names_the_holder() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(access(file.path()), Access::Accessible));
        file.as_file().lock().unwrap();
        let Access::Refused(TransportError::Busy { holder: Some(holder), .. }) =
            access(file.path())
        else {
            panic!("{:?}", access(file.path()));
        };
        assert!(holder.contains(&format!("process {}", std::process::id())), "{holder}");
    }

    #[test]
    fn the_remedy_names_the_group_to_join() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let remedy = permission_remedy(file.path());
        assert!(remedy.contains("udev"), "{remedy}");
        assert!(!remedy.contains("usermod"), "0600 helps no group: {remedy}");
        let groups = fs::read_to_string("/etc/group").unwrap();
        let Some((gid, name)) =
            [20, 5, 46].iter().find_map(|&gid| Some((gid, group_name(&groups, gid)?)))
        else {
            eprintln!("skipped: none of the usual groups here");
            return;
        };
        if std::os::unix::fs::chown(file.path(), None, Some(gid)).is_err() {
            eprintln!("skipped: only root may give a file away");
            return;
        }
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o660);
        fs::set_permissions(file.path(), mode).unwrap();
        let remedy = permission_remedy(file.path());
        assert!(remedy.contains(&format!("sudo usermod -aG {name} $USER")), "{remedy}");
    }

    #[test]
    fn a_missing_file_is_not_found() {
        let missing = Path::new("/dev/mocapd-no-such-port");
        assert!(matches!(access(missing), Access::Refused(TransportError::NotFound { .. })));
    }
}
