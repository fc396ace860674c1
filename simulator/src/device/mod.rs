//! A simulated device of the link protocol that plays a motion, with a clock of its own, which starts at 0 and drifts.
//! Sans-io: the host's bytes and the time go in, the device's bytes come out.
//!
//! Times are nanoseconds of one monotonic clock of the caller's choice.

mod log;
mod output;
mod settings;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use mocapd_drivers::{
    device::{Command, Frame, Hello, MarkerInfo, MarkerSample, Pose, Status},
    link::{DeviceLink, LABEL_BYTES_MAX, MARKERS_MAX, frame_bytes_max},
};
use mocapd_take::motion::{Marker, Motion, Position, is_gap};
use output::GroupState;

pub use crate::line::LineDevice;
use crate::{faults::SourceFaults, source::Replay};
pub(crate) use log::FateLog;
pub use log::{
    BatchFate, Fate, FaultCounts, FaultTotals, FrameFate, NetworkOptions, Sent, SentBatch,
    SentCounters, SentFate, SentFrame, SentLog,
};
pub use output::POSES_GROUP;
pub(crate) use output::{Outbox, Queued};
pub use settings::{DeviceError, DeviceSettings, RATE_MILLIHERTZ, TICK_HZ};
pub(crate) use settings::{Rates, frame_after_ns};

const SECOND_NS: u64 = 1_000_000_000;

const NS_PER_TICK: i64 = (SECOND_NS / TICK_HZ) as i64;

/// A simulated device.
#[derive(Debug)]
pub struct Device {
    settings: DeviceSettings,
    link: DeviceLink,
    hello: Hello,
    table: Vec<MarkerInfo>,
    replay: Replay,
    rates: Rates,
    outbox: Outbox,
    run: Option<Run>,
    /// An end of stream that waits for room in the queue.
    pending_end: Option<Status>,
    end_sent: bool,
    /// Whether the motion was played to its end, and no host has stopped or started it since: its `EndOfStream` may be
    /// lost.
    finished: bool,
    log: SentLog,
    warnings: Vec<String>,
    clock: DeviceClock,
    faults: Option<SourceFaults>,
    first_start_ns: Option<u64>,
    /// The next frame's number on the wire. It counts from power-up; the log counts from the creation of the device.
    counter: u32,
    commands: Vec<Command>,
    row: Vec<Position>,
    samples: Vec<MarkerSample>,
    /// By group of sampled channels.
    groups: Vec<GroupState>,
    /// The samples of a batch.
    batch: Vec<f32>,
    /// Messages with poses that left the device since power-up.
    poses_sent: u32,
    poses: Vec<Pose>,
}

/// A run, from Start to its end: when it started and when the next Status is due.
#[derive(Debug, Clone, Copy)]
struct Run {
    start_ns: u64,
    status_ns: u64,
}

impl Device {
    /// Creates a device that is switched on and waits for its host.
    ///
    /// # Errors
    /// When the motion is empty or has too many markers, when a rate, speed or drift is out of range, or when the link
    /// cannot carry a text.
    pub fn new(
        motion: impl Into<Arc<Motion>>,
        settings: DeviceSettings,
    ) -> Result<Self, DeviceError> {
        let motion = motion.into();
        let found = motion.info.markers.len();
        let ghosts = settings.faults.as_ref().map_or(0, |script| script.n_ghosts());
        match (found, motion.n_frames()) {
            (0, _) => return Err(DeviceError::NoMarkers),
            (_, 0) => return Err(DeviceError::NoFrames),
            _ if found + ghosts > MARKERS_MAX => {
                let found = found + ghosts;
                return Err(DeviceError::TooManyMarkers { found, max: MARKERS_MAX });
            }
            _ => {}
        }
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let clock = DeviceClock::new(settings.drift_ppm)?;
        let faults = settings.faults.clone();
        let faults = faults.map(|script| SourceFaults::new(script, found));
        let (table, warnings) = marker_table(&motion.info.markers);
        let hello = Hello {
            model: "mocapd-sim".to_owned(),
            serial: settings.serial.clone(),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
            rate_millihertz: rates.rate_millihertz,
            rate_min_millihertz: *RATE_MILLIHERTZ.start(),
            rate_max_millihertz: *RATE_MILLIHERTZ.end(),
            tick_hz: TICK_HZ,
            up_axis: motion.info.up.code(),
            markers_max: (found + ghosts) as u16,
            n_frames: 0,
        };
        let mut device = Self {
            link: DeviceLink::new(),
            hello,
            table,
            replay: Replay::native(motion),
            rates,
            outbox: Outbox::default(),
            run: None,
            pending_end: None,
            end_sent: false,
            finished: false,
            log: SentLog::default(),
            warnings,
            clock,
            faults,
            first_start_ns: None,
            counter: 0,
            commands: Vec::new(),
            row: Vec::new(),
            samples: Vec::new(),
            groups: settings.sampled.iter().map(|_| GroupState::default()).collect(),
            batch: Vec::new(),
            poses_sent: 0,
            poses: Vec::new(),
            settings,
        };
        device.adopt_rate(rates.rate_millihertz);
        let mut trial = Vec::new();
        device.link.hello(&device.hello, &mut trial)?;
        device.link.markers(&device.table, &mut trial)?;
        for source in &device.settings.sampled {
            device.link.sampled_group(source.info(), &mut trial)?;
            source
                .force_plates()
                .iter()
                .try_for_each(|plate| device.link.force_plate(plate, &mut trial))?;
        }
        device.link.bodies(&device.body_infos(), &mut trial)?;
        Ok(device)
    }

