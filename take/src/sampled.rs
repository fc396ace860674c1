//! Sampled channels of a take: groups of scalar channels, SAMPLES, which hold their samples in blocks, and
//! `SAMPLE_TIMES`, which say when the samples of a recording were taken, by the device's clock.
//!
//! `docs/take-format.md` has the chunks, `docs/sampled-channels.md` the blocks.

mod encoder;
mod part;
mod recording;
mod resample;
mod time_line;

#[cfg(test)]
mod tests;

use std::ops::Range;

pub(crate) use self::encoder::PartContext;
pub(crate) use self::part::{GroupReader, RecoveredSamples, SampleRun};
pub(crate) use self::resample::{FILTER, Resampler, reach};
pub(crate) use self::time_line::{RowPiece, epochs_of};
pub use self::{
    encoder::{EncodedSpan, KeySpan, KeySpans, SamplesPlan, SpanEncoder, sample_count},
    part::{GroupSamples, LostSamples, SampledPart},
    recording::{
        ReadSeek, RecordedPoses, RecordedResiduals, RecordedSamples, Recording, SampleBlock,
    },
    time_line::{PlaceIndex, RecordingClock, RowClock, SampleTimeLine},
};
use crate::{
    TakeError,
    record::{SAMPLES_MAX, SampledGroup},
    timeline::LossCauses,
    varint,
};

/// Maximum number of samples of a channel in a block: those of ten seconds at 13 kHz.
pub const BLOCK_ROWS_MAX: u64 = 1 << 17;

/// Maximum number of samples of a block, of all its channels: 4 MiB of float32. So a chunk is short enough to be held
/// before its CRC is known to match, and a few bytes that claim this many samples cost a reader about a second.
pub const BLOCK_SAMPLES_MAX: u64 = 1 << 20;

/// The kind of the parts that are scalar channels of a recording, which belong to no file. Each group is a part of its own.
pub const RECORDED: &str = "";

/// The kind of the parts that are poses of rigid bodies in a recording ([`poses`](crate::poses)).
pub const POSES: &str = "poses";

/// The numbers of the groups that are residuals of markers: those behind the numbers of a device's own groups and of poses,
/// as many as a recorder can number.
pub const RESIDUAL_GROUPS: Range<u32> = 32..256;

/// What is behind a marker's label in the name of the channel of its residuals.
pub const RESIDUAL_SUFFIX: &str = ".residual";

/// Millimetres in a count of such a channel: devices report 10 micrometres.
pub const RESIDUAL_SCALE: f64 = 0.01;

impl SampledGroup {
    /// Whether its channels are the residuals of markers: one sample in each row. The index of a channel is that of its
    /// marker in the take's table.
    #[must_use]
    pub fn has_residuals(&self) -> bool {
        self.kind == RECORDED && RESIDUAL_GROUPS.contains(&self.number)
    }
}

/// Whether the parts of this kind are channels of a recording: scalar ones, or the poses of rigid bodies.
#[must_use]
pub fn is_recorded(kind: &str) -> bool {
    kind == RECORDED || kind == POSES
}

/// The name of a part in messages.
pub(crate) fn part_name(kind: &str) -> &str {
    match kind {
        RECORDED => "the sampled channels",
        POSES => "the poses",
        _ => kind,
    }
}

const KEY: u8 = 1;
const LOST: u8 = 2;

/// What a SAMPLES chunk holds: the same samples of all channels of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleSpan {
    /// Number of the group.
    pub group: u32,
    /// Number of the first sample, from 0.
    pub first: u64,
    /// Number of samples of each channel.
    pub n: u64,
    /// Its content.
    pub content: SampleContent,
}

/// The content of a SAMPLES chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleContent {
    /// A block from which decoding can start.
    Key,
    /// A block that continues the one before.
    Continued,
    /// No block: the samples are lost.
    Lost(LossCauses),
}

