//! A motion, its events and sampled channels as streams of the Lab Streaming Layer. Sans-io: the time goes in, samples come
//! out; [`LslOutlets`] puts them on the network.
//!
//! Positions are a stream of the type `MoCap` by the convention of the XDF wiki, in metres; each group of sampled channels is
//! a stream, and so are the events. The motion is played from its first frame when the streams are read.

mod serve;

use std::sync::Arc;

use labstream_core::{
    net::StreamInfo,
    wire::{Sample, Value},
};
use mocapd_drivers::{
    device::{SampledChannelInfo, SampledGroupInfo},
    lsl::Publisher,
};
use mocapd_take::motion::{Marker, Motion, MotionEvent, Position, is_gap};

use crate::device::{
    DeviceError, Fate, FaultCounts, FaultTotals, FrameFate, Rates, SentCounters, SentFrame,
    SentLog, frame_after_ns,
};
use crate::faults::{
    ConnectionFaults, ConnectionState, Fault, Kind, Kinds, Script, SourceFaults, stream,
};
use crate::sampled::SampledSource;
use crate::source::Replay;

pub use serve::{LslOutlets, LslServeError};

/// What the streams say to come from.
const PROGRAM: &str = concat!("mocapd-sim ", env!("CARGO_PKG_VERSION"));

/// Most markers: three channels each, and at most 4096 channels.
pub const MARKERS_MAX: usize = 4096 / 3;

/// How streams play their motion.
#[derive(Debug, Clone, PartialEq)]
pub struct LslSettings {
    /// The name of the stream of positions, and the id of its source; other streams have it in front of theirs.
    pub name: String,
    /// Resample the motion to this rate, Hz; `None` keeps the recorded rate.
    pub rate_hz: Option<f64>,
    /// Playback speed, 0.001 to 1000, rounded to 0.001.
    pub speed: f64,
    /// Restart after the last frame, and never end.
    pub looping: bool,
    /// Faults of frames, time and connection.
    pub faults: Option<Arc<Script>>,
    /// Groups of sampled channels, each a stream.
    pub sampled: Vec<SampledSource>,
}

impl Default for LslSettings {
    fn default() -> Self {
        Self {
            name: "mocapd-sim".to_owned(),
            rate_hz: None,
            speed: 1.0,
            looping: false,
            faults: None,
            sampled: Vec::new(),
        }
    }
}

/// Why a motion cannot be played as streams.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LslError {
    /// A fault that does not happen to streams.
    #[error(
        "{kind} does not happen to an LSL stream, which is a TCP connection with time stamps and without numbers: remove it from \
         the script"
    )]
    Fault {
        /// Its name.
        kind: &'static str,
    },
    /// The motion or a setting suits no device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// What is to be pushed.
