//! Sampled channels: scalar signals at a rate of their own, such as those of force plates, electrodes and inertial
//! sensors, bit for bit.
//!
//! A group of channels of equal rate is coded in blocks. In a block the channels follow each other; each is predicted
//! from its own past (`predictor`) and from the channels before it, also their present. The prediction and the errors
//! so far give a distribution (`distribution`), and a sample is coded as one of the values that the channel takes
//! (`cells`, chosen by the encoder in `fit`), by decisions between two halves of an interval (`walk`). Events that a
//! distribution does not express have flags before it: a repeated sample, a sample on a line, a most frequent value.
//!
//! `docs/sampled-channels.md` specifies every byte. Takes hold such blocks, so that the format is frozen.

mod bounded;
mod fit;
mod positions;
mod prediction;
mod representation;
#[cfg(test)]
mod tests;
mod walk;

pub use self::bounded::{ChannelProfile, SampleBound};
pub(crate) use positions::Predictive;

use self::{
    fit::EarlierChannels,
    prediction::REFERENCES,
    representation::{Cells, Head, HeadModel, PALETTE_MAX},
    walk::{ChannelWalk, ReferenceChannel, SampleModel, SampledChannelState},
};
use crate::{
    CodecError, GROUP_CHANNELS, Result,
    coding::{
        isa::Isa,
        range::{BinaryCoder, RangeDecoder, RangeEncoder},
    },
    ensure,
};

/// Flag of a block whose samples are stored uncompressed, added to the number of channels.
const RAW: u8 = 0x80;

/// Bits of the index of a channel.
const INDEX_BITS: u32 = GROUP_CHANNELS.ilog2();

/// The state that encoder and decoder of a group share.
#[derive(Debug)]
struct Group {
    model: SampleModel,
    heads: HeadModel,
    tracks: Vec<SampledChannelState>,
    /// Number of channels since the key.
    n_channels: usize,
    /// The samples of the block, channel after channel.
    samples: Vec<f32>,
    /// Whether the state is that after a block, so that another can continue it.
    is_in_step: bool,
    isa: Isa,
}

impl Group {
    fn new(index_bits: u32) -> Self {
        Self {
            model: SampleModel::NEW,
            heads: HeadModel::new(index_bits),
            tracks: Vec::new(),
            n_channels: 0,
            samples: Vec::new(),
            is_in_step: false,
            isa: Isa::detect(),
        }
    }

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        if self.tracks.len() < n_channels {
            self.tracks.resize_with(n_channels, SampledChannelState::new);
        }
        for track in &mut self.tracks {
            track.cells.palette.reserve(n_rows.min(PALETTE_MAX));
        }
        let n_samples = n_channels.saturating_mul(n_rows);
        self.samples.reserve(n_samples.saturating_sub(self.samples.len()));
    }

    /// Resets the state to that before a key block.
    fn forget(&mut self) {
        self.model = SampleModel::NEW;
        self.heads.reset();
        self.tracks.iter_mut().for_each(SampledChannelState::reset);
    }

    /// Begins a block of `n_channels` channels and `n_rows` rows.
    fn begin(&mut self, n_channels: usize, n_rows: usize, key: bool) -> Result<()> {
        if !key && !self.is_in_step {
            return Err(CodecError::OutOfStep);
        }
        self.is_in_step = false;
        if key {
            self.forget();
        }
        self.n_channels = n_channels;
        if self.tracks.len() < n_channels {
            self.tracks.resize_with(n_channels, SampledChannelState::new);
        }
        self.samples.clear();
        self.samples.resize(n_channels * n_rows, 0.0);
        Ok(())
    }

    /// Codes a channel of the block; `head` and `cells` are the encoder's choice.
    fn channel<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        (channel, n_rows): (usize, usize),
        (head, cells): (Head, &Cells),
    ) -> Result<()> {
        let (tracks_before, tracks) = self.tracks.split_at_mut(channel);
        let Some(track) = tracks.first_mut() else { return Ok(()) };
        let state = (&mut track.head, &mut track.cells);
        self.heads.code(coder, !track.is_started, state, (head, cells))?;
        let (before, rest) = self.samples.split_at_mut(channel * n_rows);
        let at = |index: usize| {
            let (track, samples) =
                (tracks_before.get(index)?, before.chunks_exact(n_rows).nth(index)?);
            Some(ReferenceChannel {
                samples,
                last: track.last_before,
                per_unit: track.head.per_unit(),
            })
        };
        let mut references = [ReferenceChannel::default(); REFERENCES];
        let n_references = usize::from(track.head.n_references);
        for (slot, &index) in references.iter_mut().zip(&track.head.references).take(n_references) {
            let missing = CodecError::Corrupt("a reference that does not come before its channel");
            *slot = at(usize::from(index)).ok_or(missing)?;
        }
        let previous = channel.checked_sub(1).and_then(at);
        self.isa.run(ChannelWalk {
            coder,
            model: &mut self.model,
            track,
            previous,
            references,
            samples: &mut rest[..n_rows],
            after_gaps: &[],
            like: None,
        })
    }
}

