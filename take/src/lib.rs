//! The take file (writer and sans-io reader) and the interchange formats of the field.
//!
//! `docs/take-format.md` specifies the format byte by byte. This crate opens no file, reads no clock and starts no
//! thread: it writes to a [`std::io::Write`] and reads bytes that the caller provides.

pub mod chunk;
pub mod compare;
pub mod damage;
pub mod edit;
pub mod escape;
pub mod foreign;
pub mod frames;
pub mod import;
pub mod index;
pub mod interchange;
pub mod map;
pub mod motion;
pub mod motion_encoder;
mod order;
pub mod phase;
pub mod poses;
pub mod quantity;
pub mod reader;
pub mod record;
pub mod recovery;
pub mod sampled;
pub mod statistics;
pub mod stretch;
mod table;
pub mod timeline;
pub mod traversal;
mod up_axis;
mod varint;
pub mod writer;

pub use frames::{TakeFrames, read_motion};
pub use index::TakeEnds;
pub use map::{TakeMap, TakeTail};
pub use order::ChannelOrder;
pub use reader::{TakeEvent, TakeReader};
pub use traversal::TakeTraversal;
pub use writer::TakeWriter;

/// Why a file is not a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NotATake {
    /// The file is shorter than the magic.
    #[error("the file is shorter than the signature of a take")]
    Short,
    /// The file begins with other bytes.
    #[error("the file does not begin with the signature of a take")]
    OtherMagic,
    /// A transfer in text mode converted the line ends.
    #[error("a transfer in text mode changed its line ends; copy it again in binary mode")]
    SentAsText,
    /// The file ends inside its header.
    #[error("the file ends inside its header, so nothing can be read")]
    HeaderCut,
    /// The header is damaged; [`repair_start`](recovery::repair_start) may repair one byte of it.
    #[error("its header is damaged; try `mocapd recover`, which can repair one byte of it")]
    HeaderDamaged,
    /// The header has more damage than can be repaired.
    #[error("more than one byte of its header is damaged, so nothing can be read")]
    HeaderLost,
    /// The chunk after the magic is damaged, or is not a header.
    #[error("its header is missing or damaged")]
    NoHeader,
    /// Another program changed the file during the read.
    #[error("another program changed it while it was being read")]
    Changed,
}

/// Errors of reading and writing takes, grouped by what the caller can do about them.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TakeError {
    /// The file is not a take.
    #[error("not a take: {0}")]
    NotATake(NotATake),
    /// The take was written by another version.
    #[error("{what} has version {found}, but this build reads version {supported}: use {}",
        if found > supported { "a newer mocapd" } else { "the development version that wrote it" })]
    Unsupported {
        /// The kind of record.
        what: &'static str,
        /// The version found.
        found: u16,
        /// The version that this build reads.
        supported: u16,
    },
    /// The take names a resampler that no earlier version has.
    #[error(
        "this take was written by a newer mocapd: its resampler '{0}' is unknown to this version; update mocapd to read it"
    )]
    UnknownResampler(String),
    /// Bytes that cannot be valid.
    #[error("{what} at byte {offset}: {message}")]
    Corrupt {
        /// The kind of chunk or record.
        what: &'static str,
        /// File offset of its chunk.
        offset: u64,
        /// What is wrong.
        message: String,
    },
    /// A request that a take cannot represent.
    #[error("{0}")]
    InvalidArgument(String),
    /// The codec rejected its input.
    #[error(transparent)]
    Codec(#[from] mocapd_codec::CodecError),
    /// An I/O error.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl TakeError {
    /// [`Corrupt`](Self::Corrupt) bytes of the chunk at `offset`.
    pub(crate) fn corrupt(what: &'static str, offset: u64, message: impl Into<String>) -> Self {
        Self::Corrupt { what, offset, message: message.into() }
    }
}
