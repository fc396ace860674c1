//! STRETCH: all channels over a range of rows, with the times of the rows. It is checksummed, written and lost as a
//! unit.

mod header;
#[cfg(test)]
mod tests;

pub(crate) use self::header::{CopiedStretch, Placement, StretchChain, is_alone, may_begin_with};
pub use self::header::{StretchHeaderWriter, put_renumbered};

use std::iter;

use mocapd_codec::{
    BlockDecoder, CodecError, DecodedRows, GROUP_CHANNELS, ResamplerKind, Settings, stated_channels,
};

use crate::{
    TakeError,
    timeline::{LossCauses, RowRun, Timeline},
    varint,
};

/// Maximum number of rows of a stretch of any kind: over an hour at 1000 Hz, for resamplers that encode a whole take as
/// one stretch.
pub const ROWS_MAX: u64 = 1 << 22;

/// Maximum number of rows of a stretch of a live kind. Imports have the longest: ten seconds, which exceed this only
/// above 13 kHz and are then cut, and five minutes where nothing moves or keys are far apart, of at most 2^20 samples. A
/// recording has half a second, and at most as many rows as a time line can hold.
pub const LIVE_ROWS_MAX: u64 = 1 << 17;

/// Maximum number of recorded rows of a stretch with a time line: ten times half a second at 10 kHz; 1.5 MB in memory.
pub(crate) const RECORDED_MAX: u64 = 1 << 16;

/// Maximum number of rows from the end of one stretch to the end of the next, and so the maximum of rows lost
/// between them: days at 10 kHz. A larger number is invalid wherever it occurs.
pub(crate) const ROWS_PASSED_MAX: u64 = 1 << 32;

/// Maximum number of samples that a stretch may decode to: 400 MB of positions; 1.5 GB with their flags and the state
/// of `dense` decoders.
pub const SAMPLES_MAX: u64 = 1 << 25;

/// Longest chunk of a stretch: for each sample the 12 bytes of a position, and 4 for its presence, block lengths and
/// times, which together take less.
pub(crate) const BYTES_MAX: u64 = 16 * SAMPLES_MAX;

/// Stretch numbers count modulo this.
pub const NUMBERS: u8 = 32;

/// Maximum number of channels of a take: a marker id has 16 bits.
pub const CHANNELS_MAX: usize = 1 << 16;

/// Maximum number of groups of channels of a take.
const GROUPS_MAX: usize = CHANNELS_MAX / GROUP_CHANNELS;

/// Maximum number of runs of a stretch. A writer has at most two per recorded row; eight times as many take 24 MB.
pub(crate) const RUNS_MAX: u64 = 16 * RECORDED_MAX;

/// Maximum number of rows of a stretch of a take encoded with `kind`.
#[must_use]
pub fn rows_max(kind: ResamplerKind) -> u64 {
    if kind.is_live() { LIVE_ROWS_MAX } else { ROWS_MAX }
}

/// The rows of a stretch, and whether decoding can start at it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// First row.
    pub first_row: u64,
    /// Number of rows, including lost ones between them. 0 if the stretch only records lost rows.
    pub n_rows: u32,
    /// Whether it is encoded without state from earlier stretches.
    pub key: bool,
    /// Number of the stretch in the take, from 0, modulo [`NUMBERS`]; it reveals missing stretches.
    pub number: u8,
}

impl Span {
    /// The row after the last.
    #[must_use]
    pub fn end_row(self) -> u64 {
        self.first_row.saturating_add(u64::from(self.n_rows))
    }
}

/// Bytes of a stretch's payload, by purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StretchSizes {
    /// The header, without the time line.
    pub framing: u64,
    /// Runs and times.
    pub time_line: u64,
    /// Length prefixes of the blocks.
    pub lengths: u64,
    /// The blocks and the bytes that they share.
    pub blocks: u64,
}

