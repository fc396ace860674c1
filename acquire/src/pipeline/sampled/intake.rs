//! The reader's part: puts whole batches into the ring of their group, or counts them as lost.

use std::ops::Range;

use mocapd_codec::GROUP_CHANNELS;
use mocapd_drivers::{
    device::{BodyInfo, EndOfPoses, PoseFrame, SampleBatch, SampledGroupInfo},
    link::SAMPLE_VALUES_MAX,
};
use mocapd_take::{sampled::RESIDUAL_GROUPS, timeline::LossCauses};

use super::{
    GroupPlan, ITEMS_RESERVED, ItemContent, KEY_BLOCKS, RingProducer, Rings, SampleItem,
    SampleWakes,
    counter::{BatchStep, RowSteps, SampleCounter},
    poses::{self, NewPoses, PoseRows, PosesOutcome},
    tap::SampleTapSender,
};
use crate::pipeline::{PipelineConfig, messages::BlockTime, ring::Sample};

/// The causes of losses that have not been stated yet, in the order in which they are stated.
const CAUSES: [LossCauses; 5] = [
    REFUSED,
    LossCauses::DISCONNECTED,
    LossCauses::DROPPED_BY_DEVICE,
    LossCauses::NOT_RECEIVED,
    LossCauses::RING_FULL,
];

/// The cause of samples that arrived and were refused: there is no more specific one.
const REFUSED: LossCauses = LossCauses(0);

/// Numbers of samples stay below this, half of what a take can hold: a device whose numbers go further jumped.
const NUMBERS_MAX: u64 = 1 << 49;

/// Stretches over which the segment of the device's clock has to differ from that of a run before another run begins:
/// frames and batches that show a jump of the clock come within one.
const SEGMENT_STRETCHES: u32 = 2;

/// What became of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::pipeline) enum BatchOutcome {
    /// It is in the ring, or was counted as lost because the ring is full. `first` is the number of its first sample since the
    /// pipeline began.
    Accepted { first: u64 },
    /// It came before, and was counted.
    Duplicate,
    /// Its group was not announced before the start, or the batch does not fit it.
    Refused,
}

/// Accepts the batches of all groups. Belongs to the thread that reads the device.
#[derive(Debug)]
pub(in crate::pipeline) struct SampledIntake {
    groups: Vec<GroupIntake>,
    /// Index of the group with each number; `None` for one that was not announced.
    by_id: [Option<u8>; 256],
    wakes: SampleWakes,
    poses: PoseRows,
    /// Whether the poses of the last frame had not come before.
    has_new_poses: bool,
    residuals: ResidualRows,
    tap: SampleTapSender,
}

/// The groups of the residuals: they have a sample of each row of the frames, lost ones included, so that the number of a
/// sample less that of another is the difference of their rows.
#[derive(Debug)]
struct ResidualRows {
    are_recorded: bool,
    /// Index of the first of them, behind all other groups.
    first_group: usize,
    /// The slots of the markers of each group. The groups behind these wait for markers that appear.
    slots: Vec<Range<usize>>,
    /// The counts of a group in the current row; NaN where a marker has none.
    row: [f32; GROUP_CHANNELS],
    steps: RowSteps,
}

impl ResidualRows {
    fn new(infos: &[SampledGroupInfo], config: &PipelineConfig) -> Self {
        let is_one = |info: &SampledGroupInfo| RESIDUAL_GROUPS.contains(&info.id.into());
        let first_group = infos.iter().position(is_one).unwrap_or(infos.len());
        let n_known = config.recorded_residuals().len();
        let of_group = |first: usize| first..n_known.min(first + GROUP_CHANNELS);
        let mut slots = Vec::with_capacity(infos.len() - first_group);
        slots.extend((0..n_known).step_by(GROUP_CHANNELS).map(of_group));
        Self {
            are_recorded: config.residuals,
            first_group,
            slots,
            row: [f32::NAN; GROUP_CHANNELS],
            steps: RowSteps::new(config.rate_hz, config.tick_hz),
        }
    }

    /// How many markers have a group, the first ones.
    fn n_markers(&self) -> usize {
        self.slots.last().map_or(0, |slots| slots.end)
    }

    /// Gives a group to markers that have appeared, while there is one.
    fn open(&mut self, groups: &mut [GroupIntake], n_markers: usize, stretch: u64) {
        while self.n_markers() < n_markers
            && let Some(group) = groups.get_mut(self.slots.len())
        {
            let first_marker = self.n_markers();
            let n = (n_markers - first_marker).min(GROUP_CHANNELS);
            // Without room now, they get it with a later row.
            let has_room = group.items.vacant() > ITEMS_RESERVED;
            if !has_room || !group.push(stretch, ItemContent::Opens { first_marker, n }) {
                return;
            }
            group.plan.n_channels = n;
            self.slots.push(first_marker..first_marker + n);
        }
    }
}

