//! Around an encoder: head, presence, the stated bound.

use super::{HAS_CHANNELS, HAS_GAPS, PayloadEncoder, count_finite, presence::Presence};
use crate::{
    BlockEncoder, BlockReport, CodecError, GROUP_CHANNELS, Rows, Tolerance, bound,
    coding::bytes::write_varint,
};
#[cfg(debug_assertions)]
use crate::{DecodedRows, frame::FramedDecoder};

/// A resampler's encoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedEncoder<E: PayloadEncoder> {
    payload: E,
    presence: Presence,
    tolerance: Tolerance,
    /// Channels of the block before.
    n_channels: usize,
    /// After an error only a key block is in step with the decoder.
    lost: bool,
    /// Debug builds decode every block they write.
    #[cfg(debug_assertions)]
    twin: (FramedDecoder<E::Decoder>, Vec<DecodedRows>),
}

impl<E: PayloadEncoder> FramedEncoder<E> {
    #[cfg_attr(
        not(debug_assertions),
        expect(unused_variables, clippy::needless_pass_by_value, reason = "the twin is for debug")
    )]
    pub(crate) fn new(payload: E, decoder: E::Decoder, tolerance: Tolerance) -> Self {
        Self {
            payload,
            presence: Presence::NEW,
            tolerance,
            n_channels: 0,
            lost: false,
            #[cfg(debug_assertions)]
            twin: (FramedDecoder::new(decoder, tolerance), Vec::new()),
        }
    }

    /// Sets the samples of the reports; gives the channels up to the last one that has any.
    fn count(
        channels: &[Rows<'_>],
        least: usize,
        reports: &mut [BlockReport],
    ) -> Result<usize, CodecError> {
        let argument = |message| Err(CodecError::InvalidArgument(message));
        if !(least..=GROUP_CHANNELS).contains(&channels.len()) {
            return argument(format!(
                "a block of {} channels: give {least} to {GROUP_CHANNELS}",
                channels.len()
            ));
        }
        if reports.len() != channels.len() {
            return argument(format!("{} channels, {} reports", channels.len(), reports.len()));
        }
        let mut n_sampled = 0;
        for (i, (rows, report)) in channels.iter().zip(reports).enumerate() {
            if rows.len() != channels[0].len() {
                return argument(format!(
                    "a channel of {} rows beside one of {}: give the same stretch of each",
                    rows.len(),
                    channels[0].len()
                ));
            }
            let samples = count_finite(*rows).map_err(|error| {
                CodecError::InvalidArgument(format!("channel {i} of the group: {error}"))
            })?;
            *report = BlockReport { samples: samples as u32, ..BlockReport::default() };
            if samples > 0 {
                n_sampled = i + 1;
            }
        }
        Ok(n_sampled)
    }

    /// Appends a block with samples.
    fn encode_samples(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        let head_at = out.len();
        out.push(0);
        if channels.len() != self.n_channels {
            out[head_at] |= HAS_CHANNELS;
            write_varint(channels.len() as u64, out);
            self.n_channels = channels.len();
        }
        let n_rows = channels[0].len();
        if reports.iter().any(|report| (report.samples as usize) < n_rows) {
            out[head_at] |= HAS_GAPS;
            self.presence.write(channels, out);
        } else {
            self.presence.all_present(channels.len(), n_rows);
        }
        self.payload.encode(channels, shared, out, reports)?;
        let max_error_mm = reports.iter().map(|report| report.max_error_mm).fold(0.0, f64::max);
        let step = bound::stated_step(max_error_mm, self.tolerance.mm());
        debug_assert!(step.is_some() && !(E::EXACT && step != Some(0)), "{max_error_mm} mm");
        out[head_at] |= step.ok_or(CodecError::Corrupt("an error over the tolerance"))?;
        Ok(())
    }

    #[cfg(debug_assertions)]
    fn check(
        &mut self,
        block: &[u8],
        (channels, shared, key): (&[Rows<'_>], &[u8], bool),
        reports: &[BlockReport],
    ) {
        use crate::BlockDecoder;

        let (twin, decoded) = &mut self.twin;
        let outcome = twin.decode(block, shared, channels[0].len(), key, decoded);
        debug_assert!(outcome.is_ok(), "an encoded block does not decode: {outcome:?}");
        for (i, (rows, report)) in channels.iter().zip(reports).enumerate() {
            let Some(decoded) = decoded.get(i) else {
                debug_assert_eq!(report.samples, 0, "channel {i} is left out");
                continue;
            };
            debug_assert_eq!(decoded.present, rows.present());
            let worst = (0..rows.len())
                .filter_map(|row| Some(bound::distance_mm(rows.get(row)?, decoded.positions[row])))
                .fold(0.0, f64::max);
            debug_assert!(worst == report.max_error_mm, "{worst} decoded, {report:?} reported");
            debug_assert_eq!(decoded.kept.iter().filter(|&&k| k).count(), report.kept as usize);
        }
    }
}

impl<E: PayloadEncoder> BlockEncoder for FramedEncoder<E> {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.payload.prepare(n_channels, n_rows);
        #[cfg(debug_assertions)]
        {
            let (twin, decoded) = &mut self.twin;
            twin.prepare(n_channels, n_rows, decoded);
        }
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        let least = if key { 1 } else { self.n_channels.max(1) };
        let n_sampled = Self::count(channels, least, reports)?;
        if key {
            self.payload.reset();
            self.presence.reset();
            self.n_channels = 0;
            self.lost = false;
        }
        if self.lost {
            return Err(CodecError::InvalidArgument(
                "an earlier block failed: go on with a key block".to_owned(),
            ));
        }
        let start = out.len();
        if n_sampled == 0 {
            self.payload.break_off();
            self.presence.skip();
        } else {
            let n = n_sampled.max(self.n_channels);
            self.encode_samples(&channels[..n], shared, out, &mut reports[..n]).inspect_err(
                |_| {
                    out.truncate(start);
                    self.lost = true;
                },
            )?;
        }
        #[cfg(debug_assertions)]
        self.check(&out[start..], (channels, shared, key), reports);
        Ok(())
    }
}
