//! A group of channels, or the time line: rings in, one part a stretch out.

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_codec::{BlockEncoder, Position, Rows};
use mocapd_take::{record::Header, stretch::put_block};

use super::{
    messages::{Job, Part, PartReport, StretchEnd},
    plan::Plan,
    ring::{RingIn, RingOut, Sample, TimelineItem, ring},
    timeline::TimelineCoder,
};

/// Channels or time line, with everything needed to work without allocating.
#[derive(Debug)]
pub(super) struct Group {
    index: usize,
    content: Content,
    jobs: Option<(Receiver<Job>, Sender<Part>)>,
    buffers: Receiver<Vec<u8>>,
    buffers_back: Sender<Vec<u8>>,
}

#[derive(Debug)]
enum Content {
    Channels(Vec<Slot>, Scratch),
    Timeline(Box<TimelineCoder>),
}

#[derive(Debug)]
struct Slot {
    ring: RingOut<Sample>,
    encoder: Box<dyn BlockEncoder>,
}

/// One stretch of one channel, and its block.
#[derive(Debug)]
struct Scratch {
    first_slot: usize,
    samples: Vec<Sample>,
    positions: Vec<Position>,
    present: Vec<bool>,
    block: Vec<u8>,
}

impl Group {
    /// Group `index` of the plan, and the reader's ends of its rings.
    pub(super) fn channels(plan: &Plan, index: usize) -> (Self, Vec<RingIn<Sample>>) {
        let first_slot = index * plan.group_slots;
        let n_slots = plan.group_slots.min(plan.n_slots - first_slot);
        let mut producers = Vec::with_capacity(n_slots);
        let slots = (0..n_slots)
            .map(|_| {
                let (producer, consumer) = ring(plan.ring_rows());
                producers.push(producer);
                let mut encoder = plan.codec.encoder();
                encoder.prepare(plan.stretch_rows as usize);
                Slot { ring: consumer, encoder }
            })
            .collect();
        let rows = plan.stretch_rows as usize;
        let scratch = Scratch {
            first_slot,
            samples: vec![Sample::default(); rows],
            positions: Vec::with_capacity(rows),
            present: Vec::with_capacity(rows),
            block: Vec::with_capacity(plan.block_bytes_max()),
        };
        let content = Content::Channels(slots, scratch);
        (Self::new(plan, index, content, plan.part_bytes_max()), producers)
    }

    /// The time line's group, and the reader's end of its ring.
    pub(super) fn timeline(plan: &Plan, header: &Header) -> (Self, RingIn<TimelineItem>) {
        let (producer, consumer) = ring(plan.timeline_items());
        let coder = TimelineCoder::new(consumer, header, plan.timeline_items());
        let content = Content::Timeline(Box::new(coder));
        (Self::new(plan, plan.n_groups(), content, plan.front_bytes_max()), producer)
    }

    fn new(plan: &Plan, index: usize, content: Content, part_bytes: usize) -> Self {
        let (buffers_back, buffers) = bounded(plan.buffers_per_group());
        for _ in 0..plan.buffers_per_group() {
            drop(buffers_back.try_send(Vec::with_capacity(part_bytes)));
        }
        Self { index, content, jobs: None, buffers, buffers_back }
    }

    /// Where its jobs come from and its parts go. Gives a view of its free buffers.
    pub(super) fn connect(
        &mut self,
        jobs: Receiver<Job>,
        parts: Sender<Part>,
    ) -> Receiver<Vec<u8>> {
        self.jobs = Some((jobs, parts));
        self.buffers.clone()
    }

    /// Where the writer gives its buffers back.
    pub(super) fn buffers_back(&self) -> Sender<Vec<u8>> {
        self.buffers_back.clone()
    }

    /// Does every job for which there is a buffer.
    pub(super) fn work_off(&mut self) {
        let Some((jobs, parts)) = &self.jobs else { return };
        while !jobs.is_empty() {
            let Ok(mut bytes) = self.buffers.try_recv() else { return };
            let Ok(job) = jobs.try_recv() else {
                drop(self.buffers_back.try_send(bytes));
                return;
            };
            bytes.clear();
            let report = match &mut self.content {
                Content::Channels(slots, scratch) => scratch.encode(slots, &job.end, &mut bytes),
                Content::Timeline(coder) => {
                    coder.encode(&job.end, &mut bytes);
                    PartReport::default()
                }
            };
            let (stretch, end, counts) = (job.stretch, job.end, job.counts);
            let part = Part { stretch, end, group: self.index, bytes, report, counts };
            // Never full: it has room for every buffer there is. Closed when the writer is gone.
            if parts.try_send(part).is_err() {
                return;
            }
        }
    }
}

impl Scratch {
    /// One block for each active channel.
    fn encode(&mut self, slots: &mut [Slot], end: &StretchEnd, out: &mut Vec<u8>) -> PartReport {
        let mut report = PartReport::default();
        let n_rows = end.span.n_rows as usize;
        if n_rows == 0 {
            return report;
        }
        let active = end.n_channels.saturating_sub(self.first_slot);
        for slot in slots.iter_mut().take(active) {
            let n = slot.ring.pop_slice(&mut self.samples[..n_rows]);
            debug_assert_eq!(n, n_rows, "a closed stretch is in its rings");
            self.positions.clear();
            self.present.clear();
            self.positions.extend(self.samples[..n_rows].iter().map(|s| s.position_mm));
            self.present.extend(self.samples[..n_rows].iter().map(|s| s.present));
            self.block.clear();
            let coded = Rows::new(&self.positions, &self.present)
                .and_then(|rows| slot.encoder.encode(rows, &[], end.span.key, &mut self.block));
            match coded {
                Ok(block) => {
                    report.samples += u64::from(block.samples);
                    report.kept += u64::from(block.kept);
                    report.max_error_mm = report.max_error_mm.max(block.max_error_mm);
                    report.recoded += u64::from(block.recoded);
                }
                Err(_) => {
                    self.block.clear();
                    report.refused += 1;
                }
            }
            put_block(&self.block, end.n_channels == 1, out);
        }
        report
    }
}
