//! A simulated Motive that plays a motion live over NatNet. Sans-io: datagrams of clients and the time go in, datagrams come
//! out; [`NatNetListener`] puts it on the network.
//!
//! Labelled markers belong to an asset: that in front of a colon in their labels, or one without a name. All others are sent
//! as unlabelled markers. The motion is played from its first frame when the first client connects.

mod content;
mod serve;

use std::{
    net::{SocketAddr, SocketAddrV4},
    sync::Arc,
};

use mocapd_drivers::{
    device::MarkerSample,
    natnet::{
        Bitstream, FrameEnd, MESSAGE_BYTES_MAX, MODELS_CHANGED, NatNetServer, ServedStream,
        ServerDatagram, ServerSettings,
    },
    qtm::{Delivery, LABELS_MAX},
};
use mocapd_take::motion::{Motion, Position, is_gap};

use self::content::Content;
use crate::{
    device::{
        DeviceError, FaultCounts, FrameFate, Rates, SentCounters, SentFrame, SentLog,
        frame_after_ns,
    },
    faults::{ConnectionFaults, ConnectionState, Fault, Kind, Kinds, Script, SourceFaults, stream},
    qtm::{fates::DeliveryLog, happens},
    sampled::SampledSource,
    source::{Replay, Residuals},
};

pub use self::serve::{NatNetListener, NatNetServeError};

/// Ticks of the clock per second: those of Windows' performance counter.
pub const CLOCK_HZ: u64 = 10_000_000;

const TICK_NS: u64 = 1_000_000_000 / CLOCK_HZ;

/// How a Motive plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct NatNetSettings {
    /// Resample the motion to this rate, Hz; `None` keeps the recorded rate.
    pub rate_hz: Option<f64>,
    /// Playback speed, 0.001 to 1000, rounded to 0.001.
    pub speed: f64,
    /// Restart after the last frame, and never end.
    pub looping: bool,
    /// The version of frames and definitions.
    pub bitstream: Bitstream,
    /// How frames are sent.
    pub stream: ServedStream,
    /// Names of assets that are rigid bodies.
    pub rigid_bodies: Vec<String>,
    /// Force plates, and devices.
    pub sampled: Vec<SampledSource>,
    /// Faults of frames, time, connection and definitions.
    pub faults: Option<Arc<Script>>,
    /// The residuals of the motion's markers; by default all are alike.
    pub residuals: Option<Arc<Residuals>>,
}

impl NatNetSettings {
    /// Frames of the newest bitstream, sent in one way.
    #[must_use]
    pub fn new(stream: ServedStream) -> Self {
        Self {
            rate_hz: None,
            speed: 1.0,
            looping: false,
            bitstream: Bitstream::NEWEST,
            stream,
            rigid_bodies: Vec::new(),
            sampled: Vec::new(),
            faults: None,
            residuals: None,
        }
    }

    /// The group and port that Motive has by default.
    #[must_use]
    pub fn default_group() -> SocketAddrV4 {
        SocketAddrV4::new(mocapd_drivers::natnet::GROUP, mocapd_drivers::natnet::DATA_PORT)
    }
}

