//! The reader's end: a frame goes into every ring, or into none and onto the account.

mod axis;
mod clock;
mod pending;

use std::sync::{Arc, atomic::Ordering};

use crossbeam_channel::Sender;
use mocapd_drivers::device::{Frame, LinkCounters, MarkerInfo, Status};
use mocapd_take::{
    record::Event,
    stretch::Span,
    timeline::{Causes, RowTime},
};

use self::{
    axis::{Axis, Step},
    clock::ClockLine,
    pending::Pending,
};
use super::{
    Counts, PipelineConfig, Progress,
    plan::Plan,
    pool::{Feed, StretchEnd},
    ring::{RingIn, Sample, TimelineItem},
    writer::{Control, NewChannel},
};

/// No slot: the channel pool was used up when the marker appeared.
const NO_SLOT: u32 = u32::MAX;

/// Takes frames in. Belongs to the one thread that reads the device.
#[derive(Debug)]
pub struct Intake {
    rings: Vec<RingIn<Sample>>,
    timeline: RingIn<TimelineItem>,
    feed: Feed,
    control: Sender<Control>,
    progress: Arc<Progress>,
    /// By marker id; `NO_SLOT` where none.
    slot_of_id: Vec<u32>,
    /// By slot, as announced.
    labels: Vec<String>,
    n_channels: usize,
    /// The row being put together, by slot.
    row: Vec<Sample>,
    /// Rows that every active ring is known to have room for.
    room: usize,
    axis: Axis,
    pending: Pending,
    next_row: u64,
    open_first_row: u64,
    open_rows: u32,
    open_limit: u32,
    stretch_rows: u32,
    key_rows: u64,
    next_key_row: u64,
    counts: Counts,
    clock: ClockLine,
}

impl Intake {
    pub(super) fn new(
        config: &PipelineConfig,
        plan: &Plan,
        rings: Vec<RingIn<Sample>>,
        timeline: RingIn<TimelineItem>,
        feed: Feed,
        control: Sender<Control>,
        progress: Arc<Progress>,
    ) -> Self {
        let mut slot_of_id = vec![NO_SLOT; usize::from(u16::MAX) + 1];
        for (slot, channel) in config.channels.iter().enumerate() {
            slot_of_id[usize::from(channel.marker_id)] = slot as u32;
        }
        let mut labels: Vec<String> = config.channels.iter().map(|c| c.label.clone()).collect();
        labels.reserve(config.reserve);
        Self {
            rings,
            timeline,
            feed,
            control,
            progress,
            slot_of_id,
            labels,
            n_channels: config.channels.len(),
            row: vec![Sample::default(); plan.n_slots],
            room: 0,
            axis: Axis::default(),
            pending: Pending::default(),
            next_row: 0,
            open_first_row: 0,
            open_rows: 0,
            open_limit: plan.first_stretch_rows,
            stretch_rows: plan.stretch_rows,
            key_rows: plan.key_rows,
            next_key_row: 0,
            counts: Counts::default(),
            clock: ClockLine::new(config.tick_hz),
        }
    }

    /// One frame, at the host's monotonic time of its last byte.
    pub fn frame(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        match self.axis.step(frame.seq, frame.device_ticks) {
            Step::Next { missing } => {
                self.counts.not_received += u64::from(missing);
                self.pending.add(u64::from(missing), Causes::NOT_RECEIVED);
            }
            Step::Again => {
                self.counts.duplicates += 1;
                return;
            }
            Step::Jump => self.counts.counter_jumps += 1,
        }
        self.fill_row(frame);
        self.make_way();
        if !self.has_room() {
            self.counts.ring_full += 1;
            self.pending.add(1, Causes::RING_FULL);
            self.row.fill(Sample::default());
            self.progress
                .lost
                .store(self.counts.not_received + self.counts.ring_full, Ordering::Relaxed);
            return;
        }
        self.push_row(RowTime {
            device_ticks: frame.device_ticks,
            arrival_10us: arrival_ns / 10_000,
            timecode: frame.timecode,
        });
        self.clock.add(frame.device_ticks, arrival_ns);
        if self.open_rows >= self.open_limit {
            self.close_stretch();
        }
    }

    /// Markers of the device's table that are not channels yet become channels, while the pool lasts.
    pub fn announce(&mut self, markers: &[MarkerInfo]) {
        for marker in markers {
            let slot = self.slot_of_id[usize::from(marker.id)];
            let known = self.labels.get(slot as usize);
            if known.is_none_or(|label| marker.labelled && *label != marker.label) {
                self.open_channel(marker.id, Some((&marker.label, marker.labelled)));
            }
        }
    }

    /// Something to note at the row being recorded.
    pub fn event(&mut self, mut event: Event) {
        event.row = self.next_row;
        // The queue is full only when the disk has stalled through a thousand events.
        self.counts.events_dropped +=
            u64::from(self.control.try_send(Control::Event(event)).is_err());
    }

    /// The device's report on itself.
    pub fn status(&mut self, status: Status, last: bool) {
        self.counts.status = Some(status);
        self.counts.ended |= last;
    }

    /// What the link decoder counted so far.
    pub fn link(&mut self, link: LinkCounters) {
        self.counts.link = link;
    }

