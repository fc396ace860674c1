//! The raw log: copies every byte on the device's line to a file, without making the reader wait for the disk.
//!
//! A [`RawLogTap`] wraps the transport and copies its bytes into blocks, which a thread writes. When no block is free,
//! the log records how many bytes are missing, and the recording continues.

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
    raw_log::{Entry, RECORD_OVERHEAD_BYTES, Record, put_header, put_record},
    transport::{Transport, TransportError},
};

use crate::{
    files::{self, FileId},
    host_clock::monotonic_ns,
    threads,
};

/// Size at which a block is handed over for writing.
const BLOCK_BYTES: usize = 64 << 10;

/// Capacity of a block: one more read fits.
const BLOCK_CAPACITY_BYTES: usize = 2 * BLOCK_BYTES;

/// Number of blocks: 8 MiB of log in 16 MiB of memory. The fastest line (200 markers at 1000 Hz, 3.1 MB/s) fills them
/// in 2.7 s.
const BLOCKS: usize = 128;

/// A raw log that is being written.
#[derive(Debug)]
pub struct RawLog {
    path: PathBuf,
    file_bytes: Arc<AtomicU64>,
    tap: RawLogTap,
    thread: JoinHandle<WriterOutcome>,
}

/// The account of a finished raw log.
#[derive(Debug)]
pub struct RawLogged {
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes of the line in the log.
    pub line_bytes: u64,
    /// Bytes of the line that the disk did not accept, or not in time.
    pub missing_bytes: u64,
    /// Why the log ends early: what was written before can be read.
    pub error: Option<io::Error>,
}

impl RawLogged {
    /// Whether the log contains every byte of the line, and its end.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.missing_bytes == 0 && self.error.is_none()
    }
}

/// A piece of the log in memory.
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

/// Counters shared by all taps of a log.
#[derive(Debug, Default)]
struct Totals {
    /// Bytes that passed on the line.
    line_bytes: AtomicU64,
    /// Bytes that found no free block, and that the log does not mention yet.
    unreported_bytes: AtomicU64,
}

impl RawLog {
    /// Starts a log in a file that must not exist yet, and syncs it every `sync_every`.
    ///
    /// # Errors
    /// When the file exists or cannot be created.
    pub fn start(path: &Path, sync_every: Duration) -> anyhow::Result<Self> {
        let mut file = files::create_new(path)?;
        let id = FileId::of(&file.metadata()?);
        files::sync_name(path);
        let mut head = Vec::new();
        put_header(&mut head);
        let name = path.display().to_string();
        if let Err(error) = file.write_all(&head) {
            // Half a head is not a log, and occupies the name.
            id.remove(path).ok();
            return Err(error).with_context(|| format!("cannot write {name}"));
        }
        let (full, blocks) = bounded(BLOCKS);
        let (free, emptied) = bounded(BLOCKS);
        for _ in 0..BLOCKS {
            // Never full: the queue has a place for every block.
            free.try_send(Block::new()).ok();
        }
        let file_bytes = Arc::new(AtomicU64::new(head.len() as u64));
        let counted = Arc::clone(&file_bytes);
        let work = move || write_blocks(file, &counted, sync_every, &blocks, &free);
        let thread = threads::spawn("mocapd-raw", work)?;
        let tap = RawLogTap::new(monotonic_ns(), full, emptied, Arc::default());
        Ok(Self { path: path.to_owned(), file_bytes, tap, thread })
    }

    /// A tap, which copies a line's bytes into the log.
    #[must_use]
    pub fn tap(&self) -> RawLogTap {
        self.tap.clone()
    }

    /// The log's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file, updated as it is written.
    #[must_use]
    pub fn file_bytes(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.file_bytes)
    }

    /// Ends the log. All other taps must have been dropped.
    ///
    /// # Errors
    /// When its thread panicked.
    pub fn finish(self) -> anyhow::Result<RawLogged> {
        let passed = self.tap.end();
        let WriterOutcome { line_bytes, error } = threads::join(self.thread)?;
        Ok(RawLogged {
            file_bytes: self.file_bytes.load(Ordering::Relaxed),
            line_bytes,
            missing_bytes: passed.line_bytes.load(Ordering::Relaxed).saturating_sub(line_bytes),
            error,
        })
    }
}

/// Appends a record with the present time.
fn put_now(entry: Entry<'_>, began_ns: u64, block: &mut Vec<u8>) {
    let time_ns = monotonic_ns().saturating_sub(began_ns);
    put_record(&Record { time_ns, entry }, block);
}

/// Longest time that bytes stay in a block while the disk keeps up: what the log of a killed recorder loses.
const BLOCK_AGE_MAX_NS: u64 = 100_000_000;

/// Space kept in a block for the records of missing bytes, a closed line, and the end.
const SPARE_BYTES: usize = 3 * RECORD_OVERHEAD_BYTES + 8;

/// Copies bytes into a raw log. Clones share the log, each with a block of its own; one is in use at a time.
#[derive(Debug)]
pub struct RawLogTap {
    began_ns: u64,
    full: Sender<Block>,
    free: Receiver<Block>,
    totals: Arc<Totals>,
    /// Without memory until the next record.
    block: Block,
    block_since_ns: u64,
}

impl Clone for RawLogTap {
    fn clone(&self) -> Self {
        Self::new(self.began_ns, self.full.clone(), self.free.clone(), Arc::clone(&self.totals))
    }
}

impl RawLogTap {
    fn new(began_ns: u64, full: Sender<Block>, free: Receiver<Block>, totals: Arc<Totals>) -> Self {
        Self { began_ns, full, free, totals, block: Block::default(), block_since_ns: 0 }
    }

