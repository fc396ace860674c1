//! Sampled channels: batches of samples -> one ring per group -> blocks, beside the frames and never in their way.
//!
//! ```text
//! reader thread    SampledIntake: batch -> the ring of its group, or lost as a whole; ends blocks with the stretches
//! sampling threads SampledGroupCoder: ring -> block; a group belongs to one thread
//! writer thread    blocks -> take file, before or behind the stretch that was open when they ended
//! ```
//!
//! A stretch never waits for samples, except that a take is closed when the samples up to its end are encoded, or after
//! [`SAMPLES_WAIT_MAX`]. The threads are not those of the resamplers: where they are too slow, batches find their ring
//! full, and no frame does.
//!
//! A batch belongs to the take that was open when it arrived, as a whole: takes are divided between batches, at the
//! place in the device's stream at which they are divided between frames.
//!
//! Residuals of markers have a sample in each row of the frames: it follows its row, and is lost where the row is. Markers
//! that appear get one of the groups that are kept for them; the writer describes it in the take when it knows their labels.

mod counter;
mod intake;
mod poses;
mod tap;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use mocapd_codec::{
    GROUP_CHANNELS,
    poses::{GROUP_BODIES, POSE_CHANNELS, PoseBounds, PoseErrors, PoseQuantiser},
    sampled::{SampledEncoder, max_block_bytes},
};
use mocapd_drivers::{
    device::{SampleForm as FormSent, SampledChannelInfo, SampledGroupInfo},
    link::SAMPLE_VALUES_MAX,
};
use mocapd_take::{
    record::{Channel, SampleForm, SampledChannel, SampledGroup},
    sampled::{
        BLOCK_ROWS_MAX, POSES, RECORDED, RESIDUAL_GROUPS, RESIDUAL_SCALE, RESIDUAL_SUFFIX,
        block_rows_max,
    },
    timeline::LossCauses,
};

pub use self::tap::{SampleColumn, SampleRange, SampleTapReceiver};
pub(super) use self::{
    intake::{BatchOutcome, SampledIntake},
    poses::{NewPoses, PosesOutcome},
};
use super::{
    PipelineConfig,
    messages::{BlockTime, WriterInput},
    ring::{RingConsumer, RingProducer, ring},
};
use crate::{
    pipeline::messages::{PartContent, SamplePart},
    threads,
};

/// Length of a group's ring in seconds, as those of the markers. It has room for [`RING_BLOCKS`] of the longest batches in
/// any case.
const RING_S: f64 = 2.0;

/// Stretches after which a block ends in any case. A stretch has somewhat more samples than its length says if the device's
/// converters run fast, or its frames slowly: its block must not be divided for that.
const LONG_BLOCK: f64 = 1.5;

/// Blocks of a stretch that a ring has room for: one that is filled, one that is encoded, and two more for a thread that the system does
/// not run for a while.
const RING_BLOCKS: usize = 4;

/// Blocks and runs of lost samples that wait to be encoded: those of 2 s of the shortest stretches, 50 ms, with a loss
/// behind each of 20 batches a second, ten times. If there are more, the batch is dropped as if the ring were full.
const ITEMS_MAX: usize = 1024;

/// Places among these that no batch takes: for the end of a block, a loss of each cause, and boundaries of takes, of
/// which few are under way.
const ITEMS_RESERVED: usize = 64;

/// Encoded blocks of a group in memory: as many as encoded stretches, 32 s of a disk that stalls. Fewer if all
/// of them would need more than [`MEMORY_BYTES`].
const BUFFERS_MAX: usize = 64;
const BUFFERS_MIN: usize = 4;

/// Parts of a group that can be under way to the writer: its buffers, and boundaries.
pub(super) const HELD_MAX: usize = BUFFERS_MAX + ITEMS_RESERVED;

/// Limit of the buffers of all groups. The system provides their memory only when it is first written to.
const MEMORY_BYTES: usize = 1 << 30;