/// One group.
#[derive(Debug)]
struct GroupIntake {
    info: SampledGroupInfo,
    /// Whether the device announced it otherwise since.
    is_contradicted: bool,
    plan: GroupPlan,
    samples: RingProducer<f32>,
    items: RingProducer<SampleItem>,
    counter: SampleCounter,
    /// Number of the next sample since the pipeline began, those that are pending not included.
    next: u64,
    open: Option<OpenBlock>,
    /// Lost samples that have not been stated yet, by cause.
    pending: [u64; CAUSES.len()],
    duplicates: u64,
    jumps: u32,
    run_start: u64,
    /// The segment of the run; `None` until its first block ends.
    segment: Option<u32>,
    segment_stretches: u32,
    /// Whether the next sample begins a run.
    begins_run: bool,
    /// Blocks since the last key block, and whether the next one has to be a key block.
    since_key: u32,
    key_at: u64,
    needs_key: bool,
    /// Whether a block of the open stretch has ended.
    has_early_block: bool,
    /// Number of the first sample of the last batch, unless it came before.
    accepted: Option<u64>,
}

/// The block that is being filled.
#[derive(Debug, Clone, Copy)]
struct OpenBlock {
    n: u32,
    device_ticks: u64,
    /// The sample at which the last batch began, and its time.
    last_batch: (u32, u64),
}

impl SampledIntake {
    pub(super) fn new(
        infos: &[SampledGroupInfo],
        plans: &[GroupPlan],
        rings: Vec<Rings>,
        config: &PipelineConfig,
        (wakes, tap): (SampleWakes, SampleTapSender),
    ) -> Self {
        let mut by_id = [None; 256];
        let groups = infos.iter().zip(plans).zip(rings).enumerate();
        let groups = groups.map(|(index, ((info, plan), (samples, items)))| {
            // Devices have no groups with the numbers of residuals.
            if !RESIDUAL_GROUPS.contains(&info.id.into()) {
                by_id[usize::from(info.id)] = Some(index as u8);
            }
            let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
            let counter = match poses::NUMBERS.contains(&info.id) {
                true => SampleCounter::of_rows(rate_hz, config.tick_hz),
                false => SampleCounter::new(rate_hz, config.tick_hz),
            };
            GroupIntake {
                info: info.clone(),
                is_contradicted: false,
                plan: *plan,
                samples,
                items,
                counter,
                next: 0,
                open: None,
                pending: [0; CAUSES.len()],
                duplicates: 0,
                jumps: 0,
                run_start: 0,
                segment: None,
                segment_stretches: 0,
                begins_run: true,
                since_key: 0,
                key_at: 0,
                needs_key: true,
                has_early_block: false,
                accepted: None,
            }
        });
        let groups = groups.collect();
        Self {
            groups,
            by_id,
            wakes,
            poses: PoseRows::new(config.recorded_bodies()),
            has_new_poses: false,
            residuals: ResidualRows::new(infos, config),
            tap,
        }
    }

    fn group_mut(&mut self, id: u8) -> Option<&mut GroupIntake> {
        let index = self.by_id.get(usize::from(id)).copied().flatten()?;
        self.groups.get_mut(usize::from(index))
    }

    /// Whether the next batch of a group might find its ring full. For sources that can wait.
    pub(in crate::pipeline) fn is_full(&self) -> bool {
        self.groups.iter().any(|group| {
            group.samples.vacant() < SAMPLE_VALUES_MAX
                || group.items.vacant() <= ITEMS_RESERVED + CAUSES.len()
        })
    }

    /// Whether an announcement is that of a known group. Samples of a group that is announced otherwise are refused until
    /// it is announced as before: they must not be stored under another description.
    pub(in crate::pipeline) fn announce(&mut self, info: &SampledGroupInfo) -> bool {
        let Some(group) = self.group_mut(info.id) else { return false };
        group.is_contradicted = group.info != *info;
        !group.is_contradicted
    }

