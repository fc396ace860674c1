//! Statistics of a take: the figures of `info` that depend on its samples. They are counted while a take is written,
//! from what the encoders report, and while one is decoded; SUMMARY stores them.
//!
//! Tallies lead to them in three steps: [`BlockTally`] of a group of channels over one stretch, [`StretchTally`] of all
//! groups, [`TakeTally`] of all stretches.

use mocapd_codec::{BlockReport, DecodedRows, GROUP_CHANNELS, Rows, stated_error_step};

use crate::{
    stretch::{Span, Stretch},
    table::LostEntries,
};

/// Statistics of one channel over a whole take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ChannelStatistics {
    /// Samples present.
    pub samples: u64,
    /// Runs of rows without a sample, including those at the ends.
    pub gaps: u64,
    /// Samples kept as knots.
    pub knots: u64,
    /// The largest error stated by any block that has samples of the channel, over all channels of that block, as a
    /// [step of the tolerance](mocapd_codec::Tolerance::stated_mm).
    pub error_step: u8,
}

/// Statistics of a whole take.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TakeStatistics {
    /// By channel, in column order.
    pub channels: Vec<ChannelStatistics>,
    /// Rows with at least one sample: T of (Shi et al. 2012).
    pub rows_with_samples: u64,
    /// Rows with at least one kept sample: K.
    pub key_rows: u64,
    /// Samples present in those rows: the sum of |K in `P_i`|.
    pub samples_in_key_rows: u64,
}

impl TakeStatistics {
    /// Samples present.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.channels.iter().map(|channel| channel.samples).sum()
    }

    /// Gaps of all channels.
    #[must_use]
    pub fn gaps(&self) -> u64 {
        self.channels.iter().map(|channel| channel.gaps).sum()
    }

    /// Samples kept as knots.
    #[must_use]
    pub fn knots(&self) -> u64 {
        self.channels.iter().map(|channel| channel.knots).sum()
    }

    /// The largest error that any block states, as a step of the tolerance.
    #[must_use]
    pub fn error_step(&self) -> u8 {
        self.channels.iter().map(|channel| channel.error_step).max().unwrap_or(0)
    }

    /// SR1 of (Shi et al. 2012, eq. 7), counted over samples present; without gaps |T| / |K|.
    #[must_use]
    pub fn sr1(&self) -> Option<f64> {
        ratio(self.samples() + self.rows_with_samples, self.samples_in_key_rows + self.key_rows)
    }

    /// SR2 of (Shi et al. 2012, eq. 8), counted over samples present.
    #[must_use]
    pub fn sr2(&self) -> Option<f64> {
        ratio(self.samples() + self.rows_with_samples, 2 * self.knots())
    }
}

fn ratio(over: u64, under: u64) -> Option<f64> {
    (under > 0).then(|| over as f64 / under as f64)
}

/// The counts of one channel in one stretch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct ChannelTally {
    samples: u32,
    kept: u32,
    /// Runs of rows without a sample, and whether the first and the last row belong to one.
    gaps: u32,
    starts_in_gap: bool,
    ends_in_gap: bool,
    error_step: u8,
}

impl ChannelTally {
    /// A channel without samples.
    const UNSEEN: Self = Self {
        samples: 0,
        kept: 0,
        gaps: 1,
        starts_in_gap: true,
        ends_in_gap: true,
        error_step: 0,
    };

    /// Counts the samples of a block whose error is `error_step`.
    fn of(present: &[bool], error_step: u8) -> Self {
        let samples = present.iter().filter(|&&present| present).count() as u32;
        let is_gap = |row: Option<&bool>| row == Some(&false);
        let (starts_in_gap, ends_in_gap) = (is_gap(present.first()), is_gap(present.last()));
        let mut gaps = u32::from(starts_in_gap);
        if (samples as usize) < present.len() {
            gaps += present.windows(2).filter(|rows| rows[0] && !rows[1]).count() as u32;
        }
        let error_step = if samples > 0 { error_step } else { 0 };
        Self { samples, kept: 0, gaps, starts_in_gap, ends_in_gap, error_step }
    }
}

/// The counts of consecutive channels over the rows of one stretch. It is reused from block to block.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BlockTally {
    channels: Vec<ChannelTally>,
    /// By row: samples present, and whether any of them is kept.
    present_in: Vec<u32>,
    kept_in: Vec<bool>,
}

