//! The reader: decodes the device's stream from start to end and feeds each frame to the intake.

use std::{
    cell::Cell,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use anyhow::{anyhow, bail};
use mocapd_drivers::{
    device::{Command, DeviceEvent, Hello, LinkBudget, LinkCounters, Mark, Pong, Status, Trigger},
    transport::TransportError,
};
use mocapd_take::record::{EndingKind, Event, EventKind, TakeEnding};

use super::{ANSWER_TIMEOUT, ATTEMPTS_MAX, DeviceChannels, Rig, too_slow};
use crate::{
    clock::Prober,
    files::FileState,
    host_clock::{LatencyHistogram, monotonic_ns},
    pipeline::{Counts, Intake, PipelineProgress},
    setting::Setting,
};

/// Report silence of the device after this time.
const SILENCE_MAX: Duration = Duration::from_secs(3);

/// How long to wait for the end of the stream after Stop.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// How long to wait for frames in transit when the time is up.
const GRACE_NS: u64 = 1_000_000_000;

/// When to stop, and how to report.
#[expect(missing_debug_implementations, reason = "a closure has none")]
pub struct ReadOptions<'a> {
    /// Set to stop.
    pub stop: &'a AtomicBool,
    /// Stop after this many rows.
    pub rows_max: Option<u64>,
    /// Stop after this time by the host's clock as well, plus a grace period for frames in transit: frames may come
    /// slowly or not at all.
    pub length: Option<Duration>,
    /// Whether the reader serves a single take: the end of the take ends the reading, and changes to the take's file
    /// are reported.
    pub single_take: bool,
    /// Receives messages for the user while the reader runs.
    pub notify: &'a dyn Fn(&str),
    /// How the user can stop, appended to messages that say that the reader waits; may be empty.
    pub how_to_end: &'a str,
    /// Formats advice on the setting that an error names.
    pub how_to_set: fn(Setting) -> String,
}

/// The reader's results.
#[derive(Debug, Clone)]
pub struct ReaderOutcome {
    /// Why the reading ended; [`CutOff`](EndingKind::CutOff) when the take could not be written any further.
    pub ending: EndingKind,
    /// The final counters.
    pub counts: Counts,
    /// Time from the read that delivered a frame's last byte until the frame was in every ring.
    pub ring_latency: LatencyHistogram,
    /// Times that the device was disconnected and came back.
    pub outages: u32,
}

/// How often the latency is published.
const LATENCY_INTERVAL_NS: u64 = 1_000_000_000;

/// A device that keeps stalling must fill neither the take nor the screen.
const STALLS_REPORTED_MAX: u32 = 32;

/// Notes of the driver kept from one read: a driver with many notes must fill neither the take nor the screen.
const NOTES_MAX: usize = 8;

