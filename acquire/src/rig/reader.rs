//! The reader: from Start to the end of the stream, every byte into the protocol, every frame into the rings.

use std::{
    cell::Cell,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use anyhow::{anyhow, bail};
use mocapd_drivers::{
    device::{
        Command, DeviceEvent, Hello, LinkBudget, LinkCounters, MarkerInfo, Pong, Status, Trigger,
    },
    transport::TransportError,
};
use mocapd_take::record::{EndingKind, Event, EventKind, TakeEnding};

use super::{ANSWER_WITHIN, Rig, TRIES, refusal};
use crate::{
    clock::Prober,
    files::FileState,
    host_clock::monotonic_ns,
    latency::Latency,
    pipeline::{Counts, Intake, Progress},
    setting::Setting,
};

/// How long a device may send nothing before somebody is told.
const SILENCE: Duration = Duration::from_secs(3);

/// How long to wait for the end of the stream after Stop.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// Frames that are on their way when the time is up still come.
const GRACE_NS: u64 = 1_000_000_000;

/// When to stop, and what to tell.
#[expect(missing_debug_implementations, reason = "a closure has none")]
pub struct ReadOptions<'a> {
    /// Set to end it.
    pub stop: &'a AtomicBool,
    /// Stop after so many rows.
    pub rows_max: Option<u64>,
    /// Stop after so long by the host's clock, too, and a moment for frames that are on their way: they may come slowly,
    /// or not at all.
    pub length: Option<Duration>,
    /// Whether it is there for one take: what ends the take ends the reading, and what others do to the take's file is
    /// said.
    pub for_one_take: bool,
    /// Told, in words, what people should know while it runs.
    pub say: &'a dyn Fn(&str),
    /// How people end it, in words behind those that say that it waits; may be empty.
    pub how_to_end: &'a str,
    /// What to do with a setting that a refusal names, in words.
    pub how_to_set: fn(Setting) -> String,
}

/// What the reader saw.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Why the reading ended; [`CutOff`](EndingKind::CutOff): the take could not be written any more.
    pub ending: EndingKind,
    /// The counters.
    pub counts: Counts,
    /// From the read that brought a frame's last byte to the frame's place in every ring.
    pub ring_latency: Latency,
    /// How often the device went away and came back.
    pub outages: u32,
}

/// How often others are told how long frames take into the rings.
const LATENCY_EVERY_NS: u64 = 1_000_000_000;

/// A device that stalls for ever must fill neither the take nor the screen.
const STALLS_TOLD_MAX: u32 = 32;

/// Neither must a driver that has much to say: of notes that come with one read, no more are kept.
const NOTES_MAX: usize = 8;

impl Rig {
    /// Starts the device and reads it to the end. The intake is finished in every case.
    ///
    /// # Errors
    /// When the device refuses to start or does not answer. A device that goes away is an [`EndingKind`].
    pub fn read(
        mut self,
        mut intake: Intake,
        options: &ReadOptions<'_>,
    ) -> anyhow::Result<Recording> {
        let mut reader = Reader {
            intake: &mut intake,
            latency: Latency::default(),
            latency_told_ns: 0,
            prober: Prober::new(),
            end: None,
            started: None,
            began_anew: None,
            asked: None,
            last_status: None,
            started_again: 0,
            outages: 0,
            notes: Vec::new(),
            due_until_ns: None,
        };
        let outcome = self.read_frames(&mut reader, options);
        let Reader { latency, outages, .. } = reader;
        intake.link(self.link_counters());
        // A take that is open then ends so.
        intake.ends(match &outcome {
            Ok(ending) => (*ending).into(),
            Err(error) => TakeEnding::new(EndingKind::DeviceGone, format!("{error:#}")),
        });
        let counts = intake.finish();
        Ok(Recording { ending: outcome?, counts, ring_latency: latency, outages })
    }