impl BlockTally {
    /// A tally with memory for that many channels and rows.
    #[must_use]
    pub fn with_capacity(n_channels: usize, n_rows: usize) -> Self {
        Self {
            channels: Vec::with_capacity(n_channels),
            present_in: Vec::with_capacity(n_rows),
            kept_in: Vec::with_capacity(n_rows),
        }
    }

    /// The tally of the block that an encoder made of `channels`, with its `reports` and `kept_rows`.
    #[must_use]
    pub fn of_encoded(
        block: &[u8],
        channels: &[Rows<'_>],
        reports: &[BlockReport],
        kept_rows: &[bool],
    ) -> Self {
        let mut tally = Self::default();
        tally.restart(channels.first().map_or(0, Rows::len));
        tally.add_encoded(block, channels, reports, kept_rows);
        tally
    }

    /// Starts over, with a stretch of `n_rows` rows.
    pub fn restart(&mut self, n_rows: usize) {
        self.channels.clear();
        self.present_in.clear();
        self.present_in.resize(n_rows, 0);
        self.kept_in.clear();
        self.kept_in.resize(n_rows, false);
    }

    /// Adds the channels of a block, as [`of_encoded`](Self::of_encoded) counts them.
    pub fn add_encoded(
        &mut self,
        block: &[u8],
        channels: &[Rows<'_>],
        reports: &[BlockReport],
        kept_rows: &[bool],
    ) {
        let error_step = stated_error_step(block);
        for (rows, report) in channels.iter().zip(reports) {
            self.add_channel(rows.present(), report.kept, error_step);
        }
        self.mark_kept(kept_rows.iter().copied());
    }

    /// Adds a decoded channel of a block whose error is `error_step`; `None` for a channel without samples.
    fn add_decoded(&mut self, rows: Option<&DecodedRows>, error_step: u8) {
        let Some(rows) = rows.filter(|rows| rows.has_samples()) else {
            self.channels.push(ChannelTally::UNSEEN);
            return;
        };
        let kept = || rows.present.iter().zip(&rows.kept).map(|(present, kept)| present & kept);
        self.add_channel(&rows.present, kept().filter(|&kept| kept).count() as u32, error_step);
        self.mark_kept(kept());
    }

    fn add_channel(&mut self, present: &[bool], kept: u32, error_step: u8) {
        for (sum, &present) in self.present_in.iter_mut().zip(present) {
            *sum += u32::from(present);
        }
        self.channels.push(ChannelTally { kept, ..ChannelTally::of(present, error_step) });
    }

    fn mark_kept(&mut self, rows: impl Iterator<Item = bool>) {
        for (marked, kept) in self.kept_in.iter_mut().zip(rows) {
            *marked |= kept;
        }
    }

    /// Adds the channels of the next group over the same rows. A block can have fewer than its group.
    pub fn append(&mut self, next: &Self) {
        let n_channels = self.channels.len().next_multiple_of(GROUP_CHANNELS);
        self.channels.resize(n_channels, ChannelTally::UNSEEN);
        self.channels.extend_from_slice(&next.channels);
        for (sum, present) in self.present_in.iter_mut().zip(&next.present_in) {
            *sum += present;
        }
        self.mark_kept(next.kept_in.iter().copied());
    }
}

/// The counts of a stretch.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct StretchTally {
    /// By channel; channels after the last have no samples.
    channels: Vec<ChannelTally>,
    rows_with_samples: u64,
    key_rows: u64,
    samples_in_key_rows: u64,
}

impl StretchTally {
    /// A tally with memory for that many channels.
    #[must_use]
    pub fn with_capacity(n_channels: usize) -> Self {
        Self { channels: Vec::with_capacity(n_channels), ..Self::default() }
    }

    /// Samples of all channels.
    pub(crate) fn n_samples(&self) -> u64 {
        self.channels.iter().map(|channel| u64::from(channel.samples)).sum()
    }

    /// The counts of all channels of a stretch.
    #[must_use]
    pub fn of(all: &BlockTally) -> Self {
        let mut tally = Self::default();
        tally.set(all);
        tally
    }