    /// The Hello that it sends.
    #[must_use]
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// One sentence for each label that had to be changed for the link.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Whether a run is in progress, between Start and its end.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.run.is_some()
    }

    /// Sends a Status when one is due. Returns when the next one is.
    fn report(&mut self, mut run: Run, now_ns: u64) -> u64 {
        if run.status_ns <= now_ns {
            let status = self.status();
            self.answer(|link, out| link.status(status, out));
            run.status_ns = now_ns + SECOND_NS;
            self.run = Some(run);
        }
        run.status_ns
    }

    fn frame_time_ns(&self, run: &Run) -> u64 {
        let after_ns = frame_after_ns(self.log.run.frames_produced, self.hello.rate_millihertz);
        run.start_ns.saturating_add(self.clock.caller_ns(after_ns))
    }

    /// The time of the last frame.
    fn frame_time_before(&self, run: &Run) -> u64 {
        let last = self.log.run.frames_produced.saturating_sub(1);
        let after_ns = frame_after_ns(last, self.hello.rate_millihertz);
        run.start_ns.saturating_add(self.clock.caller_ns(after_ns))
    }

    fn ticks(&self, at_ns: u64) -> u64 {
        let ticks = self.clock.ticks(at_ns);
        let (Some(faults), Some(since_ns)) = (&self.faults, self.since_ns(at_ns)) else {
            return ticks;
        };
        ticks.saturating_add_signed(faults.clock_offset_ns(since_ns) / NS_PER_TICK)
    }

    fn since_ns(&self, at_ns: u64) -> Option<u64> {
        self.first_start_ns.map(|start_ns| at_ns.saturating_sub(start_ns))
    }

    fn status(&self) -> Status {
        Status {
            frames_produced: self.log.run.frames_produced,
            frames_dropped: self.log.run.frames_dropped,
            temperature_c_100: i16::MIN,
        }
    }

    /// Switches the device off: its memory is lost.
    pub(crate) fn lose_power(&mut self) {
        self.run = None;
        self.pending_end = None;
        self.end_sent = false;
        self.finished = false;
        self.outbox.discard();
        self.clock.reset();
        self.counter = 0;
        self.groups.fill(GroupState::default());
        self.poses_sent = 0;
        if let Some(faults) = &mut self.faults {
            faults.reset();
        }
    }

    /// Whether the motion was played to its end. A Stop or a Start from the host clears this.
    pub(crate) fn has_played_all(&self) -> bool {
        self.finished
    }

    /// Switches the device on again; with `greets`, on an open line, it sends an unsolicited Hello.
    pub(crate) fn power_up(&mut self, now_ns: u64, greets: bool) {
        self.clock.begin(now_ns);
        if greets {
            self.identify();
        }
    }

    /// Effects of the faults inside the device.
    pub(crate) fn fault_counts(&self) -> FaultCounts {
        self.faults.as_ref().map(|faults| faults.counts).unwrap_or_default()
    }

    fn add_ghosts(&mut self, since_ns: u64) {
        let Some(faults) = &mut self.faults else { return };
        let ghosts = faults.announce_ghosts(since_ns);
        faults.add_ghosts(since_ns, &mut self.samples);
        if !ghosts.is_empty() {
            self.answer(|link, out| {
                // Ghosts have no labels, and their number was checked.
                let outcome = link.markers(&ghosts, out);
                debug_assert!(outcome.is_ok());
            });
        }
    }

    /// Produces one frame, and queues it or drops it when the queue is full.
    fn produce(&mut self, at_ns: u64) {
        let number = self.log.run.frames_produced;
        let n_frames = self.replay.n_frames().max(1);
        self.replay.frame(number % n_frames, &mut self.row);
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        let counter = self.counter;
        let mut seq = counter;
        self.counter = self.counter.wrapping_add(1);
        if let Some(faults) = &mut self.faults {
            seq = faults.counter(seq, since_ns);
            faults.positions(since_ns, &mut self.row);
            faults.count_clock_faults(since_ns);
        }
        let residuals = self.settings.residuals.as_deref();
        let recorded = self.replay.recorded_frame(number % n_frames);
        let residuals = residuals.map_or(&[][..], |residuals| residuals.frame(recorded));
        let present = fill_samples(&self.table, (&self.row, residuals), &mut self.samples);
        self.add_ghosts(since_ns);
        let early_ns = self.faults.as_mut().map_or(0, |faults| faults.stamp_jitter_ns(since_ns));
        let device_ticks = self.ticks(at_ns).saturating_add_signed(-early_ns / NS_PER_TICK);
        let frame = Frame { seq, device_ticks, timecode: None, markers: &self.samples };
        let n_markers_max = usize::from(self.hello.markers_max);
        let mut dropped = !self.outbox.has_room(frame_bytes_max(n_markers_max));
        if !dropped {
            let (link, form) = (&mut self.link, self.settings.form);
            // Ids ascend and fit by construction. If the link refused a frame, it would count as dropped.
            self.outbox.put(Queued::Frame, |out| dropped = link.frame(form, &frame, out).is_err());
        }
        for counters in [&mut self.log.run, &mut self.log.total] {
            counters.frames_produced += 1;
            if dropped {
                counters.frames_dropped += 1;
            } else {
                counters.samples += u64::from(present);
                counters.samples_occluded += self.table.len() as u64 - u64::from(present);
            }
        }
        if self.settings.log_frames {
            self.log.frames.push(SentFrame {
                run: self.log.starts,
                seq,
                device_ticks,
                present,
                dropped,
                unasked: false,
                host_ns: at_ns,
            });
        }
        self.produce_poses(counter, number, at_ns);
    }
}

