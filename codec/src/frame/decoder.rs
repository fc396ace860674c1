//! Around a decoder: head, presence, and the wait for a key block after an error.

use super::{HAS_CHANNELS, HAS_GAPS, PayloadDecoder, presence::Presence};
use crate::{
    BlockDecoder, CodecError, DecodedRows, GROUP_CHANNELS, Tolerance, bound, bound::STATED_STEPS,
    coding::bytes::Bytes,
};

/// A resampler's decoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedDecoder<D> {
    payload: D,
    presence: Presence,
    tolerance: Tolerance,
    /// Channels of the block before.
    n_channels: usize,
    /// After an error only a key block is in step with the encoder.
    lost: bool,
    /// Memory of channels that a block does not have.
    spare: Vec<DecodedRows>,
}

impl<D: PayloadDecoder> FramedDecoder<D> {
    pub(crate) fn new(payload: D, tolerance: Tolerance) -> Self {
        let presence = Presence::NEW;
        Self { payload, presence, tolerance, n_channels: 0, lost: false, spare: Vec::new() }
    }

    /// Allocates what blocks of up to so many channels and rows will ever need.
    #[cfg(debug_assertions)]
    pub(super) fn prepare(&mut self, n_channels: usize, n_rows: usize, out: &mut Vec<DecodedRows>) {
        self.payload.prepare(n_channels, n_rows);
        self.fit(n_channels, n_rows, out);
        self.fit(0, n_rows, out);
    }

    fn reset(&mut self) {
        self.payload.reset();
        self.presence.reset();
        self.n_channels = 0;
        self.lost = false;
    }

    /// So many channels of so many rows, of which nothing is said yet.
    fn fit(&mut self, n_channels: usize, n_rows: usize, out: &mut Vec<DecodedRows>) {
        self.spare.extend(out.drain(n_channels.min(out.len())..));
        while out.len() < n_channels {
            out.push(self.spare.pop().unwrap_or_default());
        }
        out.iter_mut().for_each(|rows| rows.reuse(n_rows));
    }

    fn decode_samples(
        &mut self,
        block: &[u8],
        shared: &[u8],
        n_rows: usize,
        out: &mut Vec<DecodedRows>,
    ) -> Result<(), CodecError> {
        if n_rows == 0 {
            return Err(CodecError::Corrupt("a block with bytes but without rows"));
        }
        let mut input = Bytes::new(block);
        let head = input.byte("the head byte")?;
        let more = head & HAS_CHANNELS != 0;
        if more {
            let n = usize::try_from(input.varint("the number of channels")?).unwrap_or(usize::MAX);
            if n <= self.n_channels || n > GROUP_CHANNELS {
                return Err(CodecError::Corrupt("a number of channels that cannot be"));
            }
            self.n_channels = n;
        } else if self.n_channels == 0 {
            return Err(CodecError::Corrupt("a first block without its number of channels"));
        }
        self.fit(self.n_channels, n_rows, out);
        if head & HAS_GAPS != 0 {
            self.presence.read(&mut input, out)?;
            out.iter_mut().for_each(DecodedRows::blank_absent);
            if !out.iter().any(DecodedRows::has_samples) {
                return Err(CodecError::Corrupt("a block with bytes but without samples"));
            }
        } else {
            out.iter_mut().for_each(|rows| rows.present.fill(true));
            self.presence.all_present(self.n_channels, n_rows);
        }
        if more && !out.last().is_some_and(DecodedRows::has_samples) {
            return Err(CodecError::Corrupt("a last channel without samples"));
        }
        let step = head & STATED_STEPS;
        if D::EXACT && step != 0 {
            return Err(CodecError::Corrupt("a lossless block that states an error"));
        }
        let max_error_mm = bound::stated_mm(step, self.tolerance.mm());
        out.iter_mut().for_each(|rows| rows.max_error_mm = max_error_mm);
        self.payload.decode(input.rest(), shared, out)
    }
}

impl<D: PayloadDecoder> BlockDecoder for FramedDecoder<D> {
    fn decode(
        &mut self,
        block: &[u8],
        shared: &[u8],
        n_rows: usize,
        key: bool,
        out: &mut Vec<DecodedRows>,
    ) -> Result<(), CodecError> {
        self.fit(0, 0, out);
        if key {
            self.reset();
        }
        if self.lost {
            return Err(CodecError::Corrupt("an earlier block failed: start again at a key block"));
        }
        if block.is_empty() {
            self.skip(false);
            return Ok(());
        }
        let outcome = self.decode_samples(block, shared, n_rows, out);
        if outcome.is_err() {
            self.lost = true;
            self.fit(0, 0, out);
        }
        outcome
    }

    fn skip(&mut self, key: bool) {
        if key {
            self.reset();
        }
        self.payload.break_off();
        self.presence.skip();
    }
}
