//! Around an encoder: head byte, presence, the check of the bound, the raw escape.

use super::{HAS_GAPS, Outcome, PayloadEncoder, count_finite};
#[cfg(debug_assertions)]
use crate::{BlockDecoder, DecodedRows, frame::FramedDecoder};
use crate::{
    BlockEncoder, BlockReport, CodecError, Rows, Tolerance, bound, lossless::Lossless, presence,
};

/// A resampler's encoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedEncoder<E: PayloadEncoder> {
    payload: E,
    raw: Lossless,
    tolerance: Tolerance,
    /// Debug builds decode every block they write.
    #[cfg(debug_assertions)]
    twin: (FramedDecoder<E::Decoder>, DecodedRows),
}

impl<E: PayloadEncoder> FramedEncoder<E> {
    #[cfg_attr(
        not(debug_assertions),
        expect(unused_variables, clippy::needless_pass_by_value, reason = "the twin is for debug")
    )]
    pub(crate) fn new(payload: E, decoder: E::Decoder, tolerance: Tolerance) -> Self {
        Self {
            payload,
            raw: Lossless::default(),
            tolerance,
            #[cfg(debug_assertions)]
            twin: (FramedDecoder::new(decoder, tolerance), DecodedRows::default()),
        }
    }

    /// Appends head byte, presence runs and payload of a block with samples.
    fn encode_samples(
        &mut self,
        rows: Rows<'_>,
        shared: &[u8],
        samples: usize,
        out: &mut Vec<u8>,
    ) -> Result<BlockReport, CodecError> {
        let head_at = out.len();
        let gaps = samples < rows.len();
        out.push(if gaps { HAS_GAPS } else { 0 });
        if gaps {
            presence::write(rows.present(), out);
        }
        let payload_at = out.len();
        let limit = E::max_payload_bytes(samples);
        let outcome = self.payload.encode(rows, shared, limit, out)?;
        if let Outcome::Coded(report) = outcome {
            if E::EXACT {
                return Ok(report);
            }
            if out.len() - payload_at <= limit
                && let Some(step) = bound::stated_step(report.max_error_mm, self.tolerance.mm())
            {
                out[head_at] |= step;
                return Ok(report);
            }
        }
        out.truncate(payload_at);
        self.payload.abandon();
        self.raw.reset();
        self.raw.write(rows, out);
        let samples = samples as u32;
        Ok(BlockReport { samples, kept: samples, max_error_mm: 0.0, recoded: 1 })
    }
}

impl<E: PayloadEncoder> BlockEncoder for FramedEncoder<E> {
    fn prepare(&mut self, n_rows: usize) {
        self.payload.prepare(n_rows);
        self.raw.reserve(n_rows);
        #[cfg(debug_assertions)]
        {
            let (twin, decoded) = &mut self.twin;
            twin.prepare(n_rows);
            decoded.clear_to(n_rows);
        }
    }

    fn encode(
        &mut self,
        rows: Rows<'_>,
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
    ) -> Result<BlockReport, CodecError> {
        let samples = count_finite(rows)?;
        let start = out.len();
        if key {
            self.payload.reset();
        }
        let report = if samples == 0 {
            self.payload.break_off();
            BlockReport::default()
        } else {
            self.encode_samples(rows, shared, samples, out).inspect_err(|_| out.truncate(start))?
        };
        #[cfg(debug_assertions)]
        {
            let (twin, decoded) = &mut self.twin;
            let outcome = twin.decode(&out[start..], shared, rows.len(), key, decoded);
            debug_assert!(outcome.is_ok(), "an encoded block does not decode: {outcome:?}");
            debug_assert_eq!(decoded.present, rows.present());
            let worst = (0..rows.len())
                .filter_map(|row| Some(bound::distance_mm(rows.get(row)?, decoded.positions[row])))
                .fold(0.0, f64::max);
            debug_assert!(worst == report.max_error_mm, "{worst} decoded, {report:?} reported");
            debug_assert_eq!(decoded.kept.iter().filter(|&&k| k).count(), report.kept as usize);
        }
        Ok(report)
    }
}