impl SampleSpan {
    /// The number of the sample after it.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first.saturating_add(self.n)
    }

    /// Appends the payload of its chunk up to the block. That of lost samples is complete.
    pub(crate) fn put(&self, out: &mut Vec<u8>) {
        out.push(match self.content {
            SampleContent::Key => KEY,
            SampleContent::Continued => 0,
            SampleContent::Lost(_) => LOST,
        });
        for number in [self.group.into(), self.first, self.n] {
            varint::put(out, number);
        }
        if let SampleContent::Lost(causes) = self.content {
            out.push(causes.0);
        }
    }

    /// Parses the payload of a chunk. Returns also the block.
    fn parse(payload: &[u8]) -> Result<(Self, &[u8]), &'static str> {
        let mut cursor = varint::Cursor::new(payload);
        let head = cursor.byte().ok_or("it is empty")?;
        let mut number = || cursor.varint().ok_or("its numbers are incomplete");
        let (group, first, n) = (number()?, number()?, number()?);
        let group = u32::try_from(group).map_err(|_| "the number of its group is too large")?;
        let end = first.checked_add(n).filter(|end| *end <= SAMPLES_MAX);
        if n == 0 || end.is_none() {
            return Err("its range of samples is empty or too large");
        }
        let rest = cursor.rest();
        let (content, block) = match (head, rest) {
            (KEY, [_, ..]) => (SampleContent::Key, rest),
            (0, [_, ..]) => (SampleContent::Continued, rest),
            (LOST, &[causes]) => (SampleContent::Lost(LossCauses(causes)), &[][..]),
            _ => return Err("its head does not fit what follows"),
        };
        if !block.is_empty() && n > BLOCK_ROWS_MAX {
            return Err("it has more samples than a block can hold");
        }
        Ok((Self { group, first, n, content }, block))
    }
}

/// A SAMPLES chunk of a take, with the place of its block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplesChunk {
    /// What it holds.
    pub span: SampleSpan,
    /// File offset of the chunk.
    pub offset: u64,
    /// File offset of the block.
    block_at: u64,
    /// Size of the block.
    block_bytes: u64,
}

impl SamplesChunk {
    /// Parses the chunk at file offset `offset`, whose payload begins at `payload_at`.
    pub(crate) fn from_payload(
        payload: &[u8],
        payload_at: u64,
        offset: u64,
    ) -> Result<Self, TakeError> {
        let (span, block) = SampleSpan::parse(payload)
            .map_err(|why| TakeError::corrupt("chunk of samples", offset, why))?;
        let block_at = payload_at + (payload.len() - block.len()) as u64;
        Ok(Self { span, offset, block_at, block_bytes: block.len() as u64 })
    }
}

/// Maximum number of samples of each channel in a block of `n_channels` channels.
#[must_use]
pub fn block_rows_max(n_channels: usize) -> u64 {
    (BLOCK_SAMPLES_MAX / (n_channels as u64).max(1)).min(BLOCK_ROWS_MAX)
}

/// Whether the span can be one of the group.
fn fits(group: &SampledGroup, span: &SampleSpan) -> bool {
    let is_block = !matches!(span.content, SampleContent::Lost(_));
    span.end() <= group.n_samples.unwrap_or(u64::MAX)
        && !(is_block && span.n > block_rows_max(group.channels.len()))
}

const NAME: &str = "times of samples";

/// Time between two anchors from which on their line goes on beyond them, in seconds. Devices stamp batches up to some
/// milliseconds late, so that a line over less time is steeper or flatter than the rate that the group states.
const APART_S: f64 = 10.0;

/// The version of the payload.
const VERSION: u16 = 1;

/// Most anchors of a chunk: a recorder writes one for each block.
const ANCHORS_MAX: usize = 1 << 16;

/// The time of one sample of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleAnchor {
    /// Number of the sample.
    pub number: u64,
    /// Number of the first sample of its run: between the samples of a run the device's clock did not jump, and none was
    /// taken that has no number.
    pub run_start: u64,
    /// Time of the sample by the device's clock, in ticks: the clock of the rows.
    pub device_ticks: u64,
    /// The segment of the device's clock, as in CLOCK.
    pub segment: u32,
}

impl SampleAnchor {
    /// The anchor in a take in which numbers of samples and of segments are higher by these.
    pub(crate) fn moved(&self, by: u64, by_segment: u32) -> Self {
        Self {
            number: self.number.saturating_add(by),
            run_start: self.run_start.saturating_add(by),
            segment: self.segment.saturating_add(by_segment),
            ..*self
        }
    }
}