impl LineDevice for Device {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.clock.begin(now_ns);
        let mut commands = std::mem::take(&mut self.commands);
        self.link.push(bytes, &mut |command| commands.push(command));
        for command in commands.drain(..) {
            self.execute(command, now_ns);
        }
        self.commands = commands;
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        self.clock.begin(now_ns);
        let next_ns = loop {
            let Some(run) = self.run else { break u64::MAX };
            // Batches that are due with the last frame are queued: however late this is, none after it may be.
            if !self.settings.looping && self.log.run.frames_produced >= self.hello.n_frames {
                self.end(self.frame_time_before(&run));
                self.finished = true;
                break u64::MAX;
            }
            let next_ns = self.frame_time_ns(&run);
            let batch = self.next_batch(&run);
            if let Some((group, due_ns)) = batch
                && due_ns <= next_ns.min(now_ns)
            {
                self.produce_batch(group, &run);
                continue;
            }
            if next_ns > now_ns {
                let batch_ns = batch.map_or(u64::MAX, |(_, due_ns)| due_ns);
                break next_ns.min(batch_ns).min(self.report(run, now_ns));
            }
            self.produce(next_ns);
        };
        self.send_end_of_stream();
        next_ns
    }

    fn pending(&self) -> &[u8] {
        self.outbox.pending()
    }

    fn sent(&mut self, n: usize) {
        self.outbox.sent(n);
    }

    fn has_ended(&self) -> bool {
        self.run.is_none() && self.pending_end.is_none() && self.end_sent
    }

    fn log(&self) -> SentLog {
        self.outbox.complete_log(&self.log)
    }

    fn keep_frame_log(&mut self) {
        self.settings.log_frames = true;
    }

    fn take_frames(&mut self) -> Vec<SentFrame> {
        std::mem::take(&mut self.log.frames)
    }

    fn take_batch_lines(&mut self) -> Vec<String> {
        self.take_batches().into_iter().map(SentBatch::to_csv).collect()
    }
}

