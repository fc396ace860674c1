//! What a take is written to, and what was written.

use std::{
    fs::File,
    io::{self, Write},
};

use mocapd_take::record::{ClockLine, Ledger};

use crate::clock::ClockStatus;

/// What a take is written to.
pub trait TakeOutput: Write + Send + 'static {
    /// Makes everything written so far survive a power cut.
    ///
    /// # Errors
    /// The device's.
    fn sync(&mut self) -> io::Result<()>;
}

impl TakeOutput for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
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
    /// How the clocks ran in the end.
    pub clock: ClockStatus,
    /// By segment, the line of each that had one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// Of these, kept ones.
    pub kept: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
}
