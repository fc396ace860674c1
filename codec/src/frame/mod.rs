//! The frame of every block: the head byte, the number of channels, the presence section and the stated error bound.
//!
//! A resampler codes payloads only; [`FramedEncoder`] and [`FramedDecoder`] add the frame and implement the public
//! contract. Debug builds decode every block that they encode, and compare it with its samples.

mod presence;

use std::fmt;

use self::presence::Presence;
use crate::{
    BlockDecoder, BlockEncoder, BlockReport, CodecError, DecodedRows, GROUP_CHANNELS, Result, Rows,
    Tolerance,
    block::{self, STATED_STEPS},
    coding::{Bytes, write_varint},
    ensure,
};

/// Bit 7 of the head byte: the presence section follows.
const HAS_GAPS: u8 = 0x80;

/// Bit 6 of the head byte: the number of channels follows.
const HAS_CHANNELS: u8 = 0x40;

/// The state of a resampler's encoder or decoder: payloads without their frame.
pub(crate) trait Payload: Send + fmt::Debug {
    /// Whether payloads are bit-exact; the stated bound is then 0.
    const EXACT: bool = false;

    /// Allocates the memory for encoding, for [`BlockEncoder::prepare`]. Offline kinds prepare nothing.
    fn prepare(&mut self, _n_channels: usize, _n_rows: usize) {}

    /// Allocates the memory for decoding.
    #[cfg(debug_assertions)]
    fn prepare_decoder(&mut self, n_channels: usize, n_rows: usize) {
        self.prepare(n_channels, n_rows);
    }

    /// Forgets all state.
    fn reset(&mut self) {}

    /// Begins a stretch with the bytes that its channels share, which only `sync` has.
    fn begin(&mut self, _shared: &[u8], _n_rows: usize) -> Result<()> {
        Ok(())
    }

    /// Accounts for a stretch without samples: no earlier row directly precedes the next block.
    fn forget_rows(&mut self) {}
}

/// A resampler's encoder.
pub(crate) trait PayloadEncoder: Payload {
    /// Maximum number of bytes of a payload of `n_channels` channels and `n_rows` rows.
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize;

    /// Appends the payload of a block with at least one sample, all of them finite. Completes `reports`, one per
    /// channel, in which the frame has set `samples`, and sets those of `kept_rows`, one per row, in which any sample
    /// is kept. Every reported error is within the tolerance: samples that cannot be coded within it are stored
    /// exactly. Except after [`reset`](Payload::reset), there are never fewer channels than in the payload before; new
    /// ones are appended.
    ///
    /// `exact` stores every sample exactly, in the payload of a key block.
    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()>;
}

/// A resampler's decoder.
pub(crate) trait PayloadDecoder: Payload {
    /// Fills `positions` and `kept` of `channels`, whose `present` is set and whose absent rows are zero. At least one
    /// sample is present. The payload must end with its last sample.
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()>;
}

/// Maximum number of bytes of a block with payloads of the encoder `E`.
pub(crate) fn max_block_bytes<E: PayloadEncoder>(n_channels: usize, n_rows: usize) -> usize {
    // The head byte, and the number of channels, at most 64, in one byte.
    2 + presence::max_bytes(n_channels, n_rows) + E::max_payload_bytes(n_channels, n_rows)
}

/// The number of channels that a block states: key blocks do, and blocks with more channels than the block before.
/// `None` where the block states no number or an invalid one.
#[must_use]
pub fn stated_channels(block: &[u8]) -> Option<usize> {
    let (head, rest) = block.split_first()?;
    if head & HAS_CHANNELS == 0 {
        return None;
    }
    let n = Bytes::new(rest).varint("the number of channels").ok()?;
    usize::try_from(n).ok().filter(|n| (1..=GROUP_CHANNELS).contains(n))
}

/// The step in which a block states its error: the error is [`Tolerance::stated_mm`] of it. 0 for an empty block.
#[must_use]
pub fn stated_error_step(block: &[u8]) -> u8 {
    block.first().map_or(0, |head| head & STATED_STEPS)
}

