//! A simulated QTM that plays a motion as a file in real time. Sans-io: connections, their bytes and the time go in, bytes
//! and datagrams come out; [`QtmListener`] puts it on the network.
//!
//! Labelled markers are sent with their labels, all others as unlabelled markers with ids. The file is played from its first
//! frame when the first client requests frames.

mod changes;
pub(crate) mod fates;
mod samples;
mod serve;

use std::net::SocketAddr;
use std::sync::Arc;

use changes::Changes;
use fates::DeliveryLog;
use mocapd_drivers::device::{MarkerSample, Pose};
use mocapd_drivers::qtm::{
    BodySettings, ClientId, Datagram, Delivery, FrameHeader, LABELS_MAX, MISSING, QtmServer,
    ServedBody, ServedFrame, ServedSettings, WireMarker,
};
use mocapd_take::motion::{Motion, Position, UpAxis, is_gap};
use samples::FileSamples;

use crate::device::{
    DeviceError, FaultCounts, FrameFate, Rates, SentCounters, SentFrame, SentLog, frame_after_ns,
};
use crate::faults::{
    ConnectionFaults, ConnectionState, Fault, Kind, Kinds, Script, SourceFaults, stream,
};
use crate::generator::RigidBodies;
use crate::sampled::SampledSource;
use crate::source::{Replay, Residuals};

pub use samples::force_of;
pub use serve::{QtmListener, ServeError};

/// Residual of every marker of a motion without any.
const RESIDUAL_MM: f32 = 0.25;

/// Id of the first unlabelled marker: unlike a marker's place, so that nobody can take one for the other.
const FIRST_ID: u32 = 1000;

/// What it says to be.
const VERSION: &str = concat!("mocapd-sim ", env!("CARGO_PKG_VERSION"));

/// How a QTM plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct QtmSettings {
    /// Resample the motion to this rate, Hz; `None` keeps the recorded rate.
    pub rate_hz: Option<f64>,
    /// Playback speed, 0.001 to 1000, rounded to 0.001.
    pub speed: f64,
    /// Restart after the last frame, and never end.
    pub looping: bool,
    /// Faults of frames, time and connection.
    pub faults: Option<Arc<Script>>,
    /// Analog devices and force plates.
    pub sampled: Vec<SampledSource>,
    /// Rigid bodies.
    pub bodies: Option<Arc<RigidBodies>>,
    /// The residuals of the motion's markers; by default all are alike.
    pub residuals: Option<Arc<Residuals>>,
}

impl Default for QtmSettings {
    fn default() -> Self {
        Self {
            rate_hz: None,
            speed: 1.0,
            looping: false,
            faults: None,
            sampled: Vec::new(),
            bodies: None,
            residuals: None,
        }
    }
}

/// Why a motion cannot be played as a QTM.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum QtmError {
    /// A fault that does not happen on a network.
    #[error(
        "{kind} does not happen to a QTM on a network, where the system repairs or discards damaged bytes: remove it from the script"
    )]
    Fault {
        /// Its name.
        kind: &'static str,
    },
    /// The motion or a setting suits no device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// A simulated QTM.
#[derive(Debug)]
pub struct QtmDevice {
    settings: QtmSettings,
    server: QtmServer,
    /// Its settings, if no label is late.
    served: ServedSettings,
    changes: Changes,
    /// The client with the first stream.
    first_client: Option<ClientId>,
    samples: FileSamples,
    replay: Replay,
    rates: Rates,
    /// The columns of the labelled markers, and those of the others.
    labelled: Vec<usize>,
    unlabelled: Vec<usize>,
    faults: Option<SourceFaults>,
    connection: ConnectionFaults,
    state: ConnectionState,
    /// The caller's clock when QTM's clock was 0, when frames were first requested, and when the file was started.
    epoch_ns: Option<u64>,
    first_start_ns: Option<u64>,
    start_ns: Option<u64>,
    /// Frames since the file was started, and the number of the next one.
    played: u64,
    number: u32,
    log: DeliveryLog,
    counters: SentCounters,
    counts: FaultCounts,
    /// Datagrams that faults hold back, and frames until they are sent.
    late: Vec<(u32, Vec<FrameDatagram>)>,
    out: Vec<FrameDatagram>,
    /// Bytes in `out`.
    out_bytes: usize,
    ends: u64,
    row: Vec<Position>,
    ghosts: Vec<MarkerSample>,
    markers: [Vec<WireMarker>; 2],
    poses: Vec<Pose>,
    bodies: Vec<ServedBody>,
}

