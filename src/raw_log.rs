//! `record --raw`: every byte on the device's line goes into a log, too, without the reader waiting for a disk.
//!
//! A [`Tap`] sits around the transport and copies what passes into blocks; a thread writes them. When no block is free
//! the log says how many bytes are missing, and the recording goes on.

mod tap;

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
};

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_drivers::raw_log::{Entry, Record, put_head, put_record};

pub use tap::Tap;

use crate::{files, rig::monotonic_ns, threads};

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
    tap: Tap,
    thread: JoinHandle<std::io::Result<u64>>,
}

/// What a raw log came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawLogged {
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes of the line that are in it.
    pub line_bytes: u64,
    /// Bytes of the line that are not, because the disk did not take them in time.
    pub missing_bytes: u64,
}

/// What taps and the log have in common.
#[derive(Debug, Default)]
struct Totals {
    line_bytes: AtomicU64,
    missing_bytes: AtomicU64,
    /// Of these, the ones that the log does not tell yet.
    untold_bytes: AtomicU64,
}

impl RawLog {
    /// Begins a log in a file that must not exist.
    ///
    /// # Errors
    /// When it does, or cannot be made.
    pub fn start(path: &Path) -> anyhow::Result<Self> {
        let mut file = files::create_new(path)?;
        let mut head = Vec::new();
        put_head(&mut head);
        let name = path.display().to_string();
        file.write_all(&head).with_context(|| format!("cannot write {name}"))?;
        let (full, blocks) = bounded(BLOCKS);
        let (free, emptied) = bounded(BLOCKS);
        for _ in 0..BLOCKS {
            // Never full: it holds every block there is.
            free.try_send(Vec::with_capacity(BLOCK_CAPACITY_BYTES)).ok();
        }
        let head_bytes = head.len() as u64;
        let thread = threads::spawn("mocapd-raw", move || write(file, head_bytes, &blocks, &free))?;
        let tap = Tap::new(monotonic_ns(), full, emptied, Arc::default());
        Ok(Self { path: path.to_owned(), tap, thread })
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

    /// Ends the log. Every other tap must be gone.
    ///
    /// # Errors
    /// When it could not be written to its end: what is in it can be read.
    pub fn finish(self) -> anyhow::Result<RawLogged> {
        let Self { path, tap, thread } = self;
        let totals = tap.end();
        let written = threads::join(thread)?;
        let file_bytes = written.with_context(|| {
            format!("the raw log {} ends early; what is in it can be read", path.display())
        })?;
        Ok(RawLogged {
            file_bytes,
            line_bytes: totals.line_bytes.load(Ordering::Relaxed),
            missing_bytes: totals.missing_bytes.load(Ordering::Relaxed),
        })
    }
}

/// The thread: blocks to the file, and back to the taps. After an error it only gives them back.
fn write(
    mut file: File,
    head_bytes: u64,
    blocks: &Receiver<Vec<u8>>,
    free: &Sender<Vec<u8>>,
) -> std::io::Result<u64> {
    let mut written = Ok(head_bytes);
    for mut block in blocks {
        if let Ok(bytes) = written {
            written = file.write_all(&block).map(|()| bytes + block.len() as u64);
        }
        block.clear();
        free.try_send(block).ok();
    }
    if written.is_ok() {
        file.sync_all()?;
    }
    written
}

/// Appends a record that is now.
fn put(entry: Entry<'_>, began_ns: u64, block: &mut Vec<u8>) {
    let time_ns = monotonic_ns().saturating_sub(began_ns);
    put_record(&Record { time_ns, entry }, block);
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::{
        raw_log::records,
        transport::{Transport, memory},
    };

    use super::*;

    /// A tap over a few blocks, which the test takes and gives back as the thread does.
    fn tap(blocks: usize) -> (Tap, Receiver<Vec<u8>>, Sender<Vec<u8>>) {
        let (full, written) = bounded(blocks);
        let (free, emptied) = bounded(blocks);
        (0..blocks).for_each(|_| free.send(Vec::with_capacity(BLOCK_CAPACITY_BYTES)).unwrap());
        (Tap::new(monotonic_ns(), full, emptied, Arc::default()), written, free)
    }

    #[test]
    fn a_disk_that_stalls_costs_bytes_of_the_log_and_the_log_says_how_many() {
        let (tap, written, free) = tap(2);
        let (mut device, line) = memory::pair(1 << 20);
        let mut line = tap.on("dvmc", Box::new(line));
        let mut buffer = vec![0; 1 << 16];
        let mut log = Vec::new();
        put_head(&mut log);
        let mut passed = 0;
        // Far more than two blocks hold, and nobody writes them: every read comes back all the same.
        for round in 0..20u8 {
            device.write_all(&vec![round; 40_000]).unwrap();
            let mut got = 0;
            while got < 40_000 {
                let n = line.read(&mut buffer).unwrap();
                assert!(buffer[..n].iter().all(|byte| *byte == round));
                got += n;
            }
            passed += got as u64;
        }
        line.write_all(b"ping").unwrap();
        passed += 4;
        // The disk is back.
        let mut give_back = |mut block: Vec<u8>| {
            log.extend_from_slice(&block);
            block.clear();
            // At the end nobody takes it any more.
            free.send(block).ok();
        };
        written.try_iter().for_each(&mut give_back);
        device.write_all(b"late").unwrap();
        assert_eq!(line.read(&mut buffer).unwrap(), 4);
        passed += 4;
        drop(line);
        let totals = tap.end();
        written.try_iter().for_each(&mut give_back);

        let (mut found, mut missing, mut last) = (0, 0, None);
        for record in records(&log).unwrap() {
            let entry = record.unwrap().entry;
            match entry {
                Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => found += bytes.len() as u64,
                Entry::Missing(bytes) => missing += bytes,
                _ => {}
            }
            last = Some(entry);
        }
        assert_eq!(last, Some(Entry::End));
        assert!(missing > 0 && found > 80_000, "{found} and {missing}");
        assert_eq!(found + missing, passed);
        assert_eq!(totals.line_bytes.load(Ordering::Relaxed), found);
        assert_eq!(totals.missing_bytes.load(Ordering::Relaxed), missing);
    }
}
