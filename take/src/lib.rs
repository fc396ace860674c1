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

/// Why a file is no take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NotATake {
    /// There is less of it than the magic.
    #[error("the file is shorter than a take's eight bytes")]
    Short,
    /// It begins like something else.
    #[error("the file does not begin with a take's eight bytes")]
    OtherMagic,
    /// It was sent as text.
    #[error("its line ends were changed by a transfer in text mode; copy it again in binary mode")]
    SentAsText,
    /// It ends before its header does.
    #[error("the file ends inside its header, and nothing of it can be read")]
    HeaderCut,
    /// Its header is damaged; one byte of it can be [put right](recovery::mend_start).
    #[error(
        "its header is damaged, and nothing can be read without it; try `mocapd recover`, which can put one byte of it right"
    )]
    HeaderDamaged,
    /// Its header is damaged, and more of it than can be put right.
    #[error("more than one byte of its header is damaged, and nothing can be read without it")]
    HeaderLost,
    /// The chunk behind the magic is no header, or a damaged one.
    #[error("its header is damaged or not there")]
    NoHeader,
    /// Another program changed it meanwhile.
    #[error("it changed while it was read")]
    Changed,
}

/// What can go wrong with a take, by what the caller can do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TakeError {
    /// Not a take at all.
    #[error("not a take: {0}")]
    NotATake(NotATake),
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