/// Key blocks are at most this many blocks, and seconds, apart: the format's limits.
const KEY_BLOCKS: u32 = 8;
const KEY_S: f64 = 10.0;

/// Groups for the residuals of markers that appear after the start. The markers that appear with one frame are one, since a
/// group never gets more channels: most devices announce new markers together. At the start they take next to no memory; an
/// encoder has what it needs, some 15 KB a marker, allocated when the markers have appeared.
pub(super) const LATE_GROUPS: usize = 16;

/// How long a take that is to be closed waits for its last samples. Meanwhile stretches wait in memory, a third of what
/// fits there. At the end of all, how long none may come.
pub(super) const SAMPLES_WAIT_MAX: Duration = Duration::from_secs(10);

/// An entry in the order of a group's samples.
#[derive(Debug, Clone, Copy)]
struct SampleItem {
    /// The stretch that was open when it ended, or the boundary before which it ended.
    stretch: u64,
    /// Number of its first sample since the pipeline began.
    first: u64,
    /// Batches received twice, in samples, and jumps of the numbers since the item before.
    duplicates: u64,
    jumps: u32,
    content: ItemContent,
}

/// What an item is.
#[derive(Debug, Clone, Copy)]
enum ItemContent {
    /// Samples in the ring that become a block.
    Block { n: u32, key: bool, time: BlockTime },
    /// Samples that are lost.
    Lost { n: u64, causes: LossCauses },
    /// A boundary of takes, behind all samples that arrived before it.
    Boundary,
    /// The group has the residuals of `n` markers from this one on, which appeared after the start.
    Opens { first_marker: usize, n: usize },
}

/// The sizes of a group.
#[derive(Debug, Clone, Copy)]
struct GroupPlan {
    n_channels: usize,
    /// Whether it waits for markers that appear after the start.
    is_late: bool,
    /// Samples in the ring, those of all channels.
    ring_values: usize,
    /// Most samples of a channel in a block.
    rows_max: u32,
    /// Samples of a channel at which a block ends, before the next batch: those of [`LONG_BLOCK`] stretches.
    rows_due: u32,
    /// Samples of a channel in ten seconds, which key blocks are apart at most.
    key_rows: u64,
}

impl GroupPlan {
    fn new(group: &SampledGroupInfo, stretch: Duration) -> Self {
        // One for markers that appear later has room for any number of them.
        let is_late = is_late(group);
        let n_channels = if is_late { GROUP_CHANNELS } else { group.channels.len() };
        let rate_hz = f64::from(group.rate_millihertz) / 1000.0;
        let ring_rows = (RING_S * rate_hz).ceil() as usize;
        let ring_values = (ring_rows * n_channels).max(RING_BLOCKS * SAMPLE_VALUES_MAX);
        // A block ends with its stretch, or before it fills too much of the ring, which it leaves only as a whole.
        let stretch_rows = (stretch.as_secs_f64() * rate_hz * LONG_BLOCK).ceil() as u64;
        let of_ring = (ring_values as f64 / n_channels.max(1) as f64 / RING_BLOCKS as f64
            * LONG_BLOCK) as u64;
        let held_max = block_rows_max(n_channels).min(BLOCK_ROWS_MAX);
        // The longest batch fits into a block.
        let batch_rows = (SAMPLE_VALUES_MAX / n_channels.max(1)) as u64;
        let rows_due = stretch_rows.min(of_ring).min(held_max.saturating_sub(batch_rows)).max(1);
        let rows_max = (rows_due + batch_rows).min(held_max).max(1) as u32;
        let key_rows = (KEY_S * rate_hz) as u64;
        let rows_due = rows_due as u32;
        Self { n_channels, is_late, ring_values, rows_max, rows_due, key_rows }
    }

    fn block_bytes_max(&self) -> usize {
        max_block_bytes(self.n_channels, self.rows_max as usize)
    }
}

/// Wakes the thread that encodes a group.
#[derive(Debug, Clone)]
pub(super) struct SampleWakes(Vec<Sender<()>>);