    fn read_frames(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
    ) -> anyhow::Result<EndingKind> {
        self.not_finite_before = self.protocol.counters().samples_not_finite;
        if !self.start(reader, options)? {
            return Ok(EndingKind::Stopped);
        }
        let started_ns = monotonic_ns();
        let length_ns = options.length.map(|length| length.as_nanos() as u64);
        reader.due_until_ns = length_ns.map(|length_ns| started_ns.saturating_add(length_ns));
        let told = Cell::new(reader.intake.progress().file_changes());
        let is_over = |reader: &Reader<'_>| {
            tell_file(reader.intake.progress(), options, &told);
            options.stop.load(Ordering::Relaxed)
                || end_of_take(reader.intake, options).is_some()
                || options.rows_max.is_some_and(|max| reader.intake.next_row() >= max)
                || reader
                    .due_until_ns
                    .is_some_and(|due_ns| monotonic_ns() > due_ns.saturating_add(GRACE_NS))
        };
        loop {
            let or_end = |ending, intake: &Intake| end_of_take(intake, options).unwrap_or(ending);
            let ending = match self.read_until_gone(reader, options, &is_over)? {
                EndingKind::Stopped if options.stop.load(Ordering::Relaxed) => {
                    or_end(EndingKind::Stopped, reader.intake)
                }
                EndingKind::Stopped => or_end(EndingKind::Length, reader.intake),
                ending => ending,
            };
            if ending != EndingKind::DeviceGone {
                return Ok(ending);
            }
            reader.intake.event(host_event("the device was disconnected"));
            reader.intake.away(true);
            if !self.reconnect(reader, options, &is_over) {
                return Ok(or_end(EndingKind::DeviceGone, reader.intake));
            }
            reader.intake.away(false);
            reader.outages += 1;
        }
    }

    /// Reads a device that sends frames, for as long as it is there.
    fn read_until_gone(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        is_over: &dyn Fn(&Reader<'_>) -> bool,
    ) -> anyhow::Result<EndingKind> {
        let mut silence = Silence { last_frame_ns: monotonic_ns(), is_told: false };
        let mut stalls = Stalls { cleared: self.transport.stalls_cleared(), told: 0 };
        let mut stopped_ns = None;
        loop {
            let frames_before = reader.intake.counts_seen();
            match self.pump(reader) {
                Ok(()) => {}
                Err(TransportError::Disconnected { .. }) => return Ok(EndingKind::DeviceGone),
                Err(error) => return Err(anyhow!(error).context("reading from the device")),
            }
            reader.notes.drain(..).for_each(|note| (options.say)(&note));
            let now_ns = monotonic_ns();
            if reader.intake.counts_seen() != frames_before {
                silence = Silence { last_frame_ns: now_ns, is_told: false };
                reader.asked = None;
            }
            silence.tell(now_ns, options);
            stalls.tell(self.transport.stalls_cleared(), reader.intake, options);
            if stopped_ns.is_none() {
                self.probe(reader);
                if silence.is_told {
                    self.ask_who(reader, silence.last_frame_ns, now_ns);
                }
                if let Some(now) = reader.began_anew.take() {
                    match self.follow_hello(reader, &now, options) {
                        Ok(true) => {}
                        Ok(false) | Err(TransportError::Disconnected { .. }) => {
                            return Ok(EndingKind::DeviceGone);
                        }
                        Err(error) => {
                            return Err(anyhow!(error).context("starting the device again"));
                        }
                    }
                }
            }
            if reader.end.is_some() {
                return Ok(stopped_ns.map_or(EndingKind::DeviceEnded, |_| EndingKind::Stopped));
            }
            if reader.intake.has_failed() {
                self.say(Command::Stop).ok();
                return Ok(EndingKind::CutOff);
            }
            match stopped_ns {
                None if is_over(reader) => {
                    if let Some(ending) = self.stop(reader, options, now_ns) {
                        return Ok(ending);
                    }
                    stopped_ns = Some(now_ns);
                }
                Some(stopped_ns) if now_ns - stopped_ns > STOP_WITHIN.as_nanos() as u64 => {
                    (options.say)(
                        "the device does not confirm the stop: what it sent last may be missing",
                    );
                    return Ok(EndingKind::Stopped);
                }
                _ => {}
            }
        }
    }

    /// Tells the device to stop. Gives how the reading ends where its last frames are not waited for.
    fn stop(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        now_ns: u64,
    ) -> Option<EndingKind> {
        match self.say(Command::Stop) {
            Ok(()) => {}
            Err(TransportError::Disconnected { .. }) => return Some(EndingKind::DeviceGone),
            // It takes no commands: the take ends with its last frame.
            Err(error) => {
                (options.say)(&error.to_string());
                return Some(EndingKind::Stopped);
            }
        }
        let due_until_ns = reader.due_until_ns.map_or(now_ns, |due| due.min(now_ns));
        reader.intake.no_frames_due_after(due_until_ns);
        reader.no_longer_asking();
        None
    }

    /// `false` when the user stopped it before the device answered.
    pub(super) fn start(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
    ) -> anyhow::Result<bool> {
        let line_bytes_per_s = self.transport.line_bytes_per_s().unwrap_or(0);
        for _ in 0..TRIES {
            self.say(Command::Start { line_bytes_per_s })?;
            let asked_ns = monotonic_ns();
            while monotonic_ns() - asked_ns < ANSWER_WITHIN.as_nanos() as u64 {
                self.pump(reader)?;
                if options.stop.load(Ordering::Relaxed) {
                    self.say(Command::Stop)?;
                    return Ok(false);
                }
                match reader.started {
                    Some(Ok(())) => return Ok(true),
                    Some(Err(budget)) => return Err(refusal(budget, self.rate_hz(), &self.hello)),
                    None => {}
                }
            }
        }
        bail!("{} does not answer Start: switch it off and on again", self.uri)
    }

    /// Asks the device for its clock, when that is due.
    fn probe(&mut self, reader: &mut Reader<'_>) {
        if reader.intake.wants_probes() {
            reader.prober.hurry();
        }
        let now_ns = monotonic_ns();
        let Some(due_ns) = reader.prober.due(now_ns) else { return };
        // On a line that sends in batches only, between two of them: nothing arrives meanwhile.
        std::thread::sleep(Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        let host_ns = monotonic_ns();
        match self.say(Command::Ping { host_ns }) {
            Ok(()) if !self.outbox.is_empty() => reader.prober.sent(host_ns),
            // Its family has no ping, or it does not read: a recording goes on without. A device that is gone
            // shows in the next read.
            Ok(()) | Err(_) => reader.prober.off(),
        }
    }

    /// What the link counted; samples that were no numbers since Start.
    fn link_counters(&self) -> LinkCounters {
        let counters = self.protocol.counters();
        let samples_not_finite = counters.samples_not_finite - self.not_finite_before;
        LinkCounters { samples_not_finite, ..counters }
    }

    /// One read, and everything it completes.
    fn pump(&mut self, reader: &mut Reader<'_>) -> Result<(), TransportError> {
        let n = self.transport.read(&mut self.buffer)?;
        let arrival_ns = monotonic_ns();
        self.protocol.push(&self.buffer[..n], &mut |event| reader.event(event, arrival_ns));
        if n > 0 {
            reader.intake.link(self.link_counters());
        }
        reader.intake.tick(arrival_ns);
        Ok(())
    }
}

/// Since when no frame came, and whether that was told.
struct Silence {
    last_frame_ns: u64,
    is_told: bool,
}

impl Silence {
    fn tell(&mut self, now_ns: u64, options: &ReadOptions<'_>) {
        if self.is_told || now_ns - self.last_frame_ns <= SILENCE.as_nanos() as u64 {
            return;
        }
        let how_to_end = options.how_to_end;
        (options.say)(&format!(
            "no frame for 3 s: is the device capturing? Still waiting{how_to_end}"
        ));
        self.is_told = true;
    }
}

/// How often the device had stalled and was cleared, and how often that was told.
struct Stalls {
    cleared: u64,
    told: u32,
}

impl Stalls {
    fn tell(&mut self, cleared: u64, intake: &mut Intake, options: &ReadOptions<'_>) {
        if cleared <= self.cleared {
            return;
        }
        self.cleared = cleared;
        self.told += 1;
        if self.told <= STALLS_TOLD_MAX {
            intake.event(host_event("the device stalled, and was cleared"));
            (options.say)("the device stalled, and was cleared: what it was sending may be lost");
        }
        if self.told == STALLS_TOLD_MAX {
            (options.say)("it stalls again and again: no more is said of it");
        }
    }
}

/// What ends a reading that is there for one take, as the writer sees it.
fn end_of_take(intake: &Intake, options: &ReadOptions<'_>) -> Option<EndingKind> {
    let progress = intake.progress();
    match progress.file_state() {
        _ if !options.for_one_take => None,
        FileState::Truncated => Some(EndingKind::Truncated),
        FileState::Unmounted => Some(EndingKind::Unmounted),
        _ => progress.disk_full.load(Ordering::Relaxed).then_some(EndingKind::DiskFull),
    }
}

/// Says once what others did to the file; how it ends a take is said with the end.
fn tell_file(progress: &Progress, options: &ReadOptions<'_>, told: &Cell<u32>) {
    let changes = progress.file_changes();
    let is_said = changes == told.replace(changes);
    if !options.for_one_take || is_said || progress.file_state().ends_take() {
        return;
    }
    if let Some(displaced) = progress.displaced() {
        (options.say)(&displaced.words());
    }
}

pub(super) struct Reader<'a> {
    pub(super) intake: &'a mut Intake,
    latency: Latency,
    latency_told_ns: u64,
    prober: Prober,
    started: Option<Result<(), LinkBudget>>,
    pub(super) end: Option<()>,
    /// It introduced itself while it was to send frames: so.
    began_anew: Option<Hello>,
    /// It was asked who it is, because no frame came.
    pub(super) asked: Option<Asked>,
    /// What it said last of the frames of its run.
    pub(super) last_status: Option<Status>,
    /// Times that it was started again without having gone away.
    pub(super) started_again: u32,
    outages: u32,
    /// What people should be told.
    notes: Vec<String>,
    /// When the time is up, by the host's monotonic clock.
    due_until_ns: Option<u64>,
}