/// Why a motion cannot be played over NatNet.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NatNetError {
    /// A fault that does not happen on a network.
    #[error(
        "{kind} does not happen to a NatNet server, whose damaged datagrams the system discards: remove it from the script"
    )]
    Fault {
        /// Its name.
        kind: &'static str,
    },
    /// A version that is not known.
    #[error(
        "bitstream {version} is not known: give {} to {}",
        Bitstream::OLDEST,
        Bitstream::NEWEST
    )]
    Bitstream {
        /// The version.
        version: Bitstream,
    },
    /// A frame has a whole number of samples.
    #[error(
        "{sampled_hz} Hz is no multiple of the frame rate of {frame_hz} Hz, as samples of NatNet are: choose other rates"
    )]
    SampleRate {
        /// Samples of a channel per second.
        sampled_hz: f64,
        /// Frames per second.
        frame_hz: f64,
    },
    /// A datagram has 65 507 bytes at most.
    #[error(
        "its {what} take {bytes} bytes, and a datagram has {MESSAGE_BYTES_MAX} at most: play fewer markers"
    )]
    TooLarge {
        /// Frames or definitions.
        what: &'static str,
        /// Their size.
        bytes: usize,
    },
    /// No marker belongs to the asset.
    #[error("no label begins with '{name}:', so that there is no such asset: check --rigid-body")]
    NoSuchAsset {
        /// Its name.
        name: String,
    },
    /// Devices are not part of it.
    #[error(
        "bitstream {version} has no devices, only force plates: give 2.11 or later, or remove --emg"
    )]
    NoDevices {
        /// The version.
        version: Bitstream,
    },
    /// The motion or a setting suits no device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// A datagram, and the number of its frame among all that were produced; `None` for a reply.
#[derive(Debug, Clone)]
struct QueuedDatagram {
    frame: Option<u64>,
    datagram: ServerDatagram,
}

/// Datagrams that wait during a stall.
const QUEUE_MAX: usize = 1 << 14;

/// What the faults of a script do to one frame on its way.
#[derive(Debug, Clone, Copy)]
struct DatagramFaults {
    is_lost: bool,
    copies: usize,
    late_by: Option<u32>,
}

/// A simulated Motive.
#[derive(Debug)]
pub struct NatNetDevice {
    settings: NatNetSettings,
    server: NatNetServer,
    content: Content,
    replay: Replay,
    rates: Rates,
    faults: Option<SourceFaults>,
    connection: ConnectionFaults,
    state: ConnectionState,
    /// The caller's clock when the server's clock was 0, when a client first connected, and when the motion began.
    epoch_ns: Option<u64>,
    first_start_ns: Option<u64>,
    start_ns: Option<u64>,
    /// Frames since the motion began, and the number of the next one.
    played: u64,
    number: u32,
    has_ended: bool,
    /// Changes of definitions and bitstream that have happened, as indices into the script.
    changes_done: Vec<usize>,
    model_changed: bool,
    log: DeliveryLog,
    counters: SentCounters,
    counts: FaultCounts,
    /// Datagrams that faults hold back, and frames until they are sent.
    late: Vec<(u32, Vec<QueuedDatagram>)>,
    out: Vec<QueuedDatagram>,
    row: Vec<Position>,
    ghosts: Vec<MarkerSample>,
}

impl NatNetDevice {
    /// Creates a Motive that plays the motion.
    ///
    /// # Errors
    /// When the motion is empty or has too many markers, a rate, a speed or a version is out of range, or a fault does not
    /// happen to a NatNet server.
    pub fn new(
        motion: impl Into<Arc<Motion>>,
        settings: NatNetSettings,
    ) -> Result<Self, NatNetError> {
        let motion = motion.into();
        match (motion.info.markers.len(), motion.n_frames()) {
            (0, _) => return Err(DeviceError::NoMarkers.into()),
            (_, 0) => return Err(DeviceError::NoFrames.into()),
            (found, _) if found > LABELS_MAX => {
                return Err(DeviceError::TooManyMarkers { found, max: LABELS_MAX }.into());
            }
            _ => {}
        }
        let version = settings.bitstream;
        if !(Bitstream::OLDEST..=Bitstream::NEWEST).contains(&version) {
            return Err(NatNetError::Bitstream { version });
        }
        let no_faults = || Arc::new(Script { seed: 0, faults: Vec::new(), expect: None });
        let script = settings.faults.clone().unwrap_or_else(no_faults);
        let mut kinds = script.faults.iter().map(|f| f.fault.kind());
        if let Some(kind) = kinds.find(|kind| !happens(*kind) || *kind == Kind::BrokenPacket) {
            return Err(NatNetError::Fault { kind: kind.name() });
        }
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let n_markers = motion.info.markers.len();
        let content = Content::new(&motion, &settings, rates.rate_millihertz)?;
        content.check_size(version)?;
        let server = NatNetServer::new(ServerSettings {
            name: "mocapd-sim".to_owned(),
            app_version: app_version(),
            bitstream: version,
            rate_hz: (f64::from(rates.rate_millihertz) / 1000.0) as f32,
            samples_per_frame: content.samples_per_frame(),
            clock_hz: CLOCK_HZ,
            stream: settings.stream,
            model: content.model().clone(),
        });
        Ok(Self {
            server,
            content,
            replay: rates.replay(motion, rates.rate_millihertz),
            rates,
            faults: settings.faults.clone().map(|script| SourceFaults::new(script, n_markers)),
            connection: ConnectionFaults::new(&script),
            state: ConnectionState { plugged: true, powered: true, flows: true },
            epoch_ns: None,
            first_start_ns: None,
            start_ns: None,
            played: 0,
            number: 0,
            has_ended: false,
            changes_done: Vec::new(),
            model_changed: false,
            log: DeliveryLog::default(),
            counters: SentCounters::default(),
            counts: FaultCounts::default(),
            late: Vec::new(),
            out: Vec::new(),
            row: Vec::new(),
            ghosts: Vec::new(),
            settings,
        })
    }