/// Encodes the blocks of one group of sampled channels, in order. A block continues the state of the one before.
#[derive(Debug)]
pub struct SampledEncoder {
    group: Group,
    fit: fit::Fit,
}

impl Default for SampledEncoder {
    fn default() -> Self {
        Self::new()
    }
}

impl SampledEncoder {
    /// Starts with a key block.
    #[must_use]
    pub fn new() -> Self {
        Self { group: Group::new(INDEX_BITS), fit: fit::Fit::default() }
    }

    /// Allocates the memory for blocks of up to `n_channels` channels and `n_rows` rows, so that
    /// [`encode`](Self::encode) does not allocate if `out` has spare capacity for [`max_block_bytes`].
    pub fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels.min(GROUP_CHANNELS), n_rows);
        self.fit.prepare(n_rows);
    }

    /// Appends one block to `out`: 1 to [`GROUP_CHANNELS`] channels, with one sample per row each, any bits of float32.
    /// Appends nothing when there are no rows.
    ///
    /// `key` forgets all state first, so that a decoder may start here. Between two key blocks the number of channels
    /// stays the same; a key block may have any.
    ///
    /// # Errors
    /// `InvalidArgument` when there are no channels or too many, when they differ in length, or when their number
    /// changes without a key; `OutOfStep` when an earlier block failed and this is not a key block. `out` is then
    /// unchanged.
    pub fn encode(
        &mut self,
        channels: &[&[f32]],
        key: bool,
        out: &mut Vec<u8>,
    ) -> std::result::Result<(), CodecError> {
        let n_channels = channels.len();
        let n_rows = channels.first().map_or(0, |samples| samples.len());
        if n_channels == 0 || n_channels > GROUP_CHANNELS {
            return Err(CodecError::InvalidArgument(format!(
                "{n_channels} sampled channels; a group has 1 to {GROUP_CHANNELS}"
            )));
        }
        if let Some(other) = channels.iter().find(|samples| samples.len() != n_rows) {
            return Err(CodecError::InvalidArgument(format!(
                "sampled channels of {n_rows} and {} rows in one block",
                other.len()
            )));
        }
        if n_rows == 0 {
            return Ok(());
        }
        if !key && self.group.is_in_step && n_channels != self.group.n_channels {
            return Err(CodecError::InvalidArgument(format!(
                "{n_channels} sampled channels after {} without a key",
                self.group.n_channels
            )));
        }
        self.group.begin(n_channels, n_rows, key)?;
        let start = out.len();
        if self.encode_coded(channels, n_rows, out) {
            self.group.is_in_step = true;
            return Ok(());
        }
        out.truncate(start);
        out.push(n_channels as u8 | RAW);
        out.extend(
            channels.iter().flat_map(|samples| samples.iter()).flat_map(|s| s.to_le_bytes()),
        );
        self.group.forget();
        self.group.is_in_step = true;
        Ok(())
    }

    /// Appends a coded block; `false` if it is useless because it is larger than the samples.
    fn encode_coded(&mut self, channels: &[&[f32]], n_rows: usize, out: &mut Vec<u8>) -> bool {
        out.push(channels.len() as u8);
        let mut coder = RangeEncoder::new(out, 4 * channels.len() * n_rows);
        for (channel, samples) in channels.iter().enumerate() {
            let at = channel * n_rows;
            self.group.samples[at..at + n_rows].copy_from_slice(samples);
            let track = &self.group.tracks[channel];
            let before = EarlierChannels { samples: &self.group.samples[..at], n_rows, rows: None };
            let (head, cells) = self.fit.choose(track, samples, before);
            let encoded = self.group.channel(&mut coder, (channel, n_rows), (head, cells));
            let is_same = is_same(&self.group.samples[at..at + n_rows], samples);
            debug_assert!(is_same && encoded.is_ok(), "{encoded:?} for {head:?} {cells:?}");
            if encoded.is_err() || !is_same {
                return false;
            }
        }
        coder.finish()
    }
}

