//! The sizes of all queues and buffers, with their derivation.

use std::{
    ops::{Range, RangeInclusive},
    time::Duration,
};

use anyhow::ensure;
use mocapd_codec::{GROUP_CHANNELS, Settings, poses::PoseBounds};
use mocapd_drivers::device::{BODIES_MAX, BodyInfo, SampledGroupInfo};
use mocapd_take::{
    record::{Channel, RATES_HZ},
    sampled::RESIDUAL_GROUPS,
    stretch::SAMPLES_MAX,
};

use super::ring::Sample;
use crate::threads::Heartbeat;

/// Default length of a stretch and default time between syncs: their sum is what a power cut may cost.
const STRETCH: Duration = Duration::from_millis(500);
const SYNC_EVERY: Duration = Duration::from_millis(500);

/// Permitted lengths of a stretch: with longer ones a killed process loses too much, with shorter ones a take is
/// mostly headers of stretches.
pub const STRETCH_LENGTHS: RangeInclusive<Duration> =
    Duration::from_millis(50)..=Duration::from_secs(10);

/// The longest permitted time between syncs, which bounds what a power cut costs.
pub const SYNC_MAX: Duration = Duration::from_secs(60);

/// Configuration of a pipeline.
#[derive(Debug, Clone)]
pub struct PipelineConfig {
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Rows per second.
    pub rate_hz: f64,
    /// Device clock ticks per second.
    pub tick_hz: u64,
    /// The channels known at the start.
    pub channels: Vec<Channel>,
    /// The groups of sampled channels. Others that appear later are not recorded.
    pub sampled: Vec<SampledGroupInfo>,
    /// The rigid bodies: the first [`BODIES_MAX`] are recorded, and none that appear later.
    pub bodies: Vec<BodyInfo>,
    /// The largest errors of their poses; `None` to record every bit.
    pub pose_bounds: Option<PoseBounds>,
    /// Whether the residuals of the markers are recorded: of those known at the start, and of those that appear later at a few
    /// times.
    pub residuals: bool,
    /// Number of channels that may be added later.
    pub reserve: usize,
    /// Resampler threads.
    pub workers: usize,
    /// Length of a stretch. With `sync_every` it bounds what a power cut costs: one second by default.
    pub stretch: Duration,
    /// Length of the first stretch: short, so that the start is on disk soon.
    pub first_stretch: Duration,
    /// Time between key stretches.
    pub key_every: Duration,
    /// Time between syncs to disk.
    pub sync_every: Duration,
    /// Length and memory of the pre-roll, if there is one.
    pub pre_roll: Option<PreRollConfig>,
    /// Number of publishers for which what is received is copied: see
    /// [`ArmedHandles::publish_taps`](super::ArmedHandles::publish_taps).
    pub publish_taps: usize,
    /// Where its threads send their heartbeats.
    pub heartbeat: Heartbeat,
}

/// Encoded stretches to keep in memory, so that a take can begin before it is requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PreRollConfig {
    /// How long to keep them.
    pub time: Duration,
    /// Their memory limit in bytes: beyond it the oldest are dropped early.
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
            sampled: Vec::new(),
            bodies: Vec::new(),
            pose_bounds: (!codec.kind.is_lossless())
                .then(|| PoseBounds::of_tolerance(codec.tolerance)),
            residuals: false,
            reserve: SPARE_MIN,
            workers: crate::threads::default_workers(),
            stretch: STRETCH,
            first_stretch: Duration::from_millis(100),
            key_every: Duration::from_secs(10),
            sync_every: SYNC_EVERY,
            pre_roll: None,
            publish_taps: 0,
            heartbeat: Heartbeat::default(),
        }
    }

    /// With room for the markers that a device can announce later, of which it states `markers_max` in all: for 64 at least, for 256
    /// at most, and for no more than leave the queues in front of a stalled disk as long as they are.
    #[must_use]
    pub fn with_room_for(self, markers_max: usize) -> Self {
        let wanted = markers_max.saturating_sub(self.channels.len()).clamp(SPARE_MIN, SPARE_MAX);
        let with = |reserve| Self { reserve, ..self.clone() };
        let stretches = |config: &Self| Plan::new(config).map(|plan| plan.encoded_stretches).ok();
        let usual = stretches(&with(SPARE_MIN));
        let mut candidates = (SPARE_MIN..=wanted).rev().step_by(GROUP_CHANNELS).map(with);
        let fits = |config: &Self| usual.is_some() && stretches(config) == usual;
        candidates.find(fits).unwrap_or_else(|| with(SPARE_MIN))
    }

    /// The bodies that are recorded. Poses of others are refused, which is counted and reported.
    #[must_use]
    pub fn recorded_bodies(&self) -> &[BodyInfo] {
        self.bodies.get(..BODIES_MAX).unwrap_or(&self.bodies)
    }

    /// The channels known at the start whose residuals are recorded: as many as there are numbers of groups for.
    #[must_use]
    pub fn recorded_residuals(&self) -> &[Channel] {
        let channels = if self.residuals { &self.channels[..] } else { &[] };
        channels.get(..RESIDUAL_GROUPS.len() * GROUP_CHANNELS).unwrap_or(channels)
    }

    /// Rows of a full stretch.
    #[must_use]
    pub fn stretch_rows(&self) -> u32 {
        self.rows(self.stretch)
    }

    /// Times that differ from the defaults, as name and value for the take's header.
    #[must_use]
    pub fn custom_times(&self) -> Vec<(String, String)> {
        let times = [("stretch", self.stretch, STRETCH), ("sync", self.sync_every, SYNC_EVERY)];
        let other = times.into_iter().filter(|(_, time, usual)| time != usual);
        other.map(|(name, time, _)| (name.to_owned(), format!("{time:?}"))).collect()
    }

    fn rows(&self, time: Duration) -> u32 {
        (time.as_secs_f64() * self.rate_hz).floor().max(1.0) as u32
    }
}

