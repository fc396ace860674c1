//! Whether the file system of an open file is still mounted.

use std::{fs::File, os::fd::AsRawFd};

/// Whether it is in the list of what is mounted. Where the kernel tells no such thing it counts as mounted.
pub(super) fn is_mounted(file: &File) -> bool {
    let info = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", file.as_raw_fd()));
    let mounts = std::fs::read_to_string("/proc/self/mountinfo");
    let (Ok(info), Ok(mounts)) = (info, mounts) else { return true };
    mount_of(&info).is_none_or(|id| is_listed(id, &mounts))
}

/// The number of the mount that a file was opened through.
fn mount_of(fdinfo: &str) -> Option<&str> {
    fdinfo.lines().find_map(|line| line.strip_prefix("mnt_id:")).map(str::trim)
}

/// Each line begins with the number of a mount.
fn is_listed(id: &str, mountinfo: &str) -> bool {
    mountinfo.lines().any(|line| line.split(' ').next() == Some(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_open_here_is_mounted() {
        assert!(is_mounted(&tempfile::tempfile().unwrap()));
        assert_eq!(mount_of("pos:\t0\nflags:\t0100001\nmnt_id:\t29\nino:\t5\n"), Some("29"));
        assert_eq!(mount_of("pos:\t0\n"), None);
        let mounts = "21 1 8:1 / / rw\n29 21 0:25 / /run rw\n";
        assert!(is_listed("29", mounts) && !is_listed("2", mounts) && !is_listed("30", mounts));
    }
}
