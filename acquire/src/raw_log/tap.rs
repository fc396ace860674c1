//! A transport that copies what passes.

use std::sync::{Arc, atomic::Ordering};

use crossbeam_channel::{Receiver, Sender};
use mocapd_drivers::{
    raw_log::{Entry, RECORD_OVERHEAD_BYTES},
    transport::{Transport, TransportError},
};

use super::{BLOCK_BYTES, BLOCK_CAPACITY_BYTES, Block, Totals, put};
use crate::host_clock::monotonic_ns;

/// A block that holds anything is handed over after so long: what a killed recorder loses of its log.
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
    pub(super) fn new(
        began_ns: u64,
        full: Sender<Block>,
        free: Receiver<Block>,
        totals: Arc<Totals>,
    ) -> Self {
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
        if !self.block.bytes.is_empty() && age_ns > BLOCK_NS_MAX {
            self.hand_over();
        }
    }

    /// Nothing comes any more.
    pub(super) fn end(mut self) -> Arc<Totals> {
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

    fn line_bytes_per_s(&self) -> Option<u64> {
        self.line.line_bytes_per_s()
    }

    fn describe(&self) -> String {
        self.line.describe()
    }

    fn stalls_cleared(&self) -> u64 {
        self.line.stalls_cleared()
    }
}