impl SampleWakes {
    pub(super) fn wake(&self, group: usize) {
        if !self.0.is_empty() {
            // Full: it is awake, or will be. Closed: its thread has ended.
            self.0[group % self.0.len()].try_send(()).ok();
        }
    }
}

/// The writer's ends of the queues to the sampling threads.
#[derive(Debug)]
pub(super) struct SampleReturns {
    pub(super) buffers: Vec<Sender<Vec<u8>>>,
    pub(super) wakes: SampleWakes,
    /// Size of the largest block.
    pub(super) block_bytes_max: usize,
    /// By thread, whether it has ended: nothing more comes from it than what is in the queue.
    are_gone: Arc<[AtomicBool]>,
}

impl SampleReturns {
    /// Whether the thread of a group has ended.
    pub(super) fn is_gone(&self, group: usize) -> bool {
        let n_threads = self.are_gone.len().max(1);
        self.are_gone.get(group % n_threads).is_none_or(|gone| gone.load(Ordering::Acquire))
    }
}

/// The sampling threads.
#[derive(Debug)]
pub(super) struct SamplingThreads(Vec<std::thread::JoinHandle<()>>);

/// Number of places that sampled channels need in the queue to the writer, so that sending never waits: one for each
/// buffer, and some for boundaries, without which the writer waits for a time.
pub(super) fn parts_max(groups: &[SampledGroupInfo]) -> usize {
    groups.len() * HELD_MAX
}

/// Allocates the memory of all groups and starts their threads.
pub(super) fn start(
    groups: &[SampledGroupInfo],
    config: &PipelineConfig,
    to_writer: &Sender<WriterInput>,
) -> anyhow::Result<(SampledIntake, SampleReturns, SamplingThreads, SampleTapReceiver)> {
    let plans: Vec<GroupPlan> =
        groups.iter().map(|group| GroupPlan::new(group, config.stretch)).collect();
    let bytes: usize = plans.iter().map(GroupPlan::block_bytes_max).sum();
    let n_buffers = (MEMORY_BYTES / bytes.max(1)).clamp(BUFFERS_MIN, BUFFERS_MAX);
    let n_threads = config.workers.clamp(1, 8).min(groups.len());
    let mut coders: Vec<Vec<SampledGroupCoder>> = (0..n_threads).map(|_| Vec::new()).collect();
    let (mut rings, mut buffers) = (Vec::new(), Vec::new());
    for (index, plan) in plans.iter().enumerate() {
        let (samples, samples_out) = ring(plan.ring_values);
        let (items, items_out) = ring(ITEMS_MAX);
        let (back, free) = bounded(n_buffers);
        for _ in 0..n_buffers {
            back.try_send(Vec::with_capacity(plan.block_bytes_max())).ok();
        }
        coders[index % n_threads].push(SampledGroupCoder::new(
            index,
            *plan,
            (samples_out, items_out),
            free,
            quantisers(&groups[index], config.pose_bounds),
        ));
        rings.push((samples, items));
        buffers.push(back);
    }
    let are_gone: Arc<[AtomicBool]> = (0..n_threads).map(|_| AtomicBool::new(false)).collect();
    let (mut wakes, mut handles) = (Vec::new(), Vec::new());
    for (index, coders) in coders.into_iter().enumerate() {
        // One wake-up is enough: the thread looks at all its groups.
        let (wake, woken) = bounded(1);
        wakes.push(wake);
        let (parts, gone) = (to_writer.clone(), GoneOnDrop(Arc::clone(&are_gone), index));
        handles.push(threads::spawn(&format!("mocapd-smpl-{index}"), move || {
            run(coders, &woken, &parts);
            drop(gone);
        })?);
    }
    let wakes = SampleWakes(wakes);
    let (tap_in, tap) = tap::tap(&config.sampled);
    let intake = SampledIntake::new(groups, &plans, rings, config, (wakes.clone(), tap_in));
    let block_bytes_max = plans.iter().map(GroupPlan::block_bytes_max).max().unwrap_or(0);
    let returns = SampleReturns { buffers, wakes, block_bytes_max, are_gone };
    Ok((intake, returns, SamplingThreads(handles), tap))
}