    /// The frame rate, in millihertz.
    #[must_use]
    pub fn rate_millihertz(&self) -> u32 {
        self.rates.rate_millihertz
    }

    /// Takes a datagram from a client.
    pub fn on_datagram(&mut self, from: SocketAddr, bytes: &[u8], now_ns: u64) {
        if !self.state.plugged || !self.state.powered {
            return;
        }
        self.epoch_ns.get_or_insert(now_ns);
        let before = self.server.n_connects();
        let ticks = self.time_ns(now_ns) / TICK_NS;
        self.server.receive(from, bytes, ticks, now_ns);
        let replies = self.server.take_datagrams();
        if self.server.n_connects() > before {
            self.first_start_ns.get_or_insert(now_ns);
            if before == 0 {
                self.send_early_frames(now_ns);
            }
        }
        self.queue(replies.into_iter().map(|datagram| QueuedDatagram { frame: None, datagram }));
        self.poll(now_ns);
    }

    /// Frames that race with the reply to the first client's first message: those that the motion begins with.
    fn send_early_frames(&mut self, now_ns: u64) {
        let Some(script) = self.settings.faults.clone() else { return };
        for scheduled in &script.faults {
            let Fault::EarlyFrames { count } = scheduled.fault else { continue };
            for number in 0..count {
                self.replay.frame(u64::from(number) % self.replay.n_frames(), &mut self.row);
                self.content.fill((&self.row, None), &[], 0);
                let end = FrameEnd::default();
                self.content.send(&mut self.server, number, end, now_ns);
            }
            self.counts.add(Kind::EarlyFrames, 1);
        }
        let frames = self.server.take_datagrams().into_iter();
        self.queue(frames.map(|datagram| QueuedDatagram { frame: None, datagram }));
    }

    /// Time of the server's clock.
    fn time_ns(&self, now_ns: u64) -> u64 {
        let since_ns = self.since_ns(now_ns).unwrap_or(0);
        let ahead_ns = self.faults.as_ref().map_or(0, |faults| faults.clock_offset_ns(since_ns));
        now_ns.saturating_sub(self.epoch_ns.unwrap_or(now_ns)).saturating_add_signed(ahead_ns)
    }

    /// Sends the datagrams that are due: `send` returns whether the system took one.
    pub fn send_datagrams(&mut self, mut send: impl FnMut(&ServerDatagram) -> bool) {
        if !self.state.flows {
            return;
        }
        for QueuedDatagram { frame, datagram } in std::mem::take(&mut self.out) {
            let bytes = send(&datagram).then_some(datagram.bytes.len());
            if let Some(frame) = frame {
                self.log.datagram_taken(frame, bytes);
            }
        }
        self.log.settle();
    }