impl Rig {
    /// Starts the device and reads it to the end. The intake is finished in every case.
    ///
    /// # Errors
    /// When the device refuses to start or does not answer. A disconnected device is an [`EndingKind`], not an error.
    pub fn read(
        mut self,
        mut intake: Intake,
        options: &ReadOptions<'_>,
    ) -> anyhow::Result<ReaderOutcome> {
        let mut reader = Reader {
            intake: &mut intake,
            latency: LatencyHistogram::default(),
            latency_published_ns: 0,
            prober: Prober::new(),
            end: None,
            started: None,
            new_hello: None,
            query: None,
            last_status: None,
            restarts: 0,
            outages: 0,
            notes: Vec::new(),
            due_until_ns: None,
            lost_connection: None,
            last_samples_ns: 0,
        };
        let outcome = self.read_frames(&mut reader, options);
        let Reader { latency, outages, .. } = reader;
        intake.set_link_counters(self.link_counters());
        // An open take gets this ending.
        intake.set_ending(match &outcome {
            Ok(ending) => (*ending).into(),
            Err(error) => TakeEnding::new(EndingKind::DeviceGone, format!("{error:#}")),
        });
        let counts = intake.finish();
        Ok(ReaderOutcome { ending: outcome?, counts, ring_latency: latency, outages })
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
        let reported = Cell::new(reader.intake.progress().file_changes());
        let is_past = |due_ns: u64| monotonic_ns() > due_ns.saturating_add(GRACE_NS);
        let is_over = |reader: &Reader<'_>| {
            report_file_change(reader.intake.progress(), options, &reported);
            reader.intake.progress().take_notices().iter().for_each(|text| (options.notify)(text));
            options.stop.load(Ordering::Relaxed)
                || take_ending(reader.intake, options).is_some()
                || options.rows_max.is_some_and(|max| reader.intake.next_row() >= max)
                || reader.due_until_ns.is_some_and(is_past)
        };
        let mut last_outage = None;
        loop {
            let or_end = |ending, intake: &Intake| take_ending(intake, options).unwrap_or(ending);
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
            let frames_seen = reader.intake.frames_seen();
            let mut outage = Outage::begin(last_outage, frames_seen, monotonic_ns());
            if outage.is_reported() {
                reader.intake.event(host_event(&match &reader.lost_connection {
                    Some(cause) => format!("the connection was lost: {cause}"),
                    None => "the device was disconnected".to_owned(),
                }));
            }
            reader.intake.set_away(true);
            if !self.reconnect((reader, &mut outage), options, &is_over) {
                return Ok(or_end(EndingKind::DeviceGone, reader.intake));
            }
            reader.intake.set_away(false);
            last_outage = Some(outage);
            reader.outages += 1;
        }
    }

    /// Reads a device that sends frames, until it stops or is disconnected.
    fn read_until_gone(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        is_over: &dyn Fn(&Reader<'_>) -> bool,
    ) -> anyhow::Result<EndingKind> {
        let mut silence = Silence { last_frame_ns: monotonic_ns(), is_reported: false };
        let mut stalls = Stalls { cleared: self.transport.stalls_cleared(), reported: 0 };
        let mut stopped_ns = None;
        loop {
            let frames_before = reader.intake.frames_seen();
            match self.read_once(reader) {
                Ok(()) => {}
                Err(error) if error.is_gone() => {
                    reader.lost_connection = match error {
                        TransportError::ConnectionLost { cause, .. } => Some(cause),
                        _ => None,
                    };
                    return Ok(EndingKind::DeviceGone);
                }
                Err(error) => return Err(anyhow!(error).context("reading from the device")),
            }
            reader.notes.drain(..).for_each(|note| (options.notify)(&note));
            let now_ns = monotonic_ns();
            if reader.intake.frames_seen() != frames_before {
                silence = Silence { last_frame_ns: now_ns, is_reported: false };
                reader.query = None;
            }
            silence.report(now_ns, options);
            stalls.report(self.transport.stalls_cleared(), reader.intake, options);
            if stopped_ns.is_none() {
                self.probe(reader);
                // A device whose samples come is alive: asking it would stop them.
                let has_samples = reader.last_samples_ns + SILENCE_MAX.as_nanos() as u64 > now_ns;
                if silence.is_reported && !has_samples {
                    self.check_alive(reader, silence.last_frame_ns, now_ns);
                }
                if let Some(now) = reader.new_hello.take() {
                    match self.handle_hello(reader, &now, options) {
                        Ok(true) => {}
                        Ok(false) => return Ok(EndingKind::DeviceGone),
                        Err(error) if error.is_gone() => return Ok(EndingKind::DeviceGone),
                        Err(error) => {
                            return Err(anyhow!(error).context("restarting the device"));
                        }
                    }
                }
            }
            if reader.end.is_some() {
                return Ok(stopped_ns.map_or(EndingKind::DeviceEnded, |_| EndingKind::Stopped));
            }
            if reader.intake.has_failed() {
                self.send(Command::Stop).ok();
                return Ok(EndingKind::CutOff);
            }
            match stopped_ns {
                None if is_over(reader) => {
                    if let Some(ending) = self.stop(reader, options, now_ns) {
                        return Ok(ending);
                    }
                    stopped_ns = Some(now_ns);
                }
                Some(stopped_ns) if now_ns - stopped_ns > STOP_TIMEOUT.as_nanos() as u64 => {
                    (options.notify)(
                        "the device does not confirm the stop: its last frames may be missing",
                    );
                    return Ok(EndingKind::Stopped);
                }
                _ => {}
            }
        }
    }

    /// Sends Stop. Returns an ending when the last frames are not to be waited for.
    fn stop(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        now_ns: u64,
    ) -> Option<EndingKind> {
        match self.send(Command::Stop) {
            Ok(()) => {}
            Err(error) if error.is_gone() => return Some(EndingKind::DeviceGone),
            // The device takes no commands: the take ends with its last frame.
            Err(error) => {
                (options.notify)(&error.to_string());
                return Some(EndingKind::Stopped);
            }
        }
        let due_until_ns = reader.due_until_ns.map_or(now_ns, |due| due.min(now_ns));
        reader.intake.no_frames_due_after(due_until_ns);
        reader.clear_query();
        None
    }

    /// Returns `false` when the user stopped it before the device answered.
    pub(super) fn start(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
    ) -> anyhow::Result<bool> {
        let line_bytes_per_s = self.transport.line_bytes_per_s().unwrap_or(0);
        for _ in 0..ATTEMPTS_MAX {
            self.send(Command::Start { line_bytes_per_s })?;
            let sent_ns = monotonic_ns();
            while monotonic_ns() - sent_ns < ANSWER_TIMEOUT.as_nanos() as u64 {
                self.read_once(reader)?;
                if options.stop.load(Ordering::Relaxed) {
                    self.send(Command::Stop)?;
                    return Ok(false);
                }
                match reader.started {
                    Some(Ok(())) => return Ok(true),
                    Some(Err(budget)) => return Err(too_slow(budget, self.rate_hz(), &self.hello)),
                    None => {}
                }
            }
        }
        bail!("{} does not answer Start: switch it off and on again", self.uri)
    }

    /// Sends a ping when one is due.
    fn probe(&mut self, reader: &mut Reader<'_>) {
        if reader.intake.wants_probes() {
            reader.prober.restart_schedule();
        }
        let now_ns = monotonic_ns();
        let Some(due_ns) = reader.prober.due(now_ns) else { return };
        // Sleeps only on a line that sends in batches, between two batches, when nothing arrives.
        std::thread::sleep(Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        let host_ns = monotonic_ns();
        match self.send(Command::Ping { host_ns }) {
            Ok(()) if !self.outbox.is_empty() => reader.prober.sent(host_ns),
            // The driver has no ping, or the device does not read: record without. A disconnected device shows in the
            // next read.
            Ok(()) | Err(_) => reader.prober.disable(),
        }
    }

    /// The link counters, with non-finite samples counted since the start.
    fn link_counters(&self) -> LinkCounters {
        let counters = self.protocol.counters();
        let samples_not_finite = counters.samples_not_finite - self.not_finite_before;
        LinkCounters { samples_not_finite, ..counters }
    }

    /// One read, and all messages that it completes.
    fn read_once(&mut self, reader: &mut Reader<'_>) -> Result<(), TransportError> {
        let n = self.transport.read(&mut self.buffer)?;
        let now_ns = monotonic_ns();
        // The kernel's time of a datagram is free of the delay until this read.
        let received_ns = self.transport.arrival().host_ns.filter(|_| n > 0);
        let arrival_ns = received_ns.map_or(now_ns, |received_ns| received_ns.min(now_ns));
        self.protocol.push(&self.buffer[..n], &mut |event| reader.event(event, arrival_ns));
        if n > 0 {
            reader.intake.set_link_counters(self.link_counters());
        }
        reader.intake.tick(now_ns);
        Ok(())
    }
}

/// A device that comes back for less than this, and sends no frame, has not come back.
const STEADY_AFTER: Duration = Duration::from_secs(10);

/// The time from the return of such a device to the next attempt: it doubles with each.
const RETURN_INTERVAL_MIN: Duration = Duration::from_millis(500);
const RETURN_INTERVAL_MAX: Duration = Duration::from_secs(5);

/// Outages that are reported: a device that is lost again and again must fill neither the take nor the screen.
const OUTAGES_REPORTED_MAX: u32 = 32;

/// An outage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Outage {
    pub(super) lost_ns: u64,
    /// Frames before it.
    frames_seen: u64,
    /// How often the device came back in it, and when it did last.
    returns: u32,
    back_ns: u64,
    /// Number of the outage, from 1 on.
    number: u32,
}