/// Tells the writer that a thread has ended, also if it panicked: takes then are not closed later than needed.
struct GoneOnDrop(Arc<[AtomicBool]>, usize);

impl Drop for GoneOnDrop {
    fn drop(&mut self) {
        if let Some(is_gone) = self.0.get(self.1) {
            is_gone.store(true, Ordering::Release);
        }
    }
}

impl SamplingThreads {
    /// Waits for the threads, which end with the intake. A panic of one has cost samples, which the ledgers show.
    pub(super) fn join(self) {
        self.0.into_iter().for_each(|handle| drop(handle.join()));
    }
}

/// The device's groups, those of the poses of its bodies, and those of the residuals of its markers.
pub(super) fn groups(config: &PipelineConfig) -> Vec<SampledGroupInfo> {
    let rate_millihertz = (config.rate_hz * 1000.0).round() as u32;
    let poses = poses::groups(config.recorded_bodies(), rate_millihertz);
    let residuals = residual_groups(config, rate_millihertz);
    config.sampled.iter().cloned().chain(poses).chain(residuals).collect()
}

/// How many groups there are for the residuals of markers that appear later.
fn late_groups(config: &PipelineConfig) -> usize {
    let n_known = config.recorded_residuals().len().div_ceil(GROUP_CHANNELS);
    let wanted = if config.residuals { LATE_GROUPS.min(config.reserve) } else { 0 };
    wanted.min(RESIDUAL_GROUPS.len() - n_known)
}

/// Whether a group is one of residuals that has no markers yet.
fn is_late(group: &SampledGroupInfo) -> bool {
    RESIDUAL_GROUPS.contains(&group.id.into()) && group.channels.is_empty()
}

/// The residuals of a marker, in hundredths of a millimetre as drivers report them.
fn residual_channel(label: &str) -> SampledChannelInfo {
    SampledChannelInfo {
        name: format!("{label}{RESIDUAL_SUFFIX}"),
        unit: "mm".to_owned(),
        scale: RESIDUAL_SCALE,
        offset: 0.0,
    }
}

/// Describes a group of the residuals of markers that appeared: `first_marker` is the entry of the first one in the table.
pub(super) fn open_residuals(group: &mut SampledGroup, first_marker: usize, labels: &[&str]) {
    group.part_channels = labels.len() as u32;
    let channels = (first_marker as u32..).zip(labels).map(|(index, label)| {
        let SampledChannelInfo { name, unit, scale, offset } = residual_channel(label);
        SampledChannel { name, unit, index, scale, offset }
    });
    group.channels = channels.collect();
}

/// Of each marker that is known at the start a channel; and groups without channels for those that appear later.
fn residual_groups(
    config: &PipelineConfig,
    rate_millihertz: u32,
) -> impl Iterator<Item = SampledGroupInfo> {
    let channel = |channel: &Channel| residual_channel(&channel.label);
    let known = config.recorded_residuals().chunks(GROUP_CHANNELS);
    let late = std::iter::repeat_n(&[][..], late_groups(config));
    (RESIDUAL_GROUPS.start..).zip(known.chain(late)).map(move |(id, channels)| SampledGroupInfo {
        // Those that are recorded are not more than there are numbers.
        id: id as u8,
        form: FormSent::Float32,
        rate_millihertz,
        channels: channels.iter().map(channel).collect(),
    })
}

/// One for each body of a group of poses; none if all bits are kept, or for a group of the device.
fn quantisers(group: &SampledGroupInfo, bounds: Option<PoseBounds>) -> Vec<PoseQuantiser> {
    let bounds = bounds.filter(|_| poses::NUMBERS.contains(&group.id));
    let n_bodies = (group.channels.len() / POSE_CHANNELS).min(GROUP_BODIES);
    bounds.map_or_else(Vec::new, |bounds| vec![PoseQuantiser::new(bounds); n_bodies])
}

