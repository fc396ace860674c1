//! The resampler threads, and the groups of channels and the timeline, which take rows from rings and produce one part per
//! stretch. A group is an object held by one worker at a time. Its ownership moves through
//! channels: there is no lock, and no worker waits for a group.
//!
//! A group is woken when a stretch closes and when one of its buffers returns. The worker that receives the wake-up
//! takes the group from its place, does all its jobs and puts it back. A worker that finds the place empty leaves the
//! jobs to the group's holder, which checks for more after putting it back.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::JoinHandle,
};

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_codec::{BlockEncoder, BlockReport, CodecError, GROUP_CHANNELS, Position, Rows};
use mocapd_take::{
    record::Header,
    statistics::BlockTally,
    stretch::{StretchHeaderWriter, put_block},
    timeline::{Timeline, TimelineEncoder},
};

use super::{
    Counts, PipelineProgress,
    messages::{EncodeJob, Part, PartBuffer, PartReport, StretchEnd, WriterInput},
    plan::Plan,
    ring::{RingConsumer, RingProducer, Sample, TimelineItem, ring},
};
use crate::threads::{self, Heartbeat, HeartbeatHandle, ThreadRole};

/// The place where a group waits for work.
#[derive(Debug)]
struct ParkedGroup {
    park: Sender<Group>,
    unpark: Receiver<Group>,
    jobs: Receiver<EncodeJob>,
    buffers: Receiver<PartBuffer>,
    /// Whether a wake-up for this group is queued.
    woken: AtomicBool,
}

impl ParkedGroup {
    fn has_work(&self) -> bool {
        !self.jobs.is_empty() && !self.buffers.is_empty()
    }
}

/// Wakes groups. At most one wake-up per group is queued, so the queue needs one place per group.
#[derive(Debug, Clone)]
pub(super) struct WakeQueue {
    parked: Arc<[ParkedGroup]>,
    queue: Sender<Option<usize>>,
}

impl WakeQueue {
    pub(super) fn wake(&self, group: usize) {
        if !self.parked[group].woken.swap(true, Ordering::AcqRel) {
            // Disconnected only after the workers have stopped.
            self.queue.try_send(Some(group)).ok();
        }
    }
}

/// Sends the reader's jobs to the pool.
#[derive(Debug)]
pub(super) struct Feed {
    /// One sender per group; the last is the timeline's.
    jobs: Vec<Sender<EncodeJob>>,
    wakes: WakeQueue,
    plan: Plan,
    next_stretch: u64,
}

impl Feed {
    /// Number of the open stretch.
    pub(super) fn next_stretch(&self) -> u64 {
        self.next_stretch
    }

    /// Sends a job to every group with active channels and to the timeline's. Returns `false` when a queue was full,
    /// which its bound rules out while the workers live.
    pub(super) fn end_stretch(&mut self, end: StretchEnd, counts: Counts) -> bool {
        let stretch = self.next_stretch;
        self.next_stretch += 1;
        let timeline = self.jobs.len() - 1;
        let active = self.plan.groups_of(end.n_channels);
        let mut all_sent = true;
        for group in (0..active).chain([timeline]) {
            let counts = (group == timeline).then_some(counts);
            all_sent &= self.jobs[group].try_send(EncodeJob { stretch, end, counts }).is_ok();
            self.wakes.wake(group);
        }
        all_sent
    }
}

/// The worker threads.
#[derive(Debug)]
pub(super) struct Pool {
    workers: Vec<JoinHandle<()>>,
    wakes: WakeQueue,
}

impl Pool {
    pub(super) fn start(
        plan: &Plan,
        groups: Vec<Group>,
        progress: &Arc<PipelineProgress>,
        heartbeat: &Heartbeat,
    ) -> anyhow::Result<(Self, Feed)> {
        let n_groups = groups.len();
        let mut jobs = Vec::with_capacity(n_groups);
        let mut parked = Vec::with_capacity(n_groups);
        for group in groups {
            jobs.push(group.jobs_in.clone());
            let (waiting, buffers) = (group.jobs.clone(), group.buffers.clone());
            let (park, unpark) = bounded(1);
            drop(park.send(group));
            let woken = AtomicBool::new(false);
            parked.push(ParkedGroup { park, unpark, jobs: waiting, buffers, woken });
        }
        // One wake-up per group, and one stop per worker.
        let (queue, wakes_out) = bounded(n_groups + plan.workers);
        let wakes = WakeQueue { parked: parked.into(), queue };
        let mut workers = Vec::with_capacity(plan.workers);
        for index in 0..plan.workers {
            let (parked, queue) = (Arc::clone(&wakes.parked), wakes_out.clone());
            let guard = FailOnPanic(Arc::clone(progress));
            let worker_heartbeat = heartbeat.register(ThreadRole::Worker)?;
            workers.push(threads::spawn(&format!("mocapd-work-{index}"), move || {
                run_worker(&parked, &queue, &worker_heartbeat);
                drop(guard);
            })?);
        }
        let feed = Feed { jobs, wakes: wakes.clone(), plan: plan.clone(), next_stretch: 0 };
        Ok((Self { workers, wakes }, feed))
    }