/// Counts the samples present; fails when one is not finite.
pub(crate) fn count_finite(rows: Rows<'_>) -> Result<usize> {
    // Without their signs, the bits of infinities and NaN are the largest.
    let not_finite = |c: &f32| c.to_bits() & !(1 << 31) >= f32::INFINITY.to_bits();
    let (mut samples, mut any) = (0, false);
    for run in rows.runs() {
        samples += run.len();
        // Without branches, so that it vectorises.
        let positions = rows.positions()[run].as_flattened();
        any |= positions.iter().fold(false, |any, c| any | not_finite(c));
    }
    if !any {
        return Ok(samples);
    }
    let is_bad =
        |&row: &usize| rows.get(row).is_some_and(|position| position.iter().any(not_finite));
    let row = (0..rows.len()).find(is_bad).unwrap_or_default();
    Err(CodecError::InvalidArgument(format!(
        "row {row} is present but {:?} is not finite; mark such rows absent",
        rows.positions()[row]
    )))
}

/// The state that encoder and decoder carry from block to block.
#[derive(Debug)]
struct FrameState<P> {
    payload: P,
    presence: Presence,
    tolerance: Tolerance,
    /// Number of channels of the block before.
    n_channels: usize,
    /// Whether a block failed since the last key block.
    is_out_of_step: bool,
}

impl<P: Payload> FrameState<P> {
    fn new(payload: P, tolerance: Tolerance) -> Self {
        Self { payload, presence: Presence::NEW, tolerance, n_channels: 0, is_out_of_step: false }
    }

    /// Resets everything before a key block.
    fn reset(&mut self) {
        self.payload.reset();
        self.presence.reset();
        self.n_channels = 0;
        self.is_out_of_step = false;
    }

    /// Accounts for an empty block.
    fn skip_empty(&mut self) {
        self.payload.forget_rows();
        self.presence.skip();
    }
}

/// A resampler's encoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedEncoder<E> {
    state: FrameState<E>,
    /// Whether any sample is kept in each row of the last block.
    kept_rows: Vec<bool>,
    /// A decoder with which debug builds check every block.
    #[cfg(debug_assertions)]
    verifier: (FramedDecoder<E>, Vec<DecodedRows>),
}

impl<E: PayloadEncoder + PayloadDecoder> FramedEncoder<E> {
    /// An encoder of payloads; debug builds create a second payload state for the check.
    pub(crate) fn new(payload: impl Fn(Tolerance) -> E, tolerance: Tolerance) -> Self {
        Self {
            state: FrameState::new(payload(tolerance), tolerance),
            kept_rows: Vec::new(),
            #[cfg(debug_assertions)]
            verifier: (FramedDecoder::new(payload(tolerance), tolerance), Vec::new()),
        }
    }