impl Outage {
    /// The outage that begins when a connection is lost. It is the last one, of which the time goes on, if the device came back
    /// for a moment only: it would be tried again and again, and waited for without an end.
    fn begin(last: Option<Self>, frames_seen: u64, now_ns: u64) -> Self {
        let steady_ns = STEADY_AFTER.as_nanos() as u64;
        let number = last.map_or(0, |last| last.number).saturating_add(1);
        let goes_on = |last: &Self| {
            last.frames_seen == frames_seen && now_ns.saturating_sub(last.back_ns) < steady_ns
        };
        let new = Self { lost_ns: now_ns, frames_seen, returns: 0, back_ns: 0, number };
        last.filter(goes_on).unwrap_or(new)
    }

    /// Whether it is reported: once, when it begins.
    pub(super) fn is_reported(&self) -> bool {
        self.returns == 0 && self.number <= OUTAGES_REPORTED_MAX
    }

    /// The device is back.
    pub(super) fn came_back(&mut self, now_ns: u64) {
        self.returns = self.returns.saturating_add(1);
        self.back_ns = now_ns;
    }

    /// How long nothing is tried.
    pub(super) fn pause(&self) -> Duration {
        let Some(earlier) = self.returns.checked_sub(1) else { return Duration::ZERO };
        RETURN_INTERVAL_MIN.saturating_mul(1 << earlier.min(16)).min(RETURN_INTERVAL_MAX)
    }
}