/// The groups as takes describe them; without channels those of residuals that have no markers yet.
pub(super) fn records(config: &PipelineConfig) -> Vec<SampledGroup> {
    let record = |group: &SampledGroupInfo| SampledGroup {
        number: group.id.into(),
        kind: RECORDED.to_owned(),
        form: match group.form {
            FormSent::Int16 => SampleForm::Int16,
            // All counts of the link are numbers of float32.
            FormSent::Int32 | FormSent::Float32 => SampleForm::Float32,
        },
        part_channels: group.channels.len() as u32,
        rate_hz: f64::from(group.rate_millihertz) / 1000.0,
        channels: (0..)
            .zip(&group.channels)
            .map(|(index, channel)| SampledChannel {
                name: channel.name.clone(),
                unit: channel.unit.clone(),
                index,
                scale: channel.scale,
                offset: channel.offset,
            })
            .collect(),
        ..SampledGroup::default()
    };
    let mut records: Vec<SampledGroup> = groups(config).iter().map(record).collect();
    for group in &mut records {
        if let Some(before) = group.number.checked_sub(RESIDUAL_GROUPS.start) {
            // The number of a channel is that of its marker in the take's table.
            let first = before * GROUP_CHANNELS as u32;
            group.channels.iter_mut().for_each(|channel| channel.index += first);
            continue;
        }
        let Some(before) = group.number.checked_sub((*poses::NUMBERS.start()).into()) else {
            continue;
        };
        group.kind = POSES.to_owned();
        let bodies = config.recorded_bodies().chunks(GROUP_BODIES).skip(before as usize);
        let ids = bodies.flatten().flat_map(|body| [u32::from(body.id); POSE_CHANNELS]);
        group.channels.iter_mut().zip(ids).for_each(|(channel, id)| channel.index = id);
        config.pose_bounds.iter().for_each(|bounds| group.set_pose_bounds(bounds));
    }
    records
}

type Rings = (RingProducer<f32>, RingProducer<SampleItem>);
type RingEnds = (RingConsumer<f32>, RingConsumer<SampleItem>);
type FreeBuffers = Receiver<Vec<u8>>;

/// How often a thread looks for work without being woken: only if a wake-up came between its last look and its sleep.
const IDLE: Duration = Duration::from_secs(1);

/// A group, with all its memory.
#[derive(Debug)]
struct SampledGroupCoder {
    index: usize,
    plan: GroupPlan,
    rings: RingEnds,
    /// Free buffers; the writer returns them.
    buffers: FreeBuffers,
    /// The next item, for which no buffer was free.
    waiting: Option<SampleItem>,
    encoder: SampledEncoder,
    /// By body, if the group is one of poses that are stored within bounds.
    quantisers: Vec<PoseQuantiser>,
    /// The samples of a block, one after another, and channel after channel.
    rows: Vec<f32>,
    columns: Vec<f32>,
    /// Whether a block was refused, so that the next one has to be a key.
    is_out_of_step: bool,
}

impl SampledGroupCoder {
    fn new(
        index: usize,
        plan: GroupPlan,
        rings: RingEnds,
        buffers: FreeBuffers,
        quantisers: Vec<PoseQuantiser>,
    ) -> Self {
        let mut encoder = SampledEncoder::new();
        if !plan.is_late {
            encoder.prepare(plan.n_channels, plan.rows_max as usize);
        }
        let values = plan.n_channels * plan.rows_max as usize;
        let (rows, columns) = (vec![0.0; values], vec![0.0; values]);
        let (waiting, is_out_of_step) = (None, false);
        Self {
            index,
            plan,
            rings,
            buffers,
            waiting,
            encoder,
            quantisers,
            rows,
            columns,
            is_out_of_step,
        }
    }

