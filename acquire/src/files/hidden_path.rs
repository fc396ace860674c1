//! The temporary names of files that are not complete yet, so that a program that is interrupted can remove them.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// The hidden paths of this process.
static HIDDEN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn hidden() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    HIDDEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A hidden file, which is removed when this is dropped. Once it has its final name, nothing is at the hidden
/// path, or a second link to the kept file.
#[derive(Debug)]
pub(super) struct HiddenPath(PathBuf);

impl HiddenPath {
    pub(super) fn new(path: PathBuf) -> Self {
        hidden().insert(path.clone());
        Self(path)
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for HiddenPath {
    fn drop(&mut self) {
        fs::remove_file(&self.0).ok();
        hidden().remove(&self.0);
    }
}

/// Removes every incomplete output, for a process that is about to end. As long as the result is held no other can be
/// created: the thread that tries waits.
#[must_use]
pub fn remove_incomplete_outputs() -> impl Sized {
    let paths = hidden();
    for path in paths.iter() {
        fs::remove_file(path).ok();
    }
    paths
}