/// A datagram, and the number of its frame among all that were produced; `None` for the end of a measurement.
#[derive(Debug, Clone)]
struct FrameDatagram {
    frame: Option<u64>,
    datagram: Datagram,
}

/// Bytes of datagrams that wait during a stall, as many as wait for a client on its connection.
const DATAGRAM_BYTES_MAX: usize = 4 << 20;

/// What the faults of a script do to one frame on its way.
#[derive(Debug, Clone, Copy)]
struct FrameFaults {
    is_lost: bool,
    copies: usize,
    late_by: Option<u32>,
}

impl QtmDevice {
    /// Creates a QTM with the motion as its open file.
    ///
    /// # Errors
    /// When the motion is empty or has too many markers, a rate or speed is out of range, or a fault does not happen on a
    /// network.
    pub fn new(motion: impl Into<Arc<Motion>>, settings: QtmSettings) -> Result<Self, QtmError> {
        let motion = motion.into();
        let markers = &motion.info.markers;
        match (markers.len(), motion.n_frames()) {
            (0, _) => return Err(DeviceError::NoMarkers.into()),
            (_, 0) => return Err(DeviceError::NoFrames.into()),
            (found, _) if found > LABELS_MAX => {
                return Err(DeviceError::TooManyMarkers { found, max: LABELS_MAX }.into());
            }
            _ => {}
        }
        let no_faults = || Arc::new(Script { seed: 0, faults: Vec::new(), expect: None });
        let script = settings.faults.clone().unwrap_or_else(no_faults);
        if let Some(kind) =
            script.faults.iter().map(|f| f.fault.kind()).find(|k| !changes::happens(*k))
        {
            return Err(QtmError::Fault { kind: kind.name() });
        }
        let (labelled, unlabelled): (Vec<_>, Vec<_>) =
            (0..markers.len()).partition(|column| markers.get(*column).is_some_and(|m| m.labelled));
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let samples = FileSamples::new(&settings.sampled);
        let (analog, plates) = samples.devices();
        let served = ServedSettings {
            frequency_hz: f64::from(rates.rate_millihertz) / 1000.0,
            up_axis: match motion.info.up {
                UpAxis::X => "+X",
                UpAxis::Y => "+Y",
                // A laboratory's axis; QTM has no word for an unknown one.
                UpAxis::Z | UpAxis::Unknown => "+Z",
            },
            labels: labelled.iter().filter_map(|c| Some(markers.get(*c)?.label.clone())).collect(),
            bodies: settings
                .bodies
                .as_ref()
                .map(|bodies| body_settings(bodies))
                .unwrap_or_default(),
            analog,
            plates,
        };
        let changes = Changes::new(Arc::clone(&script));
        let n_columns = markers.len();
        let replay = rates.replay(motion, rates.rate_millihertz);
        Ok(Self {
            server: QtmServer::new(shown(&served, &changes), VERSION.to_owned()),
            served,
            changes,
            first_client: None,
            samples,
            replay,
            rates,
            labelled,
            unlabelled,
            faults: settings.faults.clone().map(|script| SourceFaults::new(script, n_columns)),
            connection: ConnectionFaults::new(&script),
            state: ConnectionState { plugged: true, powered: true, flows: true },
            epoch_ns: None,
            first_start_ns: None,
            start_ns: None,
            played: 0,
            number: 0,
            log: DeliveryLog::default(),
            counters: SentCounters::default(),
            counts: FaultCounts::default(),
            late: Vec::new(),
            out: Vec::new(),
            out_bytes: 0,
            ends: 0,
            row: Vec::new(),
            ghosts: Vec::new(),
            markers: [Vec::new(), Vec::new()],
            poses: Vec::new(),
            bodies: Vec::new(),
            settings,
        })
    }