    /// Wraps a line, whose bytes then go through a tap of its own.
    #[must_use]
    pub fn wrap(&self, family: &str, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let mut tap = self.clone();
        tap.put(Entry::Opened(&format!("{family} {}", line.describe())));
        Box::new(TappedTransport { line, tap, is_closed: false })
    }

    /// Copies an entry into the block, or counts its bytes as missing. Never waits.
    fn put(&mut self, entry: Entry<'_>) {
        let (n_bytes, text_bytes) = match entry {
            Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => (bytes.len(), 0),
            Entry::Opened(text) => (0, text.len()),
            Entry::Break | Entry::Baud(_) | Entry::Missing(_) | Entry::Closed | Entry::End => {
                (0, 0)
            }
        };
        let needed = n_bytes + text_bytes + RECORD_OVERHEAD_BYTES + SPARE_BYTES;
        self.totals.line_bytes.fetch_add(n_bytes as u64, Ordering::Relaxed);
        if self.block.bytes.len() + needed > BLOCK_CAPACITY_BYTES {
            self.submit_block();
        }
        if self.block.bytes.capacity() == 0 {
            let Ok(block) = self.free.try_recv() else { return self.count_missing(n_bytes) };
            self.begin(block);
        }
        // A read larger than a block: the largest read of a host fills half of one.
        if self.block.bytes.len() + needed > self.block.bytes.capacity() {
            return self.count_missing(n_bytes);
        }
        put_now(entry, self.began_ns, &mut self.block.bytes);
        self.block.line_bytes += n_bytes as u64;
        if self.block.bytes.len() >= BLOCK_BYTES {
            self.submit_block();
        }
    }

    /// Starts a block, with the number of bytes missing before it.
    fn begin(&mut self, block: Block) {
        self.block = block;
        self.block_since_ns = monotonic_ns();
        let missing = self.totals.unreported_bytes.swap(0, Ordering::Relaxed);
        if missing > 0 {
            put_now(Entry::Missing(missing), self.began_ns, &mut self.block.bytes);
        }
    }

    fn count_missing(&mut self, n_bytes: usize) {
        self.totals.unreported_bytes.fetch_add(n_bytes as u64, Ordering::Relaxed);
    }

    fn submit_block(&mut self) {
        if !self.block.bytes.is_empty() {
            // Never full: the queue has a place for every block.
            self.full.try_send(std::mem::take(&mut self.block)).ok();
        }
    }

    /// Submits the block if it is old enough.
    fn tick(&mut self) {
        let age_ns = monotonic_ns().saturating_sub(self.block_since_ns);
        // While a disk stalls, a slow line would use up the blocks nearly empty.
        let keeps_up = self.free.len() >= self.free.capacity().unwrap_or(0) / 2;
        if !self.block.bytes.is_empty() && age_ns > BLOCK_AGE_MAX_NS && keeps_up {
            self.submit_block();
        }
    }

    /// Ends the log.
    fn end(mut self) -> Arc<Totals> {
        // The recording is over: waiting for the disk is now harmless.
        if self.block.bytes.capacity() == 0
            && let Ok(block) = self.free.recv()
        {
            self.begin(block);
        }
        self.put(Entry::End);
        self.submit_block();
        Arc::clone(&self.totals)
    }
}

impl Drop for RawLogTap {
    fn drop(&mut self) {
        self.submit_block();
    }
}

/// A transport with a tap.
#[derive(Debug)]
struct TappedTransport {
    line: Box<dyn Transport>,
    tap: RawLogTap,
    /// Whether the log says that the line is closed.
    is_closed: bool,
}

impl TappedTransport {
    fn close(&mut self) {
        if !std::mem::replace(&mut self.is_closed, true) {
            self.tap.put(Entry::Closed);
        }
    }

    fn note_closed<T>(&mut self, outcome: Result<T, TransportError>) -> Result<T, TransportError> {
        if outcome.as_ref().is_err_and(TransportError::is_gone) {
            self.close();
        }
        outcome
    }
}

impl Drop for TappedTransport {
    fn drop(&mut self) {
        self.close();
    }
}

impl Transport for TappedTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let outcome = self.line.read(buf);
        if let Ok(n @ 1..) = outcome {
            self.tap.put(Entry::FromDevice(buf.get(..n).unwrap_or_default()));
        }
        self.tap.tick();
        self.note_closed(outcome)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        // Logged first, so that it precedes its answer.
        self.tap.put(Entry::ToDevice(bytes));
        let outcome = self.line.write_all(bytes);
        self.note_closed(outcome)
    }

    fn send_break(&mut self) -> Result<bool, TransportError> {
        let outcome = self.line.send_break();
        if let Ok(true) = outcome {
            self.tap.put(Entry::Break);
        }
        self.note_closed(outcome)
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        let outcome = self.line.set_baud(baud);
        if outcome.is_ok() {
            self.tap.put(Entry::Baud(baud));
        }
        self.note_closed(outcome)
    }

    fn inner(&self) -> Option<&dyn Transport> {
        Some(&*self.line)
    }
}

/// The output of a log.
trait LogOutput: Write {
    /// Syncs what was written.
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

/// The result of the writing thread.
#[derive(Debug, Default)]
struct WriterOutcome {
    /// Bytes of the line in blocks that were written completely.
    line_bytes: u64,
    /// The first error, after which nothing more is written.
    error: Option<io::Error>,
}

/// Writes blocks to the file and returns them to the taps, until the last tap is dropped. After an error it only
/// returns them.
fn write_blocks(
    mut file: impl LogOutput,
    file_bytes: &AtomicU64,
    sync_every: Duration,
    blocks: &Receiver<Block>,
    free: &Sender<Block>,
) -> WriterOutcome {
    let mut written = WriterOutcome::default();
    // When the oldest unsynced data was written: at first, the head of the log.
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
