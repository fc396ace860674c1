//! What `cut` and `concat` share: reading takes, and writing a new one.

use std::{
    io::{BufReader, BufWriter},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::Context;
use mocapd_acquire::{
    files::{self, CountingFile},
    header::SOFTWARE,
};
use mocapd_take::{
    TakeError,
    edit::{EditContext, SourceTake},
};

use super::{
    batch::outputs::{self, SeekWrite},
    output::{Progress, notify},
    remote,
};

/// Opens a take. `read` counts its bytes.
pub(super) fn open(path: &Path, read: &Arc<AtomicU64>) -> anyhow::Result<BufReader<CountingFile>> {
    Ok(BufReader::new(CountingFile::new(remote::open(path)?, read)))
}

/// Reads everything of the takes at `paths` but their samples, and checks every checksum.
///
/// # Errors
/// If one cannot be read, is damaged or was cut off.
pub(super) fn read_sources(paths: &[impl AsRef<Path>]) -> anyhow::Result<Vec<SourceTake>> {
    remote::fetch(paths)?;
    let mut bytes = 0;
    for path in paths {
        bytes += remote::len_bytes(path.as_ref())?;
    }
    let read = Arc::new(AtomicU64::new(0));
    let _progress = Progress::follow("reading", &read, bytes);
    let source = |path: &Path| {
        let reading = || format!("cannot read {}", path.display());
        SourceTake::read(&mut open(path, &read)?).with_context(reading)
    };
    paths.iter().map(|path| source(path.as_ref())).collect()
}

/// Writes a new take of `rows` rows atomically: under its name there is the whole take or none.
///
/// # Errors
/// If it exists or cannot be written, and the errors of `edit`.
pub(super) fn write<T>(
    to: &Path,
    what: &'static str,
    rows: u64,
    edit: impl FnOnce(&mut BufWriter<&mut dyn SeekWrite>, &EditContext<'_>) -> Result<T, TakeError>,
) -> anyhow::Result<T> {
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow(what, &counter, rows);
    let on_rows = |rows| counter.store(rows, Ordering::Relaxed);
    let context =
        EditContext { software: SOFTWARE, new_scratch: &files::scratch, on_rows: &on_rows };
    let (written, _) = outputs::write_whole(to, false, |out| {
        let mut out = BufWriter::new(out);
        let written = edit(&mut out, &context);
        drop(progress);
        written.with_context(|| format!("cannot write {}", to.display()))
    })?;
    Ok(written)
}

/// Reports what the new take lacks.
pub(super) fn notify_left_out(output: &Path, left_out: &[String]) {
    if !left_out.is_empty() {
        notify(&format!("{}: left out: {}", output.display(), left_out.join(", ")));
    }
}
