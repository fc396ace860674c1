//! The rig's thread: finds the device, arms the pipeline, reads frames, and starts again when that ends.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use crossbeam_channel::Sender;
use jiff::Zoned;
use mocapd_acquire::{
    host_clock::monotonic_ns,
    pipeline::{Intake, Pipeline, PipelineConfig, PreRollConfig},
    raw_log::RawLog,
    rig::{ReadOptions, Rig},
};
use mocapd_drivers::{
    registry::{self, Candidate},
    transport::usb::UsbWatch,
    uri::{DeviceUri, Location},
};
use mocapd_take::record::EndingKind;

use super::{
    EngineOptions, Inner,
    hub::NewSession,
    session::{Core, KnownDevice, Session},
};
use crate::{
    config::{key_hint, message_with_keys},
    publish::PublishedDevice,
    status::ServiceEventKind,
};

/// Time between attempts to open a device that is missing or does not respond.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Time between checks whether an idle device is connected.
const PRESENCE_INTERVAL: Duration = Duration::from_secs(2);

/// Shortest session: limits restarts of a device that keeps ending its stream at once.
const SESSION_MIN: Duration = Duration::from_secs(1);

/// Runs until the service ends.
pub(super) fn run(inner: &Arc<Inner>, sessions: &Sender<NewSession>) {
    let mut watch = UsbWatch::new();
    while !inner.is_stopping() {
        if !inner.core().arm_requested {
            inner.check_presence();
            inner.wait_while(PRESENCE_INTERVAL, |core| !core.arm_requested);
            continue;
        }
        let begun = Instant::now();
        match inner.open() {
            Ok((rig, log)) => {
                if inner.run_session(rig, sessions) {
                    inner.finish_log(log);
                } else {
                    discard(log);
                }
                let rest = SESSION_MIN.saturating_sub(begun.elapsed());
                if inner.core().arm_requested && !inner.is_stopping() {
                    std::thread::sleep(rest);
                }
            }
            Err(error) => {
                inner.report_obstacle(&message_with_keys(&error));
                watch.wait(RETRY_INTERVAL);
            }
        }
    }
}

impl Inner {
    pub(super) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    /// Waits while `condition` holds (changes are notified), at most `at_most`, and not while the service is stopping.
    pub(super) fn wait_while(&self, at_most: Duration, condition: impl Fn(&Core) -> bool) {
        let core = self.core();
        let goes_on = |core: &mut Core| condition(core) && !self.is_stopping();
        drop(self.changed.wait_timeout_while(core, at_most, goes_on));
    }

    fn check_presence(&self) {
        let options = Arc::clone(&self.core().options);
        let found = options.find_device();
        let present = found.as_ref().is_ok_and(is_attached);
        let mut core = self.core();
        let changed = core.device.present != present;
        core.device.present = present;
        core.device.obstacle = found.err().map(|error| format!("{error:#}"));
        drop(core);
        if changed {
            let what = if present { "device connected" } else { "device disconnected" };
            self.publish(ServiceEventKind::Device, what, None);
        }
    }

    /// Reports an obstacle to arming, once.
    fn report_obstacle(&self, message: &str) {
        let mut core = self.core();
        let is_new = core.device.obstacle.as_deref() != Some(message);
        core.device.obstacle = Some(message.to_owned());
        core.device.present = false;
        drop(core);
        self.changed.notify_all();
        if is_new {
            self.publish(ServiceEventKind::Warning, message, None);
        }
    }

    fn open(&self) -> anyhow::Result<(Rig, Option<RawLog>)> {
        let core = self.core();
        let (options, identity) = (Arc::clone(&core.options), core.device.identity.clone());
        let known = core.device.uri.clone();
        drop(core);
        let uri = options.find_device()?;
        let log = options.device.raw_log.then(|| begin_log(&options)).transpose()?;
        let identity = identity.filter(|_| uri.to_string() == known);
        let mut rig = match open_rig(&options, &uri, identity, &log) {
            Ok(rig) => rig,
            Err(error) => {
                discard(log);
                return Err(error);
            }
        };
        rig.wait_for_replug(options.take.reconnect);
        rig.limit_loss(options.take.stretch, options.take.sync);
        let mut core = self.core();
        core.device = KnownDevice {
            uri: uri.to_string(),
            present: true,
            obstacle: None,
            hello: rig.hello().clone(),
            driver: rig.family().to_owned(),
            markers: rig.markers().len(),
            identity: Some(rig.identity().clone()),
        };
        drop(core);
        Ok((rig, log))
    }

    /// Closes the raw log once the device is no longer read.
    fn finish_log(&self, log: Option<RawLog>) {
        let Some(log) = log else { return };
        let name = log.path().display().to_string();
        let message = match log.finish() {
            Ok(logged) if logged.is_whole() => return,
            Ok(logged) => {
                let n = logged.missing_bytes;
                format!("{n} received bytes are missing from the raw log {name}")
            }
            Err(error) => format!("the raw log {name}: {error:#}"),
        };
        self.publish(ServiceEventKind::Warning, &message, None);
    }