    /// Checks the arguments and counts the samples into `reports`; returns the number of channels up to the last one
    /// with samples.
    fn count(channels: &[Rows<'_>], least: usize, reports: &mut [BlockReport]) -> Result<usize> {
        let argument = |message| Err(CodecError::InvalidArgument(message));
        if !(least..=GROUP_CHANNELS).contains(&channels.len()) {
            return argument(format!(
                "{} channels in a block: pass {least} to {GROUP_CHANNELS}",
                channels.len()
            ));
        }
        if reports.len() != channels.len() {
            return argument(format!(
                "{} channels but {} reports: pass one report per channel",
                channels.len(),
                reports.len()
            ));
        }
        let mut n_sampled = 0;
        for (i, (rows, report)) in channels.iter().zip(reports).enumerate() {
            if rows.len() != channels[0].len() {
                return argument(format!(
                    "channels of {} and of {} rows: pass the same stretch of each",
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

    /// Appends what precedes the payload of a block with samples; the head byte states no error yet.
    fn put_head(&mut self, channels: &[Rows<'_>], out: &mut Vec<u8>, reports: &[BlockReport]) {
        let head_at = out.len();
        out.push(0);
        if channels.len() != self.state.n_channels {
            out[head_at] |= HAS_CHANNELS;
            write_varint(channels.len() as u64, out);
            self.state.n_channels = channels.len();
        }
        let n_rows = channels[0].len();
        if reports.iter().any(|report| (report.samples as usize) < n_rows) {
            out[head_at] |= HAS_GAPS;
            self.state.presence.write(channels, out);
        } else {
            self.state.presence.all_present(channels.len(), n_rows);
        }
    }

    /// Appends a block with samples.
    fn encode_samples(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<()> {
        let head_at = out.len();
        self.put_head(channels, out, reports);
        let n_rows = channels[0].len();
        self.state.payload.begin(shared, n_rows).map_err(|error| {
            CodecError::InvalidArgument(format!(
                "{error}: pass the result of Settings::plan for the same {n_rows} rows"
            ))
        })?;
        self.state.payload.encode(channels, false, out, reports, &mut self.kept_rows)?;
        let max_error_mm = reports.iter().map(|report| report.max_error_mm).fold(0.0, f64::max);
        let step = block::stated_step(max_error_mm, self.state.tolerance.mm());
        debug_assert!(step.is_some() && !(E::EXACT && step != Some(0)), "{max_error_mm} mm");
        out[head_at] |= step.ok_or(CodecError::Corrupt("an error over the tolerance"))?;
        Ok(())
    }

    /// Begins a block of `n_rows` rows, with none kept so far.
    fn keep_no_rows(&mut self, n_rows: usize) {
        self.kept_rows.clear();
        self.kept_rows.resize(n_rows, false);
    }

    /// Decodes a block and compares it with its samples and reports.
    #[cfg(debug_assertions)]
    fn check(
        &mut self,
        block: &[u8],
        channels: &[Rows<'_>],
        shared: &[u8],
        key: bool,
        reports: &[BlockReport],
    ) {
        let (verifier, decoded) = &mut self.verifier;
        let outcome = verifier.decode(block, shared, channels[0].len(), key, decoded);
        debug_assert!(outcome.is_ok(), "an encoded block does not decode: {outcome:?}");
        for (row, kept) in self.kept_rows.iter().enumerate() {
            debug_assert_eq!(decoded.iter().any(|rows| rows.kept[row]), *kept, "row {row}");
        }
        for (i, (rows, report)) in channels.iter().zip(reports).enumerate() {
            let Some(decoded) = decoded.get(i) else {
                debug_assert_eq!(report.samples, 0, "channel {i} is left out");
                continue;
            };
            debug_assert_eq!(decoded.present, rows.present());
            let worst = (0..rows.len())
                .filter_map(|row| Some(block::distance_mm(rows.get(row)?, decoded.positions[row])))
                .fold(0.0, f64::max);
            debug_assert!(worst == report.max_error_mm, "{worst} decoded, {report:?} reported");
            debug_assert_eq!(decoded.kept.iter().filter(|&&k| k).count(), report.kept as usize);
        }
    }
}

impl<E: PayloadEncoder + PayloadDecoder> BlockEncoder for FramedEncoder<E> {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.state.payload.prepare(n_channels, n_rows);
        self.kept_rows.reserve(n_rows.saturating_sub(self.kept_rows.len()));
        #[cfg(debug_assertions)]
        {
            let (verifier, decoded) = &mut self.verifier;
            verifier.prepare(n_channels, n_rows, decoded);
        }
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<()> {
        let least = if key { 1 } else { self.state.n_channels.max(1) };
        let n_sampled = Self::count(channels, least, reports)?;
        if key {
            self.state.reset();
        }
        if self.state.is_out_of_step {
            return Err(CodecError::OutOfStep);
        }
        let start = out.len();
        self.keep_no_rows(channels[0].len());
        if n_sampled == 0 {
            self.state.skip_empty();
        } else {
            let n = n_sampled.max(self.state.n_channels);
            self.encode_samples(&channels[..n], shared, out, &mut reports[..n]).inspect_err(
                |_| {
                    out.truncate(start);
                    self.state.is_out_of_step = true;
                },
            )?;
        }
        #[cfg(debug_assertions)]
        self.check(&out[start..], channels, shared, key, reports);
        Ok(())
    }

    fn encode_exact(
        &mut self,
        channels: &[Rows<'_>],
        stated_error_mm: f64,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<()> {
        let tolerance_mm = self.state.tolerance.mm();
        // The smallest step that states the error: the step of the blocks that it comes from.
        let states = |&step: &u8| block::stated_mm(step, tolerance_mm) >= stated_error_mm;
        let step = (0..=STATED_STEPS).find(states).filter(|step| !E::EXACT || *step == 0);
        let step = step.ok_or_else(|| {
            CodecError::InvalidArgument(format!(
                "a block cannot state an error of {stated_error_mm} mm: its tolerance is {} mm",
                if E::EXACT { 0.0 } else { tolerance_mm }
            ))
        })?;
        let n_sampled = Self::count(channels, 1, reports)?;
        self.state.reset();
        let start = out.len();
        self.keep_no_rows(channels[0].len());
        if n_sampled == 0 {
            self.state.skip_empty();
        } else {
            let (sampled, reports) = (&channels[..n_sampled], &mut reports[..n_sampled]);
            self.put_head(sampled, out, reports);
            out[start] |= step;
            // No key times: a channel that is stored exactly needs none.
            let Self { state: FrameState { payload, .. }, kept_rows, .. } = self;
            let begun = payload.begin(&[], sampled[0].len());
            let coded = begun.and_then(|()| payload.encode(sampled, true, out, reports, kept_rows));
            coded.inspect_err(|_| {
                out.truncate(start);
                self.state.is_out_of_step = true;
            })?;
        }
        #[cfg(debug_assertions)]
        self.check(&out[start..], channels, &[], true, reports);
        Ok(())
    }

    fn kept_rows(&self) -> &[bool] {
        &self.kept_rows
    }
}

/// A resampler's decoder with the frame around it.
#[derive(Debug)]
pub(crate) struct FramedDecoder<D> {
    state: FrameState<D>,
    /// Memory of channels that the current block lacks.
    spare: Vec<DecodedRows>,
}

impl<D: PayloadDecoder> FramedDecoder<D> {
    pub(crate) fn new(payload: D, tolerance: Tolerance) -> Self {
        Self { state: FrameState::new(payload, tolerance), spare: Vec::new() }
    }

    /// Allocates the memory for blocks of up to `n_channels` channels and `n_rows` rows.
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_channels: usize, n_rows: usize, out: &mut Vec<DecodedRows>) {
        self.state.payload.prepare_decoder(n_channels, n_rows);
        self.resize(n_channels, n_rows, out);
        self.resize(0, n_rows, out);
    }

    /// Sets the numbers of channels and rows of `out`, reusing memory; positions and presence are then undefined.
    fn resize(&mut self, n_channels: usize, n_rows: usize, out: &mut Vec<DecodedRows>) {
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
    ) -> Result<()> {
        ensure(n_rows > 0, "a block with bytes but without rows")?;
        let mut input = Bytes::new(block);
        let head = input.byte("the head byte")?;
        let more = head & HAS_CHANNELS != 0;
        if more {
            let n = usize::try_from(input.varint("the number of channels")?).unwrap_or(usize::MAX);
            ensure(
                n > self.state.n_channels && n <= GROUP_CHANNELS,
                "an impossible number of channels",
            )?;
            self.state.n_channels = n;
        } else if self.state.n_channels == 0 {
            return Err(CodecError::Corrupt("a first block without its number of channels"));
        }
        self.resize(self.state.n_channels, n_rows, out);
        if head & HAS_GAPS != 0 {
            self.state.presence.read(&mut input, out)?;
            out.iter_mut().for_each(DecodedRows::blank_absent);
            ensure(
                out.iter().any(DecodedRows::has_samples),
                "a block with bytes but without samples",
            )?;
        } else {
            out.iter_mut().for_each(|rows| rows.present.fill(true));
            self.state.presence.all_present(self.state.n_channels, n_rows);
        }
        ensure(
            !more || out.last().is_some_and(DecodedRows::has_samples),
            "a last channel without samples",
        )?;
        let step = head & STATED_STEPS;
        ensure(!D::EXACT || step == 0, "a lossless block that states an error")?;
        let max_error_mm = block::stated_mm(step, self.state.tolerance.mm());
        out.iter_mut().for_each(|rows| rows.max_error_mm = max_error_mm);
        self.state.payload.begin(shared, n_rows)?;
        self.state.payload.decode(input.rest(), out)
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
    ) -> Result<()> {
        self.resize(0, 0, out);
        if key {
            self.state.reset();
        }
        if self.state.is_out_of_step {
            return Err(CodecError::OutOfStep);
        }
        if block.is_empty() {
            self.skip(false);
            return Ok(());
        }
        let outcome = self.decode_samples(block, shared, n_rows, out);
        if outcome.is_err() {
            self.state.is_out_of_step = true;
            self.resize(0, 0, out);
        }
        outcome
    }

    fn skip(&mut self, key: bool) {
        if key {
            self.state.reset();
        }
        self.state.skip_empty();
    }
}