    /// Accepts a batch; `stretch` is the number of the open stretch.
    pub(in crate::pipeline) fn batch(
        &mut self,
        batch: &SampleBatch<'_>,
        stretch: u64,
        segment: u32,
    ) -> BatchOutcome {
        let index = self.by_id.get(usize::from(batch.group)).copied().flatten();
        let Some(group) = self.group_mut(batch.group) else { return BatchOutcome::Refused };
        let fits = group.has_shape_of(batch) && !group.is_contradicted;
        if !fits {
            // One of another shape or form need not be of this series.
            if group.is_contradicted && group.has_shape_of(batch) {
                group.lose(batch, REFUSED);
            }
            return BatchOutcome::Refused;
        }
        // While no stretch ends, nothing else wakes its thread.
        let is_block_ended = group.batch(batch, stretch, segment);
        let Some(first) = group.accepted else { return BatchOutcome::Duplicate };
        if let Some(index) = index.map(usize::from) {
            if is_block_ended {
                self.wakes.wake(index);
            }
            self.tap.offer(index, first, batch);
        }
        BatchOutcome::Accepted { first }
    }

    /// Whether an announcement has the bodies that were known at the start, and no others.
    pub(in crate::pipeline) fn announce_bodies(&mut self, bodies: &[BodyInfo]) -> bool {
        self.poses.announce(bodies)
    }

    /// Accepts the poses of a frame, all or none.
    pub(in crate::pipeline) fn poses(
        &mut self,
        frame: &PoseFrame<'_>,
        stretch: u64,
        segment: u32,
    ) -> PosesOutcome {
        let outcome = self.poses.fill(frame);
        self.has_new_poses = self.put_poses((frame.number, frame.device_ticks), stretch, segment);
        if self.has_new_poses {
            self.poses.count_tracked();
        }
        outcome
    }

    /// The poses of the last frame, unless they came before.
    pub(in crate::pipeline) fn new_poses(&self) -> Option<NewPoses<'_>> {
        self.has_new_poses.then(|| self.poses.last())
    }

    /// Counts the poses that are missing up to the end of a run.
    pub(in crate::pipeline) fn end_of_poses(
        &mut self,
        end: &EndOfPoses,
        stretch: u64,
        segment: u32,
    ) {
        self.poses.end(end);
        self.put_poses((end.number, end.device_ticks), stretch, segment);
    }

    /// Returns `false` if they came before.
    fn put_poses(
        &mut self,
        (number, device_ticks): (u32, u64),
        stretch: u64,
        segment: u32,
    ) -> bool {
        let Self { groups, by_id, wakes, poses, .. } = self;
        let index_of = |batch: &SampleBatch<'_>| by_id[usize::from(batch.group)].map(usize::from);
        let batches = poses
            .batches(number, device_ticks)
            .filter_map(|batch| index_of(&batch).map(|index| (index, batch)));
        let has_room = |(index, batch): (usize, SampleBatch<'_>)| {
            groups.get(index).is_some_and(|group| group.has_room(&batch))
        };
        let have_room = batches.clone().all(has_room);
        let mut are_new = false;
        for (index, batch) in batches {
            let Some(group) = groups.get_mut(index) else { continue };
            if !have_room {
                are_new |= group.lose(&batch, LossCauses::RING_FULL);
                continue;
            }
            if group.batch(&batch, stretch, segment) {
                wakes.wake(index);
            }
            are_new |= group.accepted.is_some();
        }
        are_new
    }

    /// Whether residuals are recorded, and those of some of the first `n_markers` markers are not.
    pub(in crate::pipeline) fn lacks_residuals(&self, n_markers: usize) -> bool {
        self.residuals.are_recorded && self.residuals.n_markers() < n_markers
    }

    /// Accepts the residuals of a recorded row, by slot: all of them, or they are lost as if the ring were full. `samples` are
    /// those of all markers so far.
    pub(in crate::pipeline) fn residuals(
        &mut self,
        samples: &[Sample],
        device_ticks: u64,
        stretch: u64,
        segment: u32,
    ) {
        let Self { groups, wakes, residuals, .. } = self;
        let Some(groups) = groups.get_mut(residuals.first_group..).filter(|of| !of.is_empty())
        else {
            return;
        };
        residuals.open(groups, samples.len(), stretch);
        let ResidualRows { first_group, slots, row, steps, .. } = residuals;
        let continues = steps.step(device_ticks);
        let mut in_use = groups.iter().zip(slots.iter());
        let have_room = in_use.all(|(group, slots)| group.has_room_for(slots.len()));
        for (index, (group, slots)) in groups.iter_mut().zip(slots.iter()).enumerate() {
            group.begins_run |= !continues;
            if !have_room {
                group.add_lost(1, LossCauses::RING_FULL);
                continue;
            }
            for (count, sample) in row.iter_mut().zip(&samples[slots.clone()]) {
                // 0: the device reports none.
                let has_one = sample.present && sample.residual_10um > 0;
                *count = if has_one { f32::from(sample.residual_10um) } else { f32::NAN };
            }
            if group.append((&row[..slots.len()], 1, device_ticks), stretch, segment) {
                wakes.wake(*first_group + index);
            }
        }
    }

    /// The residuals of rows that were lost with their frames.
    pub(in crate::pipeline) fn lose_residuals(&mut self, rows: u64, causes: LossCauses) {
        self.residuals.steps.lose(rows);
        // A ledger of samples has one cause.
        let one = [LossCauses::DISCONNECTED, LossCauses::NOT_RECEIVED, LossCauses::RING_FULL];
        let cause = one.into_iter().find(|cause| causes.contains(*cause)).unwrap_or(causes);
        let cause = if CAUSES.contains(&cause) { cause } else { REFUSED };
        let groups = self.groups.iter_mut().skip(self.residuals.first_group);
        let in_use = groups.take(self.residuals.slots.len());
        in_use.for_each(|group| group.add_lost(rows, cause));
    }

    /// Ends the open blocks with a stretch, so that they are in the same takes, and begin where it can be decoded from
    /// the start. `is_boundary`: a take may begin or end behind it.
    pub(in crate::pipeline) fn end_stretch(
        &mut self,
        stretch: u64,
        key: bool,
        is_boundary: bool,
        segment: u32,
    ) {
        for (index, group) in self.groups.iter_mut().enumerate() {
            // A take may begin with this stretch, and so with its first block.
            group.needs_key |= key && !group.has_early_block;
            group.end_block(stretch, segment);
            group.has_early_block = false;
            // What was lost belongs to the take that ends here.
            group.state_pending(stretch);
            // Behind a boundary a take may begin.
            group.needs_key |= is_boundary;
            group.follow_segment(segment);
            if is_boundary {
                group.push(stretch, ItemContent::Boundary);
            }
            self.wakes.wake(index);
        }
        if is_boundary {
            self.poses.forget();
        }
    }

    /// Ends the open blocks while no stretch is open that would end them.
    pub(in crate::pipeline) fn end_blocks(&mut self, stretch: u64, segment: u32) {
        for (index, group) in self.groups.iter_mut().enumerate() {
            if group.end_early(stretch, segment) {
                self.wakes.wake(index);
            }
        }
    }

    /// The device was away or started again: its numbers may begin again.
    pub(in crate::pipeline) fn rejoin(&mut self) {
        self.groups.iter_mut().for_each(|group| group.counter.rejoin());
        self.residuals.steps.rejoin();
    }
}