/// A `SAMPLE_TIMES` chunk: anchors of one group in one run, in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SampleTimes {
    /// Number of the group.
    pub group: u32,
    /// The anchors; at least one.
    pub anchors: Vec<SampleAnchor>,
}

impl SampleTimes {
    /// Appends the payload of a chunk with an anchor and, in the same run, the number and time of a later sample.
    pub(crate) fn put(
        group: u32,
        anchor: &SampleAnchor,
        later: Option<(u64, u64)>,
        out: &mut Vec<u8>,
    ) {
        out.extend_from_slice(&VERSION.to_le_bytes());
        let after_start = anchor.number.saturating_sub(anchor.run_start);
        for number in [
            group.into(),
            anchor.segment.into(),
            anchor.run_start,
            after_start,
            anchor.device_ticks,
        ] {
            varint::put(out, number);
        }
        if let Some((number, device_ticks)) = later.filter(|later| later.0 > anchor.number) {
            varint::put(out, number - anchor.number);
            varint::put(out, zigzag(device_ticks.wrapping_sub(anchor.device_ticks)));
        }
    }

    /// Parses the payload of the chunk at file offset `offset`, whose CRC matched.
    pub(crate) fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |why| TakeError::corrupt(NAME, offset, why);
        let Some((version, rest)) = payload.split_first_chunk::<2>() else {
            return Err(corrupt("shorter than its version"));
        };
        let (found, supported) = (u16::from_le_bytes(*version), VERSION);
        if found != supported {
            return Err(TakeError::Unsupported { what: NAME, found, supported });
        }
        Self::parse(&mut varint::Cursor::new(rest)).map_err(corrupt)
    }

    fn parse(cursor: &mut varint::Cursor<'_>) -> Result<Self, &'static str> {
        const INCOMPLETE: &str = "its numbers are incomplete";
        let small = |cursor: &mut varint::Cursor<'_>| {
            let number = cursor.varint().ok_or(INCOMPLETE)?;
            u32::try_from(number).map_err(|_| "the number of its group or segment is too large")
        };
        let (group, segment) = (small(cursor)?, small(cursor)?);
        let run_start = cursor.varint().ok_or(INCOMPLETE)?;
        let mut times = Self { group, anchors: Vec::new() };
        let (mut number, mut device_ticks) = (run_start, 0_u64);
        while !cursor.is_empty() || times.anchors.is_empty() {
            let step = cursor.varint().ok_or(INCOMPLETE)?;
            let ticks = cursor.varint().ok_or(INCOMPLETE)?;
            let is_first = times.anchors.is_empty();
            number = number.saturating_add(step);
            device_ticks =
                if is_first { ticks } else { device_ticks.wrapping_add(unzigzag(ticks)) };
            if (step == 0 && !is_first) || number > SAMPLES_MAX {
                return Err("its samples are not in order, or their numbers too large");
            }
            if times.anchors.len() == ANCHORS_MAX {
                return Err("it has more times than a chunk can hold");
            }
            times.anchors.push(SampleAnchor { number, run_start, device_ticks, segment });
        }
        Ok(times)
    }
}

fn zigzag(value: u64) -> u64 {
    let value = value.cast_signed();
    (value << 1 ^ value >> 63).cast_unsigned()
}

fn unzigzag(value: u64) -> u64 {
    value >> 1 ^ (value & 1).wrapping_neg()
}

/// When a sample was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleTime {
    /// Time by the device's clock in whole ticks, rounded down.
    pub device_ticks: u64,
    /// The rest, 0 to 1 ticks.
    pub fraction: f64,
    /// The segment of the device's clock.
    pub segment: u32,
    /// Number of the first sample of its run.
    pub run_start: u64,
}

impl SampleTime {
    /// Ticks since another time of the same segment.
    #[must_use]
    pub fn ticks_since(&self, device_ticks: u64) -> f64 {
        self.device_ticks.wrapping_sub(device_ticks).cast_signed() as f64 + self.fraction
    }
}