/// The device's marker table (one entry per column of the motion, whose number is the id), and warnings about changed
/// labels. Unlabelled markers get a temporary id and an empty label.
fn marker_table(markers: &[Marker]) -> (Vec<MarkerInfo>, Vec<String>) {
    let mut warnings = Vec::new();
    let mut table = Vec::with_capacity(markers.len());
    for (id, marker) in (0u16..).zip(markers) {
        let label = if marker.labelled { marker.label.as_str() } else { "" };
        let sent = link_label(label);
        if sent != label {
            let label = label.escape_debug();
            warnings.push(format!("the link cannot carry the label '{label}': sent as '{sent}'"));
        }
        table.push(MarkerInfo { id, label: sent, labelled: marker.labelled });
    }
    (table, warnings)
}

/// Replaces control characters by `_`, and truncates the label to what the link carries.
fn link_label(label: &str) -> String {
    let clean: String = label.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
    let end = (0..=clean.len().min(LABEL_BYTES_MAX)).rev().find(|i| clean.is_char_boundary(*i));
    clean.get(..end.unwrap_or(0)).unwrap_or_default().to_owned()
}

/// Fills `samples` with one frame, and returns the number of positions in it.
///
/// A labelled marker without a position is listed as occluded. An unlabelled one is omitted, because it is unknown
/// whether it still exists.
fn fill_samples(
    table: &[MarkerInfo],
    (row, residuals): (&[Position], &[u8]),
    samples: &mut Vec<MarkerSample>,
) -> u32 {
    samples.clear();
    let mut present = 0;
    let residuals = residuals.iter().copied().chain(std::iter::repeat(0));
    for ((marker, &position_mm), residual_10um) in table.iter().zip(row).zip(residuals) {
        let occluded = is_gap(position_mm);
        if !occluded {
            present += 1;
            let id = marker.id;
            samples.push(MarkerSample { id, occluded, residual_10um, position_mm });
        } else if marker.labelled {
            samples.push(MarkerSample { id: marker.id, occluded, ..MarkerSample::default() });
        }
    }
    present
}

/// Largest drift, parts per million: a tenth.
const DRIFT_MAX_PPM: f64 = 100_000.0;

/// A drifting clock in integer arithmetic: rounding errors do not accumulate over time.
#[derive(Debug)]
struct DeviceClock {
    /// Nanoseconds of the caller's clock per 10^9 of the device's.
    scale: u64,
    /// The caller's clock when the device's clock was 0.
    epoch_ns: Option<u64>,
}

impl DeviceClock {
    fn new(drift_ppm: f64) -> Result<Self, DeviceError> {
        if !(-DRIFT_MAX_PPM..=DRIFT_MAX_PPM).contains(&drift_ppm) {
            return Err(DeviceError::Drift { found_ppm: drift_ppm });
        }
        let scale = SECOND_NS.saturating_add_signed((drift_ppm * 1e3).round() as i64);
        Ok(Self { scale, epoch_ns: None })
    }

    /// Starts the clock, unless it is running.
    fn begin(&mut self, now_ns: u64) {
        self.epoch_ns.get_or_insert(now_ns);
    }

    /// Stops the clock until the next [`begin`](Self::begin), which starts it from 0.
    fn reset(&mut self) {
        self.epoch_ns = None;
    }

    /// The device's time at the caller's time `at_ns`, in ticks.
    fn ticks(&self, at_ns: u64) -> u64 {
        let since_ns = at_ns.saturating_sub(self.epoch_ns.unwrap_or(at_ns));
        let ticks = u128::from(since_ns) * u128::from(TICK_HZ) / u128::from(self.scale);
        u64::try_from(ticks).unwrap_or(u64::MAX)
    }

    /// The duration on the caller's clock of `device_ns` on the device's.
    fn caller_ns(&self, device_ns: u64) -> u64 {
        let ns = u128::from(device_ns) * u128::from(self.scale) / u128::from(SECOND_NS);
        u64::try_from(ns).unwrap_or(u64::MAX)
    }
}
