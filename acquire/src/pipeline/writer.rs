//! The writer thread: parts become stretches, stretches go into the take, or wait for one.

mod assembly;
mod clocks;
mod held;
mod ledgers;
mod live;
mod orders;
mod output;
mod room;

use std::{
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use anyhow::{anyhow, bail};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use mocapd_take::record::{Channel, EndingKind, TakeEnding};

pub(super) use self::live::LiveTake;
pub use self::room::HELD_MIN_BYTES;
use self::{assembly::Assemblies, clocks::ClockWriter, held::Held};
pub use self::{
    output::{TakeOutput, Written},
    room::DiskState,
};
use super::{
    Counts, Progress, lock,
    messages::{Control, FromReader, Part, PartReport, StretchEnd},
    plan::Plan,
    pool::Wakes,
    takes::Order,
};
use crate::heartbeat::Beat;

/// How often the writer looks what waits, though it is to sync with every stretch.
const LOOK_AT_MOST: Duration = Duration::from_millis(50);

/// How often the writer looks at the file when nothing is to be written: with the time between two of these looks, what
/// others do to it is noticed within a second.
const LOOK_AT_FILE: Duration = Duration::from_millis(450);

/// How long to wait for parts after a worker failed.
const GIVE_UP_AFTER: Duration = Duration::from_secs(2);

/// Owns the take file.
#[derive(Debug)]
pub(super) struct Writer<W> {
    parts: Receiver<Part>,
    control: Receiver<Control>,
    orders: Receiver<Order<W>>,
    /// Read from `orders`, but its boundary has not come.
    next_order: Option<Order<W>>,
    clocks: ClockWriter,
    /// Read from `control`, but its stretch is not written yet.
    waiting: Option<Control>,
    buffers_back: Vec<Sender<Vec<u8>>>,
    wakes: Wakes,
    progress: Arc<Progress>,
    assemblies: Assemblies,
    payload: Vec<u8>,
    /// Up to the last stretch.
    counts: Counts,
    /// All channels so far, by the stretch that may hold them first.
    table: Vec<(u64, Channel)>,
    sync_every: Duration,
    held: Option<Held>,
    live: Option<LiveTake<W>>,
    /// The pipeline is there for one take, and has failed when that has.
    for_one_take: bool,
}

/// What a writer hears from.
pub(super) struct Sources<W> {
    pub(super) parts: Receiver<Part>,
    pub(super) from_reader: FromReader,
    pub(super) orders: Receiver<Order<W>>,
}

impl<W: TakeOutput> Writer<W> {
    pub(super) fn new(
        plan: &Plan,
        channels: &[Channel],
        sources: Sources<W>,
        buffers_back: Vec<Sender<Vec<u8>>>,
        wakes: Wakes,
        progress: &Arc<Progress>,
    ) -> Self {
        let mut table = Vec::with_capacity(plan.n_slots);
        table.extend(channels.iter().map(|channel| (0, channel.clone())));
        Self {
            parts: sources.parts,
            control: sources.from_reader.control,
            orders: sources.orders,
            next_order: None,
            clocks: ClockWriter::new(sources.from_reader.clock),
            waiting: None,
            buffers_back,
            wakes,
            progress: Arc::clone(progress),
            assemblies: Assemblies::new(plan),
            payload: Vec::with_capacity(plan.stretch_bytes_max()),
            counts: Counts::default(),
            table,
            sync_every: plan.sync_every,
            held: plan.pre_roll.map(Held::new),
            live: None,
            for_one_take: false,
        }
    }

    /// Writes this take from the first stretch on, and nothing else.
    pub(super) fn for_take(&mut self, mut take: LiveTake<W>) {
        take.reserve(self.payload.capacity());
        self.live = Some(take);
        self.for_one_take = true;
    }

    /// Works until the last stretch. After an error the parts are still taken, so that the reader and the workers come
    /// to their end; what was written before stays.
    pub(super) fn run(mut self, beat: &Beat) -> anyhow::Result<()> {
        let mut silent_since = Instant::now();
        let progress = Arc::clone(&self.progress);
        self.on_take(|take, _| {
            take.look_at_disk(&progress);
            Ok(())
        });
        loop {
            beat.moved();
            let sync_after = self.sync_every.clamp(LOOK_AT_MOST, GIVE_UP_AFTER);
            match self.parts.recv_timeout(sync_after.min(LOOK_AT_FILE)) {
                Ok(part) => {
                    silent_since = Instant::now();
                    self.assemblies.add(part);
                }
                Err(RecvTimeoutError::Timeout) => {
                    beat.at_disk();
                    let is_silent = silent_since.elapsed() >= sync_after;
                    self.on_take(|take, _| {
                        take.look_at_disk(&progress);
                        take.look_at_file(&progress);
                        if is_silent { take.sync_what_waits() } else { Ok(()) }
                    });
                    let failed = progress.failed.load(Ordering::Relaxed);
                    let has_no_take = self.for_one_take && self.live.is_none();
                    if failed && !has_no_take && silent_since.elapsed() > GIVE_UP_AFTER {
                        let error = || anyhow!("a resampler thread failed");
                        self.on_take(|_, _| Err(error()));
                        return Err(error());
                    }
                }
                // The groups hold the senders, and the writer holds the groups' wakes.
                Err(RecvTimeoutError::Disconnected) => bail!("the resampler threads are gone"),
            }
            while let Some(last) = self.assemblies.front_last() {
                beat.at_disk();
                self.front();
                self.give_back();
                if last {
                    if let Some(take) = self.live.take() {
                        let ending = self.ending();
                        take.end(&self.counts, &mut self.clocks, ending);
                    }
                    return Ok(());
                }
            }
        }
    }

    /// How a take ends that is open when the reading is over.
    fn ending(&self) -> TakeEnding {
        let ending = self.progress.ending.get().cloned().unwrap_or_default();
        // Takes of the service are ended by orders; who stops its reader stops the service.
        if ending.kind == EndingKind::Stopped && !self.for_one_take {
            return EndingKind::ServiceStopped.into();
        }
        ending
    }

    /// The oldest stretch, which is complete: into the take, and to what is held.
    fn front(&mut self) {
        let Some(front) = self.assemblies.front() else { return };
        let Some((timeline, blocks)) = front.parts() else { return };
        let (stretch, end) = (front.stretch, front.end);
        let mut report = PartReport::default();
        self.payload.clear();
        self.payload.extend_from_slice(&timeline.bytes);
        for part in blocks {
            self.payload.extend_from_slice(&part.bytes);
            report.add(&part.report);
        }
        let before = self.counts;
        self.counts = timeline.counts.unwrap_or(self.counts);
        self.take_in_control(stretch);
        match end.boundary {
            0 => self.place(stretch, &end, &report, before),
            number => self.carry_out(number, &end),
        }
        self.tell_clock();
    }

    fn place(&mut self, stretch: u64, end: &StretchEnd, report: &PartReport, before: Counts) {
        let (counts, progress) = (self.counts, Arc::clone(&self.progress));
        let payload = std::mem::take(&mut self.payload);
        if let Some(held) = &mut self.held
            && !payload.is_empty()
        {
            held.push(stretch, end, &payload, *report, (before, counts));
        }
        self.on_take(|take, clocks| {
            take.stretch(end.span, end.first, &payload, report, &counts)?;
            if !end.last {
                take.ledger_and_sync(clocks, &progress)?;
            }
            take.tell(&progress);
            Ok(())
        });
        self.observe();
        self.payload = payload;
        self.tell_held();
    }

    /// What was seen of the clocks up to the last stretch: into the take, and to what the next one needs.
    fn observe(&mut self) {
        let status = self.counts.clock;
        self.on_take(|take, clocks| take.observe(clocks, &status));
        if self.live.is_none() {
            // Without a take there is nothing that could fail.
            self.clocks.write::<W>(None, &status, false).ok();
        }
    }

    /// What must stand in a take before stretch `stretch`.
    fn take_in_control(&mut self, stretch: u64) {
        while let Some(message) = self.waiting.take().or_else(|| self.control.try_recv().ok()) {
            if message.stretch() > stretch {
                self.waiting = Some(message);
                return;
            }
            match message {
                Control::Channel(new) => {
                    let channel = new.into_channel();
                    self.on_take(|take, _| take.channel(&channel));
                    lock(&self.progress.channels).push(channel.clone());
                    self.table.push((stretch, channel));
                }
                Control::Event(at, event) => {
                    self.on_take(|take, _| take.event(&event));
                    if let Some(held) = &mut self.held {
                        held.event(at, event);
                    }
                }
            }
        }
    }

    /// Something with the take, if there is one. After an error there is none.
    fn on_take(
        &mut self,
        work: impl FnOnce(&mut LiveTake<W>, &mut ClockWriter) -> anyhow::Result<()>,
    ) {
        // One that was cut short is told to end; until then nothing is written to it.
        let Some(take) = self.live.as_mut().filter(|take| !take.is_cut_short()) else { return };
        let Err(error) = work(take, &mut self.clocks) else { return };
        take.look_at_file(&self.progress);
        if take.is_cut_short() {
            return;
        }
        if self.for_one_take {
            self.progress.failed.store(true, Ordering::Relaxed);
        }
        if let Some(take) = self.live.take() {
            take.give_up(error);
        }
    }

    fn tell_held(&self) {
        let Some(held) = &self.held else { return };
        let progress = &self.progress;
        progress.held_bytes.store(held.bytes() as u64, Ordering::Relaxed);
        progress.held_ms.store((held.seconds() * 1e3) as u64, Ordering::Relaxed);
        progress.held_cut.store(held.is_cut(), Ordering::Relaxed);
    }

    fn tell_clock(&self) {
        if let Some(line) = self.counts.clock.line {
            self.progress.drift_ppb.store(line.drift_ppb, Ordering::Relaxed);
            let p99_us = self.counts.clock.jitter.p99_us;
            self.progress.jitter_p99_us.store(p99_us, Ordering::Relaxed);
        }
    }

    /// The front's buffers go back to their groups, which may have waited for them.
    fn give_back(&mut self) {
        let Self { assemblies, buffers_back, wakes, .. } = self;
        assemblies.pop_front(|part| {
            drop(buffers_back[part.group].try_send(part.bytes));
            wakes.wake(part.group);
        });
    }
}
