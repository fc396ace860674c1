//! A device over a motion, sans-io: the host's bytes and the time go in, the device's bytes come out.
//!
//! Times are nanoseconds of one monotonic clock, whichever the caller has.

mod clock;
mod line_device;
mod log;
mod outbox;
mod rates;
mod settings;
mod table;
mod talk;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use mocapd_drivers::device::{
    Command, Frame, Hello, LinkCounters, MarkerInfo, MarkerSample, Status,
};
use mocapd_drivers::link::{DeviceLink, MARKERS_MAX, frame_bytes_max};
use mocapd_take::motion::{Motion, Position, UpAxis};

use clock::DeviceClock;
pub use line_device::LineDevice;
pub use log::{SentCounters, SentFrame, SentLog};
pub(crate) use outbox::Outbox;
pub(crate) use rates::Rates;
pub use settings::{DeviceError, DeviceSettings, RATE_MHZ, TICK_HZ};

use crate::faults::{Parts, SourceFaults};
use crate::replay::Replay;

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
    /// An end of stream that found no room yet.
    owed_end: Option<Status>,
    end_said: bool,
    /// The motion was played to its end, and no host has stopped or started it since: its end may have been lost.
    finished: bool,
    log: SentLog,
    warnings: Vec<String>,
    clock: DeviceClock,
    faults: Option<SourceFaults>,
    first_start_ns: Option<u64>,
    /// The next frame's number on the wire: since power-up, while the log counts since the device was made.
    counter: u32,
    commands: Vec<Command>,
    row: Vec<Position>,
    samples: Vec<MarkerSample>,
}

/// From a Start to its end.
#[derive(Debug, Clone, Copy)]
struct Run {
    start_ns: u64,
    status_ns: u64,
}

