//! The intake: the reader puts each frame into every ring, or counts it as lost.

mod clock;
mod losses;
mod rows;

use std::sync::{Arc, atomic::Ordering};

use mocapd_drivers::{
    axis::FrameCounter,
    device::{Frame, LinkCounters, MarkerInfo, SampleBatch, SampledGroupInfo, Status},
};
use mocapd_take::{
    record::{EndingKind, Event, EventKind, TakeEnding},
    timeline::{LossCauses, RowTime},
};

use self::{
    clock::ClockTracker,
    losses::{PendingLoss, SilenceMonitor},
    rows::PoseStep,
};
use super::{
    Counts, PipelineConfig, PipelineProgress, SplitAt,
    messages::{CommandReceiver, Control, FrameTimes, TAKE_COMMANDS_MAX, TakeCommand, ToWriter},
    plan::Plan,
    pool::Feed,
    publish_tap::{FramePlace, PublishTapSender},
    ring::{PreviewFrame, PreviewSender, RingProducer, Sample, TimelineItem},
    sampled::{BatchOutcome, SampledIntake},
    writer::splitting::SplitSchedule,
};
use crate::{
    host_clock::LatencyHistogram,
    threads::{HeartbeatHandle, ThreadRole},
};

/// No slot: the channel pool was exhausted when the marker appeared.
const NO_SLOT: u32 = u32::MAX;

/// Accepts frames. Belongs to the one thread that reads the device.
#[derive(Debug)]
pub struct Intake {
    rings: Vec<RingProducer<Sample>>,
    timeline: RingProducer<TimelineItem>,
    feed: Feed,
    to_writer: ToWriter,
    progress: Arc<PipelineProgress>,
    heartbeat: HeartbeatHandle,
    /// Slot of each marker id; `NO_SLOT` if it has none.
    slot_of_id: Vec<u32>,
    /// Label of each slot, as announced.
    labels: Vec<String>,
    /// Markers announced since the last frame.
    announced: Vec<MarkerInfo>,
    n_channels: usize,
    /// The samples of the current row, by slot.
    row: Vec<Sample>,
    /// Rows that are known to fit into every active ring.
    rows_free: usize,
    rate_hz: f64,
    counter: FrameCounter,
    silence: SilenceMonitor,
    pending: PendingLoss,
    next_row: u64,
    open_first_row: u64,
    open_rows: u32,
    open_limit: u32,
    stretch_rows: u32,
    first_stretch_rows: u32,
    key_rows: u64,
    /// Rows between keys without a take: a pre-roll begins with a key.
    armed_key_rows: u64,
    /// Rows between keys at present.
    key_every: u64,
    next_key_row: u64,
    splits: SplitSchedule,
    /// The row at which the open take ends by itself.
    take_end_row: Option<u64>,
    /// Arrival of the open stretch's first row, in host nanoseconds, and the longest time it may stay open.
    open_since_ns: u64,
    open_ns_max: u64,
    /// When blocks of samples last ended without a stretch.
    blocks_since_ns: u64,
    /// The open stretch's first recorded row, and the arrival of its last.
    open_first: FrameTimes,
    last_arrival_ns: u64,
    counts: Counts,
    clocks: ClockTracker,
    is_away: bool,
    /// Whether the device is back after an outage, and its first frame has not arrived.
    rejoining: bool,
    /// A take that begins with that frame, so that it does not contain the absence of the device before it.
    deferred_begin: Option<TakeCommand>,
    /// Rows of the present absence that ended takes already contain.
    rows_away: u64,
    /// The host's monotonic time at the last call.
    now_ns: u64,
    /// When the device was asked to stop, or should have been: no frames are due afterwards.
    due_until_ns: Option<u64>,
    finished: bool,
    commands: CommandReceiver,
    tap: PreviewSender,
    /// For publishers.
    publish: Vec<PublishTapSender>,
    samples: SampledIntake,
    pose_step: PoseStep,
    /// Announcements of sampled channels that were reported.
    groups_reported: u32,
}

/// Announcements of other sampled channels that get an event: a device that repeats them must not fill the take.
const GROUPS_REPORTED_MAX: u32 = 32;

