//! What every block has in common: the head, which samples are present, the stated bound, the proof.
//!
//! A resampler codes payloads only; [`FramedEncoder`] and [`FramedDecoder`] turn it into the public
//! contract.

mod decoder;
mod encoder;
mod presence;

use std::fmt;

pub(crate) use self::{decoder::FramedDecoder, encoder::FramedEncoder};
use crate::{
    BlockReport, CodecError, DecodedRows, GROUP_CHANNELS, Position, Rows, coding::bytes::Bytes,
};

/// Bit 7 of the head byte: the presence section follows.
const HAS_GAPS: u8 = 0x80;

/// Bit 6 of the head byte: the number of channels follows.
const HAS_CHANNELS: u8 = 0x40;

/// A resampler's encoder: payloads without the frame around them.
pub(crate) trait PayloadEncoder: Send + fmt::Debug {
    /// Its other half.
    type Decoder: PayloadDecoder;

    /// Whether its payloads are bit-exact: the stated bound is then 0.
    const EXACT: bool = false;

    /// Most bytes of a payload of so many channels and rows.
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize;

    /// As [`BlockEncoder::prepare`](crate::BlockEncoder::prepare).
    fn prepare(&mut self, n_channels: usize, n_rows: usize);

    /// Forgets all state.
    fn reset(&mut self);

    /// A stretch passed without any sample of the group: no row of it may be used for prediction.
    fn break_off(&mut self);

    /// Appends the payload of a block with at least one sample, all of them finite. Fills `reports`,
    /// one a channel, where the frame has set `samples`; every error in them is within the tolerance:
    /// samples that cannot be coded so are stored as they are. There are never fewer channels than in
    /// the payload before, but after [`reset`](Self::reset); new ones come behind the others.
    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError>;
}

/// A resampler's decoder.
pub(crate) trait PayloadDecoder: Send + fmt::Debug {
    /// As [`PayloadEncoder::EXACT`].
    const EXACT: bool = false;

    /// As [`PayloadEncoder::prepare`].
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_channels: usize, n_rows: usize);

    /// Forgets all state.
    fn reset(&mut self);

    /// As [`PayloadEncoder::break_off`].
    fn break_off(&mut self);

    /// Fills `positions` and `kept` of `channels`, whose `present` is set and whose other rows are
    /// zero. At least one sample is present. The payload must end where its samples do.
    fn decode(
        &mut self,
        payload: &[u8],
        shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError>;
}

/// Most bytes of a block with such payloads.
pub(crate) fn max_block_bytes<E: PayloadEncoder>(n_channels: usize, n_rows: usize) -> usize {
    // The head, and the number of channels in one byte: there are at most 64.
    2 + presence::max_bytes(n_channels, n_rows) + E::max_payload_bytes(n_channels, n_rows)
}

/// How many channels a block states that it has: a key block does, and one that has more than the block
/// before it. None where it does not, or makes no sense.
#[must_use]
pub fn stated_channels(block: &[u8]) -> Option<usize> {
    let (head, rest) = block.split_first()?;
    if head & HAS_CHANNELS == 0 {
        return None;
    }
    let n = Bytes::new(rest).varint("the number of channels").ok()?;
    usize::try_from(n).ok().filter(|n| (1..=GROUP_CHANNELS).contains(n))
}

/// Samples present; an error when one is not finite.
pub(crate) fn count_finite(rows: Rows<'_>) -> Result<usize, CodecError> {
    // Without their signs, the bits of those that are not are the largest.
    let not_finite = |c: &f32| c.to_bits() & !(1 << 31) >= f32::INFINITY.to_bits();
    let (mut samples, mut any) = (0, false);
    for run in rows.runs() {
        samples += run.len();
        // No branch, so that many are looked at together.
        let positions = rows.positions()[run].as_flattened();
        any |= positions.iter().fold(false, |any, c| any | not_finite(c));
    }
    let is_bad =
        |(position, present): (&Position, &bool)| *present && position.iter().any(not_finite);
    let all = || rows.positions().iter().zip(rows.present());
    match any.then(|| all().position(is_bad)).flatten() {
        None => Ok(samples),
        Some(row) => Err(CodecError::InvalidArgument(format!(
            "row {row} is present but {:?} is not finite; mark such rows absent",
            rows.positions()[row]
        ))),
    }
}