impl GroupIntake {
    fn has_shape_of(&self, batch: &SampleBatch<'_>) -> bool {
        let n_channels = self.info.channels.len();
        // Blocks have room for the longest batch that drivers may pass on.
        let is_bounded = batch.samples.len() <= SAMPLE_VALUES_MAX;
        usize::from(batch.n_channels) == n_channels && batch.form == self.info.form && is_bounded
    }

    /// Counts the samples of a batch that cannot be stored. Returns `false` if it came before.
    fn lose(&mut self, batch: &SampleBatch<'_>, causes: LossCauses) -> bool {
        let is_new = self.follow(batch);
        if is_new {
            self.add_lost(batch.n_samples() as u64, causes);
        }
        is_new
    }

    /// Follows the numbers of a batch, and counts what is missing before it. Returns `false` if it came before.
    fn follow(&mut self, batch: &SampleBatch<'_>) -> bool {
        match self.counter.step(batch) {
            BatchStep::Duplicate => {
                self.duplicates += batch.n_samples() as u64;
                return false;
            }
            BatchStep::Next { missing, causes, continues } if self.has_numbers_for(missing) => {
                self.add_lost(missing, causes);
                self.begins_run |= !continues;
            }
            BatchStep::Jump | BatchStep::Next { .. } => {
                self.jumps = self.jumps.saturating_add(1);
                self.begins_run = true;
            }
        }
        true
    }

    fn has_room(&self, batch: &SampleBatch<'_>) -> bool {
        self.has_room_for(batch.samples.len())
    }

    /// Whether this many samples fit, those of all channels.
    fn has_room_for(&self, values: usize) -> bool {
        self.samples.vacant() >= values && self.items.vacant() > ITEMS_RESERVED
    }

    fn has_numbers_for(&self, missing: u64) -> bool {
        let pending = self.pending.iter().fold(missing, |sum, n| sum.saturating_add(*n));
        self.next.saturating_add(pending) < NUMBERS_MAX
    }

