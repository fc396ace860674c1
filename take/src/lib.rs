//! The take file: writer, sans-io reader, and the field's interchange formats.
//!
//! `docs/take-format.md` gives the format byte by byte. Nothing here opens a file, reads a clock or starts a
//! thread: bytes go to a [`std::io::Write`] and come from the caller.

mod ambiguity;
pub mod chunk;
pub mod damage;
pub mod escape;
pub mod foreign;
pub mod frames;
pub mod index;
pub mod interchange;
pub mod map;
pub mod motion;
pub mod phase;

pub mod reader;
pub mod record;
pub mod recovery;
pub mod stretch;
mod table;
pub mod timeline;
pub mod traversal;
mod up_axis;
mod varint;
pub mod whole;
pub mod writer;

pub use frames::{TakeFrames, read_motion};
pub use index::TakeEnds;
pub use map::TakeMap;
pub use reader::{TakeEvent, TakeReader};
pub use traversal::TakeTraversal;
pub use writer::TakeWriter;

/// What can go wrong with a take, by what the caller can do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TakeError {
    /// Not a take at all.
    #[error("not a take: {0}")]
    NotATake(&'static str),
    /// A take from another version.
    #[error("{what} has version {found}, this build reads {supported}: use {}",
        if found > supported { "a newer mocapd" } else { "the development version that wrote it" })]
    Unsupported {
        /// Which record.
        what: &'static str,
        /// The version found.
        found: u16,
        /// The version known.
        supported: u16,
    },
    /// Bytes that cannot be right.
    #[error("{what} at byte {offset}: {message}")]
    Corrupt {
        /// Which chunk or record.
        what: &'static str,
        /// File offset of its chunk.
        offset: u64,
        /// What is wrong.
        message: String,
    },
    /// The caller asked for something a take cannot hold.
    #[error("{0}")]
    InvalidArgument(String),
    /// The codec refused.
    #[error(transparent)]
    Codec(#[from] mocapd_codec::CodecError),
    /// Reading or writing failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
