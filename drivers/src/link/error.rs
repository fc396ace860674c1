//! What the wire cannot say.

/// Why a message was not written. Nothing was appended to the output.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// More markers than a frame or a table may have.
    #[error("{found} markers are more than the link's {max}; send fewer")]
    TooManyMarkers {
        /// In the frame or table.
        found: usize,
        /// [`MARKERS_MAX`](super::MARKERS_MAX).
        max: usize,
    },
    /// A frame lists an id twice, or not in ascending order.
    #[error(
        "marker {id} does not come after marker {previous}; sort a frame's markers by id, each once"
    )]
    IdsNotAscending {
        /// The one before.
        previous: u16,
        /// The one that should have been larger.
        id: u16,
    },
    /// A text is too long, or holds control characters.
    #[error("{what} '{text}' cannot be sent: use at most {bytes_max} bytes and no control characters", text = text.escape_debug())]
    Text {
        /// `label`, `model`, `serial` or `firmware`.
        what: &'static str,
        /// The text.
        text: String,
        /// What fits.
        bytes_max: usize,
    },
    /// A Hello that no host could work with.
    #[error("hello cannot be sent: {0}")]
    Hello(&'static str),
}