    /// The frame rate, in millihertz.
    #[must_use]
    pub fn rate_millihertz(&self) -> u32 {
        self.rates.rate_millihertz
    }

    /// Whether clients can reach it: not while it is switched off or its cable is pulled.
    #[must_use]
    pub fn is_reachable(&self) -> bool {
        self.state.plugged && self.state.powered
    }

    /// Accepts a client; `None` when there are too many.
    pub fn connect(&mut self, peer: SocketAddr) -> Option<ClientId> {
        self.server.connect(peer)
    }

    /// A client has closed its connection.
    pub fn disconnect(&mut self, id: ClientId) {
        self.log.abandon(id);
        self.changes.forget(id);
        self.server.disconnect(id);
    }

    /// Takes bytes from a client.
    pub fn on_bytes(&mut self, id: ClientId, bytes: &[u8], now_ns: u64) {
        self.epoch_ns.get_or_insert(now_ns);
        let starts = self.server.n_streams();
        self.server.receive(id, bytes);
        if self.server.n_streams() > starts {
            self.first_start_ns.get_or_insert(now_ns);
        }
        self.poll(now_ns);
    }

    /// Whether more bytes of a client may be read.
    #[must_use]
    pub fn may_receive(&self, id: ClientId) -> bool {
        self.server.may_receive(id)
    }

    /// Whether a client is to be disconnected once it has what is pending.
    #[must_use]
    pub fn is_out_of_step(&self, id: ClientId) -> bool {
        self.server.is_out_of_step(id)
    }

    /// The bytes to send to a client now.
    #[must_use]
    pub fn pending(&self, id: ClientId) -> &[u8] {
        match self.server.pending(id) {
            _ if !self.state.flows => &[],
            [] => self.changes.pending(id),
            pending => pending,
        }
    }

    /// Whether no client has bytes pending.
    #[must_use]
    pub fn is_all_sent(&self) -> bool {
        !self.state.flows || self.server.is_all_sent()
    }

    /// The connection took the first `n` pending bytes.
    pub fn sent(&mut self, id: ClientId, n: usize) {
        if self.server.pending(id).is_empty() {
            return self.changes.sent(id, n);
        }
        self.server.sent(id, n);
        self.log.taken(id, self.server.bytes_sent(id), n);
    }

    /// Sends the datagrams that are due: `send` returns whether the system took one.
    pub fn send_datagrams(&mut self, mut send: impl FnMut(&Datagram) -> bool) {
        if !self.state.flows {
            return;
        }
        self.out_bytes = 0;
        for FrameDatagram { frame, datagram } in std::mem::take(&mut self.out) {
            let bytes = send(&datagram).then_some(datagram.bytes.len());
            if let Some(frame) = frame {
                self.log.datagram_taken(frame, bytes);
            }
        }
        self.log.settle();
    }

    /// Queues datagrams of a frame, or of the end of a measurement.
    fn queue(&mut self, datagrams: Vec<FrameDatagram>) {
        self.out_bytes += datagrams.iter().map(|d| d.datagram.bytes.len()).sum::<usize>();
        self.out.extend(datagrams);
    }

    /// Does everything that is due. Returns the time of the next event; `u64::MAX` when only a client can cause one.
    pub fn poll(&mut self, now_ns: u64) -> u64 {
        self.update_state(now_ns);
        let next_ns = if self.state.powered { self.play_until(now_ns) } else { u64::MAX };
        let Some(since_ns) = self.since_ns(now_ns) else { return next_ns };
        let change_ns = self.connection.next_ns(since_ns);
        next_ns.min(change_ns.saturating_add(now_ns - since_ns))
    }

    fn since_ns(&self, at_ns: u64) -> Option<u64> {
        self.first_start_ns.map(|start_ns| at_ns.saturating_sub(start_ns))
    }