    /// Returns whether there is something to encode.
    fn batch(&mut self, batch: &SampleBatch<'_>, stretch: u64, segment: u32) -> bool {
        let n = batch.n_samples() as u32;
        self.accepted = None;
        if !self.follow(batch) {
            return false;
        }
        self.accepted = Some(self.pending.iter().fold(self.next, |sum, n| sum.saturating_add(*n)));
        if n == 0 {
            return false;
        }
        if !self.has_room(batch) {
            self.add_lost(n.into(), LossCauses::RING_FULL);
            return false;
        }
        self.append((batch.samples, n, batch.device_ticks), stretch, segment)
    }

    /// Appends `n` samples of each channel, for which there is room. Returns whether there is something to encode.
    fn append(
        &mut self,
        (samples, n, ticks): (&[f32], u32, u64),
        stretch: u64,
        segment: u32,
    ) -> bool {
        let is_apart = self.begins_run || self.pending.iter().any(|&n| n > 0);
        let is_ended = is_apart
            || self.open.is_some_and(|open| {
                open.n >= self.plan.rows_due || open.n + n > self.plan.rows_max
            });
        if is_ended {
            self.end_early(stretch, segment);
        }
        if std::mem::take(&mut self.begins_run) {
            (self.run_start, self.segment, self.segment_stretches) = (self.next, None, 0);
        }
        let open = OpenBlock { n: 0, device_ticks: ticks, last_batch: (0, ticks) };
        let open = self.open.get_or_insert(open);
        open.last_batch = (open.n, ticks);
        open.n += n;
        self.next += u64::from(n);
        self.samples.push_slice(samples);
        is_ended
    }

    fn add_lost(&mut self, n: u64, causes: LossCauses) {
        if let Some(place) = CAUSES.iter().position(|cause| *cause == causes) {
            self.pending[place] = self.pending[place].saturating_add(n);
        }
    }

    /// Ends the open block before its stretch, and states what was lost. Returns whether there is something to encode.
    fn end_early(&mut self, stretch: u64, segment: u32) -> bool {
        let is_open = self.open.is_some();
        // Whether a take may begin with this stretch is not known yet: its first block is a key.
        self.needs_key |= is_open && !self.has_early_block;
        self.has_early_block |= is_open;
        self.end_block(stretch, segment);
        self.state_pending(stretch);
        is_open
    }

    /// Ends the open block.
    fn end_block(&mut self, stretch: u64, segment: u32) {
        let Some(OpenBlock { n, device_ticks, last_batch }) = self.open.take() else { return };
        let segment = *self.segment.get_or_insert(segment);
        let time = BlockTime { device_ticks, last_batch, run_start: self.run_start, segment };
        // Up to the end of this block.
        let is_late = self.next.saturating_sub(self.key_at) > self.plan.key_rows;
        let key = self.needs_key || is_late || self.since_key + 1 >= KEY_BLOCKS;
        if key {
            self.key_at = self.next - u64::from(n);
        }
        self.since_key = if key { 0 } else { self.since_key + 1 };
        self.needs_key = false;
        self.push_at(self.next - u64::from(n), stretch, ItemContent::Block { n, key, time });
    }

    /// States the losses that are pending, if there is room.
    fn state_pending(&mut self, stretch: u64) {
        for (place, causes) in CAUSES.into_iter().enumerate() {
            let n = self.pending[place];
            if n > 0 && self.push(stretch, ItemContent::Lost { n, causes }) {
                self.pending[place] = 0;
                self.next += n;
                self.needs_key = true;
            }
        }
    }

    fn push(&mut self, stretch: u64, content: ItemContent) -> bool {
        self.push_at(self.next, stretch, content)
    }

    /// Returns `false` if there is no room: then the numbers of later samples close the gap, or the writer waits for a
    /// boundary in vain.
    fn push_at(&mut self, first: u64, stretch: u64, content: ItemContent) -> bool {
        if self.items.vacant() == 0 {
            return false;
        }
        let (duplicates, jumps) = (self.duplicates, self.jumps);
        (self.duplicates, self.jumps) = (0, 0);
        self.items.push(SampleItem { stretch, first, duplicates, jumps, content });
        true
    }

    /// Begins another run if frames show, over a whole stretch, another segment of the clock than the run has.
    fn follow_segment(&mut self, segment: u32) {
        let differs = self.segment.is_some_and(|of_run| of_run != segment);
        self.segment_stretches = if differs { self.segment_stretches + 1 } else { 0 };
        self.begins_run |= self.segment_stretches >= SEGMENT_STRETCHES;
    }
}