impl Reader<'_> {
    /// The device is back, and will be started again.
    pub(super) fn restart(&mut self, markers: &[MarkerInfo]) {
        self.started = None;
        self.end = None;
        self.began_anew = None;
        self.count_anew();
        self.intake.announce(markers);
    }

    /// Its counter, clock and reports may begin anew.
    pub(super) fn count_anew(&mut self) {
        self.last_status = None;
        self.prober = Prober::new();
        self.intake.rejoin();
    }

    fn event(&mut self, event: DeviceEvent<'_>, arrival_ns: u64) {
        match event {
            DeviceEvent::Frame(frame) => {
                self.intake.frame(&frame, arrival_ns);
                let done_ns = monotonic_ns();
                self.latency.add(done_ns.saturating_sub(arrival_ns));
                if done_ns.saturating_sub(self.latency_told_ns) > LATENCY_EVERY_NS {
                    self.latency_told_ns = done_ns;
                    self.intake.tell_latency(&self.latency);
                }
            }
            DeviceEvent::Markers(markers) => self.intake.announce(markers),
            DeviceEvent::Status(status) => {
                self.last_status = Some(status);
                self.intake.status(status, false);
            }
            DeviceEvent::Note(text) if self.notes.len() < NOTES_MAX => {
                self.intake.event(Event::new(EventKind::Device, monotonic_ns(), text));
                self.notes.push(text.to_owned());
            }
            // Being asked stops it, and some say so.
            DeviceEvent::EndOfStream(status) if self.is_asking() => {
                self.last_status = Some(status);
                self.intake.status(status, false);
            }
            DeviceEvent::EndOfStream(status) if self.started.is_some() => {
                self.intake.status(status, true);
                self.end = Some(());
            }
            DeviceEvent::Started(_) => self.started = Some(Ok(())),
            DeviceEvent::Refused(budget) => self.started = Some(Err(budget)),
            DeviceEvent::Trigger(trigger) => {
                let kind =
                    if trigger.kind == 0 { EventKind::Trigger } else { EventKind::SyncPulse };
                let Trigger { device_ticks, input, .. } = trigger;
                let event = Event::new(kind, arrival_ns, "");
                self.intake.event(Event { device_ticks, input, ..event });
            }
            // An answer to a command of the handshake that came late.
            DeviceEvent::Hello(hello) if self.started.is_some() => {
                self.began_anew = Some(hello.clone());
                self.no_longer_asking();
            }
            DeviceEvent::Pong(Pong { host_ns, device_ticks }) => {
                if self.prober.answered(host_ns, arrival_ns) {
                    self.intake.probe(device_ticks, host_ns, arrival_ns);
                }
            }
            DeviceEvent::Hello(_)
            | DeviceEvent::RateSet(_)
            | DeviceEvent::EndOfStream(_)
            | DeviceEvent::Note(_) => {}
        }
    }
}

