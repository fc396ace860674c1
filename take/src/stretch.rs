//! STRETCH: all channels over the same rows, and when these were: the unit that is checksummed, written
//! and lost as one.

mod chain;
mod front;
#[cfg(test)]
mod tests;

pub(crate) use self::chain::{Chain, Placed};
use self::front::Front;
pub use self::front::{FrontWriter, put_moved};

use std::iter;

use mocapd_codec::{
    BlockDecoder, CodecError, DecodedRows, GROUP_CHANNELS, ResamplerKind, Settings, stated_channels,
};

use crate::{
    TakeError,
    timeline::{Causes, Run, Timeline},
    varint,
};

/// Most rows of one stretch of any kind: over an hour at 1000 Hz, for the resamplers that are not cut into
/// stretches.
pub const ROWS_MAX: u64 = 1 << 22;

/// Most rows of one stretch of a live kind. An import has the longest: ten seconds, which up to 13 kHz are
/// fewer rows, and above is cut to this. A recording has half a second, and as many rows as a time line has
/// room for.
pub const LIVE_ROWS_MAX: u64 = 1 << 17;

/// Most recorded rows of one stretch with a time line: ten times half a second at 10 kHz, a megabyte and
/// a half in memory.
pub(crate) const RECORDED_MAX: u64 = 1 << 16;

/// Most rows from the end of one stretch to the end of the next, and so most that are lost between them:
/// days at 10 kHz. What claims more, in whatever place, is wrong.
pub(crate) const ROWS_PASSED_MAX: u64 = 1 << 32;

/// Most samples that one stretch may decode to: 400 MB of positions; with their flags, and what decoders of
/// `dense` keep beside them, 1.5 GB.
pub const SAMPLES_MAX: u64 = 1 << 25;

/// Longest chunk of a stretch: of each sample the 12 bytes of a position, and 4 for whether it is there, for the lengths
/// of blocks and for the times, which together take less.
pub(crate) const BYTES_MAX: u64 = 16 * SAMPLES_MAX;

/// Stretches are counted modulo this.
pub const NUMBERS: u8 = 32;

/// Most channels of a take: marker ids have 16 bits.
pub const CHANNELS_MAX: usize = 1 << 16;

/// Most groups of channels.
const GROUPS_MAX: usize = CHANNELS_MAX / GROUP_CHANNELS;

/// Most runs of one stretch: a writer has at most two a recorded row, and eight times as many are 24 MB.
pub(crate) const RUNS_MAX: u64 = 16 * RECORDED_MAX;

/// Most rows of one stretch of a take coded with `kind`.
#[must_use]
pub fn rows_max(kind: ResamplerKind) -> u64 {
    if kind.is_live() { LIVE_ROWS_MAX } else { ROWS_MAX }
}

/// Where a stretch lies and whether a decoder can start at it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// First row.
    pub first_row: u64,
    /// Rows, lost ones between them included. 0: the take ends with lost rows.
    pub n_rows: u32,
    /// Coded without state from earlier stretches.
    pub key: bool,
    /// Counts the stretches of a take from 0, modulo [`NUMBERS`]: one that is missing shows.
    pub number: u8,
}

impl Span {
    /// The row after its last.
    #[must_use]
    pub fn end_row(self) -> u64 {
        self.first_row.saturating_add(u64::from(self.n_rows))
    }
}

/// Bytes of a stretch's payload, by what they are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sizes {
    /// Its front without the time line.
    pub framing: u64,
    /// Runs and times.
    pub time_line: u64,
    /// The lengths of its blocks.
    pub lengths: u64,
    /// Its blocks, and what they share.
    pub blocks: u64,
}

/// A stretch as stored, its blocks still coded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stretch<'a> {
    /// Where it lies.
    pub span: Span,
    /// At least one stretch before it is missing.
    pub missing_before: bool,
    /// The rows from the end of the stretch before to the end of this one; an import has none.
    pub timeline: Option<Timeline>,
    /// What its channels share.
    pub shared: &'a [u8],
    /// Its blocks, one a group of [`GROUP_CHANNELS`] channels in table order; groups after the last have
    /// no samples.
    pub blocks: Vec<&'a [u8]>,
    /// What its bytes are for.
    pub sizes: Sizes,
}

impl Stretch<'_> {
    /// The row after the stretch before it: where its account of rows begins, lost ones included.
    #[must_use]
    pub fn from_row(&self) -> u64 {
        self.timeline.as_ref().map_or(self.span.first_row, |timeline| timeline.first_row)
    }

    /// Whether it has no rows, and stands for stretches that were damaged: a recovery wrote it in their place.
    pub(crate) fn stands_for_damaged(&self) -> bool {
        let runs = self.timeline.as_ref().map_or(&[][..], |timeline| &timeline.runs);
        self.span.n_rows == 0 && all_damaged(runs)
    }

    /// The channels that its blocks state, those before them included. The most of a take's stretches
    /// is how many channels it has samples of at least.
    #[must_use]
    pub fn stated_channels(&self) -> usize {
        let stated = |(group, block): (usize, &&[u8])| {
            Some(group * GROUP_CHANNELS + stated_channels(block)?)
        };
        self.blocks.iter().enumerate().filter_map(stated).max().unwrap_or(0)
    }
}

