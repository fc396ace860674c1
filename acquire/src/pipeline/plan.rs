//! How large everything is: each bound with its arithmetic.

use std::{
    ops::{Range, RangeInclusive},
    time::Duration,
};

use anyhow::ensure;
use mocapd_codec::{GROUP_CHANNELS, Settings};
use mocapd_take::{record::Channel, stretch::SAMPLES_MAX};

use super::ring::Sample;
use crate::heartbeat::Heartbeat;

/// Length of a stretch, and time between syncs, unless others are chosen: together what a power cut may cost.
const STRETCH: Duration = Duration::from_millis(500);
const SYNC_EVERY: Duration = Duration::from_millis(500);

/// Lengths of a stretch that can be chosen: above them a kill costs more than anybody wants, below them a take is mostly
/// fronts of stretches.
pub const STRETCH_LENGTHS: RangeInclusive<Duration> =
    Duration::from_millis(50)..=Duration::from_secs(10);

/// The longest time between syncs that can be chosen: what a disk loses with its power.
pub const SYNC_MAX: Duration = Duration::from_secs(60);

/// What a recording needs to know before it starts.
#[derive(Debug, Clone)]
pub struct PipelineConfig {
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Rows a second.
    pub rate_hz: f64,
    /// Device clock ticks a second.
    pub tick_hz: u64,
    /// The channels known at the start.
    pub channels: Vec<Channel>,
    /// How many more may appear.
    pub reserve: usize,
    /// Resampler threads.
    pub workers: usize,
    /// Length of a stretch. With `sync_every` it bounds what a pulled plug costs: one second by default.
    pub stretch: Duration,
    /// Length of the first stretch, so that a start is on disk soon.
    pub first_stretch: Duration,
    /// Time between key stretches.
    pub key_every: Duration,
    /// Time between syncs to disk.
    pub sync_every: Duration,
    /// What is kept in memory beside what is written.
    pub pre_roll: Option<PreRollConfig>,
    /// Where its threads say that they move.
    pub heartbeat: Heartbeat,
}

/// Coded stretches that are kept in memory, so that a take can begin before it was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PreRollConfig {
    /// How long they are kept.
    pub time: Duration,
    /// Bytes that they may take: beyond it the oldest go earlier.
    pub bytes_max: usize,
}

impl PipelineConfig {
    /// The defaults for a device.
    #[must_use]
    pub fn new(codec: Settings, rate_hz: f64, tick_hz: u64, channels: Vec<Channel>) -> Self {
        Self {
            codec,
            rate_hz,
            tick_hz,
            channels,
            reserve: 64,
            workers: crate::threads::default_workers(),
            stretch: STRETCH,
            first_stretch: Duration::from_millis(100),
            key_every: Duration::from_secs(10),
            sync_every: SYNC_EVERY,
            pre_roll: None,
            heartbeat: Heartbeat::default(),
        }
    }
}

impl PipelineConfig {
    /// Rows of a full stretch.
    #[must_use]
    pub fn stretch_rows(&self) -> u32 {
        self.rows(self.stretch)
    }

    /// What is not as usual, as HEADER tells it.
    #[must_use]
    pub fn chosen(&self) -> Vec<(String, String)> {
        let times = [("stretch", self.stretch, STRETCH), ("sync", self.sync_every, SYNC_EVERY)];
        let other = times.into_iter().filter(|(_, time, usual)| time != usual);
        other.map(|(name, time, _)| (name.to_owned(), format!("{time:?}"))).collect()
    }

    fn rows(&self, time: Duration) -> u32 {
        (time.as_secs_f64() * self.rate_hz).floor().max(1.0) as u32
    }
}

/// Rings hold this many full stretches: two being filled or coded, two more for a worker that the
/// system does not run for a second; of shorter stretches as many as make up the same time.
const RING_STRETCHES: u32 = 4;

/// Coded stretches in memory: 64 x 0.5 s, so that a disk that stalls for 30 s costs nothing; of shorter
/// stretches as many as make up the same time.
const CODED_STRETCHES: u32 = 64;

/// Most memory for the rings, and for coded stretches, which is touched only as far as they do not
/// compress: ten thousand markers at 240 Hz, or two hundred at 10 kHz, stay below. Beyond it fewer
/// stretches are kept.
const MEMORY_BYTES: usize = 2 << 30;

/// Time between key stretches while no take is written: a pre-roll begins with one, so by so much more it has than was
/// asked for. A key costs bytes, but these only stay in memory.
const ARMED_KEY_EVERY: Duration = Duration::from_secs(1);

/// Boundaries on their way to the writer: each waits for its answer before the next is asked for, or gives up after
/// seconds.
const BOUNDARIES_MAX: usize = 16;

/// A time line item per row, and as many again for the runs of loss between them; beside these, room for
/// the runs that are pending when the rings are full and when the take ends.
const TIMELINE_ITEMS_PER_ROW: usize = 2;

/// Runs kept apart. Loss that changes its cause more often than that between two recorded frames is
/// told as one run with all its causes; the ledger's counters stay exact.
pub(super) const RUNS_MAX: usize = 8;

/// Events and channel announcements that wait for the writer: a marker that appears is one, and a
/// device announces at most its whole table at once, in one message.
pub(super) const CONTROL_MAX: usize = 1024;

