//! What a take is written to, and what was written.

use std::io::{self, Write};

use mocapd_take::record::{ClockLine, Ledger, TakeEnding};
use rustix::fs::{FallocateFlags, fallocate, fstatvfs};

use super::DiskState;
use crate::{
    clock::ClockStatus,
    files::{Displaced, FileState, TakeFile},
};

/// What a take is written to.
pub trait TakeOutput: Write + Send + 'static {
    /// Makes everything written so far survive a power cut.
    ///
    /// # Errors
    /// The device's.
    fn sync(&mut self) -> io::Result<()>;

    /// Makes sure that so many bytes can be written from an offset on, whatever others write to the disk meanwhile.
    ///
    /// # Errors
    /// `StorageFull`, `QuotaExceeded` when there is no such room; `Unsupported` where none can be held back.
    fn hold_back(&mut self, _from: u64, _bytes: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Gives back what was held and is not needed: the output has so many bytes.
    ///
    /// # Errors
    /// The device's.
    fn release(&mut self, _bytes: u64) -> io::Result<()> {
        Ok(())
    }

    /// Bytes that the disk has left, for whoever may write there; `None` where nobody can tell.
    fn free_bytes(&self) -> Option<u64> {
        None
    }

    /// What others have done to it; at most a moment old.
    fn look(&mut self) -> FileState {
        FileState::InPlace
    }

    /// The same, as of now.
    fn look_now(&mut self) -> FileState {
        FileState::InPlace
    }

    /// More about that, where something was done.
    fn displaced(&self) -> Option<Displaced> {
        None
    }
}

impl TakeOutput for TakeFile {
    fn sync(&mut self) -> io::Result<()> {
        self.file().sync_data()
    }

    fn hold_back(&mut self, from: u64, bytes: u64) -> io::Result<()> {
        Ok(fallocate(self.file(), FallocateFlags::KEEP_SIZE, from, bytes)?)
    }

    fn release(&mut self, bytes: u64) -> io::Result<()> {
        Self::release(self, bytes)
    }

    fn look(&mut self) -> FileState {
        Self::look(self)
    }

    fn look_now(&mut self) -> FileState {
        Self::look_now(self)
    }

    fn displaced(&self) -> Option<Displaced> {
        Self::displaced(self)
    }

    fn free_bytes(&self) -> Option<u64> {
        let disk = fstatvfs(self.file()).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }
}

impl TakeOutput for Vec<u8> {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for io::Sink {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What was written in the end.
#[derive(Debug, Clone, Default)]
pub struct Written {
    /// The ledger as it stands in the take.
    pub ledger: Ledger,
    /// How it ended, as it stands in the take.
    pub ending: TakeEnding,
    /// How the clocks ran in the end.
    pub clock: ClockStatus,
    /// By segment, the line of each that had one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// What was left of the disk.
    pub disk: DiskState,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// Of these, kept ones.
    pub kept: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
}