    /// Replaces the counts by those of all channels of a stretch.
    pub fn set(&mut self, all: &BlockTally) {
        self.channels.clear();
        self.channels.extend_from_slice(&all.channels);
        (self.rows_with_samples, self.key_rows, self.samples_in_key_rows) = (0, 0, 0);
        for (&present, &kept) in all.present_in.iter().zip(&all.kept_in) {
            self.rows_with_samples += u64::from(present > 0);
            self.key_rows += u64::from(kept);
            self.samples_in_key_rows += if kept { u64::from(present) } else { 0 };
        }
    }

    /// The counts of a stretch whose `rows` were decoded, by channel.
    #[must_use]
    pub fn of_decoded<'a, I>(stretch: &Stretch<'_>, rows: I) -> Self
    where
        I: Iterator<Item = Option<&'a DecodedRows>>,
    {
        let mut all = BlockTally::default();
        all.restart(stretch.span.n_rows as usize);
        for (channel, rows) in rows.enumerate() {
            let block = stretch.blocks.get(channel / GROUP_CHANNELS).copied().unwrap_or_default();
            all.add_decoded(rows, stated_error_step(block));
        }
        Self::of(&all)
    }

    /// Memory used in addition to the structure itself, in bytes.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        self.channels.capacity() * size_of::<ChannelTally>()
    }
}

/// Adds up the stretches of a take.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TakeTally {
    statistics: TakeStatistics,
    /// By channel: the last row so far has no sample.
    in_gap: Vec<bool>,
    /// The row after the last stretch.
    end_row: u64,
}

impl TakeTally {
    /// Sets the number of channels announced so far. New ones had a gap until now.
    pub fn announce(&mut self, n_channels: usize) {
        self.insert(self.in_gap.len(), n_channels.saturating_sub(self.in_gap.len()));
    }

    /// Inserts `n` channels before column `at`: their entries of the channel table were lost.
    fn insert(&mut self, at: usize, n: usize) {
        let in_gap = self.end_row > 0;
        let unseen = ChannelStatistics { gaps: in_gap.into(), ..ChannelStatistics::default() };
        let at = at.min(self.in_gap.len());
        self.in_gap.splice(at..at, std::iter::repeat_n(in_gap, n));
        self.statistics.channels.splice(at..at, std::iter::repeat_n(unseen, n));
    }

    /// Follows the channel table of a [traversal](crate::TakeTraversal) up to `n_channels`, among them those of lost
    /// entries.
    pub fn follow_table(&mut self, lost: Option<LostEntries>, n_channels: usize) {
        if let Some(lost) = lost {
            self.insert(lost.first, lost.inserted);
        }
        self.announce(n_channels);
    }

    /// Adds the next stretch. One without rows only records lost ones.
    pub fn add(&mut self, span: Span, stretch: &StretchTally) {
        if span.n_rows == 0 {
            return;
        }
        self.skip_rows_to(span.first_row);
        self.end_row = span.end_row();
        let Self { statistics, in_gap, .. } = self;
        statistics.rows_with_samples += stretch.rows_with_samples;
        statistics.key_rows += stretch.key_rows;
        statistics.samples_in_key_rows += stretch.samples_in_key_rows;
        let tallies = stretch.channels.iter().chain(std::iter::repeat(&ChannelTally::UNSEEN));
        for ((channel, in_gap), tally) in statistics.channels.iter_mut().zip(in_gap).zip(tallies) {
            channel.samples += u64::from(tally.samples);
            channel.knots += u64::from(tally.kept);
            // A gap that continues is not a new one.
            channel.gaps += u64::from(tally.gaps) - u64::from(*in_gap && tally.starts_in_gap);
            channel.error_step = channel.error_step.max(tally.error_step);
            *in_gap = tally.ends_in_gap;
        }
    }

    /// Samples so far.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.statistics.samples()
    }

    /// The statistics of a take of `n_rows` rows, including lost ones after the last stretch.
    #[must_use]
    pub fn finish(mut self, n_rows: u64) -> TakeStatistics {
        self.skip_rows_to(n_rows);
        self.statistics
    }

    /// Counts rows up to `row` that no stretch contains: gaps in every channel.
    fn skip_rows_to(&mut self, row: u64) {
        if row <= self.end_row {
            return;
        }
        self.end_row = row;
        for (channel, in_gap) in self.statistics.channels.iter_mut().zip(&mut self.in_gap) {
            channel.gaps += u64::from(!std::mem::replace(in_gap, true));
        }
    }
}