    pub(super) fn wakes(&self) -> WakeQueue {
        self.wakes.clone()
    }

    /// Ends the workers after the jobs that are queued.
    pub(super) fn stop(self) {
        for _ in &self.workers {
            self.wakes.queue.send(None).ok();
        }
        for worker in self.workers {
            // A panic was already reported through `PipelineProgress::failed`.
            drop(worker.join());
        }
    }
}

fn run_worker(
    parked: &[ParkedGroup],
    queue: &Receiver<Option<usize>>,
    heartbeat: &HeartbeatHandle,
) {
    let next = || {
        heartbeat.idle();
        queue.recv()
    };
    while let Ok(Some(index)) = next() {
        let place = &parked[index];
        // A swap, not a store: a thread that found the flag set had sent its job before, and that job must be
        // visible below. A plain store could move past the check of the jobs, and the wake-up would be lost.
        place.woken.swap(false, Ordering::AcqRel);
        while let Ok(mut group) = place.unpark.try_recv() {
            group.run_jobs(heartbeat);
            drop(place.park.try_send(group));
            if !place.has_work() {
                break;
            }
        }
    }
}

/// Marks the pipeline as failed when a thread panics: a panicking worker loses its group, a panicking writer loses
/// the file, so the recording must stop.
#[derive(Debug)]
pub(super) struct FailOnPanic(pub(super) Arc<PipelineProgress>);

impl Drop for FailOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Relaxed);
        }
    }
}

/// Channels or the timeline, with all buffers preallocated.
#[derive(Debug)]
pub(super) struct Group {
    index: usize,
    coder: GroupCoder,
    pub(super) jobs: Receiver<EncodeJob>,
    pub(super) jobs_in: Sender<EncodeJob>,
    parts: Sender<WriterInput>,
    /// Free buffers; the writer returns them.
    pub(super) buffers: Receiver<PartBuffer>,
    pub(super) buffers_back: Sender<PartBuffer>,
}

#[derive(Debug)]
enum GroupCoder {
    Channels(Box<ChannelCoder>),
    Timeline(Box<TimelineCoder>),
}

/// One stretch of the group's channels, and their block.
#[derive(Debug)]
struct ChannelCoder {
    first_slot: usize,
    slots: Vec<ChannelBuffer>,
    encoder: Box<dyn BlockEncoder>,
    samples: Vec<Sample>,
    block: Vec<u8>,
    /// Visibility counters, if requested, by slot across all groups.
    visibility: Option<VisibilityCounters>,
}

#[derive(Debug)]
struct ChannelBuffer {
    ring: RingConsumer<Sample>,
    positions: Vec<Position>,
    present: Vec<bool>,
}

impl Group {
    /// Group `index` of the plan, and the reader's ends of its rings.
    pub(super) fn channels(
        plan: &Plan,
        index: usize,
        visibility: Option<VisibilityCounters>,
        parts: &Sender<WriterInput>,
    ) -> (Self, Vec<RingProducer<Sample>>) {
        let rows = plan.stretch_rows as usize;
        let n_slots = plan.slots_of(index).len();
        let mut producers = Vec::with_capacity(n_slots);
        let slots = (0..n_slots).map(|_| {
            let (producer, ring) = ring(plan.ring_rows);
            producers.push(producer);
            let (positions, present) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
            ChannelBuffer { ring, positions, present }
        });
        let mut encoder = plan.codec.encoder();
        encoder.prepare(n_slots, rows);
        let coder = GroupCoder::Channels(Box::new(ChannelCoder {
            first_slot: plan.slots_of(index).start,
            slots: slots.collect(),
            encoder,
            samples: vec![Sample::default(); rows],
            block: Vec::with_capacity(plan.part_bytes_max(index)),
            visibility,
        }));
        (Self::new(plan, index, coder, plan.part_bytes_max(index), parts), producers)
    }