/// Spare channels for markers that appear later, of every device: a group of the codec.
const SPARE_MIN: usize = GROUP_CHANNELS;

/// Spare channels of a device that states that it can announce so many: reflections in a bright room, and all strays of an NDI system.
/// Each group of them takes some megabytes from the start for its encoder, whether or not a marker appears; its rings and buffers
/// take memory only once they are filled.
const SPARE_MAX: usize = 4 * GROUP_CHANNELS;

/// How long the end of a take, and a frame for publishers, wait for the poses of a frame, in nanoseconds: devices send them
/// with the frame, but a line needs up to 15 ms for those of 128 bodies at 3 Mbaud. The next frame ends the wait of publishers.
pub(super) const POSES_WAIT_NS: u64 = 20_000_000;

/// Capacity of a ring in full stretches: two being filled or encoded, and two more for a worker that the
/// system does not run for a second. With shorter stretches, the number that lasts the same time.
const RING_STRETCHES: u32 = 4;

/// Encoded stretches in memory: 64 x 0.5 s, so that a disk that stalls for 30 s costs nothing. With shorter
/// stretches, the number that lasts the same time.
const ENCODED_STRETCHES: u32 = 64;

/// Memory limit of the rings, and of the buffers for encoded stretches, which become resident only as far as they are
/// filled: ten thousand markers at 240 Hz, or two hundred at 10 kHz, stay below it. Beyond it fewer stretches are kept.
const MEMORY_BYTES: usize = 2 << 30;

/// Time between key stretches while no take is written. A pre-roll begins with a key, so it is longer than requested by
/// up to this time. A key costs bytes, but these stay in memory.
const ARMED_KEY_EVERY: Duration = Duration::from_secs(1);

/// Boundaries in transit to the writer. Each caller waits for its reply before it sends the next, or gives up after
/// seconds. A recording that is divided into takes has no callers: a recorded row follows each of its boundaries, and for
/// each row there are two items of the timeline ([`Plan::spans_max`]).
const BOUNDARIES_MAX: usize = 16;

/// Timeline items per row: one for the row and one for a run of loss before it. Besides these there is room for
/// the runs that are pending when the rings are full and when the take ends.
const TIMELINE_ITEMS_PER_ROW: usize = 2;

/// Runs of loss kept apart between two recorded frames. If the cause changes more often, they are
/// stored as one run with all their causes; the ledger's counters stay exact.
pub(super) const RUNS_MAX: usize = 8;

/// Events and channel announcements queued for the writer: each marker that appears is one, and a
/// device announces at most its whole table at once, in one message.
pub(super) const CONTROL_MAX: usize = 1024;

/// Clock observations queued for the writer: at most ten round trips a second (the link's budget) and
/// four points a second, and only at the start; about 60 in a stall of 30 s.
pub(super) const CLOCK_ITEMS_MAX: usize = 1024;