pub(super) fn host_event(text: &str) -> Event {
    Event::new(EventKind::Host, monotonic_ns(), text)
}

/// A device that sent frames and is silent for so long is asked who it is, and again after as long: one that starts up
/// needs a while, and being asked stops one that only pauses.
const ASK_EVERY: Duration = Duration::from_secs(10);

/// Starts that get an event and words: a device that is started in vain must fill neither the take nor the screen.
const STARTS_TOLD_MAX: u32 = 32;

/// After so many answers that arrived with damage beside them the last one is believed: a line that is never clean must
/// not keep a device from being started again.
const ASKED_MAX: u32 = 5;

/// When and in what state of the line it was asked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked {
    at_ns: u64,
    /// Messages that had arrived damaged by then.
    damaged: u64,
    /// How often, without a frame in between.
    times: u32,
    /// It has not answered.
    waits: bool,
}

impl Rig {
    /// A device that sent frames and sends none any more may have lost its power while the line to it stayed: it says who
    /// it is when it is asked, and is started again then.
    pub(super) fn ask_who(&mut self, reader: &mut Reader<'_>, last_frame_ns: u64, now_ns: u64) {
        let since_ns = reader.asked.map_or(last_frame_ns, |asked| asked.at_ns);
        let is_due = now_ns.saturating_sub(since_ns) > ASK_EVERY.as_nanos() as u64;
        if is_due && reader.intake.counts_seen() > 0 {
            reader.asked = Some(Asked {
                at_ns: now_ns,
                damaged: self.protocol.counters().messages_damaged,
                times: reader.asked.map_or(1, |asked| asked.times.saturating_add(1)),
                waits: true,
            });
            // A device that is gone shows in the next read.
            self.say(Command::Identify).ok();
        }
    }

