//! What can go wrong, by what the caller can do about it.

/// An error of the codec.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CodecError {
    /// The block's bytes cannot have come from the encoder: bit rot, or another format.
    #[error("corrupt block: {0}")]
    Corrupt(&'static str),
    /// The block ends before its samples do.
    #[error("block cut short: {0}")]
    Truncated(&'static str),
    /// The caller asked for something that has no answer; the message says what would.
    #[error("{0}")]
    InvalidArgument(String),
}