/// The sizes derived from a [`PipelineConfig`].
#[derive(Debug, Clone)]
pub(super) struct Plan {
    encoded_stretches: usize,
    /// Rows in each channel's ring.
    pub(super) ring_rows: usize,
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
            "the resampler {0} needs the whole take: record with dense, fast or lossless, \
             then export the take and import it with {0}",
            config.codec.kind
        );
        ensure!(
            RATES_HZ.contains(&config.rate_hz),
            "cannot record at {} Hz: choose a rate from 0.001 to 1000000 Hz",
            config.rate_hz
        );
        let n_slots = config.channels.len() + config.reserve;
        let workers = config.workers.max(1);
        let plan = Self {
            encoded_stretches: count_for(ENCODED_STRETCHES, config.stretch),
            ring_rows: count_for(RING_STRETCHES, config.stretch) * config.stretch_rows() as usize,
            codec: config.codec,
            workers,
            n_slots,
            stretch_rows: config.stretch_rows(),
            // The rings have the size for stretches of length `stretch`.
            first_stretch_rows: config.rows(config.first_stretch.min(config.stretch)),
            key_rows: u64::from(config.rows(config.key_every)),
            armed_key_rows: u64::from(config.rows(config.key_every.min(ARMED_KEY_EVERY))),
            pre_roll: config.pre_roll,
            sync_every: config.sync_every,
        };
        let ring_bytes = plan.ring_rows.saturating_mul(n_slots).saturating_mul(size_of::<Sample>());
        ensure!(
            ring_bytes <= MEMORY_BYTES
                && (n_slots as u64).saturating_mul(u64::from(plan.stretch_rows)) <= SAMPLES_MAX,
            "cannot record {n_slots} markers at {} Hz: use a lower rate",
            config.rate_hz
        );
        let fitting = MEMORY_BYTES / plan.stretch_bytes_max();
        Ok(Self { encoded_stretches: fitting.clamp(2, plan.encoded_stretches), ..plan })
    }

    /// The codec's groups. They do not depend on the number of workers, so that any number gives the same take.
    pub(super) fn n_groups(&self) -> usize {
        self.groups_of(self.n_slots)
    }

    /// The slots of a group.
    pub(super) fn slots_of(&self, group: usize) -> Range<usize> {
        let first = group * GROUP_CHANNELS;
        first..(first + GROUP_CHANNELS).min(self.n_slots)
    }

    /// Number of groups that hold the first `n_channels` channels.
    pub(super) fn groups_of(&self, n_channels: usize) -> usize {
        n_channels.div_ceil(GROUP_CHANNELS)
    }

    pub(super) fn timeline_items(&self) -> usize {
        TIMELINE_ITEMS_PER_ROW * self.ring_rows + 4 * RUNS_MAX
    }

    /// Stretches closed and not yet encoded: each has at least one row in every ring of an active group
    /// (one item of the timeline's ring); the last one has no rows, and neither do boundaries.
    pub(super) fn spans_max(&self) -> usize {
        self.timeline_items() + 1 + BOUNDARIES_MAX
    }

    /// Buffers for encoded parts, per group.
    pub(super) fn buffers_per_group(&self) -> usize {
        self.encoded_stretches
    }

    /// All buffers: sending a part never waits.
    pub(super) fn parts_max(&self) -> usize {
        (self.n_groups() + 1) * self.buffers_per_group()
    }

    /// Largest size of a group's part: its block, and five bytes for its length. Allocated as a whole, but only
    /// what is written becomes resident.
    pub(super) fn part_bytes_max(&self, group: usize) -> usize {
        let (n_channels, n_rows) = (self.slots_of(group).len(), self.stretch_rows as usize);
        self.codec.max_block_bytes(n_channels, n_rows) + 5
    }

    /// Largest size of a stretch's header: per item a run (11 + 1), ticks and arrival (16 unless both are noise
    /// of hours) and timecode (5); 64 for its head and a key stretch's clocks.
    pub(super) fn header_bytes_max(&self) -> usize {
        self.timeline_items() * 33 + 64
    }

    /// Largest size of a stretch's payload.
    pub(super) fn stretch_bytes_max(&self) -> usize {
        let parts = (0..self.n_groups()).map(|group| self.part_bytes_max(group));
        parts.sum::<usize>() + self.header_bytes_max()
    }
}

/// Number of stretches: `stretches` of the default length, or as many shorter ones as last the same time.
fn count_for(stretches: u32, stretch: Duration) -> usize {
    let shorter = STRETCH.as_secs_f64() / stretch.as_secs_f64().max(1e-3);
    (f64::from(stretches) * shorter.max(1.0)).ceil() as usize
}

#[cfg(test)]
mod tests {
    use mocapd_codec::{ResamplerKind, Tolerance};

    use super::*;

    fn spare(n_channels: u16, markers_max: usize, rate_hz: f64) -> (usize, usize) {
        let codec =
            Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(0.5).unwrap() };
        let channel = |marker_id| Channel { marker_id, label: String::new(), labelled: true };
        let channels = (0..n_channels).map(channel).collect();
        let config = PipelineConfig::new(codec, rate_hz, 1_000_000, channels);
        let config = config.with_room_for(markers_max);
        (config.reserve, Plan::new(&config).unwrap().encoded_stretches)
    }

    #[test]
    fn there_is_room_for_as_many_markers_as_a_device_can_announce() {
        assert_eq!(spare(20, 20, 240.0), (64, 64));
        assert_eq!(spare(20, 200, 240.0), (180, 64));
        assert_eq!(spare(20, 10_000, 240.0), (256, 64));
    }

    #[test]
    fn spare_channels_cost_neither_a_rate_nor_the_time_that_a_stalled_disk_may_take() {
        let (reserve, stretches) = spare(400, 1424, 10_000.0);
        assert!((64..256).contains(&reserve), "{reserve}");
        assert_eq!(stretches, spare(400, 400, 10_000.0).1);
    }
}