    fn queue(&mut self, datagrams: impl Iterator<Item = QueuedDatagram>) {
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
            if let Some(faults) = &mut self.faults {
                faults.reset();
            }
        } else if before.plugged && !self.state.plugged {
            self.log.cut(Kind::Unplug);
        }
        if !self.state.plugged || !self.state.powered {
            self.late.clear();
            self.out.clear();
        }
        if !before.powered && self.state.powered {
            self.epoch_ns = Some(now_ns);
        }
        self.change_definitions(since_ns);
    }

    /// Applies the changes of definitions and bitstream that are due.
    fn change_definitions(&mut self, since_ns: u64) {
        let Some(script) = self.settings.faults.clone() else { return };
        let mut withholds = false;
        for (index, scheduled) in script.faults.iter().enumerate() {
            let is_due = |at_s: f64| (at_s * 1e9) as u64 <= since_ns;
            match scheduled.fault {
                Fault::LateModel { for_s } => {
                    withholds |= !is_due(for_s);
                    if !self.changes_done.contains(&index) {
                        self.changes_done.push(index);
                        self.counts.add(Kind::LateModel, 1);
                    }
                }
                Fault::ModelChange { at_s }
                    if is_due(at_s) && !self.changes_done.contains(&index) =>
                {
                    self.changes_done.push(index);
                    self.counts.add(Kind::ModelChange, 1);
                    self.content.rename_last();
                    self.server.set_model(self.content.model().clone());
                    self.model_changed = true;
                }
                Fault::BitstreamChange { at_s, major, minor }
                    if is_due(at_s) && !self.changes_done.contains(&index) =>
                {
                    self.changes_done.push(index);
                    self.counts.add(Kind::BitstreamChange, 1);
                    let version = Bitstream::new(major, minor);
                    self.server.set_bitstream(version.clamp(Bitstream::OLDEST, Bitstream::NEWEST));
                }
                _ => {}
            }
        }
        self.server.withhold_model(withholds);
    }

    /// Plays the frames that are due, and returns the time of the next.
    fn play_until(&mut self, now_ns: u64) -> u64 {
        if self.first_start_ns.is_none() || self.has_ended {
            return u64::MAX;
        }
        let n_frames = self.replay.n_frames().max(1);
        let start_ns = *self.start_ns.get_or_insert(now_ns);
        loop {
            let next_ns =
                start_ns.saturating_add(frame_after_ns(self.played, self.rates.rate_millihertz));
            if next_ns > now_ns {
                return next_ns;
            }
            if !self.settings.looping && self.played >= n_frames {
                self.release(u32::MAX);
                self.has_ended = true;
                return u64::MAX;
            }
            self.play(self.played % n_frames, next_ns);
        }
    }

    fn play(&mut self, index: u64, at_ns: u64) {
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        self.replay.frame(index, &mut self.row);
        let mut number = self.number;
        self.number = self.number.wrapping_add(1);
        self.ghosts.clear();
        if let Some(faults) = &mut self.faults {
            number = faults.counter(number, since_ns);
            faults.positions(since_ns, &mut self.row);
            faults.count_clock_faults(since_ns);
            faults.add_ghosts(since_ns, &mut self.ghosts);
        }
        let recorded = self.replay.recorded_frame(index);
        let residuals = self.settings.residuals.as_deref().map(|of| of.frame(recorded));
        self.content.fill((&self.row, residuals), &self.ghosts, self.played);
        self.played += 1;
        let ticks = self.time_ns(at_ns) / TICK_NS;
        let way = self.faults_on_the_way(since_ns);
        let sent = SentFrame {
            run: 1,
            seq: number,
            device_ticks: ticks * TICK_NS,
            present: self.row.iter().filter(|position| !is_gap(**position)).count() as u32,
            dropped: false,
            unasked: !self.server.has_listeners(),
            host_ns: at_ns,
        };
        self.counters.frames_produced += 1;
        let lost_by = (!self.state.plugged).then_some(Kind::Unplug);
        let lost_by = lost_by.or(way.is_lost.then_some(Kind::LostFrames));
        if let Some(kind) = lost_by {
            self.log.lost(sent, kind);
        } else {
            self.send_frame(sent, way, at_ns);
        }
        self.release(1);
    }

    fn send_frame(&mut self, sent: SentFrame, way: DatagramFaults, at_ns: u64) {
        let flags = if std::mem::take(&mut self.model_changed) { MODELS_CHANGED } else { 0 };
        // Logs have nanoseconds, as takes do.
        let ticks = sent.device_ticks / TICK_NS;
        let end = FrameEnd {
            timestamp_s: ticks as f64 / CLOCK_HZ as f64,
            ticks: [ticks; 3],
            flags,
            ..FrameEnd::default()
        };
        let n = self.content.send(&mut self.server, sent.seq, end, at_ns);
        let datagrams = self.server.take_datagrams();
        let delivery = match n {
            Some(0) => Delivery::NoStream,
            Some(n) if self.out.len() + n <= QUEUE_MAX => Delivery::Datagrams(n),
            Some(_) | None => Delivery::Dropped,
        };
        match delivery {
            Delivery::Datagrams(_) => {
                self.counters.samples += u64::from(sent.present);
                self.counters.samples_occluded += self.row.len() as u64 - u64::from(sent.present);
            }
            Delivery::Dropped => self.counters.frames_dropped += 1,
            _ => self.counters.frames_unasked += 1,
        }
        let number = self.counters.frames_produced;
        self.log.sent(sent, delivery, number);
        if !matches!(delivery, Delivery::Datagrams(_)) {
            return;
        }
        if way.copies > 1 {
            self.counts.add(Kind::DoubledFrames, 1);
            self.log.again(way.copies as u32 - 1);
        }
        let of_frame = |datagram: &ServerDatagram| QueuedDatagram {
            frame: Some(number),
            datagram: datagram.clone(),
        };
        let all: Vec<_> = (0..way.copies).flat_map(|_| datagrams.iter().map(of_frame)).collect();
        match way.late_by {
            Some(by) => {
                self.log.late(sent, Kinds::of(Kind::LateFrames));
                // One more than it is late by, because the release after this frame counts it.
                self.late.push((by + 1, all));
            }
            None => self.queue(all.into_iter()),
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
        due.into_iter().for_each(|(_, datagrams)| self.queue(datagrams.into_iter()));
    }

    fn faults_on_the_way(&self, since_ns: u64) -> DatagramFaults {
        let mut way = DatagramFaults { is_lost: false, copies: 1, late_by: None };
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

    /// Whether the motion has ended, and all of it was sent.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.has_ended && self.out.is_empty() && self.late.is_empty()
    }

    /// What it has sent so far.
    #[must_use]
    pub fn log(&self) -> SentLog {
        let mut log = SentLog {
            run: self.counters,
            total: self.counters,
            starts: self.server.n_connects(),
            ends: u64::from(self.has_ended),
            ..SentLog::default()
        };
        self.log.complete(&mut log);
        if self.settings.faults.is_some() {
            let mut totals = self.log.totals();
            let source = self.faults.as_ref().map(|faults| faults.counts).unwrap_or_default();
            let since_ns = self.log.last_ns().and_then(|at_ns| self.since_ns(at_ns)).unwrap_or(0);
            for counts in [source, self.counts, self.connection.counts(since_ns)] {
                totals.counts = totals.counts.merge(counts);
            }
            log.faults = Some(totals);
        }
        log
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

/// The version of this program.
fn app_version() -> [u8; 4] {
    let mut version = [0; 4];
    let parts = env!("CARGO_PKG_VERSION").split('.').map(|part| part.parse().unwrap_or(0));
    version.iter_mut().zip(parts).for_each(|(to, part)| *to = part);
    version
}