    /// Runs a session. Returns whether a frame arrived.
    fn run_session(&self, rig: Rig, sessions: &Sender<NewSession>) -> bool {
        let stop = Arc::new(AtomicBool::new(false));
        let (intake, pipeline) = match self.begin_session(&rig, &stop, sessions) {
            Ok(begun) => begun,
            Err(error) => {
                self.report_obstacle(&format!("{error:#}"));
                return false;
            }
        };
        self.publish(ServiceEventKind::State, "armed", None);
        let defer = |message: &str| self.events.defer(message);
        let options = ReadOptions {
            stop: &stop,
            rows_max: None,
            length: None,
            single_take: false,
            notify: &defer,
            how_to_end: "",
            how_to_set: key_hint,
        };
        let progress = Arc::clone(pipeline.progress());
        let read = rig.read(intake, &options);
        // From here no take can begin, and one in progress ends.
        self.core().session = None;
        let joined = pipeline.join();
        let message = match (&read, &joined) {
            (_, Err(error)) => {
                self.fail(&format!("{error:#}"));
                "recording pipeline failed"
            }
            (Err(error), _) => {
                self.report_obstacle(&message_with_keys(error));
                "device cannot be read"
            }
            (Ok(recording), _) => match recording.ending {
                EndingKind::DeviceEnded => {
                    // A replay that is over is not started again automatically.
                    self.core().arm_requested = false;
                    "device ended its stream"
                }
                EndingKind::DeviceGone => "device gone",
                EndingKind::CutOff => {
                    self.fail("the recording pipeline failed: see the log");
                    "recording pipeline failed"
                }
                _ => "disarmed",
            },
        };
        self.changed.notify_all();
        self.publish(ServiceEventKind::State, message, None);
        progress.frames.load(Ordering::Relaxed) > 0
    }

    fn begin_session(
        &self,
        rig: &Rig,
        stop: &Arc<AtomicBool>,
        sessions: &Sender<NewSession>,
    ) -> anyhow::Result<(Intake, Pipeline)> {
        let options = Arc::clone(&self.core().options);
        let pre_roll = PreRollConfig {
            time: options.arm.pre_roll,
            bytes_max: usize::try_from(options.arm.memory_max_bytes).unwrap_or(usize::MAX),
        };
        let config = PipelineConfig {
            pre_roll: Some(pre_roll),
            publish_taps: self.publications.len(),
            heartbeat: self.heartbeat.clone(),
            ..rig.pipeline_config(options.take.codec)
        };
        let header = rig.take_header(&config)?;
        let (intake, pipeline, armed) = Pipeline::arm(&config, &header)?;
        let progress = Arc::clone(pipeline.progress());
        let number = self.sessions.fetch_add(1, Ordering::Relaxed) + 1;
        let session = Session {
            number,
            takes: armed.takes,
            progress: Arc::clone(&progress),
            seen: armed.seen,
            slots: config.channels.len() + config.reserve,
            pre_roll: options.arm.pre_roll,
            reconnect: options.take.reconnect,
            armed_ns: monotonic_ns(),
            stop: Arc::clone(stop),
            header: header.clone(),
        };
        let device = PublishedDevice {
            header: header.clone(),
            progress: Arc::clone(&progress),
            bodies: config.recorded_bodies().to_vec(),
            sampled: config.sampled.clone(),
            plates: rig.plates().to_vec(),
            subject: options.subject.clone(),
        };
        self.publications.set_device(armed.publish_taps, &device);
        // The hub drops the previous session: it checks this channel in every round.
        let (tap, sample_tap) = (armed.tap, armed.sample_tap);
        let PublishedDevice { sampled, bodies, .. } = device;
        sessions.try_send(NewSession { tap, sample_tap, sampled, bodies, progress, header }).ok();
        let mut core = self.core();
        core.session = Some(session);
        // A disarm or stop may have been requested during arming.
        if !core.arm_requested || self.is_stopping() {
            stop.store(true, Ordering::Relaxed);
        }
        drop(core);
        self.changed.notify_all();
        Ok((intake, pipeline))
    }

    /// Reports a failure of the data plane, which needs attention.
    pub(super) fn fail(&self, message: &str) {
        self.core().failure = Some(message.to_owned());
        self.changed.notify_all();
        self.publish(ServiceEventKind::Failure, message, None);
    }
}

/// Opens the device, at the port where it is now, and sets its rate.
fn open_rig(
    options: &EngineOptions,
    uri: &DeviceUri,
    identity: Option<Candidate>,
    log: &Option<RawLog>,
) -> anyhow::Result<Rig> {
    let tap = log.as_ref().map(RawLog::tap);
    let mut rig = match identity {
        Some(identity) => Rig::reopen(uri, &identity, tap)?,
        None => Rig::open_logged(uri, tap)?,
    };
    rig.limit_angles(options.take.angle_degrees);
    rig.record_residuals(options.take.residuals);
    rig.state_up_axis(options.take.up_axis);
    if let Some(rate_hz) = options.device.rate_hz {
        rig.set_rate(rate_hz)?;
    }
    Ok(rig)
}

/// Starts a raw log named by the time.
fn begin_log(options: &EngineOptions) -> anyhow::Result<RawLog> {
    let now = Zoned::now().strftime("%Y-%m-%d_%H%M%S%.3f");
    let name = format!("{now}_{}.rawlog", options.rig);
    RawLog::start(&options.take.directory.join(name), options.take.sync)
}

/// Removes the raw log of a session without frames.
fn discard(log: Option<RawLog>) {
    let Some(log) = log else { return };
    let path = log.path().to_owned();
    drop(log.finish());
    std::fs::remove_file(path).ok();
}

/// Whether a device is attached at the location, without opening it.
fn is_attached(uri: &DeviceUri) -> bool {
    match &uri.location {
        Location::Serial { path, .. } => path.exists(),
        Location::Usb { vid, pid, serial } => registry::devices().is_ok_and(|listed| {
            listed.iter().any(|device| {
                device.candidate.usb_ids == Some((*vid, *pid))
                    && (serial.is_none() || device.candidate.serial == *serial)
            })
        }),
        // Only a connection attempt shows.
        Location::Network(_) | Location::Streams(_) => true,
    }
}
