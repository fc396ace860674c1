//! The contract of every resampler: one channel's rows over one stretch in, one block out, and back.

use crate::{CodecError, Position};

/// One channel over one stretch: a row per frame.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    positions: &'a [Position],
    present: &'a [bool],
}

impl<'a> Rows<'a> {
    /// `positions[i]` counts only where `present[i]`.
    ///
    /// # Errors
    /// `InvalidArgument` when the lengths differ.
    pub fn new(positions: &'a [Position], present: &'a [bool]) -> Result<Self, CodecError> {
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
        let start = at + present[at..].iter().position(|&p| p)?;
        let len = present[start..].iter().position(|&p| !p).unwrap_or(present.len() - start);
        at = start + len;
        Some(start..at)
    })
}

/// What an encoder proved about the block it just wrote.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BlockReport {
    /// Samples present.
    pub samples: u32,
    /// Samples kept (knots): the asynchronous sampling `TS_i` of (Shi et al. 2012).
    pub kept: u32,
    /// Largest Euclidean distance between a sample and its float32 reconstruction, in millimetres,
    /// measured, not estimated.
    pub max_error_mm: f64,
    /// Blocks that missed the tolerance at first and were coded again, tighter.
    pub recoded: u32,
}

/// Encodes the blocks of one channel, in order. State may run from block to block.
pub trait BlockEncoder: Send + std::fmt::Debug {
    /// Allocates what blocks of up to `n_rows` rows will ever need; not called, it is allocated as
    /// blocks need it. What a debug build checks behind every block is not part of it.
    fn prepare(&mut self, n_rows: usize);

    /// Appends one block to `out`: nothing at all when no row is present.
    ///
    /// `key` forgets all state first, so that a decoder may start here. `shared` is what
    /// [`Settings::plan`](crate::Settings::plan) gave for this stretch. Does not allocate after
    /// [`prepare`](Self::prepare), when `out` has room for
    /// [`max_block_bytes`](crate::Settings::max_block_bytes) (live kinds).
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite; `out` is then as it was.
    fn encode(
        &mut self,
        rows: Rows<'_>,
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
    ) -> Result<BlockReport, CodecError>;
}

/// Decodes the blocks of one channel, in order, starting at a key block.
pub trait BlockDecoder: Send + std::fmt::Debug {
    /// Replaces `out` by the rows of one block. An empty block is `n_rows` absent rows.
    ///
    /// # Errors
    /// `Corrupt` or `Truncated`; the decoder then needs a key block to go on.
    fn decode(
        &mut self,
        block: &[u8],
        shared: &[u8],
        n_rows: usize,
        key: bool,
        out: &mut DecodedRows,
    ) -> Result<(), CodecError>;

    /// Passes an empty block: rows without a sample, however many.
    fn skip(&mut self, key: bool);
}

/// The rows of one decoded block. Reused from block to block.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DecodedRows {
    /// One position a row; `[0.0; 3]` where not present.
    pub positions: Vec<Position>,
    /// Whether the row has a sample.
    pub present: Vec<bool>,
    /// Whether the sample was kept (a knot) rather than interpolated.
    pub kept: Vec<bool>,
    /// The bound that the block states for itself, in millimetres: at least the largest error the
    /// encoder measured, rounded up to the block's one byte, never above the tolerance.
    pub max_error_mm: f64,
}

impl DecodedRows {
    /// `n_rows` absent rows, in the memory already there.
    pub(crate) fn clear_to(&mut self, n_rows: usize) {
        self.positions.clear();
        self.positions.resize(n_rows, [0.0; 3]);
        for flags in [&mut self.present, &mut self.kept] {
            flags.clear();
            flags.resize(n_rows, false);
        }
        self.max_error_mm = 0.0;
    }
}
