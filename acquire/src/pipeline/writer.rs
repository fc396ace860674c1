//! The writer thread: assembles parts into stretches and writes them to the take, or buffers them for a pre-roll.

mod clocks;
mod live;
mod pre_roll;
mod samples;
pub(super) mod splitting;

use std::{
    collections::VecDeque,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use anyhow::{bail, ensure};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use mocapd_take::{
    record::{Channel, EndingKind, TakeEnding},
    statistics::{BlockTally, StretchTally},
};

use self::{clocks::ClockWriter, pre_roll::PreRollBuffer, splitting::SplitState};
pub(super) use self::{
    live::{LiveTake, TakePlace},
    samples::SampleQueue,
};
use super::{
    Counts, NewTake, PipelineProgress, Split, TakeFailed, lock,
    messages::{
        Control, FromReader, Part, PartBuffer, PartContent, PartReport, Reply, StretchEnd,
        StretchReport, TakeCommand, WriterInput,
    },
    plan::Plan,
    pool::WakeQueue,
    sampled::open_residuals,
};
use crate::{
    files::FileState,
    threads::{HeartbeatHandle, ResamplerFailed},
};

/// Shortest polling interval of the writer, even if it is to sync with every stretch.
const POLL_INTERVAL_MIN: Duration = Duration::from_millis(50);

/// How often the writer checks the file when there is nothing to write. Together with the file's own checking interval,
/// changes by other programs are noticed within a second.
const FILE_CHECK_INTERVAL: Duration = Duration::from_millis(450);

/// How long to wait for parts after a worker failed.
const PARTS_TIMEOUT: Duration = Duration::from_secs(2);

/// The writer, which owns the take file.
#[derive(Debug)]
pub(super) struct Writer {
    parts: Receiver<WriterInput>,
    control: Receiver<(u64, Control)>,
    commands: Receiver<(u64, TakeCommand)>,
    /// Received from `commands`; its boundary has not come yet.
    next_command: Option<(u64, TakeCommand)>,
    clocks: ClockWriter,
    /// Received from `control`; its stretch is not written yet.
    next_control: Option<(u64, Control)>,
    buffers_back: Vec<Sender<PartBuffer>>,
    wakes: WakeQueue,
    samples: SampleQueue,
    /// Whether the present boundary is executed without some samples before it.
    misses_samples: bool,
    progress: Arc<PipelineProgress>,
    assembler: StretchAssembler,
    payload: Vec<u8>,
    /// What the stretch in `payload` holds, and all its channels while it is assembled.
    report: StretchReport,
    tally: BlockTally,
    /// The counters at the end of the last stretch.
    counts: Counts,
    /// All channels so far, each with the number of the stretch that may be the first to contain it.
    table: Vec<(u64, Channel)>,
    sync_every: Duration,
    pre_roll: Option<PreRollBuffer>,
    live: Option<LiveTake>,
    /// Whether the pipeline serves a single take, or those of a recording that is divided, and fails with it.
    single_take: bool,
    /// How the recording is divided, if it is.
    split: Option<SplitState>,
}

/// The writer's ends of the queues that it shares with other threads.
#[derive(Debug)]
pub(super) struct WriterEndpoints {
    pub(super) parts: Receiver<WriterInput>,
    pub(super) from_reader: FromReader,
    pub(super) samples: SampleQueue,
    pub(super) buffers_back: Vec<Sender<PartBuffer>>,
    pub(super) wakes: WakeQueue,
}

impl Writer {
    pub(super) fn new(
        plan: &Plan,
        ends: WriterEndpoints,
        progress: &Arc<PipelineProgress>,
    ) -> Self {
        let WriterEndpoints { parts, from_reader, samples, buffers_back, wakes } = ends;
        let mut table = Vec::with_capacity(plan.n_slots);
        table.extend(lock(&progress.channels).iter().map(|channel| (0, channel.clone())));
        Self {
            parts,
            control: from_reader.control,
            commands: from_reader.commands,
            next_command: None,
            clocks: ClockWriter::new(from_reader.clock),
            next_control: None,
            buffers_back,
            wakes,
            samples,
            misses_samples: false,
            progress: Arc::clone(progress),
            assembler: StretchAssembler::new(plan),
            payload: Vec::with_capacity(plan.stretch_bytes_max()),
            report: StretchReport {
                parts: PartReport::default(),
                tally: StretchTally::with_capacity(plan.n_slots),
                lacks_residuals: false,
            },
            tally: BlockTally::with_capacity(plan.n_slots, plan.stretch_rows as usize),
            counts: Counts::default(),
            table,
            sync_every: plan.sync_every,
            pre_roll: plan.pre_roll.map(PreRollBuffer::new),
            live: None,
            single_take: false,
            split: None,
        }
    }

    /// Writes this take alone, from the first stretch on, or divides it.
    pub(super) fn set_single_take(&mut self, mut take: LiveTake, split: Option<Split>) {
        take.reserve(self.payload.capacity(), self.samples.block_bytes_max());
        self.live = Some(take);
        self.single_take = true;
        self.split = split.map(SplitState::new);
        self.progress.takes_begun.store(self.split.iter().len() as u32, Ordering::Relaxed);
    }

    /// Runs until the last stretch. After an error it still accepts the parts, so that the reader and the workers can
    /// finish; what was written before stays.
    pub(super) fn run(mut self, heartbeat: &HeartbeatHandle) -> anyhow::Result<()> {
        let mut idle_since = Instant::now();
        let mut upkeep = Instant::now();
        let progress = Arc::clone(&self.progress);
        self.with_take(|take, _| {
            take.poll_disk(&progress);
            Ok(())
        });
        loop {
            heartbeat.beat();
            let sync_after = self.sync_every.clamp(POLL_INTERVAL_MIN, PARTS_TIMEOUT);
            match self.parts.recv_timeout(sync_after.min(FILE_CHECK_INTERVAL)) {
                Ok(WriterInput::Part(part)) => {
                    idle_since = Instant::now();
                    self.assembler.add(part);
                }
                Ok(WriterInput::Samples(part)) => {
                    self.samples.add(part);
                    heartbeat.at_disk();
                    self.write_samples(self.assembler.next_stretch);
                }
                Err(RecvTimeoutError::Timeout) => heartbeat.at_disk(),
                // Not expected: the groups hold the senders, and the writer keeps the groups alive through their
                // wake-ups.
                Err(RecvTimeoutError::Disconnected) => bail!("the resampler threads have ended"),
            }
            // Samples may come without frames: their file is synced and looked at as well.
            if upkeep.elapsed() >= sync_after.min(FILE_CHECK_INTERVAL) {
                upkeep = Instant::now();
                heartbeat.at_disk();
                self.keep_up(idle_since.elapsed() >= sync_after);
                self.apply_early_control();
                let failed = progress.failed.load(Ordering::Relaxed);
                let has_no_take = self.single_take && self.live.is_none();
                if failed && !has_no_take && idle_since.elapsed() > PARTS_TIMEOUT {
                    self.with_take(|_, _| Err(ResamplerFailed.into()));
                    return Err(ResamplerFailed.into());
                }
            }
            while let Some(last) = self.assembler.front_is_last() {
                heartbeat.at_disk();
                if !self.write_samples_before_front() {
                    break;
                }
                self.process_front();
                self.return_buffers();
                if last {
                    self.apply_held_events(u64::MAX);
                    if let Some(take) = self.live.take() {
                        let ending = self.ending();
                        take.end(&self.counts, &mut self.clocks, ending);
                    }
                    return Ok(());
                }
            }
        }
    }

    /// Looks at the disk and the file, and syncs what no stretch has synced. `is_idle`: no stretch came for a while.
    fn keep_up(&mut self, is_idle: bool) {
        let progress = Arc::clone(&self.progress);
        self.with_take(|take, _| {
            take.poll_disk(&progress);
            take.check_file(&progress);
            if is_idle { take.sync_pending() } else { Ok(()) }
        });
        // Samples alone make a file longer, too.
        self.ask_for_split();
    }

    /// The ending of a take that is open when the reading is over.
    fn ending(&self) -> TakeEnding {
        let ending = self.progress.ending.get().cloned().unwrap_or_default();
        // In the service, commands end takes; its reader is stopped only when the service ends.
        if ending.kind == EndingKind::Stopped && !self.single_take {
            return EndingKind::ServiceStopped.into();
        }
        ending
    }

    /// Processes the oldest stretch, which is complete.
    fn process_front(&mut self) {
        let Some(front) = self.assembler.front() else { return };
        let Some((timeline, blocks)) = front.parts() else { return };
        let (stretch, end) = (front.stretch, front.end);
        self.report.parts = PartReport::default();
        self.report.lacks_residuals = end.lacks_residuals;
        self.tally.restart(end.span.n_rows as usize);
        self.payload.clear();
        self.payload.extend_from_slice(&timeline.buffer.bytes);
        for part in blocks {
            self.payload.extend_from_slice(&part.buffer.bytes);
            self.report.parts.add(&part.report);
            self.tally.append(&part.buffer.tally);
        }
        self.report.tally.set(&self.tally);
        let before = self.counts;
        self.counts = timeline.counts.unwrap_or(self.counts);
        let n_channels_before = self.table.len();
        self.apply_control(stretch, Some(&end));
        match self.command_at(stretch) {
            None => {
                self.put_stretch(stretch, &end, before);
                if end.splits {
                    self.split(end.span.first_row, n_channels_before);
                }
            }
            Some(command) => {
                self.observe();
                self.execute(command, &end);
                while let Some(command) = self.command_at(stretch) {
                    self.execute(command, &end);
                }
            }
        }
        self.publish_clock();
    }

    /// Writes those samples that belong before the oldest stretch and are encoded by now. Returns `false` if that
    /// stretch is a boundary, which has to wait for the rest.
    fn write_samples_before_front(&mut self) -> bool {
        let Some(front) = self.assembler.front() else { return true };
        let (stretch, is_boundary) = (front.stretch, front.end.span.n_rows == 0);
        let is_last = front.end.last;
        if is_boundary && !self.samples.is_complete(stretch, is_last, || self.parts.is_empty()) {
            return false;
        }
        self.write_samples(stretch);
        self.misses_samples = is_boundary && self.samples.end_wait(stretch);
        if self.misses_samples {
            self.with_take(|take, _| {
                take.miss_samples();
                Ok(())
            });
        }
        true
    }

    /// Writes the samples of stretches up to `stretch` to the open take, and keeps them for a pre-roll.
    fn write_samples(&mut self, stretch: u64) {
        while let Some(part) = self.samples.next_up_to(stretch, self.table.len()) {
            if let PartContent::Opens { first_marker, n } = part.content {
                self.open_residuals(part.group, first_marker, n);
                continue;
            }
            self.with_take(|take, _| take.samples(&part));
            if let Some(buffer) = &mut self.pre_roll {
                buffer.samples(part.copy());
            }
            self.samples.give_back(part);
        }
    }

    /// Describes the residuals of markers that appeared, which are in the table, in the open take and the next ones.
    fn open_residuals(&mut self, index: usize, first_marker: usize, n: usize) {
        let Some(group) = self.samples.groups.get_mut(index) else { return };
        let markers = self.table.iter().skip(first_marker).take(n);
        let labels: Vec<&str> = markers.map(|(_, channel)| &channel.label[..]).collect();
        open_residuals(group, first_marker, &labels);
        let group = group.clone();
        self.with_take(|take, _| take.open_samples(index, &group));
    }

    fn put_stretch(&mut self, stretch: u64, end: &StretchEnd, before: Counts) {
        let (counts, progress) = (self.counts, Arc::clone(&self.progress));
        let payload = std::mem::take(&mut self.payload);
        let report = std::mem::take(&mut self.report);
        if let Some(buffer) = &mut self.pre_roll
            && !payload.is_empty()
        {
            buffer.push(stretch, end, &payload, &report, (before, counts));
        }
        self.with_take(|take, clocks| {
            take.stretch(end.span, end.first, &payload, &report, &counts)?;
            if !end.last {
                take.ledger_and_sync(clocks, &progress)?;
            }
            take.publish(&progress);
            Ok(())
        });
        self.observe();
        (self.payload, self.report) = (payload, report);
        self.publish_pre_roll();
        self.ask_for_split();
    }

    /// Writes what was observed of the clocks up to the last stretch: to the take, and to what the next take needs.
    fn observe(&mut self) {
        let status = self.counts.clock;
        self.with_take(|take, clocks| take.observe(clocks, &status));
        if self.live.is_none() {
            // Without a take there is nothing that can fail.
            self.clocks.write::<Vec<u8>>(None, &status, false).ok();
        }
    }

    /// Applies the channels and events of the open stretch: the queue must not overflow while no frame comes that ends it. A
    /// recording that is divided waits, because the end of the stretch tells which take they belong to.
    fn apply_early_control(&mut self) {
        if self.split.is_none() && self.assembler.front_is_last().is_none() {
            self.apply_control(self.assembler.next_stretch, None);
        }
    }

    /// Applies the channels and events that precede stretch `stretch`, except those for the next take of a recording
    /// that is divided. `end`: how the stretch ends, once that is known.
    fn apply_control(&mut self, stretch: u64, end: Option<&StretchEnd>) {
        while let Some((at, item)) =
            self.next_control.take().or_else(|| self.control.try_recv().ok())
        {
            if at > stretch {
                self.next_control = Some((at, item));
                return;
            }
            match item {
                Control::Channel(new) => {
                    let channel = new.into_channel();
                    // The next take has it in its header.
                    if end.is_none_or(|end| !end.splits) {
                        self.with_take(|take, _| take.channel(&channel));
                    }
                    lock(&self.progress.channels).push(channel.clone());
                    self.table.push((stretch, channel));
                }
                Control::Event(event) => {
                    let held = end.map_or(Some(event.clone()), |end| self.hold_event(event, end));
                    let Some(event) = held else { continue };
                    self.with_take(|take, _| take.event(&event));
                    if let Some(buffer) = &mut self.pre_roll {
                        buffer.event(at, event);
                    }
                }
            }
        }
    }

    /// Runs `work` on the open take, if there is one. An error ends the take.
    fn with_take(
        &mut self,
        work: impl FnOnce(&mut LiveTake, &mut ClockWriter) -> anyhow::Result<()>,
    ) {
        // A take that was cut short will be ended; until then nothing is written to it.
        let Some(take) = self.live.as_mut().filter(|take| !take.is_cut_short()) else { return };
        let Err(error) = work(take, &mut self.clocks) else { return };
        take.check_file(&self.progress);
        if take.is_cut_short() {
            return;
        }
        if self.single_take {
            self.progress.failed.store(true, Ordering::Relaxed);
        }
        if let Some(take) = self.live.take() {
            take.fail(error);
        }
    }

    fn publish_pre_roll(&self) {
        let Some(buffer) = &self.pre_roll else { return };
        let progress = &self.progress;
        progress.pre_roll_bytes.store(buffer.bytes() as u64, Ordering::Relaxed);
        progress.pre_roll_ms.store((buffer.seconds() * 1e3) as u64, Ordering::Relaxed);
        progress.pre_roll_is_cut.store(buffer.is_cut(), Ordering::Relaxed);
    }

    fn publish_clock(&self) {
        if let Some(line) = self.counts.clock.line {
            *lock(&self.progress.clock_line) = Some(line);
            self.progress.drift_ppb.store(line.drift_ppb, Ordering::Relaxed);
            let p99_us = self.counts.clock.jitter.p99_us;
            self.progress.jitter_p99_us.store(p99_us, Ordering::Relaxed);
        }
    }

    /// Returns the oldest stretch's buffers to their groups, which may be waiting for them.
    fn return_buffers(&mut self) {
        let Self { assembler, buffers_back, wakes, .. } = self;
        assembler.pop_front(|part| {
            drop(buffers_back[part.group].try_send(part.buffer));
            wakes.wake(part.group);
        });
    }
}

impl Writer {
    /// The next command whose boundary is this stretch or an earlier one.
    fn command_at(&mut self, stretch: u64) -> Option<TakeCommand> {
        let next = self.next_command.take().or_else(|| self.commands.try_recv().ok());
        // A command may come early: its boundary is then behind this stretch.
        self.next_command = next;
        self.next_command.take_if(|(at, _)| *at <= stretch).map(|(_, command)| command)
    }

    fn execute(&mut self, command: TakeCommand, end: &StretchEnd) {
        match command {
            TakeCommand::End(ending) => self.end_take(ending),
            TakeCommand::Begin(take, reply) => {
                self.end_take(EndingKind::Stopped);
                let progress = Arc::clone(&self.progress);
                let mut clocks = std::mem::replace(&mut self.clocks, ClockWriter::idle());
                clocks.begin();
                let requested_ns = take.requested_ns;
                self.live = self.begin_take(*take, &reply, end, &mut clocks, &progress);
                self.clocks = clocks;
                self.with_take(|take, _| take.mark_request(end.span.first_row, requested_ns));
            }
            TakeCommand::Save(take, reply) => {
                // The open take continues, and observers keep seeing that one.
                let mut clocks = self.clocks.for_saved_take();
                let progress = PipelineProgress::new(&[]);
                let saved = self.begin_take(*take, &reply, end, &mut clocks, &progress);
                if let Some(mut saved) = saved {
                    if self.misses_samples {
                        saved.miss_samples();
                    }
                    saved.end(&self.counts.in_rows(), &mut clocks, EndingKind::Saved.into());
                }
            }
        }
    }

    fn end_take(&mut self, ending: EndingKind) {
        if let Some(take) = self.live.take() {
            take.end(&self.counts.in_rows(), &mut self.clocks, ending.into());
        }
        *lock(&self.progress.take) = None;
    }

    /// Begins a take with the pre-roll that it asks for. On failure the error goes to the requester.
    fn begin_take(
        &self,
        mut new: NewTake,
        reply: &Reply,
        end: &StretchEnd,
        clocks: &mut ClockWriter,
        progress: &PipelineProgress,
    ) -> Option<LiveTake> {
        let from = self.pre_roll.as_ref().map_or(0, |p| p.start_of(new.pre_roll, new.requested_ns));
        let first = self.pre_roll.as_ref().and_then(|buffer| buffer.from(from).next());
        let (base, rows_before, stretch) = match first {
            // The row after the preceding stretch: rows lost before the first stretch belong to the take.
            Some(kept) => (kept.before.in_rows(), kept.before.in_rows().seen(), kept.stretch),
            None => (self.counts.in_rows(), end.span.first_row, u64::MAX),
        };
        let known = |(since, _): &&(u64, Channel)| *since <= stretch;
        // The first row is older than the request.
        let before_ns =
            first.map_or(0, |kept| new.requested_ns.saturating_sub(kept.first.arrival_ns));
        new.header.created_unix_ms -= (before_ns / 1_000_000).cast_signed();
        new.header.channels = self.table.iter().filter(known).map(|(_, c)| c.clone()).collect();
        progress.disk_full.store(false, Ordering::Relaxed);
        progress.set_file_state(FileState::InPlace, None);
        let place = TakePlace { base, rows_before };
        let groups = &self.samples.groups;
        let mut take = match LiveTake::begin(new, reply, place, groups, self.sync_every) {
            Ok(take) => take,
            Err(error) => {
                reply.ended.try_send(Err(TakeFailed::without_output(error))).ok();
                return None;
            }
        };
        take.reserve(self.payload.capacity(), self.samples.block_bytes_max());
        match self.write_pre_roll(&mut take, from, stretch, clocks, progress) {
            Ok(()) => Some(take),
            Err(error) => {
                take.fail(error);
                None
            }
        }
    }

    fn write_pre_roll(
        &self,
        take: &mut LiveTake,
        from: usize,
        first: u64,
        clocks: &mut ClockWriter,
        progress: &PipelineProgress,
    ) -> anyhow::Result<()> {
        take.poll_disk(progress);
        let Some(buffer) = &self.pre_roll else { return Ok(()) };
        if first == u64::MAX {
            return Ok(());
        }
        let mut channels = self.table.iter().filter(|(since, _)| *since > first).peekable();
        let mut events = buffer.events().filter(|(stretch, _)| *stretch >= first).peekable();
        let mut samples = buffer.samples_from(first).peekable();
        for stretch in buffer.from(from) {
            let is_full = progress.disk_full.load(Ordering::Relaxed);
            ensure!(!is_full, "the disk is full: free some space");
            while let Some((_, channel)) = channels.next_if(|(at, _)| *at <= stretch.stretch) {
                take.channel(channel)?;
            }
            while let Some((_, event)) = events.next_if(|(at, _)| *at <= stretch.stretch) {
                take.event(event)?;
            }
            let (payload, report) = (&stretch.payload, &stretch.report);
            while let Some(part) = samples.next_if(|part| part.stretch <= stretch.stretch) {
                take.samples(part)?;
            }
            take.stretch(stretch.span, stretch.first, payload, report, &stretch.after)?;
        }
        samples.try_for_each(|part| take.samples(part))?;
        channels.try_for_each(|(_, channel)| take.channel(channel))?;
        events.try_for_each(|(_, event)| take.event(event))?;
        take.ledger_and_sync(clocks, progress)?;
        take.publish(progress);
        Ok(())
    }
}

/// The parts of one stretch.
#[derive(Debug)]
pub(super) struct StretchAssembly {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    /// By group; the timeline's is the last.
    slots: Vec<Option<Part>>,
    missing: usize,
}

impl StretchAssembly {
    /// The timeline's part and the channels' parts in order, if the stretch is complete.
    pub(super) fn parts(&self) -> Option<(&Part, impl Iterator<Item = &Part>)> {
        let mut present = self.slots.iter().flatten();
        Some((present.next_back()?, present))
    }
}

/// Encoded stretches that are not written yet, oldest first.
#[derive(Debug)]
pub(super) struct StretchAssembler {
    assemblies: VecDeque<StretchAssembly>,
    spare: Vec<Vec<Option<Part>>>,
    next_stretch: u64,
    plan: Plan,
}

impl StretchAssembler {
    pub(super) fn new(plan: &Plan) -> Self {
        // No group can be further ahead than it has buffers.
        let ahead_max = plan.buffers_per_group() + 1;
        let n_groups = plan.n_groups() + 1;
        let empty = || (0..n_groups).map(|_| None).collect();
        Self {
            assemblies: VecDeque::with_capacity(ahead_max),
            spare: (0..ahead_max).map(|_| empty()).collect(),
            next_stretch: 0,
            plan: plan.clone(),
        }
    }

    pub(super) fn add(&mut self, part: Part) {
        let at = (part.stretch - self.next_stretch) as usize;
        let n_groups = self.plan.n_groups() + 1;
        while self.assemblies.len() <= at {
            self.assemblies.push_back(StretchAssembly {
                stretch: self.next_stretch + self.assemblies.len() as u64,
                end: part.end,
                slots: self.spare.pop().unwrap_or_else(|| (0..n_groups).map(|_| None).collect()),
                missing: usize::MAX,
            });
        }
        let assembly = &mut self.assemblies[at];
        if assembly.missing == usize::MAX {
            assembly.end = part.end;
            assembly.missing = self.plan.groups_of(part.end.n_channels) + 1;
        }
        let group = part.group;
        assembly.missing -= 1;
        assembly.slots[group] = Some(part);
    }

    /// The oldest stretch.
    pub(super) fn front(&self) -> Option<&StretchAssembly> {
        self.assemblies.front()
    }

    /// If the oldest stretch is complete: whether it is the last of all.
    pub(super) fn front_is_last(&self) -> Option<bool> {
        self.front().filter(|front| front.missing == 0).map(|front| front.end.last)
    }

    /// Removes the oldest stretch and passes its parts to `give_back`.
    pub(super) fn pop_front(&mut self, mut give_back: impl FnMut(Part)) {
        let Some(mut front) = self.assemblies.pop_front() else { return };
        front.slots.iter_mut().filter_map(Option::take).for_each(&mut give_back);
        self.spare.push(front.slots);
        self.next_stretch += 1;
    }
}