/// Maximum number of frames that a device can have produced beyond those seen: a day and more at 10 kHz. A larger
/// number is a contradiction, not loss.
const UNSEEN_MAX: u64 = 1 << 30;

/// The reader's ends of the queues that it shares with other threads.
pub(super) struct ReaderEndpoints {
    pub(super) rings: Vec<RingProducer<Sample>>,
    pub(super) timeline: RingProducer<TimelineItem>,
    pub(super) feed: Feed,
    pub(super) to_writer: ToWriter,
    pub(super) commands: CommandReceiver,
    pub(super) tap: PreviewSender,
    pub(super) publish: Vec<PublishTapSender>,
    pub(super) samples: SampledIntake,
    pub(super) progress: Arc<PipelineProgress>,
}

impl Intake {
    pub(super) fn new(
        config: &PipelineConfig,
        plan: &Plan,
        ends: ReaderEndpoints,
    ) -> anyhow::Result<Self> {
        let ReaderEndpoints {
            rings,
            timeline,
            feed,
            to_writer,
            commands,
            tap,
            publish,
            samples,
            progress,
        } = ends;
        let mut slot_of_id = vec![NO_SLOT; usize::from(u16::MAX) + 1];
        for (slot, channel) in config.channels.iter().enumerate() {
            slot_of_id[usize::from(channel.marker_id)] = slot as u32;
        }
        let mut labels: Vec<String> = config.channels.iter().map(|c| c.label.clone()).collect();
        labels.reserve(config.reserve);
        Ok(Self {
            rings,
            timeline,
            feed,
            progress,
            heartbeat: config.heartbeat.register(ThreadRole::Reader)?,
            slot_of_id,
            labels,
            announced: Vec::new(),
            n_channels: config.channels.len(),
            row: vec![Sample::default(); plan.n_slots],
            rows_free: 0,
            rate_hz: config.rate_hz,
            counter: FrameCounter::new(config.rate_hz, config.tick_hz),
            silence: SilenceMonitor::new(config.rate_hz),
            pending: PendingLoss::default(),
            next_row: 0,
            open_first_row: 0,
            open_rows: 0,
            open_limit: plan.first_stretch_rows,
            stretch_rows: plan.stretch_rows,
            first_stretch_rows: plan.first_stretch_rows,
            key_rows: plan.key_rows,
            armed_key_rows: plan.armed_key_rows,
            key_every: if plan.pre_roll.is_some() { plan.armed_key_rows } else { plan.key_rows },
            next_key_row: 0,
            splits: SplitSchedule::Never,
            take_end_row: None,
            open_since_ns: 0,
            blocks_since_ns: 0,
            open_ns_max: config.stretch.as_nanos() as u64,
            open_first: FrameTimes::default(),
            last_arrival_ns: 0,
            counts: Counts::default(),
            clocks: ClockTracker::new(config.tick_hz, to_writer.clock.clone()),
            to_writer,
            is_away: false,
            rejoining: false,
            deferred_begin: None,
            rows_away: 0,
            now_ns: 0,
            due_until_ns: None,
            finished: false,
            commands,
            tap,
            publish,
            samples,
            pose_step: PoseStep::new(config.recorded_bodies().len()),
            groups_reported: 0,
        })
    }

    /// Divides the recording into takes, from its first frame on.
    pub(super) fn split_at(&mut self, at: SplitAt) {
        self.splits = SplitSchedule::new(at);
    }

