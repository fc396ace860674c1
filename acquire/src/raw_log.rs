//! A raw log: every byte on the device's line goes into a log, too, without the reader waiting for a disk.
//!
//! A [`Tap`] sits around the transport and copies what passes into blocks; a thread writes them. When no block is free
//! the log says how many bytes are missing, and the recording goes on.

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
    time::{Duration, Instant},
};

use anyhow::Context;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use mocapd_drivers::{
    raw_log::{Entry, RECORD_OVERHEAD_BYTES, Record, put_head, put_record},
    transport::{Transport, TransportError},
};

use crate::{
    files::{self, FileId},
    host_clock::monotonic_ns,
    threads,
};

/// A block is handed over when it holds so much: the writes of a disk.
const BLOCK_BYTES: usize = 64 << 10;

/// A block has room for one read more.
const BLOCK_CAPACITY_BYTES: usize = 2 * BLOCK_BYTES;

/// Blocks in all: 8 MiB of a log, in 16 MiB of memory. The fastest line (200 markers at 1000 Hz, 3.1 MB/s) fills them in
/// 2.7 s.
const BLOCKS: usize = 128;

/// A raw log under way.
#[derive(Debug)]
pub struct RawLog {
    path: PathBuf,
    file_bytes: Arc<AtomicU64>,
    tap: Tap,
    thread: JoinHandle<Written>,
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
        let work = move || write(file, &counted, sync_every, &blocks, &free);
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
        let Written { line_bytes, error } = threads::join(self.thread)?;
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

/// A block that holds anything is handed over after so long while the disk keeps up: what a killed recorder loses of its log.
const BLOCK_NS_MAX: u64 = 100_000_000;

/// Room that is kept for what is missing, a closed line, and the end.
const SPARE_BYTES: usize = 3 * RECORD_OVERHEAD_BYTES + 8;

/// The way into a raw log. Copies share the log, each with a block of its own: one is in use at a time.
#[derive(Debug)]
pub struct Tap {
    began_ns: u64,
    full: Sender<Block>,
    free: Receiver<Block>,
    totals: Arc<Totals>,
    /// Without memory of its own between two of them.
    block: Block,
    block_since_ns: u64,
}

impl Clone for Tap {
    fn clone(&self) -> Self {
        Self::new(self.began_ns, self.full.clone(), self.free.clone(), Arc::clone(&self.totals))
    }
}

impl Tap {
    fn new(began_ns: u64, full: Sender<Block>, free: Receiver<Block>, totals: Arc<Totals>) -> Self {
        Self { began_ns, full, free, totals, block: Block::default(), block_since_ns: 0 }
    }

    /// A line whose bytes go through a tap of its own.
    #[must_use]
    pub fn on(&self, family: &str, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let mut tap = self.clone();
        tap.put(Entry::Opened(&format!("{family} {}", line.describe())));
        Box::new(Tapped { line, tap, gone: false })
    }

    /// Into the block, or into the count of what is missing: it never waits.
    fn put(&mut self, entry: Entry<'_>) {
        let n_bytes = match entry {
            Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => bytes.len(),
            Entry::Break
            | Entry::Baud(_)
            | Entry::Opened(_)
            | Entry::Missing(_)
            | Entry::Closed
            | Entry::End => 0,
        };
        let words_bytes = if let Entry::Opened(words) = entry { words.len() } else { 0 };
        let needed = n_bytes + words_bytes + RECORD_OVERHEAD_BYTES + SPARE_BYTES;
        self.totals.line_bytes.fetch_add(n_bytes as u64, Ordering::Relaxed);
        if self.block.bytes.len() + needed > BLOCK_CAPACITY_BYTES {
            self.hand_over();
        }
        if self.block.bytes.capacity() == 0 {
            let Ok(block) = self.free.try_recv() else { return self.miss(n_bytes) };
            self.begin(block);
        }
        // A single read that no block holds: the largest that a host makes has half of one.
        if self.block.bytes.len() + needed > self.block.bytes.capacity() {
            return self.miss(n_bytes);
        }
        put(entry, self.began_ns, &mut self.block.bytes);
        self.block.line_bytes += n_bytes as u64;
        if self.block.bytes.len() >= BLOCK_BYTES {
            self.hand_over();
        }
    }

    /// A new block says first what is missing before it.
    fn begin(&mut self, block: Block) {
        self.block = block;
        self.block_since_ns = monotonic_ns();
        let missing = self.totals.untold_bytes.swap(0, Ordering::Relaxed);
        if missing > 0 {
            put(Entry::Missing(missing), self.began_ns, &mut self.block.bytes);
        }
    }