/// A stretch with its blocks still encoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stretch<'a> {
    /// Its rows.
    pub span: Span,
    /// Whether at least one stretch before it is missing.
    pub missing_before: bool,
    /// The times of the rows from the end of the previous stretch to the end of this one; `None` in an import.
    pub timeline: Option<Timeline>,
    /// Bytes that all its channels share.
    pub shared: &'a [u8],
    /// One block per group of [`GROUP_CHANNELS`] channels, in the order of the channel table; groups after the last
    /// have no samples.
    pub blocks: Vec<&'a [u8]>,
    /// The bytes of its payload, by purpose.
    pub sizes: StretchSizes,
    /// Its payload.
    pub payload: &'a [u8],
}

impl Stretch<'_> {
    /// The row after the previous stretch, from which this one accounts for all rows, including lost ones.
    #[must_use]
    pub fn from_row(&self) -> u64 {
        self.timeline.as_ref().map_or(self.span.first_row, |timeline| timeline.first_row)
    }

    /// Whether the stretch has no rows and replaces damaged stretches of a recovered take.
    pub(crate) fn replaces_damaged(&self) -> bool {
        let runs = self.timeline.as_ref().map_or(&[][..], |timeline| &timeline.runs);
        self.span.n_rows == 0 && all_damaged(runs)
    }

    /// The number of channels up to the last one that its blocks have samples of. The largest such number is the least
    /// number of channels of the take.
    #[must_use]
    pub fn stated_channels(&self) -> usize {
        let stated = |(first, block): (usize, &&[u8])| Some(first + stated_channels(block)?);
        (0..).step_by(GROUP_CHANNELS).zip(&self.blocks).filter_map(stated).max().unwrap_or(0)
    }
}

/// Whether all runs are of rows that were damaged before a recovery.
fn all_damaged(runs: &[RowRun]) -> bool {
    let damaged = |run: &RowRun| run.lost.is_some_and(|lost| lost.contains(LossCauses::DAMAGED));
    !runs.is_empty() && runs.iter().all(damaged)
}

/// Appends the block of one group. A block that is `alone` in its stretch needs no length prefix.
pub fn put_block(block: &[u8], alone: bool, out: &mut Vec<u8>) {
    if !alone {
        varint::put(out, block.len() as u64);
    }
    out.extend_from_slice(block);
}

/// Splits the rest of `cursor` into blocks. The error is a message.
fn take_blocks<'a>(
    cursor: &mut varint::Cursor<'a>,
    alone: bool,
    n_rows: u32,
    sizes: &mut StretchSizes,
) -> Result<Vec<&'a [u8]>, &'static str> {
    let all = cursor.rest();
    let mut blocks = Vec::new();
    if alone && !all.is_empty() {
        blocks.push(all);
    }
    while !alone && !cursor.is_empty() {
        if blocks.len() == GROUPS_MAX {
            return Err("it has more channels than marker ids");
        }
        blocks.push(cursor.prefixed().ok_or("its blocks do not fill the payload")?);
    }
    let with_samples = blocks.iter().filter(|block| !block.is_empty()).count() as u64;
    if u64::from(n_rows) * with_samples > SAMPLES_MAX {
        return Err("it claims more samples than a stretch can hold");
    }
    if n_rows == 0 && with_samples > 0 {
        return Err("it has blocks but no rows");
    }
    let in_blocks = blocks.iter().map(|block| block.len()).sum::<usize>();
    sizes.blocks += in_blocks as u64;
    sizes.lengths = (all.len() - in_blocks) as u64;
    Ok(blocks)
}

/// Decodes the stretches of a take in order.
#[derive(Debug)]
pub struct StretchDecoder {
    settings: Settings,
    /// Numbers of the groups to decode; `None`: all.
    chosen: Option<Vec<usize>>,
    /// Decoders by group, created with the group's first block.
    groups: Vec<Option<GroupDecoder>>,
    /// Whether the previous stretch was not decoded, so decoding resumes at the next key stretch.
    waits_for_key: bool,
}