    /// Accepts a frame; `arrival_ns` is the host's monotonic time of its last byte.
    pub fn frame(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        self.now_ns = arrival_ns;
        self.flush_poses_before(frame.seq);
        if !self.announced.is_empty() {
            self.bind_announced();
        }
        self.execute_commands(arrival_ns);
        let rejoins = self.rejoining;
        // Those frames arrived before the absence was reported.
        if !rejoins && let Some(begin) = self.deferred_begin.take() {
            self.cut(begin, arrival_ns);
        }
        if rejoins {
            self.end_outage(frame, arrival_ns);
            self.split_after_outage(arrival_ns);
        } else if !self.count_frame(frame) {
            return;
        }
        let Frame { device_ticks, timecode, .. } = *frame;
        self.end_silence(device_ticks, arrival_ns, rejoins);
        // No frame is dropped because of its timestamp; but no line fits both sides of a jump.
        let event = self.clocks.frame(device_ticks, arrival_ns);
        self.clock_events(event, device_ticks, arrival_ns);
        self.fill_row(frame);
        let (row, n_channels) = (self.next_row + self.pending.rows(), self.n_channels);
        let head = PreviewFrame { row, device_ticks, arrival_ns, n_channels, is_displayed: false };
        self.tap.offer(frame.seq, head, &self.row[..n_channels]);
        let place = FramePlace { seq: frame.seq, row, device_ticks, arrival_ns };
        for tap in &mut self.publish {
            tap.frame(place, &self.row[..n_channels]);
        }
        self.make_room();
        if !self.has_room() {
            self.counts.ring_full += 1;
            self.pending.add(1, LossCauses::RING_FULL);
            self.row.fill(Sample::default());
            self.progress.lost.store(self.counts.lost(), Ordering::Relaxed);
            return;
        }
        self.split_before_frame();
        self.end_before_frame();
        if self.open_rows == 0 {
            self.open_since_ns = arrival_ns;
            self.open_first = FrameTimes { device_ticks, arrival_ns };
        }
        self.last_arrival_ns = arrival_ns;
        self.progress.last_arrival_ns.store(arrival_ns, Ordering::Relaxed);
        self.push_row(RowTime { device_ticks, arrival_10us: arrival_ns / 10_000, timecode });
        if self.open_rows >= self.open_limit {
            self.close_stretch();
        }
        // The frame was the last one of the take: its end does not wait for the next, but for its poses.
        if !self.flush_poses_of(frame.seq) {
            self.end_before_frame();
        }
    }

    /// Accepts a batch of samples: all of it goes into the ring of its group, or is counted as lost.
    pub fn samples(&mut self, batch: &SampleBatch<'_>) {
        let segment = self.clocks.segment();
        match self.samples.batch(batch, self.feed.next_stretch(), segment) {
            BatchOutcome::Accepted { first } => {
                self.publish.iter_mut().for_each(|tap| tap.batch(first, batch));
            }
            BatchOutcome::Duplicate => {}
            BatchOutcome::Refused => {
                self.count_refused(format_args!("samples of group {}", batch.group));
            }
        }
    }

    /// Counts a batch that is not recorded; the first one is reported.
    fn count_refused(&mut self, what: std::fmt::Arguments<'_>) {
        self.counts.batches_refused += 1;
        if self.counts.batches_refused == 1 {
            let text = format!(
                "{what} were not announced before the start, or do not fit: they are not recorded"
            );
            self.event(Event::new(EventKind::Host, self.now_ns, text));
        }
    }

    /// Reports a group of sampled channels that was not announced before the start, or was announced otherwise. Repeated
    /// announcements of known groups are ignored.
    pub fn announce_group(&mut self, group: &SampledGroupInfo) {
        if !self.samples.announce(group) {
            let (n, id) = (group.channels.len(), group.id);
            self.report_announcement(format_args!("{n} sampled channels as group {id}"));
        }
    }

    fn report_announcement(&mut self, what: std::fmt::Arguments<'_>) {
        if self.groups_reported >= GROUPS_REPORTED_MAX {
            return;
        }
        self.groups_reported += 1;
        let text =
            format!("the device announced {what} during the recording: start again to record them");
        self.event(Event::new(EventKind::Host, self.now_ns, text));
    }

    /// Advances the host's monotonic time, also when nothing arrives: a stretch that stays open because frames come
    /// slowly, or not at all, is closed when its time is up.
    pub fn tick(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
        self.heartbeat.beat();
        if !self.awaits_poses(now_ns) {
            self.end_without_poses();
            self.execute_commands(now_ns);
        }
        if self.open_rows > 0 && now_ns.saturating_sub(self.open_since_ns) > self.open_ns_max {
            self.close_stretch();
        }
        // Without frames no stretch ends the blocks of samples.
        if self.open_rows == 0 && now_ns.saturating_sub(self.blocks_since_ns) > self.open_ns_max {
            self.blocks_since_ns = now_ns;
            self.samples.end_blocks(self.feed.next_stretch(), self.clocks.segment());
        }
    }