impl Device {
    /// A device that is switched on, and waits.
    ///
    /// # Errors
    /// When there is nothing to send, or a rate, a speed or a text is out of range.
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
        let rates = Rates::new(&motion, &settings)?;
        let clock = DeviceClock::new(settings.drift_ppm)?;
        let faults = settings.faults.clone();
        let faults = faults.map(|script| SourceFaults::new(script, found));
        let (table, warnings) = table::announce(&motion.info.markers);
        let hello = Hello {
            model: "mocapd-sim".to_owned(),
            serial: settings.serial.clone(),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
            rate_mhz: rates.rate_mhz,
            rate_min_mhz: *RATE_MHZ.start(),
            rate_max_mhz: *RATE_MHZ.end(),
            tick_hz: TICK_HZ,
            up_axis: match motion.info.up {
                UpAxis::Unknown => 0,
                UpAxis::X => 1,
                UpAxis::Y => 2,
                UpAxis::Z => 3,
            },
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
            owed_end: None,
            end_said: false,
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
            settings,
        };
        device.adopt_rate(rates.rate_mhz);
        let mut trial = Vec::new();
        device.link.hello(&device.hello, &mut trial)?;
        device.link.markers(&device.table, &mut trial)?;
        Ok(device)
    }

    /// Who it says it is.
    #[must_use]
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// What of the motion could not be said as it was, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// What the host's bytes were.
    #[must_use]
    pub fn host_counters(&self) -> LinkCounters {
        self.link.counters()
    }

    /// Whether frames are due: between a Start and its end.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.run.is_some()
    }

    /// Whether a run has ended and its end of stream was queued, with no Start or Identify since.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.run.is_none() && self.owed_end.is_none() && self.end_said
    }

    /// What it sent so far.
    #[must_use]
    pub fn log(&self) -> SentLog {
        self.outbox.completed(&self.log)
    }

    /// Keeps a [`SentFrame`] for every frame from now on; [`take_frames`](Self::take_frames) takes them away.
    pub fn keep_frame_log(&mut self) {
        self.settings.log_frames = true;
    }

    /// Takes the logged frames away.
    pub fn take_frames(&mut self) -> Vec<SentFrame> {
        std::mem::take(&mut self.log.frames)
    }

    /// The bytes that the line should carry next.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        self.outbox.pending()
    }

    /// The line took the first `n` pending bytes.
    pub fn sent(&mut self, n: usize) {
        self.outbox.sent(n);
    }

    /// Bytes from the host, in pieces of any size.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.clock.begin(now_ns);
        let mut commands = std::mem::take(&mut self.commands);
        self.link.push(bytes, &mut |command| commands.push(command));
        for command in commands.drain(..) {
            self.obey(command, now_ns);
        }
        self.commands = commands;
    }

    /// Does what is due. Gives the time of the next thing that will be; `u64::MAX` when only the host can
    /// cause one.
    pub fn poll(&mut self, now_ns: u64) -> u64 {
        self.clock.begin(now_ns);
        let next_ns = loop {
            let Some(run) = self.run else { break u64::MAX };
            let next_ns = self.frame_time_ns(&run);
            if !self.settings.looping && self.log.run.frames_produced >= self.hello.n_frames {
                self.end();
                self.finished = true;
                break u64::MAX;
            }
            if next_ns > now_ns {
                break next_ns.min(self.report(run, now_ns));
            }
            self.produce(next_ns);
        };
        self.say_end();
        next_ns
    }

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
        let after = u128::from(self.log.run.frames_produced) * 1000 * u128::from(SECOND_NS)
            / u128::from(self.hello.rate_mhz.max(1));
        let after_ns = self.clock.caller_ns(u64::try_from(after).unwrap_or(u64::MAX));
        run.start_ns.saturating_add(after_ns)
    }

    fn ticks(&self, at_ns: u64) -> u64 {
        let ticks = self.clock.ticks(at_ns);
        let (Some(faults), Some(since_ns)) = (&self.faults, self.since_ns(at_ns)) else {
            return ticks;
        };
        ticks.saturating_add_signed(faults.clock_ahead_ns(since_ns) / NS_PER_TICK)
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

    /// The device is switched off: what it was about to say is gone.
    pub(crate) fn lose_power(&mut self) {
        self.run = None;
        self.owed_end = None;
        self.end_said = false;
        self.finished = false;
        self.outbox.discard();
        self.clock.reset();
        self.counter = 0;
        if let Some(faults) = &mut self.faults {
            faults.begin_anew();
        }
    }

    /// It is switched on again. `greets`: its line is open, and it says who it is.
    pub(crate) fn power_up(&mut self, now_ns: u64, greets: bool) {
        self.clock.begin(now_ns);
        if greets {
            self.identify();
        }
    }

    /// What the faults inside it had a part in.
    pub(crate) fn fault_parts(&self) -> Parts {
        self.faults.as_ref().map(SourceFaults::parts).unwrap_or_default()
    }

    fn add_ghosts(&mut self, since_ns: u64) {
        let Some(faults) = &mut self.faults else { return };
        let ghosts = faults.announce_ghosts(since_ns);
        faults.add_ghosts(since_ns, &mut self.samples);
        if !ghosts.is_empty() {
            self.answer(|link, out| {
                // No label is too long, and there are few enough.
                let said = link.markers(&ghosts, out);
                debug_assert!(said.is_ok());
            });
        }
    }

    /// One frame, whose time has come, into the queue or lost.
    fn produce(&mut self, at_ns: u64) {
        let number = self.log.run.frames_produced;
        let n_frames = self.replay.n_frames().max(1);
        self.replay.frame(number % n_frames, &mut self.row);
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        let mut seq = self.counter;
        self.counter = self.counter.wrapping_add(1);
        if let Some(faults) = &mut self.faults {
            seq = faults.counter(seq, since_ns);
            faults.positions(since_ns, &mut self.row);
        }
        if let Some(faults) = &mut self.faults {
            faults.stamped(since_ns);
        }
        let present = table::list(&self.table, &self.row, &mut self.samples);
        self.add_ghosts(since_ns);
        let device_ticks = self.ticks(at_ns);
        let frame = Frame { seq, device_ticks, timecode: None, markers: &self.samples };
        let n_markers_max = usize::from(self.hello.markers_max);
        let mut dropped = !self.outbox.has_room(frame_bytes_max(n_markers_max));
        if !dropped {
            let (link, form) = (&mut self.link, self.settings.form);
            // Ids ascend and are few enough by construction; a frame the link refused would not have left.
            self.outbox.put(true, |out| dropped = link.frame(form, &frame, out).is_err());
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
            let run = self.log.starts;
            let host_ns = at_ns;
            let unasked = false;
            self.log.frames.push(SentFrame {
                run,
                seq,
                device_ticks,
                present,
                dropped,
                unasked,
                host_ns,
            });
        }
    }
}