/// The times of all samples of a group: those of a run lie on the lines between its anchors. Before the first and behind
/// the last anchor of a run the line through these two goes on if they are far enough apart for it; else samples come at
/// the group's rate. A block whose anchors are lost has times only where other anchors show its run.
#[derive(Debug, Clone, Copy)]
pub struct SampleClock<'a> {
    anchors: &'a [SampleAnchor],
    /// The chunks of the samples, in order.
    chunks: &'a [SamplesChunk],
    /// Ticks between two anchors from which on their line goes on beyond them.
    apart_ticks: f64,
    /// Ticks from a sample to the next at the group's rate.
    nominal_ticks: f64,
}

impl<'a> SampleClock<'a> {
    /// The clock of a group with `rate_hz`, whose anchors and chunks are in ascending order of samples.
    pub(crate) fn new(
        anchors: &'a [SampleAnchor],
        chunks: &'a [SamplesChunk],
        rate_hz: f64,
        tick_hz: u64,
    ) -> Self {
        let (apart_ticks, nominal_ticks) = (APART_S * tick_hz as f64, tick_hz as f64 / rate_hz);
        Self { anchors, chunks, apart_ticks, nominal_ticks }
    }

    /// The time of a sample; `None` before the first run, and where the run is unknown because anchors are lost.
    #[must_use]
    pub fn at(&self, number: u64) -> Option<SampleTime> {
        let next = self.anchors.partition_point(|anchor| anchor.number <= number);
        let before = next.checked_sub(1).and_then(|at| self.anchors.get(at));
        let after = self.anchors.get(next).filter(|after| after.run_start <= number);
        let (from, ticks_each) = match (before, after) {
            (Some(before), Some(after)) if before.run_start == after.run_start => {
                (before, slope(before, after))
            }
            // The anchor of the first sample of the run is missing.
            (_, Some(after)) => (after, self.ticks_each(next)),
            (Some(before), None) if self.is_anchored(number, before) => {
                (before, self.ticks_each(next - 1))
            }
            (_, None) => return None,
        };
        let by = (i128::from(number) - i128::from(from.number)) as f64 * ticks_each;
        let whole = by.floor();
        Some(SampleTime {
            device_ticks: from.device_ticks.wrapping_add_signed(whole as i64),
            fraction: by - whole,
            segment: from.segment,
            run_start: from.run_start,
        })
    }

    /// Whether a sample lies in the run of the last anchor before it: it is in the same block, or lost. Each block has an
    /// anchor at its first sample unless that is lost, and another run may begin there.
    fn is_anchored(&self, number: u64, before: &SampleAnchor) -> bool {
        let at = self.chunks.partition_point(|chunk| chunk.span.first <= number);
        let Some(chunk) = at.checked_sub(1).and_then(|at| self.chunks.get(at)) else { return true };
        let is_lost = matches!(chunk.span.content, SampleContent::Lost(_));
        is_lost || number >= chunk.span.end() || before.number >= chunk.span.first
    }

    /// Ticks from a sample to the next over the whole run of an anchor, if it is long enough to measure them.
    fn ticks_each(&self, at: usize) -> f64 {
        let Some(anchor) = self.anchors.get(at) else { return self.nominal_ticks };
        let is_before = |other: &SampleAnchor| other.run_start < anchor.run_start;
        let is_within = |other: &SampleAnchor| other.run_start <= anchor.run_start;
        let first = self.anchors.get(self.anchors.partition_point(is_before));
        let last = self.anchors.get(self.anchors.partition_point(is_within).saturating_sub(1));
        match first.zip(last) {
            Some((first, last)) if last.number > first.number => {
                let each = slope(first, last);
                let apart = each * last.number.saturating_sub(first.number) as f64;
                if apart >= self.apart_ticks { each } else { self.nominal_ticks }
            }
            _ => self.nominal_ticks,
        }
    }
}

/// Ticks from a sample to the next on the line between two anchors.
fn slope(a: &SampleAnchor, b: &SampleAnchor) -> f64 {
    let ticks = b.device_ticks.wrapping_sub(a.device_ticks).cast_signed();
    ticks as f64 / b.number.saturating_sub(a.number).max(1) as f64
}