    /// Records an event at the current row.
    pub fn event(&mut self, event: Event) {
        self.event_at(self.next_row, event);
    }

    /// Records an event of the device at the row of its device time, if that row is still in the open stretch: the event may
    /// have come later than the frames of its time.
    pub fn device_event(&mut self, event: Event) {
        let back = self.counter.frames_back(event.device_ticks).map_or(0, |back| back + 1);
        let row = self.next_row.saturating_sub(back).max(self.open_first_row.min(self.next_row));
        self.event_at(row, event);
    }

    fn event_at(&mut self, row: u64, event: Event) {
        let event = Event { row, ..event };
        // The queue is full only after the disk stalled through a thousand events.
        let control = (self.feed.next_stretch(), Control::Event(event));
        self.counts.events_dropped += u64::from(self.to_writer.control.try_send(control).is_err());
    }

    /// Executes the commands of other threads.
    fn execute_commands(&mut self, now_ns: u64) {
        if self.commands.is_empty() {
            return;
        }
        while let Some(mark) = self.commands.next_mark() {
            if mark.is_awaited() {
                self.event(mark.event);
                // The requester may be gone.
                mark.row.try_send(self.next_row).ok();
            }
        }
        // Commands stay queued here while the writer's own queue is full.
        while self.to_writer.commands.len() < TAKE_COMMANDS_MAX
            && let Some(command) = self.commands.next_command()
        {
            let is_begin = matches!(command, TakeCommand::Begin(..));
            if is_begin && self.deferred_begin.is_none() && (self.is_away || self.rejoining) {
                self.deferred_begin = Some(command);
            } else {
                self.cut(command, now_ns);
            }
        }
    }

    /// Puts the rows of an outage into a stretch of their own and makes the next one a key: a take that begins after
    /// them has none of them.
    fn split_after_outage(&mut self, now_ns: u64) {
        match self.deferred_begin.take() {
            Some(begin) => self.cut(begin, now_ns),
            // A take that ends in the absence has a part of its rows.
            None if self.splits.is_due(self.next_row + self.pending.rows()) => {}
            None if self.length_is_reached() => {}
            None if self.pending.rows() > 0 => {
                self.close_stretch();
                self.close_pending();
                self.next_key_row = self.next_row;
            }
            None => {}
        }
    }

    /// Closes the open stretch, and passes a command to the writer for the boundary behind it. A short key stretch
    /// follows, so that its content is on disk soon.
    fn cut(&mut self, command: TakeCommand, now_ns: u64) {
        self.close_stretch();
        if !matches!(command, TakeCommand::Begin(..)) {
            self.count_absence(now_ns);
        }
        let is_at_length = matches!(command, TakeCommand::End(EndingKind::Length));
        match self.take_end_row.filter(|_| is_at_length && self.length_is_reached()) {
            // The take ends at its length, even if the reader learned of the end some rows later.
            Some(end_row) => self.close_pending_up_to(end_row),
            None => self.close_pending(),
        }
        let boundary = self.feed.next_stretch();
        // A take that waits for its device begins before this command: an end does not wait.
        for command in self.deferred_begin.take().into_iter().chain([command]) {
            match &command {
                TakeCommand::Begin(take, _) => {
                    // While a take is written, key stretches may be rarer.
                    self.key_every = self.key_rows;
                    let rows = take.length_rows;
                    self.take_end_row = rows.map(|rows| self.next_row.saturating_add(rows));
                }
                TakeCommand::End(_) => {
                    self.key_every = self.armed_key_rows;
                    self.take_end_row = None;
                }
                TakeCommand::Save(..) => {}
            }
            // If the writer is gone, the closed reply channel tells the requester.
            self.to_writer.commands.try_send((boundary, command)).ok();
        }
        self.end_boundary();
        self.next_key_row = self.next_row;
        self.open_limit = self.first_stretch_rows;
    }