/// The decoder of one group of channels.
#[derive(Debug)]
struct GroupDecoder {
    decoder: Box<dyn BlockDecoder>,
    /// Channels in its last block since the key stretch.
    n_channels: usize,
    /// Its rows in the last decoded stretch.
    rows: Vec<DecodedRows>,
}

impl StretchDecoder {
    /// A decoder of all groups of a take encoded with `settings`.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self { settings, chosen: None, groups: Vec::new(), waits_for_key: true }
    }

    /// A decoder of the groups with the numbers `groups`; groups are coded independently. [`rows`](Self::rows) has no
    /// samples of the others.
    #[must_use]
    pub fn with_groups(settings: Settings, groups: Vec<usize>) -> Self {
        Self { chosen: Some(groups), ..Self::new(settings) }
    }

    /// Skips a stretch, and with it all stretches that depend on it.
    pub fn skip(&mut self) {
        self.waits_for_key = true;
    }

    /// Whether a stretch depends on one that was not decoded.
    #[must_use]
    pub fn depends_on_lost(&self, span: Span) -> bool {
        self.waits_for_key && !span.key
    }

    /// Decodes the next stretch into [`rows`](Self::rows).
    ///
    /// # Errors
    /// `InvalidArgument` when the stretch [depends on a lost one](Self::depends_on_lost); `Codec`. After an error, all
    /// stretches that depend on this one are lost, too.
    pub fn decode(&mut self, stretch: &Stretch<'_>) -> Result<(), TakeError> {
        let Span { key, n_rows, .. } = stretch.span;
        if self.depends_on_lost(stretch.span) {
            return Err(TakeError::InvalidArgument("depends on a damaged stretch".to_owned()));
        }
        self.waits_for_key = true;
        if u64::from(n_rows) > rows_max(self.settings.kind) {
            Err(CodecError::Corrupt("more rows than a stretch can hold"))?;
        }
        if self.groups.len() < stretch.blocks.len() {
            self.groups.resize_with(stretch.blocks.len(), || None);
        }
        // Every existing group must see the stretch, if only as a gap.
        let is_chosen = |group: usize| self.chosen.as_ref().is_none_or(|all| all.contains(&group));
        let chosen = |(group, &block)| if is_chosen(group) { block } else { &[][..] };
        let blocks = stretch.blocks.iter().enumerate().map(chosen).chain(iter::repeat(&[][..]));
        let mut n_channels = 0;
        for (group, block) in self.groups.iter_mut().zip(blocks.clone()) {
            if key && let Some(group) = group {
                group.n_channels = 0;
            }
            if !block.is_empty() {
                let group = group.get_or_insert_with(|| GroupDecoder::new(self.settings));
                group.n_channels = stated_channels(block).unwrap_or(group.n_channels);
                n_channels += group.n_channels;
            }
        }
        if n_channels as u64 * u64::from(n_rows) > SAMPLES_MAX {
            Err(CodecError::Corrupt("more samples than a stretch can hold"))?;
        }
        for (group, block) in self.groups.iter_mut().zip(blocks) {
            if let Some(GroupDecoder { decoder, rows, .. }) = group {
                decoder.decode(block, stretch.shared, n_rows as usize, key, rows)?;
            }
        }
        self.waits_for_key = false;
        Ok(())
    }

    /// The rows of the last decoded stretch, by channel; `None` for a channel without samples in it.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.rows_in(|column| column)
    }

    /// The rows like [`rows`](Self::rows), in another order of channels: `row_of` gives the channel at each place.
    pub(crate) fn rows_in(
        &self,
        row_of: impl Fn(usize) -> usize,
    ) -> impl Iterator<Item = Option<&DecodedRows>> {
        (0..self.groups.len() * GROUP_CHANNELS).map(move |column| {
            let channel = row_of(column);
            let group = self.groups.get(channel / GROUP_CHANNELS)?.as_ref()?;
            group.rows.get(channel % GROUP_CHANNELS)
        })
    }
}

impl GroupDecoder {
    fn new(settings: Settings) -> Self {
        Self { decoder: settings.decoder(), n_channels: 0, rows: Vec::new() }
    }
}