    /// Encodes the samples in the rings while there are free buffers. Returns `false` when no more will come, or the
    /// writer is gone.
    fn run(&mut self, parts: &Sender<WriterInput>) -> bool {
        loop {
            let Some(item) = self.waiting.take().or_else(|| self.rings.1.pop()) else {
                return !self.rings.1.is_over();
            };
            let content = match item.content {
                ItemContent::Boundary => {
                    // A take that begins here has nothing of the poses before.
                    self.quantisers.iter_mut().for_each(PoseQuantiser::forget);
                    PartContent::Boundary
                }
                ItemContent::Opens { first_marker, n } => {
                    self.plan.n_channels = n;
                    self.encoder.prepare(n, self.plan.rows_max as usize);
                    PartContent::Opens { first_marker, n }
                }
                ItemContent::Block { .. } | ItemContent::Lost { .. } => {
                    let Ok(buffer) = self.buffers.try_recv() else {
                        self.waiting = Some(item);
                        return true;
                    };
                    self.content(item.content, buffer)
                }
            };
            let SampleItem { stretch, first, duplicates, jumps, .. } = item;
            let part = SamplePart { group: self.index, stretch, first, duplicates, jumps, content };
            // There is a place for every buffer. Without one for a boundary, the writer waits in vain for a time.
            if parts
                .try_send(WriterInput::Samples(part))
                .is_err_and(|error| error.is_disconnected())
            {
                return false;
            }
        }
    }

    fn content(&mut self, content: ItemContent, mut buffer: Vec<u8>) -> PartContent {
        buffer.clear();
        match content {
            ItemContent::Block { n, key, time } => {
                let key = key || self.is_out_of_step;
                if self.encode(n as usize, key, &mut buffer) {
                    let mut errors = PoseErrors::default();
                    let measured = self.quantisers.iter_mut().map(PoseQuantiser::take_errors);
                    measured.for_each(|of_body| errors.add(&of_body));
                    PartContent::Block { n, key, time, errors, block: buffer }
                } else {
                    // A bug in this program: a cause without a name.
                    let causes = Default::default();
                    PartContent::Lost { n: n.into(), causes, buffer }
                }
            }
            ItemContent::Lost { n, causes } => PartContent::Lost { n, causes, buffer },
            ItemContent::Boundary | ItemContent::Opens { .. } => PartContent::Boundary,
        }
    }

    fn encode(&mut self, n_rows: usize, key: bool, out: &mut Vec<u8>) -> bool {
        let n_channels = self.plan.n_channels;
        let values = n_rows * n_channels;
        let n = self.rings.0.pop_slice(&mut self.rows[..values]);
        debug_assert_eq!(n, values, "an ended block is in the ring");
        for row in self.rows[..values].chunks_exact_mut(n_channels) {
            let (poses, _) = row.as_chunks_mut::<POSE_CHANNELS>();
            let quantisers = self.quantisers.iter_mut();
            quantisers.zip(poses).for_each(|(quantiser, pose)| quantiser.round(pose));
        }
        let rows = self.rows[..values].chunks_exact(n_channels);
        for (row, samples) in rows.enumerate() {
            for (channel, &sample) in samples.iter().enumerate() {
                self.columns[channel * n_rows + row] = sample;
            }
        }
        let mut channels: [&[f32]; GROUP_CHANNELS] = [&[]; GROUP_CHANNELS];
        for (slot, column) in channels.iter_mut().zip(self.columns[..values].chunks_exact(n_rows)) {
            *slot = column;
        }
        let encoded = self.encoder.encode(&channels[..n_channels], key, out);
        self.is_out_of_step = encoded.is_err();
        !self.is_out_of_step
    }
}

/// Runs until the intake is gone and everything is encoded.
fn run(mut groups: Vec<SampledGroupCoder>, woken: &Receiver<()>, parts: &Sender<WriterInput>) {
    loop {
        groups.retain_mut(|group| group.run(parts));
        if groups.is_empty() {
            return;
        }
        if woken.recv_timeout(IDLE) == Err(RecvTimeoutError::Disconnected) {
            // The writer and the intake are gone: what waits for a buffer is not written.
            groups.retain_mut(|group| group.run(parts) && group.waiting.is_none());
            return;
        }
    }
}
