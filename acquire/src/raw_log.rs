//! `record --raw`: every byte on the device's line goes into a log, too, without the reader waiting for a disk.
//!
//! A [`Tap`] sits around the transport and copies what passes into blocks; a thread writes them. When no block is free
//! the log says how many bytes are missing, and the recording goes on.

mod tap;
mod write;

#[cfg(test)]
mod tests;

use std::{
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use anyhow::Context;
use crossbeam_channel::bounded;
use mocapd_drivers::raw_log::{Entry, Record, put_head, put_record};

pub use tap::Tap;

use crate::{
    files::{self, FileId},
    host_clock::monotonic_ns,
    threads,
};

/// A block is handed over when it holds so much: the writes of a disk.
const BLOCK_BYTES: usize = 64 << 10;

/// A block has room for one read more.
const BLOCK_CAPACITY_BYTES: usize = 2 * BLOCK_BYTES;

/// Blocks in all, 16 MiB: five seconds of the fastest line (200 markers at 1000 Hz, 3.1 MB/s).
const BLOCKS: usize = 128;

/// A raw log under way.
#[derive(Debug)]
pub struct RawLog {
    path: PathBuf,
    file_bytes: Arc<AtomicU64>,
    tap: Tap,
    thread: JoinHandle<write::Written>,
}

/// What a raw log came to.
#[derive(Debug)]
pub struct RawLogged {
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes of the line that are in it.
    pub line_bytes: u64,
    /// Bytes of the line that are not, because the disk did not take them, or not in time.
    pub missing_bytes: u64,
    /// Why it ends early: what is in it can be read.
    pub error: Option<io::Error>,
}

impl RawLogged {
    /// Whether every byte of the line is in it, and its end.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.missing_bytes == 0 && self.error.is_none()
    }
}

/// Some of a log, on its way to the disk.
#[derive(Debug, Default)]
struct Block {
    bytes: Vec<u8>,
    /// Bytes of the line in it.
    line_bytes: u64,
}

impl Block {
    fn new() -> Self {
        Self { bytes: Vec::with_capacity(BLOCK_CAPACITY_BYTES), line_bytes: 0 }
    }

    fn clear(&mut self) {
        self.bytes.clear();
        self.line_bytes = 0;
    }
}

/// What taps and the log have in common.
#[derive(Debug, Default)]
struct Totals {
    /// Bytes that passed.
    line_bytes: AtomicU64,
    /// Of these, the ones for which no block was free, and that the log does not tell yet.
    untold_bytes: AtomicU64,
}

impl RawLog {
    /// Begins a log in a file that must not exist. What is written is forced onto the disk every `sync_every`.
    ///
    /// # Errors
    /// When it does, or cannot be made.
    pub fn start(path: &Path, sync_every: Duration) -> anyhow::Result<Self> {
        let mut file = files::create_new(path)?;
        let id = FileId::of(&file.metadata()?);
        files::sync_name(path);
        let mut head = Vec::new();
        put_head(&mut head);
        let name = path.display().to_string();
        if let Err(error) = file.write_all(&head) {
            // Half of a head is no log, and takes the name.
            id.remove(path).ok();
            return Err(error).with_context(|| format!("cannot write {name}"));
        }
        let (full, blocks) = bounded(BLOCKS);
        let (free, emptied) = bounded(BLOCKS);
        for _ in 0..BLOCKS {
            // Never full: it holds every block there is.
            free.try_send(Block::new()).ok();
        }
        let file_bytes = Arc::new(AtomicU64::new(head.len() as u64));
        let counted = Arc::clone(&file_bytes);
        let work = move || write::write(file, &counted, sync_every, &blocks, &free);
        let thread = threads::spawn("mocapd-raw", work)?;
        let tap = Tap::new(monotonic_ns(), full, emptied, Arc::default());
        Ok(Self { path: path.to_owned(), file_bytes, tap, thread })
    }

    /// What copies a line's bytes into it.
    #[must_use]
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// Where it is written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file: they grow as it is written.
    #[must_use]
    pub fn file_bytes(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.file_bytes)
    }

    /// Ends the log. Every other tap must be gone.
    ///
    /// # Errors
    /// When its thread panicked.
    pub fn finish(self) -> anyhow::Result<RawLogged> {
        let passed = self.tap.end();
        let write::Written { line_bytes, error } = threads::join(self.thread)?;
        Ok(RawLogged {
            file_bytes: self.file_bytes.load(Ordering::Relaxed),
            line_bytes,
            missing_bytes: passed.line_bytes.load(Ordering::Relaxed).saturating_sub(line_bytes),
            error,
        })
    }
}

/// Appends a record that is now.
fn put(entry: Entry<'_>, began_ns: u64, block: &mut Vec<u8>) {
    let time_ns = monotonic_ns().saturating_sub(began_ns);
    put_record(&Record { time_ns, entry }, block);
}