#[derive(Debug)]
pub(crate) enum Push<'a> {
    /// A sample with its time stamp.
    One(&'a Sample),
    /// Consecutive samples of a fixed rate, with the time stamp of the last, in seconds.
    Chunk(&'a [Sample], f64),
}

/// A simulated source of streams.
#[derive(Debug)]
pub struct LslDevice {
    settings: LslSettings,
    replay: Replay,
    rates: Rates,
    events: Vec<MotionEvent>,
    faults: Option<SourceFaults>,
    connection: ConnectionFaults,
    state: ConnectionState,
    /// The caller's clock when the streams were first read, and when the motion was started.
    first_start_ns: Option<u64>,
    start_ns: Option<u64>,
    has_ended: bool,
    /// Whether anybody reads the positions.
    is_read: bool,
    /// Frames since the motion was started.
    played: u64,
    next_event: usize,
    /// Samples taken of each group of sampled channels in this run.
    groups: Vec<u64>,
    counters: SentCounters,
    counts: FaultCounts,
    totals: FaultTotals,
    frames_sent: u64,
    bytes_sent: u64,
    starts: u64,
    ends: u64,
    keeps_fates: bool,
    fates: Vec<FrameFate>,
    row: Vec<Position>,
    batch: Vec<f32>,
}

impl LslDevice {
    /// Creates the streams of a motion.
    ///
    /// # Errors
    /// When the motion is empty or has too many markers, a rate or speed is out of range, or a fault does not happen to
    /// streams.
    pub fn new(motion: impl Into<Arc<Motion>>, settings: LslSettings) -> Result<Self, LslError> {
        let motion = motion.into();
        match (motion.info.markers.len(), motion.n_frames()) {
            (0, _) => return Err(DeviceError::NoMarkers.into()),
            (_, 0) => return Err(DeviceError::NoFrames.into()),
            (found, _) if found > MARKERS_MAX => {
                return Err(DeviceError::TooManyMarkers { found, max: MARKERS_MAX }.into());
            }
            _ => {}
        }
        let no_faults = || Arc::new(Script { seed: 0, faults: Vec::new(), expect: None });
        let script = settings.faults.clone().unwrap_or_else(no_faults);
        if let Some(kind) = script.faults.iter().map(|f| f.fault.kind()).find(|k| !happens(*k)) {
            return Err(LslError::Fault { kind: kind.name() });
        }
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let n_columns = motion.info.markers.len();
        let mut events = motion.info.events.clone();
        events.sort_by_key(|event| event.frame);
        Ok(Self {
            events,
            replay: rates.replay(motion, rates.rate_millihertz),
            rates,
            faults: settings.faults.clone().map(|script| SourceFaults::new(script, n_columns)),
            connection: ConnectionFaults::new(&script),
            state: ConnectionState { plugged: true, powered: true, flows: true },
            first_start_ns: None,
            start_ns: None,
            has_ended: false,
            is_read: false,
            played: 0,
            next_event: 0,
            groups: vec![0; settings.sampled.len()],
            counters: SentCounters::default(),
            counts: FaultCounts::default(),
            totals: FaultTotals::default(),
            frames_sent: 0,
            bytes_sent: 0,
            starts: 0,
            ends: 0,
            keeps_fates: false,
            fates: Vec::new(),
            row: Vec::new(),
            batch: Vec::new(),
            settings,
        })
    }

    /// The frame rate, in millihertz.
    #[must_use]
    pub fn rate_millihertz(&self) -> u32 {
        self.rates.rate_millihertz
    }

    /// The streams: positions first, then one of each group of sampled channels, then the events, if there are any.
    #[must_use]
    pub fn infos(&self) -> Vec<StreamInfo> {
        let name = &self.settings.name;
        let motion = self.replay.motion();
        let rate_hz = f64::from(self.rates.rate_millihertz) / 1000.0;
        let mut infos = vec![positions_stream(name, &motion.info.markers, rate_hz)];
        let groups = self.settings.sampled.iter().map(SampledSource::info);
        infos.extend(groups.map(|group| samples_stream(name, group)));
        if !self.events.is_empty() {
            infos.push(events_stream(name));
        }
        infos
    }

    /// Whether the streams can be read: not while the source is switched off or its cable is pulled.
    #[must_use]
    pub fn is_reachable(&self) -> bool {
        self.state.plugged && self.state.powered
    }

    /// Whether the motion is being played.
    #[must_use]
    pub fn is_playing(&self) -> bool {
        self.start_ns.is_some()
    }

    /// Whether the motion has been played to its end and is not played again.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Plays the motion from its first frame: the streams are read.
    pub fn start(&mut self, now_ns: u64) {
        self.first_start_ns.get_or_insert(now_ns);
        self.start_ns = Some(now_ns);
        (self.played, self.next_event, self.has_ended) = (0, 0, false);
        self.groups.fill(0);
        self.starts += 1;
    }

    /// The streams are read again, after an outage: the motion has gone on.
    pub fn resume(&mut self) {
        self.starts += 1;
    }

    /// Nobody reads the streams any more.
    pub fn stop(&mut self) {
        self.start_ns = None;
        self.has_ended = false;
    }

    /// States whether anybody reads the positions.
    pub(crate) fn set_read(&mut self, is_read: bool) {
        self.is_read = is_read;
    }

    /// Does everything that is due: calls `push` with the number of a stream and its samples. Returns the time of the next
    /// event; `u64::MAX` when only a reader can cause one.
    pub(crate) fn poll(&mut self, now_ns: u64, push: &mut dyn FnMut(usize, Push<'_>)) -> u64 {
        self.update_state(now_ns);
        let next_ns = if self.state.powered { self.play_until(now_ns, push) } else { u64::MAX };
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
            // Its program ends: the motion begins anew when the streams are read again.
            self.start_ns = None;
            if let Some(faults) = &mut self.faults {
                faults.reset();
            }
        }
    }

    /// Plays what is due, in the order of times, and returns the time of the next. While nothing is delivered, it waits.
    fn play_until(&mut self, now_ns: u64, push: &mut dyn FnMut(usize, Push<'_>)) -> u64 {
        let n_frames = self.replay.n_frames().max(1);
        let stalls = !self.state.flows && self.state.plugged;
        let Some(start_ns) = self.start_ns.filter(|_| !stalls) else { return u64::MAX };
        loop {
            let after_ns = frame_after_ns(self.played, self.rates.rate_millihertz);
            let frame_ns = start_ns.saturating_add(after_ns);
            let batch = self.next_batch(start_ns);
            if let Some((group, due_ns)) =
                batch.filter(|(_, due_ns)| *due_ns <= frame_ns.min(now_ns))
            {
                self.play_batch(group, due_ns, push);
                continue;
            }
            if frame_ns > now_ns {
                return batch.map_or(frame_ns, |(_, due_ns)| due_ns.min(frame_ns));
            }
            if !self.settings.looping && self.played >= n_frames {
                self.start_ns = None;
                self.has_ended = true;
                self.ends += 1;
                return u64::MAX;
            }
            let index = self.played % n_frames;
            self.next_event = if index == 0 { 0 } else { self.next_event };
            self.play_events(index, frame_ns, push);
            self.play(index, frame_ns, push);
        }
    }

    fn play(&mut self, index: u64, at_ns: u64, push: &mut dyn FnMut(usize, Push<'_>)) {
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        self.replay.frame(index, &mut self.row);
        let number = self.played;
        self.played += 1;
        if let Some(faults) = &mut self.faults {
            faults.positions(since_ns, &mut self.row);
            faults.count_clock_faults(since_ns);
        }
        let present = self.row.iter().filter(|position| !is_gap(**position)).count() as u32;
        let early_ns = self.faults.as_mut().map_or(0, |faults| faults.stamp_jitter_ns(since_ns));
        let time_ns = self.stamp_ns(at_ns).saturating_add_signed(-early_ns);
        let frame = SentFrame {
            run: self.starts,
            seq: number as u32,
            device_ticks: time_ns,
            present,
            dropped: false,
            unasked: !self.is_read,
            host_ns: at_ns,
        };
        self.counters.frames_produced += 1;
        let lost_by = (!self.state.plugged).then_some(Kind::Unplug);
        if let Some(kind) = lost_by.or_else(|| self.is_lost(since_ns).then_some(Kind::LostFrames)) {
            self.log_fate(frame, Fate::Lost, Kinds::of(kind));
            return;
        }
        let values = self.row.iter().flat_map(|position| {
            let metres = |mm: f32| (f64::from(mm) / 1000.0) as f32;
            let gap = is_gap(*position);
            position.map(|mm| Value::F32(if gap { f32::NAN } else { metres(mm) }))
        });
        let sample = Sample { timestamp: time_ns as f64 * 1e-9, values: values.collect() };
        self.bytes_sent += 9 + 4 * sample.values.len() as u64;
        push(0, Push::One(&sample));
        if !self.is_read {
            self.counters.frames_unasked += 1;
            self.log_fate(frame, Fate::Unasked, Kinds::default());
            return;
        }
        self.counters.samples += u64::from(present);
        self.counters.samples_occluded += self.row.len() as u64 - u64::from(present);
        self.log_fate(frame, Fate::Whole, Kinds::default());
    }

    /// The time stamp of what is taken at this time, on LSL's clock.
    fn stamp_ns(&self, at_ns: u64) -> u64 {
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        let offset_ns = self.faults.as_ref().map_or(0, |faults| faults.clock_offset_ns(since_ns));
        at_ns.saturating_add_signed(offset_ns)
    }

    fn is_lost(&self, since_ns: u64) -> bool {
        let Some(script) = &self.settings.faults else { return false };
        let number = self.counters.frames_produced;
        script.active(since_ns).any(|(index, scheduled)| match scheduled.fault {
            Fault::LostFrames { rate, run } => {
                let first = number.saturating_sub(run - 1);
                (first..=number).any(|number| stream(script, index, number).unit() < rate)
            }
            _ => false,
        })
    }

    fn log_fate(&mut self, frame: SentFrame, fate: Fate, faults: Kinds) {
        let fate = FrameFate { frame, frames: 1, fate, again: 0, faults };
        self.frames_sent += u64::from(fate.fate == Fate::Whole);
        self.totals.add(&fate);
        if self.keeps_fates {
            self.fates.push(fate);
        }
    }

    /// Events of this frame of the motion.
    fn play_events(&mut self, frame: u64, at_ns: u64, push: &mut dyn FnMut(usize, Push<'_>)) {
        let timestamp = self.stamp_ns(at_ns) as f64 * 1e-9;
        let stream = 1 + self.groups.len();
        while let Some(event) =
            self.events.get(self.next_event).filter(|event| event.frame <= frame)
        {
            self.next_event += 1;
            if self.state.plugged {
                let values = vec![Value::Str(event.label().as_bytes().to_vec())];
                push(stream, Push::One(&Sample { timestamp, values }));
            }
        }
    }

    /// The group whose batch is due next, and when that is: with its last sample.
    fn next_batch(&self, start_ns: u64) -> Option<(usize, u64)> {
        let due = |(index, taken): (usize, &u64)| {
            let source = self.settings.sampled.get(index)?;
            let last = taken + source.batch_samples() - 1;
            Some((
                index,
                start_ns.saturating_add(frame_after_ns(last, source.info().rate_millihertz)),
            ))
        };
        self.groups.iter().enumerate().filter_map(due).min_by_key(|(_, due_ns)| *due_ns)
    }

    fn play_batch(&mut self, index: usize, due_ns: u64, push: &mut dyn FnMut(usize, Push<'_>)) {
        let time_s = self.stamp_ns(due_ns) as f64 * 1e-9;
        let Some(source) = self.settings.sampled.get(index) else { return };
        let Some(taken) = self.groups.get_mut(index) else { return };
        let n = source.batch_samples();
        self.batch.clear();
        source.samples(*taken, n, &mut self.batch);
        *taken += n;
        if !self.state.plugged {
            return;
        }
        let channels = &source.info().channels;
        let samples = self
            .batch
            .chunks_exact(channels.len().max(1))
            .map(|row| Sample { timestamp: 0.0, values: values_of(row, channels) });
        let samples: Vec<Sample> = samples.collect();
        push(1 + index, Push::Chunk(&samples, time_s));
    }

    /// What it has sent so far.
    #[must_use]
    pub fn log(&self) -> SentLog {
        let mut log = SentLog {
            run: self.counters,
            total: self.counters,
            starts: self.starts,
            ends: self.ends,
            frames_sent: self.frames_sent,
            frames_discarded: self.totals.of(Fate::Lost),
            bytes_sent: self.bytes_sent,
            ..SentLog::default()
        };
        if self.settings.faults.is_some() {
            let mut totals = self.totals.clone();
            let source = self.faults.as_ref().map(|faults| faults.counts).unwrap_or_default();
            let since_ns = self.start_ns.and_then(|at_ns| self.since_ns(at_ns)).unwrap_or(u64::MAX);
            for counts in [source, self.counts, self.connection.counts(since_ns)] {
                totals.counts = totals.counts.merge(counts);
            }
            log.faults = Some(totals);
        }
        log
    }

    /// Keeps a [`FrameFate`] for every frame from now on.
    pub fn keep_frame_log(&mut self) {
        self.keeps_fates = true;
    }

    /// Takes the frames whose fate is known.
    pub fn take_fates(&mut self) -> Vec<FrameFate> {
        std::mem::take(&mut self.fates)
    }
}

fn publisher(name: &str) -> Publisher<'_> {
    Publisher { name, source_id: name, program: PROGRAM }
}

/// The stream of positions.
fn positions_stream(name: &str, markers: &[Marker], rate_hz: f64) -> StreamInfo {
    let labels: Vec<String> =
        markers.iter().enumerate().map(|(column, marker)| label(marker, column)).collect();
    publisher(name).positions(&labels, rate_hz)
}

/// A stream of sampled channels.
fn samples_stream(name: &str, group: &SampledGroupInfo) -> StreamInfo {
    let is_plates = group.channels.iter().any(|channel| channel.unit == "N");
    let (kind, what) = if is_plates { ("Force", "plates") } else { ("EMG", "emg") };
    publisher(&format!("{name}-{what}-{}", group.id)).samples(kind, group)
}

/// The stream of events.
fn events_stream(name: &str) -> StreamInfo {
    publisher(&format!("{name}-events")).events()
}

fn label(marker: &Marker, column: usize) -> String {
    if marker.label.is_empty() { format!("u{:03}", column + 1) } else { marker.label.clone() }
}

/// The values of one sample of a group, in the units of its channels.
fn values_of(counts: &[f32], channels: &[SampledChannelInfo]) -> Vec<Value> {
    let value = |(count, channel): (&f32, &SampledChannelInfo)| {
        Value::F32(((f64::from(*count) - channel.offset) * channel.scale) as f32)
    };
    counts.iter().zip(channels).map(value).collect()
}

/// Replaces LSL's configuration files for this process, if it has no stream yet: for tests, which need a session of their own.
pub fn configure(text: &str) {
    labstream_core::net::config::set_content(text);
}

/// Whether a fault can happen to a stream: nothing damages the bytes of a connection, and samples have no numbers.
fn happens(kind: Kind) -> bool {
    matches!(
        kind,
        Kind::LostFrames
            | Kind::Stall
            | Kind::ClockDrift
            | Kind::ClockJump
            | Kind::StampJitter
            | Kind::Unplug
            | Kind::PowerLoss
            | Kind::Swaps
            | Kind::OcclusionStorm
    )
}
