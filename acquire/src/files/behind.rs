//! Large files go to the disk while they are still being written, and not all at the end.

use std::{fs::File, io, thread::JoinHandle};

use crossbeam_channel::{Sender, TrySendError, bounded};
use rustix::fs::{Advice, fadvise};

use crate::threads;

/// How much is written before the disk is told to begin, and between two such calls: half a second of a slow disk, so
/// that the wait at the end is short, and enough that a call costs nothing beside it.
const STEP_BYTES: u64 = 32 << 20;

/// Syncs a file behind its writer, on a thread of its own, which begins with the first step.
#[derive(Debug, Default)]
pub(super) struct Behind {
    since_bytes: u64,
    syncer: Option<Syncer>,
}

#[derive(Debug)]
struct Syncer {
    wake: Sender<()>,
    thread: JoinHandle<io::Result<()>>,
}

impl Behind {
    /// So many bytes more were written to `file`. Never waits for the disk.
    ///
    /// # Errors
    /// What the disk said to an earlier sync: it says that once only.
    pub(super) fn wrote(&mut self, file: &File, n_bytes: usize) -> io::Result<()> {
        self.since_bytes += n_bytes as u64;
        if self.since_bytes < STEP_BYTES {
            return Ok(());
        }
        self.since_bytes = 0;
        if self.syncer.is_none() {
            self.syncer = start(file);
        }
        let gone = match &self.syncer {
            // Where there is no thread to be had, everything is synced at the end.
            None => false,
            // Full: a sync is still to begin, and will take these bytes as well.
            Some(syncer) => matches!(syncer.wake.try_send(()), Err(TrySendError::Disconnected(()))),
        };
        if gone { self.finish() } else { Ok(()) }
    }

    /// Waits for the sync that is under way.
    ///
    /// # Errors
    /// What the disk said to any sync.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        let Some(Syncer { wake, thread }) = self.syncer.take() else { return Ok(()) };
        drop(wake);
        threads::join(thread).map_err(io::Error::other)?
    }
}

/// `None` where the system gives no thread, or no second handle.
fn start(file: &File) -> Option<Syncer> {
    let file = file.try_clone().ok()?;
    // One waiting wake is all that can be of use.
    let (wake, woken) = bounded(1);
    let sync = move || woken.iter().try_for_each(|()| sync(&file));
    let thread = threads::spawn("mocapd-sync", sync).ok()?;
    Some(Syncer { wake, thread })
}

/// Puts on the disk what was written, and gives the memory back that held it: a file of gigabytes would take all there
/// is from the others on the machine, and memory that was just free is written the fastest.
fn sync(file: &File) -> io::Result<()> {
    file.sync_data()?;
    // Whether the system takes advice is its own affair.
    fadvise(file, 0, None, Advice::DontNeed).ok();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn begins_with_the_first_step_and_ends_when_told() {
        let file = tempfile::tempfile().unwrap();
        let mut behind = Behind::default();
        behind.wrote(&file, STEP_BYTES as usize - 1).unwrap();
        assert!(behind.syncer.is_none());
        behind.wrote(&file, 1).unwrap();
        assert!(behind.syncer.is_some());
        behind.wrote(&file, STEP_BYTES as usize).unwrap();
        behind.finish().unwrap();
        assert!(behind.syncer.is_none());
    }

    #[test]
    fn an_error_of_the_disk_is_told_once_and_not_lost() {
        // A pipe cannot be synced: the kernel says EINVAL.
        let (_reader, writer) = io::pipe().unwrap();
        let file = File::from(std::os::fd::OwnedFd::from(writer));
        let mut behind = Behind::default();
        behind.wrote(&file, STEP_BYTES as usize).unwrap();
        assert_eq!(behind.finish().unwrap_err().kind(), io::ErrorKind::InvalidInput);
        behind.finish().unwrap();
    }
}