    /// A device introduced itself while it was to send frames: its stream ended, or it is started again. `false` when it
    /// is another one.
    pub(super) fn follow_hello(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if let Some(status) = reader.end_that_was_lost(now) {
            let words =
                "the end of the stream was lost on the line: the device was asked, and had ended";
            reader.intake.event(host_event(words));
            (options.say)(words);
            reader.intake.status(status, true);
            reader.end = Some(());
            return Ok(true);
        }
        let damaged = self.protocol.counters().messages_damaged;
        if let Some(asked) = &mut reader.asked
            && now.n_frames > 0
            && damaged > asked.damaged
            && asked.times < ASKED_MAX
        {
            // That its motion is over may have been lost again: it is asked again when that is due, and it waits.
            asked.waits = true;
            return Ok(true);
        }
        self.start_again(reader, now, options)
    }

    /// A device that introduced itself while it was to send frames is started again, as it was. `false` when it is
    /// another one.
    fn start_again(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if (&now.model, &now.serial) != (&self.hello.model, &self.hello.serial) {
            (options.say)(&format!("another device answers, {} {}", now.model, now.serial));
            return Ok(false);
        }
        reader.started_again += 1;
        reader.count_anew();
        if reader.started_again <= STARTS_TOLD_MAX {
            reader.intake.event(host_event("the device introduced itself and was started again"));
            (options.say)(
                "the device introduced itself, as after a reset, a loss of power or a long silence: it was started again",
            );
        }
        if now.rate_mhz != self.hello.rate_mhz {
            self.say(Command::SetRate(self.hello.rate_mhz))?;
        }
        let line_bytes_per_s = self.transport.line_bytes_per_s().unwrap_or(0);
        self.say(Command::Start { line_bytes_per_s })?;
        Ok(true)
    }
}

impl Reader<'_> {
    /// Whether an answer is waited for.
    pub(super) fn is_asking(&self) -> bool {
        self.asked.is_some_and(|asked| asked.waits)
    }

    /// It answered, or is asked no more.
    pub(super) fn no_longer_asking(&mut self) {
        if let Some(asked) = &mut self.asked {
            asked.waits = false;
        }
    }

    /// What a device said of its run that was asked because no frame came, when that was all of a motion: then the end of
    /// its stream was lost on the way.
    fn end_that_was_lost(&self, now: &Hello) -> Option<Status> {
        let of_all = |status: &Status| now.n_frames > 0 && status.frames_produced >= now.n_frames;
        self.last_status.filter(of_all).filter(|_| self.asked.is_some())
    }
}
