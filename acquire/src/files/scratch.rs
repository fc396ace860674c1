//! A temporary file for what is too much for memory.

use std::{
    fs::File,
    io,
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::Arc,
};

use mocapd_take::content::ScratchFile;

#[derive(Debug)]
struct Scratch {
    file: File,
    dir: PathBuf,
}

impl ScratchFile for Scratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(bytes, at)
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all_at(bytes, at).map_err(|error| failed(&self.dir, &error))
    }
}

/// A file without a name, which is gone with the process. In `$TMPDIR`, or in `/var/tmp`, which is on a disk where `/tmp` is
/// often memory.
///
/// # Errors
/// That there can be none, and what to do.
pub fn scratch() -> io::Result<Arc<dyn ScratchFile>> {
    let chosen = std::env::var_os("TMPDIR").filter(|dir| !dir.is_empty()).map(PathBuf::from);
    let on_disk = || Some(PathBuf::from("/var/tmp")).filter(|dir| dir.is_dir());
    let dir = chosen.or_else(on_disk).unwrap_or_else(std::env::temp_dir);
    let file = tempfile::tempfile_in(&dir).map_err(|error| failed(&dir, &error))?;
    Ok(Arc::new(Scratch { file, dir }))
}

fn failed(dir: &Path, error: &io::Error) -> io::Error {
    let message = format!(
        "no room for a temporary file in {} with what the take keeps of its source ({error}): set TMPDIR to another folder",
        dir.display()
    );
    io::Error::new(error.kind(), message)
}