    /// The timeline's group, and the reader's end of its ring.
    pub(super) fn timeline(
        plan: &Plan,
        header: &Header,
        parts: &Sender<WriterInput>,
    ) -> (Self, RingProducer<TimelineItem>) {
        let (producer, consumer) = ring(plan.timeline_items());
        let coder = TimelineCoder::new(consumer, header, plan.timeline_items());
        let coder = GroupCoder::Timeline(Box::new(coder));
        (Self::new(plan, plan.n_groups(), coder, plan.header_bytes_max(), parts), producer)
    }

    fn new(
        plan: &Plan,
        index: usize,
        coder: GroupCoder,
        part_bytes: usize,
        parts: &Sender<WriterInput>,
    ) -> Self {
        let (jobs_in, jobs) = bounded(plan.spans_max());
        let (buffers_back, buffers) = bounded(plan.buffers_per_group());
        let (n_slots, n_rows) = match coder {
            GroupCoder::Channels(_) => (plan.slots_of(index).len(), plan.stretch_rows as usize),
            GroupCoder::Timeline(_) => (0, 0),
        };
        for _ in 0..plan.buffers_per_group() {
            let bytes = Vec::with_capacity(part_bytes);
            let tally = BlockTally::with_capacity(n_slots, n_rows);
            drop(buffers_back.try_send(PartBuffer { bytes, tally }));
        }
        Self { index, coder, jobs, jobs_in, parts: parts.clone(), buffers, buffers_back }
    }

    /// Does every job for which there is a buffer.
    fn run_jobs(&mut self, heartbeat: &HeartbeatHandle) {
        while !self.jobs.is_empty() {
            heartbeat.beat();
            let Ok(mut buffer) = self.buffers.try_recv() else { return };
            let Ok(job) = self.jobs.try_recv() else {
                drop(self.buffers_back.try_send(buffer));
                return;
            };
            buffer.clear();
            let report = match &mut self.coder {
                GroupCoder::Channels(channels) => channels.encode(&job.end, &mut buffer),
                GroupCoder::Timeline(coder) => {
                    coder.encode(&job.end, &mut buffer.bytes);
                    PartReport::default()
                }
            };
            let (stretch, end, counts) = (job.stretch, job.end, job.counts);
            let part = Part { stretch, end, group: self.index, buffer, report, counts };
            // Never full: it has a place for every buffer there is. Closed when the writer is gone.
            if self.parts.try_send(WriterInput::Part(part)).is_err() {
                return;
            }
        }
    }
}

impl ChannelCoder {
    /// Encodes the active channels as one block.
    fn encode(&mut self, end: &StretchEnd, out: &mut PartBuffer) -> PartReport {
        let n_rows = end.span.n_rows as usize;
        let n_channels = end.n_channels.saturating_sub(self.first_slot).min(self.slots.len());
        if n_rows == 0 || n_channels == 0 {
            return PartReport::default();
        }
        for slot in &mut self.slots[..n_channels] {
            let n = slot.ring.pop_slice(&mut self.samples[..n_rows]);
            debug_assert_eq!(n, n_rows, "a closed stretch is in its rings");
            slot.positions.clear();
            slot.present.clear();
            slot.positions.extend(self.samples[..n_rows].iter().map(|s| s.position_mm));
            slot.present.extend(self.samples[..n_rows].iter().map(|s| s.present));
        }
        if let Some(VisibilityCounters(counts)) = &self.visibility {
            let counts = &counts[self.first_slot..];
            let slots = self.slots[..n_channels].iter();
            slots.zip(counts).for_each(|(slot, counts)| counts.count(&slot.present));
        }
        self.block.clear();
        let key = end.span.key;
        let report = self.encode_rows(n_channels, key, &mut out.tally).unwrap_or_else(|_| {
            // The decoder will see a stretch without samples, and the encoder's state must match.
            self.block.clear();
            self.slots[..n_channels].iter_mut().for_each(|slot| slot.present.fill(false));
            drop(self.encode_rows(n_channels, key, &mut out.tally));
            PartReport { refused: 1, ..PartReport::default() }
        });
        put_block(&self.block, end.n_channels <= GROUP_CHANNELS, &mut out.bytes);
        report
    }

    fn encode_rows(
        &mut self,
        n_channels: usize,
        key: bool,
        tally: &mut BlockTally,
    ) -> Result<PartReport, CodecError> {
        let mut rows = [Rows::default(); GROUP_CHANNELS];
        for (rows, slot) in rows.iter_mut().zip(&self.slots[..n_channels]) {
            *rows = Rows::new(&slot.positions, &slot.present)?;
        }
        let mut reports = [BlockReport::default(); GROUP_CHANNELS];
        let (rows, reports) = (&rows[..n_channels], &mut reports[..n_channels]);
        self.encoder.encode(rows, &[], key, &mut self.block, reports)?;
        tally.restart(rows.first().map_or(0, Rows::len));
        tally.add_encoded(&self.block, rows, reports, self.encoder.kept_rows());
        let mut report = PartReport::default();
        reports.iter().for_each(|channel| report.add_channel(channel));
        Ok(report)
    }
}

