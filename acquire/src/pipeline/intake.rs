//! The reader's end: a frame goes into every ring, or into none and onto the account.

mod axis;
mod clock;
mod losses;
mod rows;

use std::sync::{Arc, atomic::Ordering};

use mocapd_drivers::device::{Frame, LinkCounters, MarkerInfo, Status};
use mocapd_take::{
    record::{Event, TakeEnding},
    timeline::{Causes, RowTime},
};

use self::{
    axis::Axis,
    clock::Clocks,
    losses::{Pending, Silences},
};
use super::{
    Counts, PipelineConfig, Progress,
    commands::{Mailbox, TAKE_COMMANDS_MAX, TakeCommand},
    messages::{Control, Moment, ToWriter},
    plan::Plan,
    pool::Feed,
    ring::{RingIn, Sample, TapHead, TapIn, TimelineItem},
};
use crate::{
    heartbeat::{Beat, Who},
    latency::Latency,
};

/// No slot: the channel pool was used up when the marker appeared.
const NO_SLOT: u32 = u32::MAX;

/// Takes frames in. Belongs to the one thread that reads the device.
#[derive(Debug)]
pub struct Intake {
    rings: Vec<RingIn<Sample>>,
    timeline: RingIn<TimelineItem>,
    feed: Feed,
    to_writer: ToWriter,
    progress: Arc<Progress>,
    beat: Beat,
    /// By marker id; `NO_SLOT` where none.
    slot_of_id: Vec<u32>,
    /// By slot, as announced.
    labels: Vec<String>,
    /// Markers of the device's table that came since the last frame.
    announced: Vec<MarkerInfo>,
    n_channels: usize,
    /// The row being put together, by slot.
    row: Vec<Sample>,
    /// Rows that every active ring is known to have room for.
    room: usize,
    rate_hz: f64,
    axis: Axis,
    silences: Silences,
    pending: Pending,
    next_row: u64,
    open_first_row: u64,
    open_rows: u32,
    open_limit: u32,
    stretch_rows: u32,
    first_stretch_rows: u32,
    key_rows: u64,
    /// Without a take: a pre-roll begins with a key.
    armed_key_rows: u64,
    /// Rows between keys now.
    key_every: u64,
    next_key_row: u64,
    /// When the open stretch got its first row, in host nanoseconds, and how long it may stay open.
    open_since_ns: u64,
    open_ns_max: u64,
    /// The open stretch's first recorded row, and when the last one arrived.
    open_first: Moment,
    last_arrival_ns: u64,
    counts: Counts,
    clocks: Clocks,
    is_away: bool,
    /// The device is back after an outage, and its first frame has not come.
    rejoining: bool,
    /// A take is to begin with that frame: a device's absence before it is none of the take's.
    begins_then: Option<TakeCommand>,
    /// Rows of the absence that lasts, which takes that ended meanwhile have already.
    rows_away: u64,
    /// The host's monotonic time, as it was told last.
    now_ns: u64,
    /// The device was asked to stop, or should have, then: no frames are due from there on.
    due_until_ns: Option<u64>,
    finished: bool,
    mailbox: Mailbox,
    tap: TapIn,
}

/// Frames that a device can have produced beyond those seen: a day and more at 10 kHz. What claims more
/// is a contradiction, not loss.
const UNSEEN_MAX: u64 = 1 << 30;

/// What the reader holds of what it shares with other threads.
pub(super) struct ReaderEnds {
    pub(super) rings: Vec<RingIn<Sample>>,
    pub(super) timeline: RingIn<TimelineItem>,
    pub(super) feed: Feed,
    pub(super) to_writer: ToWriter,
    pub(super) mailbox: Mailbox,
    pub(super) tap: TapIn,
    pub(super) progress: Arc<Progress>,
}