/// When the last frame came, and whether the silence since then was reported.
struct Silence {
    last_frame_ns: u64,
    is_reported: bool,
}

impl Silence {
    fn report(&mut self, now_ns: u64, options: &ReadOptions<'_>) {
        if self.is_reported || now_ns - self.last_frame_ns <= SILENCE_MAX.as_nanos() as u64 {
            return;
        }
        let how_to_end = options.how_to_end;
        let text = format!("no frame for 3 s: is the device capturing? Still waiting{how_to_end}");
        (options.notify)(&text);
        self.is_reported = true;
    }
}

/// Stalls of the device that the transport has cleared, and how many were reported.
struct Stalls {
    cleared: u64,
    reported: u32,
}

impl Stalls {
    fn report(&mut self, cleared: u64, intake: &mut Intake, options: &ReadOptions<'_>) {
        if cleared <= self.cleared {
            return;
        }
        self.cleared = cleared;
        self.reported += 1;
        if self.reported <= STALLS_REPORTED_MAX {
            intake.event(host_event("the device stalled and its endpoint was cleared"));
            (options.notify)("the device stalled and its endpoint was cleared: data may be lost");
        }
        if self.reported == STALLS_REPORTED_MAX {
            (options.notify)("the device keeps stalling: further stalls are not reported");
        }
    }
}

/// The ending of a single take that the writer asks for.
fn take_ending(intake: &Intake, options: &ReadOptions<'_>) -> Option<EndingKind> {
    let progress = intake.progress();
    match progress.file_state() {
        _ if !options.single_take => None,
        FileState::Truncated => Some(EndingKind::Truncated),
        FileState::Unmounted => Some(EndingKind::Unmounted),
        _ => progress.disk_full.load(Ordering::Relaxed).then_some(EndingKind::DiskFull),
    }
}

/// Reports each change of the take's file once. A change that ends the take is reported with its end.
fn report_file_change(
    progress: &PipelineProgress,
    options: &ReadOptions<'_>,
    reported: &Cell<u32>,
) {
    let changes = progress.file_changes();
    let is_reported = changes == reported.replace(changes);
    if !options.single_take || is_reported || progress.file_state().ends_take() {
        return;
    }
    if let Some(displaced) = progress.displaced() {
        (options.notify)(&displaced.message());
    }
}

pub(super) struct Reader<'a> {
    pub(super) intake: &'a mut Intake,
    latency: LatencyHistogram,
    latency_published_ns: u64,
    prober: Prober,
    started: Option<Result<(), LinkBudget>>,
    pub(super) end: Option<()>,
    /// A hello received during the stream: the device identified itself again.
    new_hello: Option<Hello>,
    /// Set when the device was asked for its identity because no frame came; cleared by the next frame.
    pub(super) query: Option<IdentityQuery>,
    /// The device's last status report of this run.
    pub(super) last_status: Option<Status>,
    /// Restarts without a disconnection.
    pub(super) restarts: u32,
    outages: u32,
    /// Messages for the user.
    notes: Vec<String>,
    /// When the time is up, by the host's monotonic clock.
    due_until_ns: Option<u64>,
    /// How the connection to a device on the network ended.
    pub(super) lost_connection: Option<String>,
    /// Arrival of the last batch of samples.
    last_samples_ns: u64,
}