    fn miss(&mut self, n_bytes: usize) {
        self.totals.untold_bytes.fetch_add(n_bytes as u64, Ordering::Relaxed);
    }

    fn hand_over(&mut self) {
        if !self.block.bytes.is_empty() {
            // Never full: it holds every block there is.
            self.full.try_send(std::mem::take(&mut self.block)).ok();
        }
    }

    /// Time passed.
    fn tick(&mut self) {
        let age_ns = monotonic_ns().saturating_sub(self.block_since_ns);
        // With a disk that stalls, blocks of a slow line would be used up nearly empty.
        let keeps_up = self.free.len() >= self.free.capacity().unwrap_or(0) / 2;
        if !self.block.bytes.is_empty() && age_ns > BLOCK_NS_MAX && keeps_up {
            self.hand_over();
        }
    }

    /// Nothing comes any more.
    fn end(mut self) -> Arc<Totals> {
        // The recording is over: now there is time to wait for the disk.
        if self.block.bytes.capacity() == 0
            && let Ok(block) = self.free.recv()
        {
            self.begin(block);
        }
        self.put(Entry::End);
        self.hand_over();
        Arc::clone(&self.totals)
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.hand_over();
    }
}

/// A line that is listened to.
#[derive(Debug)]
struct Tapped {
    line: Box<dyn Transport>,
    tap: Tap,
    /// That it is gone was told.
    gone: bool,
}

impl Tapped {
    fn close(&mut self) {
        if !std::mem::replace(&mut self.gone, true) {
            self.tap.put(Entry::Closed);
        }
    }

    fn look<T>(&mut self, outcome: Result<T, TransportError>) -> Result<T, TransportError> {
        if let Err(TransportError::Disconnected { .. }) = outcome {
            self.close();
        }
        outcome
    }
}

impl Drop for Tapped {
    fn drop(&mut self) {
        self.close();
    }
}

impl Transport for Tapped {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let outcome = self.line.read(buf);
        if let Ok(n @ 1..) = outcome {
            self.tap.put(Entry::FromDevice(buf.get(..n).unwrap_or_default()));
        }
        self.tap.tick();
        self.look(outcome)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        // Before it is answered.
        self.tap.put(Entry::ToDevice(bytes));
        let outcome = self.line.write_all(bytes);
        self.look(outcome)
    }

    fn send_break(&mut self) -> Result<bool, TransportError> {
        let outcome = self.line.send_break();
        if let Ok(true) = outcome {
            self.tap.put(Entry::Break);
        }
        self.look(outcome)
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        let outcome = self.line.set_baud(baud);
        if outcome.is_ok() {
            self.tap.put(Entry::Baud(baud));
        }
        self.look(outcome)
    }

    fn inner(&self) -> Option<&dyn Transport> {
        Some(&*self.line)
    }
}

/// Where a log goes.
trait LogOutput: Write {
    /// Forces what was written onto the disk.
    ///
    /// # Errors
    /// The disk's.
    fn sync(&mut self) -> io::Result<()>;
}

impl LogOutput for std::fs::File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// What the thread came to.
#[derive(Debug, Default)]
struct Written {
    /// Bytes of the line in the blocks that were written whole.
    line_bytes: u64,
    /// After one nothing is written any more.
    error: Option<io::Error>,
}

/// Blocks to the file, and back to the taps, until the last tap is gone. After an error it only gives them back.
fn write(
    mut file: impl LogOutput,
    file_bytes: &AtomicU64,
    sync_every: Duration,
    blocks: &Receiver<Block>,
    free: &Sender<Block>,
) -> Written {
    let mut written = Written::default();
    // Since when something is not forced onto the disk: at first what a log begins with.
    let mut unsynced = Some(Instant::now());
    loop {
        let due = unsynced.map(|since| since + sync_every);
        let block = match due {
            Some(due) => blocks.recv_deadline(due),
            None => blocks.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        let is_over = matches!(block, Err(RecvTimeoutError::Disconnected));
        if let Ok(mut block) = block {
            if written.error.is_none() {
                match file.write_all(&block.bytes) {
                    Ok(()) => {
                        written.line_bytes += block.line_bytes;
                        file_bytes.fetch_add(block.bytes.len() as u64, Ordering::Relaxed);
                        unsynced.get_or_insert_with(Instant::now);
                    }
                    Err(error) => written.error = Some(error),
                }
            }
            block.clear();
            free.try_send(block).ok();
        }
        let is_due = due.is_some_and(|due| Instant::now() >= due) || sync_every.is_zero();
        if written.error.is_none() && (is_over || is_due) && unsynced.take().is_some() {
            written.error = file.sync().err();
        }
        if is_over {
            return written;
        }
    }
}