impl Intake {
    pub(super) fn new(
        config: &PipelineConfig,
        plan: &Plan,
        ends: ReaderEnds,
    ) -> anyhow::Result<Self> {
        let ReaderEnds { rings, timeline, feed, to_writer, mailbox, tap, progress } = ends;
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
            beat: config.heartbeat.beat(Who::Reader)?,
            slot_of_id,
            labels,
            announced: Vec::new(),
            n_channels: config.channels.len(),
            row: vec![Sample::default(); plan.n_slots],
            room: 0,
            rate_hz: config.rate_hz,
            axis: Axis::new(config.rate_hz, config.tick_hz),
            silences: Silences::new(config.rate_hz),
            pending: Pending::default(),
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
            open_since_ns: 0,
            open_ns_max: config.stretch.as_nanos() as u64,
            open_first: Moment::default(),
            last_arrival_ns: 0,
            counts: Counts::default(),
            clocks: Clocks::new(config.tick_hz, to_writer.clock.clone()),
            to_writer,
            is_away: false,
            rejoining: false,
            begins_then: None,
            rows_away: 0,
            now_ns: 0,
            due_until_ns: None,
            finished: false,
            mailbox,
            tap,
        })
    }

    /// One frame, at the host's monotonic time of its last byte.
    pub fn frame(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        self.now_ns = arrival_ns;
        if !self.announced.is_empty() {
            self.bind_announced();
        }
        self.execute_commands(arrival_ns);
        let rejoins = self.rejoining;
        // Its frames came before whoever waited for it was told.
        if !rejoins && let Some(begin) = self.begins_then.take() {
            self.cut(begin, arrival_ns);
        }
        if rejoins {
            self.end_outage(frame, arrival_ns);
            self.part_from_outage(arrival_ns);
        } else if !self.follow(frame) {
            return;
        }
        self.end_silence(frame.device_ticks, arrival_ns, rejoins);
        // No frame is dropped for its time; but no line fits both sides of a jump.
        let event = self.clocks.frame(frame.device_ticks, arrival_ns);
        self.clock_events(event, frame.device_ticks, arrival_ns);
        self.fill_row(frame);
        self.tap.offer(
            TapHead {
                row: self.next_row + self.pending.rows(),
                device_ticks: frame.device_ticks,
                arrival_ns,
                n_channels: self.n_channels,
                is_shown: false,
            },
            &self.row[..self.n_channels],
        );
        self.make_way();
        if !self.has_room() {
            self.counts.ring_full += 1;
            self.pending.add(1, Causes::RING_FULL);
            self.row.fill(Sample::default());
            self.progress.lost.store(self.counts.lost(), Ordering::Relaxed);
            return;
        }
        if self.open_rows == 0 {
            self.open_since_ns = arrival_ns;
            self.open_first = Moment { device_ticks: frame.device_ticks, arrival_ns };
        }
        self.last_arrival_ns = arrival_ns;
        self.progress.last_arrival_ns.store(arrival_ns, Ordering::Relaxed);
        self.push_row(RowTime {
            device_ticks: frame.device_ticks,
            arrival_10us: arrival_ns / 10_000,
            timecode: frame.timecode,
        });
        if self.open_rows >= self.open_limit {
            self.close_stretch();
        }
    }

    /// The host's monotonic time, told also when nothing arrives: a stretch that stays open because frames
    /// come slowly, or no more, goes to disk all the same.
    pub fn tick(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
        self.beat.moved();
        self.execute_commands(now_ns);
        if self.open_rows > 0 && now_ns.saturating_sub(self.open_since_ns) > self.open_ns_max {
            self.close_stretch();
        }
    }

    /// The reader waits for a device, and is alive.
    pub(crate) fn alive(&self) {
        self.beat.moved();
    }

    /// Something to note at the row being recorded.
    pub fn event(&mut self, event: Event) {
        self.event_at(self.next_row, event);
    }

    fn event_at(&mut self, row: u64, event: Event) {
        let event = Event { row, ..event };
        // The queue is full only when the disk has stalled through a thousand events.
        let control = (self.feed.next_stretch(), Control::Event(event));
        self.counts.events_dropped += u64::from(self.to_writer.control.try_send(control).is_err());
    }

    /// What other threads want of the reader.
    fn execute_commands(&mut self, now_ns: u64) {
        if self.mailbox.is_empty() {
            return;
        }
        while let Some(mark) = self.mailbox.next_mark() {
            if mark.is_wanted() {
                self.event(mark.event);
                // Whoever asked may have gone.
                mark.row.try_send(self.next_row).ok();
            }
        }
        // While the writer has as much to do as it takes on, commands wait in the mailbox.
        while self.to_writer.commands.len() < TAKE_COMMANDS_MAX
            && let Some(command) = self.mailbox.next_command()
        {
            let is_begin = matches!(command, TakeCommand::Begin(..));
            if is_begin && self.begins_then.is_none() && (self.is_away || self.rejoining) {
                self.begins_then = Some(command);
            } else {
                self.cut(command, now_ns);
            }
        }
    }

    /// Rows of an outage are a stretch of their own, and the next one is a key: a take that begins behind them has
    /// none of them.
    fn part_from_outage(&mut self, now_ns: u64) {
        match self.begins_then.take() {
            Some(begin) => self.cut(begin, now_ns),
            None if self.pending.rows() > 0 => {
                self.close_stretch();
                self.close_pending();
                self.next_key_row = self.next_row;
            }
            None => {}
        }
    }

    /// Ends the open stretch, and has the writer carry out a command between it and the next one, which is a short key
    /// stretch, so that what begins there is on disk soon.
    fn cut(&mut self, command: TakeCommand, now_ns: u64) {
        self.close_stretch();
        if !matches!(command, TakeCommand::Begin(..)) {
            self.count_absence(now_ns);
        }
        self.close_pending();
        let boundary = self.feed.next_stretch();
        // A take that waits for its device is begun and done with: an end does not wait.
        for command in self.begins_then.take().into_iter().chain([command]) {
            match command {
                // While a take is written, key stretches may be rarer.
                TakeCommand::Begin(..) => self.key_every = self.key_rows,
                TakeCommand::End(_) => self.key_every = self.armed_key_rows,
                TakeCommand::Save(..) => {}
            }
            // Without a writer there is nobody to carry it out, and whoever asked is told by that.
            self.to_writer.commands.try_send((boundary, command)).ok();
        }
        self.end_boundary();
        self.next_key_row = self.next_row;
        self.open_limit = self.first_stretch_rows;
    }

    /// The device's report on itself.
    pub fn status(&mut self, status: Status, last: bool) {
        if last && !self.rejoining {
            // Its last word on what was due by the host's clock alone.
            let told = status.frames_produced.saturating_add(self.counts.reports_from);
            let not_produced = self.counts.seen().saturating_sub(told).min(self.rows_away);
            self.rows_away -= not_produced;
            self.counts.not_produced(not_produced);
        }
        let is_accounted = self.counts.status(status, self.rejoining);
        if is_accounted && !self.rejoining {
            self.silences.account(self.now_ns);
        }
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
        counts.clock = self.clocks.status();
        counts.pending = self.pending.counted();
        counts
    }

    /// Frames so far, those that were lost too.
    #[must_use]
    pub fn counts_seen(&self) -> u64 {
        self.counts.seen()
    }

    /// Whether the next frame might find a ring full, however many are lost before it: for sources that can wait.
    #[must_use]
    pub fn is_full(&mut self) -> bool {
        // More lost rows than the open stretch has left do not go into the rings.
        !self.has_room_for(1 + self.open_limit.saturating_sub(self.open_rows) as usize)
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

    /// What other threads see of it.
    pub(crate) fn progress(&self) -> &Progress {
        &self.progress
    }

    /// The device went away, or is back.
    pub fn away(&mut self, is_away: bool) {
        self.is_away = is_away;
        self.progress.is_away.store(is_away, Ordering::Relaxed);
        if !is_away {
            self.progress.outages.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// For whoever watches.
    pub(crate) fn tell_latency(&self, latency: &Latency) {
        let p99_ns = latency.quantile_ns(0.99);
        self.progress.ring_latency_p99_ns.store(p99_ns, Ordering::Relaxed);
    }

    /// The device was told to stop, or should have been done, at `host_ns`: that no frame comes after it is no loss.
    pub fn no_frames_due_after(&mut self, host_ns: u64) {
        self.due_until_ns.get_or_insert(host_ns);
    }

    /// Why there will be no more frames: a take that is open ends so.
    pub fn ends(&self, ending: TakeEnding) {
        // It ends once.
        self.progress.ending.set(ending).ok();
    }

    /// No more frames: what is open is closed, and the take ends with the ledger.
    pub fn finish(mut self) -> Counts {
        self.close_take();
        self.counts()
    }

    fn close_take(&mut self) {
        if std::mem::replace(&mut self.finished, true) {
            return;
        }
        self.clocks.close();
        self.count_absence(self.now_ns);
        if let Some(status) = self.counts.status {
            let unseen = status.frames_produced.saturating_sub(self.counts.seen());
            if unseen > UNSEEN_MAX {
                self.counts.impossible_produced = Some(status.frames_produced);
                self.counts.status = None;
            } else {
                let gone = Causes::NOT_RECEIVED.union(Causes::DISCONNECTED);
                let cause = if self.counts.ended { Causes::NOT_RECEIVED } else { gone };
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

/// A reader that is dropped in the middle must not leave the writer waiting.
impl Drop for Intake {
    fn drop(&mut self) {
        self.close_take();
    }
}
