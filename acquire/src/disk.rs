//! Whether a disk has room for a take.

use std::path::Path;

use anyhow::bail;
use rustix::fs::statvfs;

use crate::pipeline::HELD_MIN_BYTES;

/// Makes sure that a take can be begun at `path` without taking what has to stay free.
///
/// # Errors
/// How much is free, how much must be, and what to do.
pub fn check_room(path: &Path, keep_free_bytes: u64) -> anyhow::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    // What cannot be told is not held against it: creating the file will tell.
    let Ok(disk) = statvfs(folder.unwrap_or(Path::new("."))) else { return Ok(()) };
    let free_bytes = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free_bytes < keep_free_bytes.saturating_add(HELD_MIN_BYTES) {
        bail!(
            "the disk is nearly full: {:.0} MB are free for {}, and {:.0} MB have to stay free (--keep-free, take.keep_free) beside {:.0} MB \
             to close a take in: delete something, or record to another disk",
            mb(free_bytes),
            path.display(),
            mb(keep_free_bytes),
            mb(HELD_MIN_BYTES)
        );
    }
    Ok(())
}

fn mb(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}
