//! The contract of every resampler: one group of channels over one stretch in, one block out, and back.

use crate::Position;

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
    /// An earlier block failed, and only a key block is in step with the other side again.
    #[error("an earlier block failed: go on with a key block")]
    OutOfStep,
    /// The caller asked for something that has no answer; the message says what would.
    #[error("{0}")]
    InvalidArgument(String),
}

pub(crate) type Result<T> = std::result::Result<T, CodecError>;

/// Bytes of which something does not hold that holds of an encoder's are corrupt.
#[inline(always)]
pub(crate) fn ensure(holds: bool, otherwise: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(CodecError::Corrupt(otherwise)) }
}

/// Most channels of a group: those that are coded together.
///
/// What a block costs whatever is in it (its length, its head, the ends of its coders, what it learns
/// anew after a key) is then paid once for a whole body; and a hundred markers still make two groups,
/// for as many processors.
pub const GROUP_CHANNELS: usize = 64;

/// One channel over one stretch: a row per frame. None by default.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rows<'a> {
    positions: &'a [Position],
    present: &'a [bool],
}

impl<'a> Rows<'a> {
    /// `positions[i]` counts only where `present[i]`.
    ///
    /// # Errors
    /// `InvalidArgument` when the lengths differ.
    pub fn new(
        positions: &'a [Position],
        present: &'a [bool],
    ) -> std::result::Result<Self, CodecError> {
        if positions.len() == present.len() {
            return Ok(Self { positions, present });
        }
        Err(CodecError::InvalidArgument(format!(
            "{} positions but {} presence flags",
            positions.len(),
            present.len()
        )))
    }

    /// Rows, present or not.
    #[must_use]
    pub fn len(&self) -> usize {
        self.present.len()
    }

    /// No rows at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.present.is_empty()
    }

    /// The sample of a row, if there is one.
    #[must_use]
    pub fn get(&self, row: usize) -> Option<Position> {
        (*self.present.get(row)?).then(|| self.positions[row])
    }

    /// One position a row; meaningless where not present.
    #[must_use]
    pub fn positions(&self) -> &'a [Position] {
        self.positions
    }

    /// One flag a row.
    #[must_use]
    pub fn present(&self) -> &'a [bool] {
        self.present
    }

    /// The runs of present rows, as half-open ranges.
    pub fn runs(&self) -> impl Iterator<Item = std::ops::Range<usize>> + 'a {
        runs(self.present)
    }
}

/// The runs of present rows, as half-open ranges.
pub(crate) fn runs(present: &[bool]) -> impl Iterator<Item = std::ops::Range<usize>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at + length(&present[at..], false);
        at = start + length(&present[start..], true);
        (start < at).then_some(start..at)
    })
}

/// How many rows from the first on are as said. Most are as those before them: many are looked at together.
fn length(present: &[bool], state: bool) -> usize {
    let (many, _) = present.as_chunks::<32>();
    let is_other = |many: &[bool; 32]| many.iter().fold(false, |any, &p| any | (p != state));
    let same = 32 * many.iter().position(is_other).unwrap_or(many.len());
    let rest = &present[same..];
    same + rest.iter().position(|&p| p != state).unwrap_or(rest.len())
}

/// What an encoder proved about one channel of the block it just wrote.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct BlockReport {
    /// Samples present.
    pub samples: u32,
    /// Samples kept (knots): the asynchronous sampling `TS_i` of (Shi et al. 2012).
    pub kept: u32,
    /// Largest Euclidean distance between a sample and its float32 reconstruction, in millimetres,
    /// measured, not estimated.
    pub max_error_mm: f64,
}

impl BlockReport {
    /// States that all samples are as they were.
    pub(crate) fn keep_all(&mut self) {
        (self.kept, self.max_error_mm) = (self.samples, 0.0);
    }
}

/// Encodes the blocks of one group of channels, in order. State may run from block to block.
///
/// To be called, not implemented elsewhere: it may get more methods.
pub trait BlockEncoder: Send + std::fmt::Debug {
    /// Allocates what blocks of up to so many channels and rows will ever need; not called, it is
    /// allocated as blocks need it. What a debug build checks behind every block is not part of it.
    fn prepare(&mut self, n_channels: usize, n_rows: usize);

    /// Appends one block to `out`: nothing at all when no channel has a sample.
    ///
    /// `channels` are 1 to [`GROUP_CHANNELS`], each with the same number of rows; `reports` gets one
    /// a channel. Between two key blocks a channel keeps its place, and new ones come behind.
    ///
    /// `key` forgets all state first, so that a decoder may start here. `shared` is what
    /// [`Settings::plan`](crate::Settings::plan) gave for this stretch. Does not allocate after
    /// [`prepare`](Self::prepare), when `out` has room for
    /// [`max_block_bytes`](crate::Settings::max_block_bytes) (live kinds).
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite, or the slices do not fit each other;
    /// `out` is then as it was. `OutOfStep` where an earlier block failed half way and this is no key block.
    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> std::result::Result<(), CodecError>;
}

/// Decodes the blocks of one group of channels, in order, starting at a key block.
///
/// What it allocates goes with the rows times the channels of a block, which
/// [`stated_channels`](crate::stated_channels) tells beforehand. To be called, not implemented elsewhere:
/// it may get more methods.
pub trait BlockDecoder: Send + std::fmt::Debug {
    /// Replaces `out` by the rows of one block, an entry for each channel that it has: those from
    /// the group's first to the last one with a sample since the key block. The memory in `out` is
    /// used again. An empty block has none. `n_rows` is believed: bound it when it comes from a file.
    ///
    /// # Errors
    /// `Corrupt` or `Truncated`; `out` is then empty and the decoder needs a key block to go on, and says
    /// `OutOfStep` of any other.
    fn decode(
        &mut self,
        block: &[u8],
        shared: &[u8],
        n_rows: usize,
        key: bool,
        out: &mut Vec<DecodedRows>,
    ) -> std::result::Result<(), CodecError>;

    /// Passes an empty block: rows without a sample, however many.
    fn skip(&mut self, key: bool);
}

/// The rows of one channel of a decoded block. Reused from block to block.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct DecodedRows {
    /// One position a row; `[0.0; 3]` where not present.
    pub positions: Vec<Position>,
    /// Whether the row has a sample.
    pub present: Vec<bool>,
    /// Whether the sample was kept (a knot) rather than interpolated.
    pub kept: Vec<bool>,
    /// The bound that the block states for all its channels, in millimetres: at least the largest
    /// error the encoder measured, rounded up to a 63rd of the tolerance, never above it.
    pub max_error_mm: f64,
}

impl DecodedRows {
    /// Whether any row has a sample.
    #[must_use]
    pub fn has_samples(&self) -> bool {
        self.present.contains(&true)
    }

    /// `n_rows` rows that are not kept, in the memory already there. Which of them are present, and where they are,
    /// is as it was: to be said of every row.
    pub(crate) fn reuse(&mut self, n_rows: usize) {
        self.positions.resize(n_rows, [0.0; 3]);
        self.present.resize(n_rows, false);
        self.kept.clear();
        self.kept.resize(n_rows, false);
        self.max_error_mm = 0.0;
    }

    /// Absent rows have no position.
    pub(crate) fn blank_absent(&mut self) {
        for (position, present) in self.positions.iter_mut().zip(&self.present) {
            *position = if *present { *position } else { [0.0; 3] };
        }
    }
}