/// Whether the payload of a long stretch may begin with these bytes, so far as its front says.
pub(crate) fn may_begin_with(payload: &[u8]) -> bool {
    Front::may_begin_with(payload)
}

/// Whether runs are those of rows that were damaged before a recovery.
fn all_damaged(runs: &[Run]) -> bool {
    let damaged = |run: &Run| run.lost.is_some_and(|causes| causes.contains(Causes::DAMAGED));
    !runs.is_empty() && runs.iter().all(damaged)
}

/// Appends one group's block; one that is `alone` in its stretch needs no length.
pub fn put_block(block: &[u8], alone: bool, out: &mut Vec<u8>) {
    if !alone {
        varint::put(out, block.len() as u64);
    }
    out.extend_from_slice(block);
}

/// All that is left of `cursor`. An error says what is wrong.
fn take_blocks<'a>(
    cursor: &mut varint::Cursor<'a>,
    alone: bool,
    n_rows: u32,
    sizes: &mut Sizes,
) -> Result<Vec<&'a [u8]>, &'static str> {
    let all = cursor.rest();
    let mut blocks = Vec::new();
    if alone && !all.is_empty() {
        blocks.push(all);
    }
    while !alone && !cursor.is_empty() {
        if blocks.len() == GROUPS_MAX {
            return Err("it has more channels than there are marker ids");
        }
        let block = cursor.varint().and_then(|n| cursor.take(n));
        blocks.push(block.ok_or("its blocks do not fill it")?);
    }
    let with_samples = blocks.iter().filter(|block| !block.is_empty()).count() as u64;
    if u64::from(n_rows) * with_samples > SAMPLES_MAX {
        return Err("it claims more samples than a stretch can hold");
    }
    if n_rows == 0 && with_samples > 0 {
        return Err("it has blocks and no rows");
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
    /// Those that are decoded; `None`: all.
    wanted: Option<Vec<usize>>,
    /// Made with the first block, so that an empty one costs nothing.
    groups: Vec<Option<Group>>,
    /// The stretch before was not decoded: what follows up to the next key stretch cannot be either.
    waits_for_key: bool,
}

/// One group of channels.
#[derive(Debug)]
struct Group {
    decoder: Box<dyn BlockDecoder>,
    /// Channels of its last block since the key.
    n_channels: usize,
    /// Its rows in the last stretch decoded.
    rows: Vec<DecodedRows>,
}

impl StretchDecoder {
    /// For a take coded with `settings`.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self { settings, wanted: None, groups: Vec::new(), waits_for_key: true }
    }

    /// The same for some groups only, by number: what is coded together is decoded together, and groups know
    /// nothing of each other. [`rows`](Self::rows) has nothing of the others.
    #[must_use]
    pub fn of_groups(settings: Settings, wanted: Vec<usize>) -> Self {
        Self { wanted: Some(wanted), ..Self::new(settings) }
    }

    /// A stretch that the reader gave is not decoded: what depends on it is lost, too.
    pub fn pass(&mut self) {
        self.waits_for_key = true;
    }

    /// It needs a stretch that was not decoded.
    #[must_use]
    pub fn depends_on_lost(&self, span: Span) -> bool {
        self.waits_for_key && !span.key
    }

    /// Decodes the stretch after the one before; [`rows`](Self::rows) then has what is in it.
    ///
    /// # Errors
    /// `InvalidArgument` when it [`depends_on_lost`](Self::depends_on_lost); `Codec`; what depends on the
    /// stretch is then lost, too.
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
        // Every group that is there must see the stretch, if only as a gap.
        let is_wanted = |group: usize| self.wanted.as_ref().is_none_or(|all| all.contains(&group));
        let wanted = |(group, &block)| if is_wanted(group) { block } else { &[][..] };
        let blocks = stretch.blocks.iter().enumerate().map(wanted).chain(iter::repeat(&[][..]));
        let mut n_channels = 0;
        for (group, block) in self.groups.iter_mut().zip(blocks.clone()) {
            if let Some(group) = group
                && key
            {
                group.n_channels = 0;
            }
            if !block.is_empty() {
                let group = group.get_or_insert_with(|| Group::new(self.settings));
                group.n_channels = stated_channels(block).unwrap_or(group.n_channels);
                n_channels += group.n_channels;
            }
        }
        if n_channels as u64 * u64::from(n_rows) > SAMPLES_MAX {
            Err(CodecError::Corrupt("more samples than a stretch can hold"))?;
        }
        for (group, block) in self.groups.iter_mut().zip(blocks) {
            if let Some(Group { decoder, rows, .. }) = group {
                decoder.decode(block, stretch.shared, n_rows as usize, key, rows)?;
            }
        }
        self.waits_for_key = false;
        Ok(())
    }

    /// The rows of the last stretch decoded, by channel; `None` where it has nothing of a channel.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.groups.iter().flat_map(|group| {
            let rows = group.as_ref().map_or(&[][..], |group| &group.rows);
            rows.iter().map(Some).chain(iter::repeat(None)).take(GROUP_CHANNELS)
        })
    }
}

impl Group {
    fn new(settings: Settings) -> Self {
        Self { decoder: settings.decoder(), n_channels: 0, rows: Vec::new() }
    }
}