    /// The counters now.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let mut counts = self.counts;
        counts.clock = self.clock.fit();
        counts
    }

    /// Frames in the rings so far.
    #[must_use]
    pub fn counts_recorded(&self) -> u64 {
        self.counts.recorded
    }

    /// Whether the next frame would find a ring full: for sources that can wait.
    #[must_use]
    pub fn is_full(&mut self) -> bool {
        !self.has_room()
    }

    /// The row that the next frame gets.
    #[must_use]
    pub fn next_row(&self) -> u64 {
        self.next_row
    }

    /// Whether the writer or a worker failed: nothing taken in from now on reaches the disk.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.progress.failed.load(Ordering::Relaxed)
    }

    /// No more frames: what is open is closed, and the take ends with the ledger.
    pub fn finish(mut self) -> Counts {
        if self.counts.ended {
            let produced = self.counts.status.map_or(0, |status| status.frames_produced);
            let seen = self.counts.recorded + self.counts.not_received + self.counts.ring_full;
            self.pending.add(produced.saturating_sub(seen), Causes::NOT_RECEIVED);
        }
        self.close_stretch();
        self.push_pending();
        let counts = self.counts();
        self.end_stretch(0, true);
        counts
    }

    /// The frame's markers by slot.
    fn fill_row(&mut self, frame: &Frame<'_>) {
        for marker in frame.markers {
            let mut slot = self.slot_of_id[usize::from(marker.id)];
            if slot == NO_SLOT {
                self.open_channel(marker.id, None);
                slot = self.slot_of_id[usize::from(marker.id)];
            }
            let Some(sample) = self.row.get_mut(slot as usize) else {
                self.counts.markers_dropped += 1;
                continue;
            };
            let finite = marker.position_mm.iter().all(|v| v.is_finite());
            self.counts.samples_not_finite += u64::from(!finite && !marker.occluded);
            *sample =
                Sample { position_mm: marker.position_mm, present: finite && !marker.occluded };
        }
    }

    /// A channel that was not there before begins with a stretch of its own.
    fn open_channel(&mut self, id: u16, named: Option<(&str, bool)>) {
        if self.n_channels >= self.row.len() {
            return;
        }
        self.close_stretch();
        let channel = NewChannel {
            stretch: self.feed.next_stretch(),
            slot: self.n_channels,
            marker_id: id,
            named: named.map(|(label, labelled)| (label.to_owned(), labelled)),
        };
        if self.control.try_send(Control::Channel(channel)).is_err() {
            return;
        }
        self.labels.push(named.map(|(label, _)| label.to_owned()).unwrap_or_default());
        self.slot_of_id[usize::from(id)] = self.n_channels as u32;
        self.n_channels += 1;
        self.room = 0;
    }

    /// Closes the open stretch when the rows lost before this frame do not fit into it.
    fn make_way(&mut self) {
        let left = u64::from(self.open_limit - self.open_rows);
        if self.open_rows > 0 && self.pending.rows() >= left {
            self.close_stretch();
        }
    }

    /// Whether this frame, and the lost rows before it that belong into the open stretch, fit.
    fn has_room(&mut self) -> bool {
        let rows = 1 + if self.open_rows > 0 { self.pending.rows() as usize } else { 0 };
        if self.room < rows {
            let active = &self.rings[..self.n_channels];
            self.room = active.iter().map(RingIn::room).min().unwrap_or(usize::MAX);
        }
        self.room >= rows && self.timeline.room() > self.pending.len() + 1
    }

    fn push_row(&mut self, time: RowTime) {
        if self.open_rows > 0 {
            for _ in 0..self.pending.rows() {
                self.push_samples(|_| Sample::default());
                self.open_rows += 1;
            }
        }
        self.push_pending();
        if self.open_rows == 0 {
            self.open_first_row = self.next_row;
        }
        let mut present = 0;
        self.push_samples(|sample| {
            present += u64::from(sample.present);
            std::mem::take(sample)
        });
        self.timeline.push(TimelineItem::Recorded(time));
        self.open_rows += 1;
        self.next_row += 1;
        self.counts.recorded += 1;
        self.counts.samples_announced += self.n_channels as u64;
        self.counts.samples_present += present;
        self.progress.frames.store(self.counts.recorded, Ordering::Relaxed);
    }

    fn push_samples(&mut self, mut take: impl FnMut(&mut Sample) -> Sample) {
        for (ring, sample) in self.rings[..self.n_channels].iter_mut().zip(&mut self.row) {
            ring.push(take(sample));
        }
        self.room = self.room.saturating_sub(1);
    }

    fn push_pending(&mut self) {
        self.next_row += self.pending.rows();
        for (rows, causes) in self.pending.drain() {
            self.timeline.push(TimelineItem::Lost { rows, causes });
        }
        self.progress
            .lost
            .store(self.counts.not_received + self.counts.ring_full, Ordering::Relaxed);
    }

    fn close_stretch(&mut self) {
        if self.open_rows > 0 {
            self.end_stretch(self.open_rows, false);
            self.open_rows = 0;
            self.open_limit = self.stretch_rows;
        }
    }

    fn end_stretch(&mut self, n_rows: u32, last: bool) {
        let first_row = if n_rows > 0 { self.open_first_row } else { self.next_row };
        let key = first_row >= self.next_key_row;
        if key {
            self.next_key_row = first_row + self.key_rows;
        }
        let end =
            StretchEnd { span: Span { first_row, n_rows, key }, n_channels: self.n_channels, last };
        if !self.feed.end_stretch(end, self.counts()) {
            self.progress.failed.store(true, Ordering::Relaxed);
        }
    }
}
