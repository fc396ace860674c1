//! The temporary names of outputs that are not complete yet, so that a program that is interrupted can remove them.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// How to remove a hidden path.
#[derive(Debug, Clone)]
enum Kind {
    File,
    /// The staging folder of this data set, and what removes it and what was added from it.
    Staging {
        dataset: PathBuf,
        discard: fn(&Path, &Path),
    },
}

impl Kind {
    fn remove(&self, path: &Path) {
        match self {
            Self::File => drop(fs::remove_file(path)),
            Self::Staging { dataset, discard } => discard(path, dataset),
        }
    }
}

/// The hidden paths of this process.
static HIDDEN: Mutex<BTreeMap<PathBuf, Kind>> = Mutex::new(BTreeMap::new());

fn hidden() -> MutexGuard<'static, BTreeMap<PathBuf, Kind>> {
    HIDDEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A hidden file or staging folder, which is removed when this is dropped. Once a file has its final name, nothing is at
/// the hidden path, or a second link to the kept file.
#[derive(Debug)]
pub(super) struct HiddenPath(PathBuf, Kind);

impl HiddenPath {
    pub(super) fn file(path: PathBuf) -> Self {
        Self::new(path, Kind::File)
    }

    pub(super) fn staging(path: PathBuf, dataset: PathBuf, discard: fn(&Path, &Path)) -> Self {
        Self::new(path, Kind::Staging { dataset, discard })
    }

    fn new(path: PathBuf, kind: Kind) -> Self {
        hidden().insert(path.clone(), kind.clone());
        Self(path, kind)
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// Renames the folder; from then on only the folder itself is removed, by `remove`, and what was added from it stays.
    /// Waits for ever if the program is being interrupted.
    pub(super) fn commit(&mut self, to: PathBuf, remove: fn(&Path, &Path)) {
        let mut paths = hidden();
        paths.remove(&self.0);
        if fs::rename(&self.0, &to).is_ok() {
            self.0 = to;
        }
        if let Kind::Staging { discard, .. } = &mut self.1 {
            *discard = remove;
        }
        paths.insert(self.0.clone(), self.1.clone());
    }
}

impl Drop for HiddenPath {
    fn drop(&mut self) {
        self.1.remove(&self.0);
        hidden().remove(&self.0);
    }
}

/// Removes every incomplete output, for a process that is about to end. As long as the result is held no other can be
/// created: the thread that tries waits.
#[must_use]
pub fn remove_incomplete_outputs() -> impl Sized {
    let paths = hidden();
    for (path, kind) in paths.iter() {
        kind.remove(path);
    }
    paths
}
