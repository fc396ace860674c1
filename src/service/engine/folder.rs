//! The takes in the service's folder.

use std::{
    fs::{self, File},
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    time::SystemTime,
};

use mocapd_take::{TakeEvent, TakeReader, index::Footer};

use super::{Inner, names};
use crate::service::{
    control::{Refusal, RefusalKind},
    status::TakeSummary,
};

/// Bytes of a take that are read for what its header says: of hundreds of markers.
const HEAD_BYTES: u64 = 64 << 10;

/// Files of a folder that are looked at: more is no folder of takes.
const FILES_MAX: usize = 100_000;

impl Inner {
    pub(super) fn list_takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal> {
        let core = self.core();
        let directory = core.options.directory.clone();
        let open = core.take.as_ref().map(|take| take.path.clone());
        let last = core.last_take.clone();
        drop(core);
        let cannot = |error: std::io::Error| {
            let words = format!("cannot read the folder {}: {error}", directory.display());
            Refusal::new(RefusalKind::Disk, words)
        };
        let mut found = Vec::new();
        for entry in fs::read_dir(&directory).map_err(cannot)?.take(FILES_MAX).flatten() {
            let path = entry.path();
            let is_take = path.extension().is_some_and(|extension| extension == "take");
            let Ok(file) = entry.metadata() else { continue };
            if is_take && file.is_file() {
                found.push((file.modified().unwrap_or(SystemTime::UNIX_EPOCH), file.len(), path));
            }
        }
        found.sort_by(|a, b| b.cmp(a));
        found.truncate(limit);
        let summary = |(modified, bytes, path): (SystemTime, u64, PathBuf)| {
            let since_1970 = modified.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            let mut summary = TakeSummary {
                name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
                bytes,
                modified_unix_ms: i64::try_from(since_1970.as_millis()).unwrap_or(i64::MAX),
                is_open: open.as_ref() == Some(&path),
                health: "unknown".to_owned(),
                ..TakeSummary::default()
            };
            look_into(&path, &mut summary);
            // What was counted while it was written is known better.
            if let Some(last) = last.as_ref().filter(|last| last.take_id == summary.take_id) {
                summary.health.clone_from(&last.health);
                summary.seconds = last.seconds;
                summary.ending.clone_from(&last.ending);
            }
            summary
        };
        Ok(found.into_iter().map(summary).collect())
    }

    pub(super) fn path_of(&self, name: &str) -> Result<PathBuf, Refusal> {
        let name = names::checked(name)?;
        let path = self.core().options.directory.join(format!("{name}.take"));
        // A link could lead out of the folder.
        if path.symlink_metadata().is_ok_and(|file| file.is_file()) {
            return Ok(path);
        }
        Err(Refusal::new(RefusalKind::NotFound, format!("there is no take called {name}")))
    }
}

/// What header and footer tell, without reading what lies between.
fn look_into(path: &Path, summary: &mut TakeSummary) {
    let Ok(mut file) = File::open(path) else { return };
    let mut head = Vec::new();
    if (&mut file).take(HEAD_BYTES).read_to_end(&mut head).is_err() {
        return;
    }
    let mut rate_hz = 0.0;
    let mut reader = TakeReader::new();
    reader.push(&head);
    while let Ok(Some(event)) = reader.next_event() {
        if let TakeEvent::Header(header) = event {
            rate_hz = header.rate_hz;
            summary.markers = header.channels.len();
            summary.take_id = header.take_id.iter().map(|byte| format!("{byte:02x}")).collect();
            break;
        }
    }
    if rate_hz == 0.0 {
        summary.health = "unreadable".to_owned();
        return;
    }
    if summary.is_open {
        return;
    }
    match footer(&mut file, summary.bytes) {
        Some(footer) => {
            summary.health = "complete".to_owned();
            summary.seconds = footer.n_rows as f64 / rate_hz;
        }
        None => summary.health = "cut off".to_owned(),
    }
}

/// The footer, by its checksum.
fn footer(file: &mut File, file_bytes: u64) -> Option<Footer> {
    let at = file_bytes.checked_sub(Footer::CHUNK_BYTES as u64)?;
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut chunk = [0; Footer::CHUNK_BYTES];
    file.read_exact(&mut chunk).ok()?;
    Footer::from_chunk(&chunk)
}