    /// Accepts a status report of the device; `last`: its final one after a stop.
    pub fn status(&mut self, status: Status, last: bool) {
        if last && !self.rejoining {
            // The final report settles rows that were due by the host's clock alone.
            let reported = status.frames_produced.saturating_add(self.counts.reports_offset);
            let not_produced = self.counts.seen().saturating_sub(reported).min(self.rows_away);
            self.rows_away -= not_produced;
            self.counts.not_produced(not_produced);
        }
        let is_accounted = self.counts.status(status, self.rejoining);
        if is_accounted && !self.rejoining {
            self.silence.account(self.now_ns);
        }
        self.counts.ended |= last;
    }

    /// Sets the link decoder's counters.
    pub fn set_link_counters(&mut self, link: LinkCounters) {
        self.counts.link = link;
    }

    /// The current counters.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let mut counts = self.counts;
        counts.clock = self.clocks.status();
        counts.pending = self.pending.counted();
        counts
    }

    /// Frames so far, including lost ones.
    #[must_use]
    pub fn frames_seen(&self) -> u64 {
        self.counts.seen()
    }

    /// Whether the next frame might find a ring full, however many are lost before it, or the next batch of samples. For
    /// sources that can wait.
    #[must_use]
    pub fn is_full(&mut self) -> bool {
        // Lost rows beyond the end of the open stretch do not go into the rings.
        let rows = 1 + self.open_limit.saturating_sub(self.open_rows) as usize;
        !self.has_room_for(rows) || self.samples.is_full()
    }

    /// The row of the next frame.
    #[must_use]
    pub fn next_row(&self) -> u64 {
        self.next_row
    }

    /// Whether the writer or a worker has failed: then no further frame reaches the disk.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.progress.failed.load(Ordering::Relaxed)
    }

    /// The live counters.
    pub(crate) fn progress(&self) -> &PipelineProgress {
        &self.progress
    }

    /// Reports that the device was disconnected, or is back.
    pub fn set_away(&mut self, is_away: bool) {
        self.is_away = is_away;
        self.flush_poses();
        self.progress.is_away.store(is_away, Ordering::Relaxed);
        if !is_away {
            self.progress.outages.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Publishes the latency for observers.
    pub(crate) fn publish_latency(&self, latency: &LatencyHistogram) {
        let p99_ns = latency.quantile_ns(0.99);
        self.progress.ring_latency_p99_ns.store(p99_ns, Ordering::Relaxed);
    }

    /// Reports that the device was told to stop at `host_ns`, or should have stopped: later frames are not missing.
    pub fn no_frames_due_after(&mut self, host_ns: u64) {
        self.due_until_ns.get_or_insert(host_ns);
    }

    /// Sets why there will be no more frames, which becomes the ending of an open take.
    pub fn set_ending(&self, ending: TakeEnding) {
        // The first ending counts.
        self.progress.ending.set(ending).ok();
    }

    /// Closes the open stretch, and ends the take with its ledger.
    pub fn finish(mut self) -> Counts {
        self.close_take();
        self.counts()
    }

    fn close_take(&mut self) {
        if std::mem::replace(&mut self.finished, true) {
            return;
        }
        self.flush_poses();
        self.clocks.close();
        self.count_absence(self.now_ns);
        if let Some(status) = self.counts.status {
            let unseen = status.frames_produced.saturating_sub(self.counts.seen());
            if unseen > UNSEEN_MAX {
                self.counts.impossible_produced = Some(status.frames_produced);
                self.counts.status = None;
            } else {
                let either = LossCauses::NOT_RECEIVED.union(LossCauses::DISCONNECTED);
                let cause = if self.counts.ended { LossCauses::NOT_RECEIVED } else { either };
                self.counts.outages += u32::from(!self.counts.ended && unseen > 0);
                self.pending.add(unseen, cause);
            }
        }
        self.counts.closed = true;
        self.close_stretch();
        self.push_pending();
        self.end_stretch(0, true);
    }
}

/// A reader that is dropped early must not leave the writer waiting.
impl Drop for Intake {
    fn drop(&mut self) {
        self.close_take();
    }
}
