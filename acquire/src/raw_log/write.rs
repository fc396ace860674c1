//! The thread that writes a log.

use std::{
    io::{self, Write},
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};

use super::Block;

/// Where a log goes.
pub(super) trait LogOutput: Write {
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
pub(super) struct Written {
    /// Bytes of the line in the blocks that were written whole.
    pub(super) line_bytes: u64,
    /// After one nothing is written any more.
    pub(super) error: Option<io::Error>,
}

/// Blocks to the file, and back to the taps, until the last tap is gone. After an error it only gives them back.
pub(super) fn write(
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
