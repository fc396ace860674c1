//! Around a decoder: head byte, presence, the raw escape, and the wait for a key block after an error.

use super::{HAS_GAPS, PayloadDecoder};
use crate::{
    BlockDecoder, CodecError, DecodedRows, Tolerance, bound, coding::bytes::Bytes,
    lossless::Lossless, presence,
};

/// A resampler's decoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedDecoder<D> {
    payload: D,
    raw: Lossless,
    tolerance: Tolerance,
    /// After an error only a key block is in step with the encoder.
    lost: bool,
}

impl<D: PayloadDecoder> FramedDecoder<D> {
    pub(crate) fn new(payload: D, tolerance: Tolerance) -> Self {
        Self { payload, raw: Lossless::default(), tolerance, lost: false }
    }

    /// Allocates what blocks of up to `n_rows` rows will ever need.
    #[cfg(debug_assertions)]
    pub(super) fn prepare(&mut self, n_rows: usize) {
        self.payload.prepare(n_rows);
        self.raw.reserve(n_rows);
    }

    fn decode_samples(
        &mut self,
        block: &[u8],
        shared: &[u8],
        out: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let mut input = Bytes::new(block);
        let head = input.byte("the head byte")?;
        if head & HAS_GAPS != 0 {
            presence::read(&mut input, &mut out.present)?;
        } else {
            out.present.fill(true);
        }
        let step = head & !HAS_GAPS;
        out.max_error_mm = bound::stated_mm(step, self.tolerance.mm());
        if D::EXACT {
            if step != 0 {
                return Err(CodecError::Corrupt("a lossless block that states an error"));
            }
            return self.payload.decode(input.rest(), shared, out);
        }
        if step == 0 {
            self.payload.break_off();
            self.raw.reset();
            return self.raw.read(input.rest(), out);
        }
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
        out: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        out.clear_to(n_rows);
        if key {
            self.payload.reset();
            self.lost = false;
        }
        if self.lost {
            return Err(CodecError::Corrupt("an earlier block failed: start again at a key block"));
        }
        if block.is_empty() {
            self.skip(key);
            return Ok(());
        }
        if n_rows == 0 {
            self.lost = true;
            return Err(CodecError::Corrupt("a block with bytes but without rows"));
        }
        self.decode_samples(block, shared, out).inspect_err(|_| {
            self.lost = true;
            out.clear_to(n_rows);
        })
    }

    fn skip(&mut self, key: bool) {
        if key {
            self.payload.reset();
            self.lost = false;
        }
        self.payload.break_off();
    }
}