    /// Applies the outages that begin or end at this time.
    fn update_state(&mut self, now_ns: u64) {
        let Some(since_ns) = self.since_ns(now_ns) else { return };
        let before = std::mem::replace(&mut self.state, self.connection.state(since_ns));
        if before.powered && !self.state.powered {
            self.server.restart();
            self.log.cut(Kind::PowerLoss);
            (self.start_ns, self.played, self.number) = (None, 0, 0);
            self.samples.reset();
            if let Some(faults) = &mut self.faults {
                faults.reset();
            }
        } else if before.plugged && !self.state.plugged {
            self.server.disconnect_all();
            self.log.cut(Kind::Unplug);
        }
        if !self.state.plugged || !self.state.powered {
            self.changes.forget_all();
            self.first_client = None;
            self.late.clear();
            self.out.clear();
            self.out_bytes = 0;
        }
        if !before.powered && self.state.powered {
            self.epoch_ns = Some(now_ns);
        }
    }

    /// Plays the frames that are due, and returns the time of the next.
    fn play_until(&mut self, now_ns: u64) -> u64 {
        if !self.server.is_playing() {
            (self.start_ns, self.played) = (None, 0);
            return u64::MAX;
        }
        let n_frames = self.replay.n_frames().max(1);
        if self.start_ns.is_none() {
            self.samples.start();
        }
        let start_ns = *self.start_ns.get_or_insert(now_ns);
        loop {
            let next_ns =
                start_ns.saturating_add(frame_after_ns(self.played, self.rates.rate_millihertz));
            if next_ns > now_ns {
                return next_ns;
            }
            if !self.settings.looping && self.played >= n_frames {
                self.end();
                return u64::MAX;
            }
            self.samples.add_until(next_ns - start_ns, &mut self.server);
            self.play(self.played % n_frames, next_ns);
        }
    }

    /// The file is over.
    fn end(&mut self) {
        self.release(u32::MAX);
        self.server.end_measurement();
        let last = self.server.take_datagrams().into_iter();
        self.queue(last.map(|datagram| FrameDatagram { frame: None, datagram }).collect());
        (self.start_ns, self.played) = (None, 0);
        self.ends += 1;
    }

    fn play(&mut self, index: u64, at_ns: u64) {
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        self.replay.frame(index, &mut self.row);
        let mut number = self.number;
        self.number = self.number.wrapping_add(1);
        self.played += 1;
        let mut ahead_ns = 0;
        self.ghosts.clear();
        if let Some(faults) = &mut self.faults {
            number = faults.counter(number, since_ns);
            faults.positions(since_ns, &mut self.row);
            faults.count_clock_faults(since_ns);
            faults.add_ghosts(since_ns, &mut self.ghosts);
            ahead_ns = faults.clock_offset_ns(since_ns) - faults.stamp_jitter_ns(since_ns);
        }
        self.apply_changes(since_ns);
        self.fill_markers(index);
        self.fill_bodies(index, since_ns);
        let present = self.row.iter().filter(|position| !is_gap(**position)).count();
        let time_ns = at_ns.saturating_sub(self.epoch_ns.unwrap_or(at_ns));
        let time_us = time_ns.saturating_add_signed(ahead_ns) / 1000;
        let way = self.faults_on_the_way(since_ns);
        let header = FrameHeader { time_us, number };
        let [labelled, unlabelled] = &self.markers;
        let bodies = &self.bodies[..];
        let frame = ServedFrame { header, labelled, unlabelled, bodies, ..Default::default() };
        let first = self.server.first_stream();
        let sent = SentFrame {
            run: first.unwrap_or(self.server.n_streams()),
            seq: number,
            device_ticks: time_us,
            present: present as u32,
            dropped: false,
            unasked: first.is_none(),
            host_ns: at_ns,
        };
        self.counters.frames_produced += 1;
        let lost_by = (!self.state.plugged).then_some(Kind::Unplug);
        let is_broken = self.changes.is_broken(self.first_client);
        let lost_by = lost_by.or(is_broken.then_some(Kind::BrokenPacket));
        let lost_by = lost_by.or(way.is_lost.then_some(Kind::LostFrames));
        if let Some(kind) = lost_by {
            self.log.lost(sent, kind);
        } else {
            let mut delivery = self.server.frame(&frame);
            let datagrams = self.server.take_datagrams();
            if matches!(delivery, Delivery::Datagrams(_)) && self.out_bytes > DATAGRAM_BYTES_MAX {
                delivery = Delivery::Dropped;
            }
            self.first_client = match delivery {
                Delivery::Queued { client, .. } => Some(client),
                Delivery::Datagrams(_) => datagrams.first().map(|datagram| datagram.client),
                _ => None,
            };
            self.count(sent, &delivery);
            self.log.sent(sent, delivery, self.counters.frames_produced);
            if delivery != Delivery::Dropped {
                self.forward(sent, delivery, way, &datagrams);
            }
        }
        self.release(1);
    }