/// Whether all bits are the same.
fn is_same(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Decodes the blocks of one group of sampled channels, in order, starting at a key block.
#[derive(Debug)]
pub struct SampledDecoder {
    group: Group,
}

impl Default for SampledDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl SampledDecoder {
    /// Starts with a key block.
    #[must_use]
    pub fn new() -> Self {
        Self { group: Group::new(INDEX_BITS) }
    }

    /// Allocates the memory for blocks of up to `n_channels` channels and `n_rows` rows.
    pub fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels.min(GROUP_CHANNELS), n_rows);
    }

    /// Decodes one block of `n_rows` rows. The result has one slice per channel, one after another:
    /// `samples[channel * n_rows + row]`. The decoder trusts `n_rows`: bound it when it comes from a file.
    ///
    /// # Errors
    /// `Corrupt` or `Truncated`; until the next key block every other block then gives `OutOfStep`.
    pub fn decode(
        &mut self,
        block: &[u8],
        n_rows: usize,
        key: bool,
    ) -> std::result::Result<&[f32], CodecError> {
        if n_rows == 0 {
            ensure(block.is_empty(), "a block without rows")?;
            return Ok(&[]);
        }
        let decoded = self.decode_rows(block, n_rows, key);
        self.group.is_in_step = decoded.is_ok();
        decoded?;
        Ok(&self.group.samples)
    }

    fn decode_rows(&mut self, block: &[u8], n_rows: usize, key: bool) -> Result<()> {
        if !key && !self.group.is_in_step {
            return Err(CodecError::OutOfStep);
        }
        let (&head, payload) =
            block.split_first().ok_or(CodecError::Truncated("the number of channels"))?;
        let n_channels = usize::from(head & !RAW);
        ensure((1..=GROUP_CHANNELS).contains(&n_channels), "an impossible number of channels")?;
        ensure(
            key || n_channels == self.group.n_channels,
            "a number of channels that differs from the key block's",
        )?;
        self.group.begin(n_channels, n_rows, key)?;
        if head & RAW != 0 {
            let (samples, rest) = payload.as_chunks::<4>();
            ensure(
                rest.is_empty() && samples.len() <= n_channels * n_rows,
                "bytes after the payload",
            )?;
            if samples.len() < n_channels * n_rows {
                return Err(CodecError::Truncated("samples"));
            }
            for (slot, bytes) in self.group.samples.iter_mut().zip(samples) {
                *slot = f32::from_le_bytes(*bytes);
            }
            self.group.forget();
            return Ok(());
        }
        let mut coder = RangeDecoder::new(payload);
        let cells = Cells::default();
        for channel in 0..n_channels {
            self.group.channel(&mut coder, (channel, n_rows), (Head::default(), &cells))?;
        }
        coder.finish()
    }
}

/// The largest size of a block in bytes: that of the samples, and the number of channels.
#[must_use]
pub const fn max_block_bytes(n_channels: usize, n_rows: usize) -> usize {
    n_channels.saturating_mul(n_rows).saturating_mul(4).saturating_add(1)
}
