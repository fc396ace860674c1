//! Sampled channels of a take: groups of scalar channels, and SAMPLES, which hold their samples in blocks.
//!
//! `docs/take-format.md` has the chunks, `docs/sampled-channels.md` the blocks.

mod encoder;
mod part;
mod recording;
mod resample;
#[cfg(test)]
mod tests;
mod time_line;
mod times;

pub(crate) use self::encoder::PartContext;
pub(crate) use self::part::{GroupReader, RecoveredSamples, SampleRun};
pub(crate) use self::resample::{FILTER, Resampler, reach};
pub(crate) use self::time_line::epochs_of;
pub use self::{
    encoder::{EncodedSpan, KeySpan, KeySpans, SamplesPlan, SpanEncoder, sample_count},
    part::{GroupSamples, LostSamples, SampledPart},
    recording::{ReadSeek, RecordedPoses, RecordedSamples, Recording, SampleBlock},
    time_line::{PlaceIndex, RecordingClock, RowClock, SampleTimeLine},
    times::{SampleAnchor, SampleClock, SampleTime, SampleTimes},
};

use crate::{TakeError, record::SampledGroup, timeline::LossCauses, varint};

/// Maximum number of samples of a channel in a block: those of ten seconds at 13 kHz.
pub const BLOCK_ROWS_MAX: u64 = 1 << 17;

/// Maximum number of samples of a block, of all its channels: 4 MiB of float32. So a chunk is short enough to be held
/// before its CRC is known to match, and a few bytes that claim this many samples cost a reader about a second.
pub const BLOCK_SAMPLES_MAX: u64 = 1 << 20;

/// The kind of the parts that are scalar channels of a recording, which belong to no file. Each group is a part of its own.
pub const RECORDED: &str = "";

/// The kind of the parts that are poses of rigid bodies in a recording ([`poses`](crate::poses)).
pub const POSES: &str = "poses";

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
        let end = first.checked_add(n).filter(|end| *end <= crate::record::SAMPLES_MAX);
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