    /// Counts a frame's samples, or why it has none.
    fn count(&mut self, sent: SentFrame, delivery: &Delivery) {
        let counters = &mut self.counters;
        match delivery {
            Delivery::Queued { .. } | Delivery::Datagrams(_) => {
                counters.samples += u64::from(sent.present);
                counters.samples_occluded += self.row.len() as u64 - u64::from(sent.present);
            }
            Delivery::Dropped => counters.frames_dropped += 1,
            Delivery::NotRequested | Delivery::NoStream => counters.frames_unasked += 1,
        }
    }

    /// Sends a frame's datagrams on: twice or late, if a fault wants it.
    fn forward(
        &mut self,
        sent: SentFrame,
        delivery: Delivery,
        way: FrameFaults,
        datagrams: &[Datagram],
    ) {
        let is_datagrams = matches!(delivery, Delivery::Datagrams(_));
        let copies = if is_datagrams { way.copies } else { 1 };
        if copies > 1 {
            self.counts.add(Kind::DoubledFrames, 1);
            self.log.again(copies as u32 - 1);
        }
        let frame = is_datagrams.then_some(self.counters.frames_produced);
        let of_frame = |datagram: &Datagram| FrameDatagram { frame, datagram: datagram.clone() };
        let all: Vec<_> = (0..copies).flat_map(|_| datagrams.iter().map(of_frame)).collect();
        match way.late_by {
            Some(by) if is_datagrams => {
                self.log.late(sent, Kinds::of(Kind::LateFrames));
                // One more than it is late by, because the release after this frame counts it.
                self.late.push((by + 1, all));
            }
            _ => self.queue(all),
        }
    }