/// Observations of the clocks that wait for the writer: at most ten a second of round trips (the link's budget)
/// and four of points, and only at the start; in a stall of 30 s some 60.
pub(super) const CLOCK_ITEMS_MAX: usize = 1024;

/// The sizes that follow from a [`PipelineConfig`].
#[derive(Debug, Clone)]
pub(super) struct Plan {
    coded_stretches: usize,
    ring_rows: usize,
    pub(super) codec: Settings,
    pub(super) workers: usize,
    pub(super) n_slots: usize,
    pub(super) stretch_rows: u32,
    pub(super) first_stretch_rows: u32,
    pub(super) key_rows: u64,
    pub(super) armed_key_rows: u64,
    pub(super) pre_roll: Option<PreRollConfig>,
    pub(super) sync_every: Duration,
}

impl Plan {
    pub(super) fn new(config: &PipelineConfig) -> anyhow::Result<Self> {
        ensure!(
            config.codec.kind.is_live(),
            "the resampler {} works on whole takes: record with dense, fast or lossless, \
             then export and import with it",
            config.codec.kind
        );
        ensure!(
            config.rate_hz.is_finite() && (0.001..=1e6).contains(&config.rate_hz),
            "cannot record at {} Hz",
            config.rate_hz
        );
        let n_slots = config.channels.len() + config.reserve;
        let workers = config.workers.max(1);
        let plan = Self {
            coded_stretches: usual_time(CODED_STRETCHES, config.stretch),
            ring_rows: usual_time(RING_STRETCHES, config.stretch) * config.stretch_rows() as usize,
            codec: config.codec,
            workers,
            n_slots,
            stretch_rows: config.stretch_rows(),
            // The rings are made for stretches of `stretch`.
            first_stretch_rows: config.rows(config.first_stretch.min(config.stretch)),
            key_rows: u64::from(config.rows(config.key_every)),
            armed_key_rows: u64::from(config.rows(config.key_every.min(ARMED_KEY_EVERY))),
            pre_roll: config.pre_roll,
            sync_every: config.sync_every,
        };
        let ring_bytes =
            plan.ring_rows().saturating_mul(n_slots).saturating_mul(size_of::<Sample>());
        ensure!(
            ring_bytes <= MEMORY_BYTES
                && (n_slots as u64).saturating_mul(u64::from(plan.stretch_rows)) <= SAMPLES_MAX,
            "{n_slots} markers at {} Hz are more than can be recorded: use a lower rate",
            config.rate_hz
        );
        let coded_stretches =
            (MEMORY_BYTES / plan.stretch_bytes_max()).clamp(2, plan.coded_stretches);
        Ok(Self { coded_stretches, ..plan })
    }

    /// The codec's groups, whatever the number of workers: the same take for any of them.
    pub(super) fn n_groups(&self) -> usize {
        self.groups_of(self.n_slots)
    }

    /// The slots of a group.
    pub(super) fn slots_of(&self, group: usize) -> Range<usize> {
        let first = group * GROUP_CHANNELS;
        first..(first + GROUP_CHANNELS).min(self.n_slots)
    }

    /// Groups that hold the first `n_channels` channels.
    pub(super) fn groups_of(&self, n_channels: usize) -> usize {
        n_channels.div_ceil(GROUP_CHANNELS)
    }

    /// Rows in every channel's ring.
    pub(super) fn ring_rows(&self) -> usize {
        self.ring_rows
    }

    pub(super) fn timeline_items(&self) -> usize {
        TIMELINE_ITEMS_PER_ROW * self.ring_rows() + 4 * RUNS_MAX
    }

    /// Stretches closed and not yet coded: each has at least one row in every ring of an active group
    /// (one item of the time line ring), one more is the last, without rows, and so are boundaries.
    pub(super) fn spans_max(&self) -> usize {
        self.timeline_items() + 1 + BOUNDARIES_MAX
    }

    /// Buffers for coded parts that each group has.
    pub(super) fn buffers_per_group(&self) -> usize {
        self.coded_stretches
    }

    /// Every buffer there is: sending a part never waits.
    pub(super) fn parts_max(&self) -> usize {
        (self.n_groups() + 1) * self.buffers_per_group()
    }

    /// Most bytes of a group's part: its block, and five of its length. Allocated as a whole, but only
    /// what is written becomes resident.
    pub(super) fn part_bytes_max(&self, group: usize) -> usize {
        let (n_channels, n_rows) = (self.slots_of(group).len(), self.stretch_rows as usize);
        self.codec.max_block_bytes(n_channels, n_rows) + 5
    }

    /// Room for a stretch's front: per item a run (11 + 1), ticks and arrival (16 unless both are noise of
    /// hours) and timecode (5); 64 for its head and a key stretch's clocks.
    pub(super) fn front_bytes_max(&self) -> usize {
        self.timeline_items() * 33 + 64
    }

    /// Most bytes of a stretch's payload.
    pub(super) fn stretch_bytes_max(&self) -> usize {
        let parts = (0..self.n_groups()).map(|group| self.part_bytes_max(group));
        parts.sum::<usize>() + self.front_bytes_max()
    }
}

/// So many stretches of the usual length, or more of shorter ones that make up the same time.
fn usual_time(stretches: u32, stretch: Duration) -> usize {
    let shorter = STRETCH.as_secs_f64() / stretch.as_secs_f64().max(1e-3);
    (f64::from(stretches) * shorter.max(1.0)).ceil() as usize
}
