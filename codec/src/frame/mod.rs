//! What every block has in common: the head byte, the presence runs, the raw escape, the proof.
//!
//! A resampler codes payloads only; [`FramedEncoder`] and [`FramedDecoder`] turn it into the public
//! contract.

mod decoder;
mod encoder;

use std::fmt;

pub(crate) use self::{decoder::FramedDecoder, encoder::FramedEncoder};
use crate::{BlockReport, CodecError, DecodedRows, Rows, lossless::Lossless, presence};

/// Bit 7 of the head byte: presence runs follow.
const HAS_GAPS: u8 = 0x80;

/// What a resampler made of one block.
#[derive(Debug)]
pub(crate) enum Outcome {
    /// The payload is written and its reconstruction measured.
    Coded(BlockReport),
    /// It has no payload within the tolerance: the block is to be stored raw.
    Escape,
}

/// A resampler's encoder: payloads without the frame around them.
pub(crate) trait PayloadEncoder: Send + fmt::Debug {
    /// Its other half.
    type Decoder: PayloadDecoder;

    /// Whether its payloads are bit-exact: the stated bound is then 0 and there is no escape.
    const EXACT: bool = false;

    /// Most bytes of a payload of so many samples; one that is larger is stored raw.
    fn max_payload_bytes(samples: usize) -> usize {
        Lossless::max_payload_bytes(samples)
    }

    /// As [`BlockEncoder::prepare`](crate::BlockEncoder::prepare).
    fn prepare(&mut self, n_rows: usize);

    /// Forgets all state.
    fn reset(&mut self);

    /// The block just passed was not coded here (it is absent or raw): no row of it may be
    /// used for prediction.
    fn break_off(&mut self);

    /// The block just coded is thrown away and stored raw: [`break_off`](Self::break_off), with what
    /// has been learnt as it was before the block.
    fn abandon(&mut self) {
        self.break_off();
    }

    /// Appends the payload of a block with at least one sample, all of them finite.
    /// A payload that grows over `limit` bytes will be thrown away.
    fn encode(
        &mut self,
        rows: Rows<'_>,
        shared: &[u8],
        limit: usize,
        out: &mut Vec<u8>,
    ) -> Result<Outcome, CodecError>;
}

/// A resampler's decoder.
pub(crate) trait PayloadDecoder: Send + fmt::Debug {
    /// As [`PayloadEncoder::EXACT`].
    const EXACT: bool = false;

    /// As [`PayloadEncoder::prepare`].
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_rows: usize);

    /// Forgets all state.
    fn reset(&mut self);

    /// As [`PayloadEncoder::break_off`].
    fn break_off(&mut self);

    /// Fills `positions` and `kept` of `rows`, whose `present` is set and whose other rows are zero.
    fn decode(
        &mut self,
        payload: &[u8],
        shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError>;
}

/// Most bytes of a block with such payloads.
pub(crate) fn max_block_bytes<E: PayloadEncoder>(n_rows: usize) -> usize {
    // An escape is never larger than the raw payload of the same samples.
    let payload = E::max_payload_bytes(n_rows).max(Lossless::max_payload_bytes(n_rows));
    1 + presence::max_bytes(n_rows) + payload
}

/// Samples present; an error when one is not finite.
pub(crate) fn count_finite(rows: Rows<'_>) -> Result<usize, CodecError> {
    let mut samples = 0;
    for (row, (position, &present)) in rows.positions().iter().zip(rows.present()).enumerate() {
        if present && !position.iter().all(|c| c.is_finite()) {
            return Err(CodecError::InvalidArgument(format!(
                "row {row} is present but {position:?} is not finite; mark such rows absent"
            )));
        }
        samples += usize::from(present);
    }
    Ok(samples)
}