/// Encodes the timeline's items up to the end of a stretch.
#[derive(Debug)]
struct TimelineCoder {
    ring: RingConsumer<TimelineItem>,
    timeline: Timeline,
    next_row: u64,
    header_writer: StretchHeaderWriter,
}

impl TimelineCoder {
    pub(super) fn new(ring: RingConsumer<TimelineItem>, header: &Header, items_max: usize) -> Self {
        // As for a reader, which has only the header.
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz);
        let mut times = TimelineEncoder::new(tick_hz, header.rate_hz);
        times.reserve(items_max);
        let mut timeline = Timeline::default();
        timeline.runs.reserve(items_max);
        timeline.times.reserve(items_max);
        let header_writer = StretchHeaderWriter::with_times(header.stretch_rows, times);
        Self { ring, timeline, next_row: 0, header_writer }
    }

    /// Writes nothing when no row was recorded or lost since the last stretch.
    pub(super) fn encode(&mut self, end: &StretchEnd, out: &mut Vec<u8>) {
        let end_row = end.span.end_row();
        self.timeline.restart(self.next_row);
        while self.next_row < end_row {
            let Some(item) = self.ring.pop() else { break };
            match item {
                TimelineItem::Recorded(time) => {
                    self.timeline.push(time);
                    self.next_row += 1;
                }
                TimelineItem::Lost { rows, causes } => {
                    self.timeline.push_lost(rows, causes);
                    self.next_row += rows;
                }
            }
        }
        if self.timeline.n_rows() > 0 {
            let alone = end.n_channels <= GROUP_CHANNELS;
            self.header_writer.put(end.span, &self.timeline, &[], alone, out);
        }
    }
}

/// Visibility counters of all channels, by slot.
#[derive(Debug, Clone, Default)]
pub struct VisibilityCounters(pub(super) Arc<[VisibilityCounts]>);

/// Visibility counters of one channel, in rows of the encoded stretches.
#[derive(Debug, Default)]
pub(super) struct VisibilityCounts {
    rows: AtomicU64,
    present: AtomicU64,
    gaps: AtomicU64,
    longest_gap: AtomicU64,
    /// Rows of the current gap. Used only by the worker that holds the group.
    open_gap: AtomicU64,
}

/// Visibility of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Visibility {
    /// Rows since the channel exists; lost frames count as not visible.
    pub rows: u64,
    /// Rows with a position.
    pub present: u64,
    /// Times that the marker disappeared.
    pub gaps: u64,
    /// Rows of the longest gap.
    pub longest_gap: u64,
}

impl VisibilityCounters {
    pub(super) fn new(n_slots: usize) -> Self {
        Self((0..n_slots).map(|_| VisibilityCounts::default()).collect())
    }

    /// The visibility of the channel in `slot`.
    #[must_use]
    pub fn get(&self, slot: usize) -> Option<Visibility> {
        let channel = self.0.get(slot)?;
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        Some(Visibility {
            rows: get(&channel.rows),
            present: get(&channel.present),
            gaps: get(&channel.gaps),
            longest_gap: get(&channel.longest_gap),
        })
    }
}

impl VisibilityCounts {
    /// Adds one stretch.
    pub(super) fn count(&self, present: &[bool]) {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        let (mut open, mut gaps, mut longest) =
            (get(&self.open_gap), get(&self.gaps), get(&self.longest_gap));
        let mut n_present = 0;
        for &present in present {
            if present {
                n_present += 1;
                open = 0;
            } else {
                gaps += u64::from(open == 0);
                open += 1;
                longest = longest.max(open);
            }
        }
        let put = |n: &AtomicU64, value| n.store(value, Ordering::Relaxed);
        put(&self.rows, get(&self.rows) + present.len() as u64);
        put(&self.present, get(&self.present) + n_present);
        put(&self.gaps, gaps);
        put(&self.longest_gap, longest);
        put(&self.open_gap, open);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_continue_from_stretch_to_stretch() {
        let counters = VisibilityCounters::new(1);
        counters.0[0].count(&[true, false, false]);
        counters.0[0].count(&[false, true, true, false]);
        let expected = Visibility { rows: 7, present: 3, gaps: 2, longest_gap: 3 };
        assert_eq!(counters.get(0), Some(expected));
        assert_eq!(counters.get(1), None);
    }
}
