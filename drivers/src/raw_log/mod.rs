//! The raw log: every byte that went over a line, either way, with its time. `docs/raw-log.md` has the format.

mod read;
mod write;

#[cfg(test)]
mod tests;

pub use read::{RawLogError, Records, records};
pub use write::{put_head, put_record};

/// What a raw log begins with.
///
/// The first byte is no text, the line ends show a transfer that changed them, and 0x1a ends a listing.
pub const MAGIC: [u8; 8] = *b"\x89MRL\r\n\x1a\n";

/// The version that this build writes and reads.
pub const VERSION: u8 = 1;

/// Bytes before the first record.
pub const HEAD_BYTES: usize = MAGIC.len() + 1;

/// Type, time, length and checksum around every payload.
pub const RECORD_OVERHEAD_BYTES: usize = 1 + 8 + 4 + 4;

/// The longest payload: 16 times what a host reads at once.
pub const PAYLOAD_BYTES_MAX: usize = 1 << 20;

/// Where the length of a payload ends, and it begins.
const PAYLOAD_AT: usize = 1 + 8 + 4;

/// What a record tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry<'a> {
    /// The device said these bytes.
    FromDevice(&'a [u8]),
    /// The host said these bytes.
    ToDevice(&'a [u8]),
    /// The host held the line in the break state, as a reset.
    Break,
    /// The host changed the line's speed, in baud.
    Baud(u32),
    /// The line was opened. The driver's name and the line in words, with a space in between.
    Opened(&'a str),
    /// The device was gone, or the line was closed.
    Closed,
    /// So many bytes of both directions are not in the log: the disk did not take them in time.
    Missing(u64),
    /// The log is whole: nothing went over the line after it.
    End,
}

impl Entry<'_> {
    fn kind(&self) -> u8 {
        match self {
            Self::FromDevice(_) => 0x01,
            Self::ToDevice(_) => 0x02,
            Self::Break => 0x03,
            Self::Baud(_) => 0x04,
            Self::Opened(_) => 0x10,
            Self::Closed => 0x11,
            Self::Missing(_) => 0x20,
            Self::End => 0x7f,
        }
    }
}

/// One record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record<'a> {
    /// Nanoseconds since the log was begun.
    pub time_ns: u64,
    /// What it tells.
    pub entry: Entry<'a>,
}