impl Reader<'_> {
    /// The device is back and will be started again.
    pub(super) fn restart(&mut self, channels: &DeviceChannels) {
        self.started = None;
        self.end = None;
        self.new_hello = None;
        self.reset_counters();
        self.intake.announce(&channels.markers);
        channels.sampled.iter().for_each(|group| self.intake.announce_group(group));
        self.intake.announce_bodies(&channels.bodies);
    }

    /// The device's counter, clock and status reports may start again from zero.
    pub(super) fn reset_counters(&mut self) {
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
                if done_ns.saturating_sub(self.latency_published_ns) > LATENCY_INTERVAL_NS {
                    self.latency_published_ns = done_ns;
                    self.intake.publish_latency(&self.latency);
                }
            }
            DeviceEvent::Samples(batch) => {
                self.last_samples_ns = arrival_ns;
                self.intake.samples(&batch);
            }
            DeviceEvent::Poses(frame) => {
                self.last_samples_ns = arrival_ns;
                self.intake.poses(&frame);
            }
            DeviceEvent::EndOfPoses(end) => self.intake.end_of_poses(&end),
            DeviceEvent::Markers(markers) => self.intake.announce(markers),
            DeviceEvent::SampledGroup(group) => self.intake.announce_group(group),
            DeviceEvent::Bodies(bodies) => self.intake.announce_bodies(bodies),
            // A take has those that were announced before it.
            DeviceEvent::ForcePlate(_) => {}
            DeviceEvent::Status(status) => {
                self.last_status = Some(status);
                self.intake.status(status, false);
            }
            DeviceEvent::Note(text) if self.notes.len() < NOTES_MAX => {
                self.intake.event(Event::new(EventKind::Device, monotonic_ns(), text));
                self.notes.push(text.to_owned());
            }
            // Some devices confirm that the query stopped their stream.
            DeviceEvent::EndOfStream(status) if self.is_querying() => {
                self.last_status = Some(status);
                self.intake.status(status, false);
            }
            DeviceEvent::EndOfStream(status) if self.started.is_some() => {
                self.intake.status(status, true);
                self.end = Some(());
            }
            DeviceEvent::Started(_) => self.started = Some(Ok(())),
            DeviceEvent::Refused(budget) => self.started = Some(Err(budget)),
            DeviceEvent::Trigger(Trigger { device_ticks, input, kind }) => {
                let kind = if kind == 0 { EventKind::Trigger } else { EventKind::SyncPulse };
                let event = Event::new(kind, arrival_ns, "");
                self.intake.event(Event { device_ticks, input, ..event });
            }
            DeviceEvent::Mark(Mark { device_ticks, text }) => {
                let event = Event::new(EventKind::Mark, arrival_ns, text);
                self.intake.device_event(Event { device_ticks, ..event });
            }
            // A late answer to a command of the handshake.
            DeviceEvent::Hello(hello) if self.started.is_some() => {
                self.new_hello = Some(hello.clone());
                self.clear_query();
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

/// A device that sent frames and is silent is asked for its identity after this time, and again each time it passes: a
/// device that is starting up needs a while, and the query stops one that only pauses.
const IDENTIFY_INTERVAL: Duration = Duration::from_secs(10);

/// Restarts that are reported: a device that restarts again and again must fill neither the take nor the screen.
const RESTARTS_REPORTED_MAX: u32 = 32;

/// After this many answers that came with damaged messages the last one is believed: on a line that is never clean the
/// device must still be restarted.
const IDENTIFY_ATTEMPTS_MAX: u32 = 5;

/// A query for the device's identity.
#[derive(Debug, Clone, Copy)]
pub(super) struct IdentityQuery {
    at_ns: u64,
    /// Damaged messages counted when it was sent.
    damaged: u64,
    /// Queries since the last frame.
    attempts: u32,
    /// Whether it has not been answered yet.
    is_pending: bool,
}

impl Rig {
    /// Asks a device that has stopped sending frames for its identity. It may have lost its power while its line stayed
    /// up: it then answers, and is started again.
    pub(super) fn check_alive(&mut self, reader: &mut Reader<'_>, last_frame_ns: u64, now_ns: u64) {
        let since_ns = reader.query.map_or(last_frame_ns, |query| query.at_ns);
        let is_due = now_ns.saturating_sub(since_ns) > IDENTIFY_INTERVAL.as_nanos() as u64
            && !self.protocol.checks_silence();
        if is_due && reader.intake.frames_seen() > 0 {
            reader.query = Some(IdentityQuery {
                at_ns: now_ns,
                damaged: self.protocol.counters().messages_damaged,
                attempts: reader.query.map_or(1, |query| query.attempts.saturating_add(1)),
                is_pending: true,
            });
            // A device that is gone shows in the next read.
            self.send(Command::Identify).ok();
        }
    }

    /// The device identified itself during the stream: either its stream had ended, or it is restarted. Returns `false`
    /// for another device.
    pub(super) fn handle_hello(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if let Some(status) = reader.lost_end_status(now) {
            let text = "the end-of-stream message was lost on the line: the device reports that its stream has ended";
            reader.intake.event(host_event(text));
            (options.notify)(text);
            reader.intake.status(status, true);
            reader.end = Some(());
            return Ok(true);
        }
        let damaged = self.protocol.counters().messages_damaged;
        if let Some(query) = &mut reader.query
            && now.n_frames > 0
            && damaged > query.damaged
            && query.attempts < IDENTIFY_ATTEMPTS_MAX
        {
            // The message that its motion is over may be lost again: wait, and query again when that is due.
            query.is_pending = true;
            return Ok(true);
        }
        self.restart_device(reader, now, options)
    }

    /// Restarts a device that identified itself during the stream, with its settings. Returns `false` for another
    /// device.
    fn restart_device(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if (&now.model, &now.serial) != (&self.hello.model, &self.hello.serial) {
            (options.notify)(&self.another_device(now));
            return Ok(false);
        }
        reader.restarts += 1;
        reader.reset_counters();
        if reader.restarts <= RESTARTS_REPORTED_MAX {
            reader.intake.event(host_event("the device identified itself again and was restarted"));
            (options.notify)(
                "the device identified itself again, as after a reset, a power loss or a long silence: mocapd restarted it",
            );
        }
        if now.rate_millihertz != self.hello.rate_millihertz {
            self.send(Command::SetRate(self.hello.rate_millihertz))?;
        }
        let line_bytes_per_s = self.transport.line_bytes_per_s().unwrap_or(0);
        self.send(Command::Start { line_bytes_per_s })?;
        Ok(true)
    }
}

impl Reader<'_> {
    /// Whether an answer is expected.
    pub(super) fn is_querying(&self) -> bool {
        self.query.is_some_and(|query| query.is_pending)
    }

    /// The device answered, or is not asked any more.
    pub(super) fn clear_query(&mut self) {
        if let Some(query) = &mut self.query {
            query.is_pending = false;
        }
    }

    /// The last status report of a device that was queried because no frame came, if it had sent its whole motion: then
    /// the end of its stream was lost on the line.
    fn lost_end_status(&self, now: &Hello) -> Option<Status> {
        let complete = |status: &Status| now.n_frames > 0 && status.frames_produced >= now.n_frames;
        self.last_status.filter(complete).filter(|_| self.query.is_some())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn an_outage_goes_on_until_a_frame_comes_or_the_device_stays() {
        let mut outage = Outage::begin(None, 100, 10 * S);
        assert!(outage.is_reported() && outage.pause().is_zero());
        let mut pauses = Vec::new();
        for second in 11..20 {
            outage.came_back(second * S);
            outage = Outage::begin(Some(outage), 100, second * S + S / 2);
            assert_eq!((outage.lost_ns, outage.is_reported()), (10 * S, false));
            pauses.push(outage.pause().as_millis());
        }
        assert_eq!(pauses[..5], [500, 1000, 2000, 4000, 5000]);
        assert_eq!(pauses[8], 5000);
        outage.came_back(20 * S);
        let after_a_frame = Outage::begin(Some(outage), 101, 21 * S);
        let after_a_while = Outage::begin(Some(outage), 100, 30 * S);
        for new in [after_a_frame, after_a_while] {
            assert!(new.lost_ns > 20 * S && new.is_reported() && new.pause().is_zero());
        }
    }

    #[test]
    fn outages_that_never_end_are_not_reported_for_ever() {
        let mut last = None;
        let reported = (0..100_u64).filter(|n| {
            let outage = Outage::begin(last, *n, n * S);
            last = Some(outage);
            outage.is_reported()
        });
        assert_eq!(reported.count(), OUTAGES_REPORTED_MAX as usize);
    }
}