    /// Counts frames as passed, and sends the late ones that are due.
    fn release(&mut self, frames: u32) {
        for (left, _) in &mut self.late {
            *left = left.saturating_sub(frames);
        }
        let (due, rest): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.late).into_iter().partition(|(left, _)| *left == 0);
        self.late = rest;
        due.into_iter().for_each(|(_, datagrams)| self.queue(datagrams));
    }

    fn faults_on_the_way(&self, since_ns: u64) -> FrameFaults {
        let mut way = FrameFaults { is_lost: false, copies: 1, late_by: None };
        let Some(script) = &self.settings.faults else { return way };
        let number = self.counters.frames_produced;
        for (index, scheduled) in script.active(since_ns) {
            let hits = |number, rate| stream(script, index, number).unit() < rate;
            match scheduled.fault {
                Fault::LostFrames { rate, run } => {
                    let first = number.saturating_sub(run - 1);
                    way.is_lost |= (first..=number).any(|number| hits(number, rate));
                }
                Fault::DoubledFrames { rate } if hits(number, rate) => way.copies = 2,
                Fault::LateFrames { rate, by } if hits(number, rate) => way.late_by = Some(by),
                _ => {}
            }
        }
        way
    }

    /// The markers of the current frame, labelled and unlabelled.
    fn fill_markers(&mut self, index: u64) {
        let Self { row, labelled, unlabelled, ghosts, changes, .. } = self;
        let recorded = self.replay.recorded_frame(index);
        let residuals = self.settings.residuals.as_deref().map(|of| of.frame(recorded));
        let residual_mm = |column: usize| match residuals {
            Some(counts) => f32::from(counts.get(column).copied().unwrap_or(0)) / 100.0,
            None => RESIDUAL_MM,
        };
        let [with_label, without] = &mut self.markers;
        let wire = |column: &usize| {
            let position = row.get(*column).copied().filter(|position| !is_gap(*position));
            WireMarker {
                position_mm: position.unwrap_or([MISSING; 3]),
                id: FIRST_ID + *column as u32,
                residual_mm: residual_mm(*column),
            }
        };
        let n_labelled = labelled.len() - usize::from(changes.hides_last() && !labelled.is_empty());
        let (labelled, late) = labelled.split_at(n_labelled);
        with_label.clear();
        with_label.extend(labelled.iter().map(wire));
        without.clear();
        let is_seen = |marker: &WireMarker| !marker.position_mm.iter().any(|value| value.is_nan());
        without.extend(late.iter().chain(&*unlabelled).map(wire).filter(is_seen));
        without.extend(ghosts.iter().map(|ghost| WireMarker {
            position_mm: ghost.position_mm,
            id: FIRST_ID + u32::from(ghost.id),
            residual_mm: RESIDUAL_MM,
        }));
    }

    /// Applies the faults of settings and packets that are due.
    fn apply_changes(&mut self, since_ns: u64) {
        if self.changes.apply(since_ns, self.first_client, &mut self.counts) {
            self.server.change_settings(shown(&self.served, &self.changes));
        }
    }

    /// The bodies of the current frame.
    fn fill_bodies(&mut self, index: u64, since_ns: u64) {
        let Some(bodies) = &self.settings.bodies else { return };
        let rate_hz = f64::from(self.rates.rate_millihertz) / 1000.0;
        bodies.poses(index, rate_hz, &mut self.poses);
        if let Some(faults) = &mut self.faults {
            faults.poses(since_ns, &mut self.poses);
        }
        self.bodies.clear();
        // One that is not listed is lost: frames have all bodies of the settings.
        self.bodies.extend(bodies.infos().iter().map(|info| {
            let pose = self.poses.iter().find(|pose| pose.body == info.id);
            pose.map_or(ServedBody::LOST, ServedBody::of_pose)
        }));
    }

    /// Whether a file has ended, and no client has requested frames since.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ends > 0 && !self.server.is_playing() && self.out.is_empty() && self.late.is_empty()
    }

    /// What it has sent so far.
    #[must_use]
    pub fn log(&self) -> SentLog {
        let mut log = SentLog {
            run: self.counters,
            total: self.counters,
            starts: self.server.n_streams(),
            ends: self.ends,
            ..SentLog::default()
        };
        self.log.complete(&mut log);
        if self.settings.faults.is_some() {
            let mut totals = self.log.totals();
            let source = self.faults.as_ref().map(|faults| faults.counts).unwrap_or_default();
            let since_ns = self.last_since_ns();
            for counts in [source, self.counts, self.connection.counts(since_ns)] {
                totals.counts = totals.counts.merge(counts);
            }
            log.faults = Some(totals);
        }
        log
    }

    /// Time of the last frame since the first request.
    fn last_since_ns(&self) -> u64 {
        self.log.last_ns().and_then(|at_ns| self.since_ns(at_ns)).unwrap_or(0)
    }

    /// Keeps a [`FrameFate`] for every frame from now on.
    pub fn keep_frame_log(&mut self) {
        self.log.keep_frames();
    }

    /// Takes the frames whose fate is known.
    pub fn take_fates(&mut self) -> Vec<FrameFate> {
        self.log.take()
    }

    /// Nothing is sent any more: settles the fates of the last frames.
    pub fn close(&mut self) {
        self.log.close();
    }
}

fn body_settings(bodies: &RigidBodies) -> Vec<BodySettings> {
    let body = |info: mocapd_drivers::device::BodyInfo| BodySettings {
        name: info.name,
        ..BodySettings::default()
    };
    bodies.infos().into_iter().map(body).collect()
}

/// The settings that clients see: without a label that is late, and with one that was changed.
fn shown(served: &ServedSettings, changes: &Changes) -> ServedSettings {
    let mut shown = served.clone();
    if changes.is_renamed
        && let Some(last) = shown.labels.last_mut()
    {
        last.push_str(" renamed");
    }
    if changes.hides_last() {
        shown.labels.pop();
    }
    shown
}

/// Whether a fault can happen on a network: the system repairs a stream, and discards a damaged datagram.
pub(crate) fn happens(kind: Kind) -> bool {
    !matches!(
        kind,
        Kind::BitFlips | Kind::DroppedBytes | Kind::DoubledBytes | Kind::Bursts | Kind::Garbage
    )
}
