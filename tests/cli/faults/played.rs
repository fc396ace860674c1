//! Plays a script: a device with faults on a pty, and the program that records it.

use std::{
    io::Write,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::Builder,
};

use mocapd_drivers::{
    device::{Command, DeviceEvent, MarkerSample, Pose, Protocol},
    link::HostLink,
};
use mocapd_simulator::{
    device::{Device, DeviceSettings, LineDevice, SentBatch, SentFrame, SentLog},
    faults::{BatchFate, Fate, FaultyDevice, FrameFate, KINDS, Kind, Kinds, Script},
    generator::{ForcePlates, JumpSpec, Occlusion, RigidBodies},
    pty::{PtyLine, ServeOptions, serve},
    sampled::SampledSource,
    source::Residuals,
};
use mocapd_take::motion::Motion;
use serde_json::Value;

use super::super::{Folder, Ran};
use crate::support::{jump, samples};

pub(super) const RATE_HZ: f64 = 240.0;
const SECONDS: f64 = 2.0;

/// A device that keeps running while its cable is pulled: a busy machine has time to open it again before the end.
const SECONDS_UNPLUGGED: f64 = 6.0;

/// The result of playing a script.
pub(super) struct Played {
    pub(super) ran: Ran,
    pub(super) report: Value,
    pub(super) info: Value,
    pub(super) sent: SentLog,
    /// Every frame in the order in which the device produced it.
    pub(super) fates: Vec<FrameFate>,
    /// Every batch of samples, likewise.
    pub(super) batches: Vec<BatchFate>,
    /// The logs of frames and of batches.
    pub(super) logs: [String; 2],
}

fn motion(script: &Script) -> Motion {
    let seconds = if script.has(Kind::Unplug) { SECONDS_UNPLUGGED } else { SECONDS };
    jump(1, RATE_HZ, seconds)
}

/// Serves a device at `rig` in the folder, and records it with these options. `log` receives its frames.
pub(crate) fn record_from(
    folder: &Folder,
    mut device: impl LineDevice + Send + 'static,
    [log, batch_log]: [Option<Box<dyn Write + Send>>; 2],
    options: &[&str],
) -> (Ran, SentLog) {
    let link = folder.path("rig");
    let mut line = PtyLine::open(Some(&link)).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let thread = Builder::new().name("simulator".to_owned()).spawn(move || {
        let options = ServeOptions { log, batch_log, ..ServeOptions::default() };
        serve(&mut line, &mut device, options, &stopped).unwrap()
    });
    let uri = format!("serial:{}", link.display());
    let record = [&["record", "-d", &uri, "--lossless", "--json"][..], options].concat();
    let ran = folder.run(&record);
    stop.store(true, Ordering::Relaxed);
    let sent = thread.unwrap().join().unwrap();
    assert!(!ran.stdout.is_empty(), "{}", ran.stderr);
    (ran, sent)
}

/// The sampled channels of the device: two force plates and five electrodes.
pub(crate) fn sources() -> Vec<SampledSource> {
    let plates = Arc::new(ForcePlates::new(&JumpSpec::new(1, RATE_HZ)).unwrap());
    vec![
        SampledSource::plates(0, plates, 1000.0).unwrap(),
        SampledSource::electrodes(1, "5@2kHz".parse().unwrap(), 9).unwrap(),
    ]
}

/// Rigid bodies in two groups of a take, a tenth of whose poses are missing.
pub(crate) fn bodies() -> RigidBodies {
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.2 });
    RigidBodies::new(&JumpSpec { occlusion, ..JumpSpec::new(1, RATE_HZ) }, 10).unwrap()
}

/// The residuals of the motion.
fn residuals(script: &Script) -> Residuals {
    Residuals::generated(5, &motion(script))
}

fn settings(script: &Arc<Script>) -> DeviceSettings {
    // A busy machine must not make the device drop frames; a stall must.
    let queue_bytes = if script.has(Kind::Stall) { None } else { Some(64 << 20) };
    let (sampled, faults) = (sources(), Some(Arc::clone(script)));
    let (bodies, residuals) = (Some(Arc::new(bodies())), Some(Arc::new(residuals(script))));
    DeviceSettings { queue_bytes, faults, sampled, bodies, residuals, ..DeviceSettings::default() }
}

/// A log file that the test reads when the device is done.
#[derive(Clone, Default)]
pub(crate) struct SharedLog(Arc<Mutex<Vec<u8>>>);

impl SharedLog {
    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
    }
}

impl Write for SharedLog {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Records a device with the faults of a script, to its end.
pub(super) fn play(folder: &Folder, script: &Script) -> Played {
    let script = Arc::new(script.clone());
    let device = Device::new(motion(&script), settings(&script)).unwrap();
    let device = FaultyDevice::new(device, &script);
    let logs = [SharedLog::default(), SharedLog::default()];
    let [log, batch_log] = logs.clone().map(|log| Some(Box::new(log) as Box<dyn Write + Send>));
    let (ran, sent) =
        record_from(folder, device, [log, batch_log], &["-o", "a.take", "--residuals"]);
    let [log, batch_log] = logs.map(|log| log.text());
    let report = ran.json();
    let info = folder.run(&["info", "a.take", "--json"]).json();
    let (fates, batches) = (fates(&log), batch_fates(&batch_log));
    Played { ran, report, info, sent, fates, batches, logs: [log, batch_log] }
}

/// Reads the log file back.
pub(crate) fn fates(log: &str) -> Vec<FrameFate> {
    let mut lines = log.lines();
    assert_eq!(lines.next(), Some(FrameFate::CSV_HEADER));
    lines.map(|line| fate_of(line).unwrap_or_else(|| panic!("{line}"))).collect()
}

/// Reads the log file of batches back.
fn batch_fates(log: &str) -> Vec<BatchFate> {
    let mut lines = log.lines();
    assert_eq!(lines.next(), Some(BatchFate::CSV_HEADER));
    lines.map(|line| batch_fate_of(line).unwrap_or_else(|| panic!("{line}"))).collect()
}

/// Parses a batch from a line of its log file; `None` for other lines.
fn batch_fate_of(line: &str) -> Option<BatchFate> {
    let cells: Vec<&str> = line.split(',').collect();
    let number = |i: usize| cells.get(i)?.parse::<u64>().ok();
    let frame = SentBatch {
        run: number(0)?,
        group: number(1)? as u8,
        number: number(2)? as u32,
        first: number(3)?,
        first_in_run: number(4)?,
        n: number(5)?,
        device_ticks: number(6)?,
        dropped: number(7)? == 1,
        host_ns: number(8)?,
    };
    let (fate, again) = (fate_named(cells.get(9)?)?, number(10)? as u32);
    let (faults, frames) = (kinds_named(cells.get(11)?)?, number(12)?);
    Some(BatchFate { frame, frames, fate, again, faults })
}

/// The contents of each frame in the log.
pub(super) fn sent_frames(script: &Script, played: &Played) -> Vec<Vec<MarkerSample>> {
    let changes_motion = [Kind::Swaps, Kind::Ghosts, Kind::OcclusionStorm];
    if changes_motion.iter().any(|kind| script.has(*kind)) {
        let all = played.fates.iter().all(|f| f.frame.run == 1 && f.fate != Fate::Dropped);
        assert!(all, "one run, as below");
        return in_virtual_time(script).0;
    }
    let (motion, residuals) = (motion(script), residuals(script));
    let mut run = (0, 0);
    let frame = |fate: &FrameFate| {
        run = if run.0 == fate.frame.run { (run.0, run.1 + 1) } else { (fate.frame.run, 0) };
        let mut markers = samples(motion.frame(run.1));
        for (marker, residual) in markers.iter_mut().zip(residuals.frame(run.1 as u64)) {
            marker.residual_10um = *residual;
        }
        markers
    };
    played.fates.iter().map(frame).collect()
}

/// The poses of each frame of a run, by its number; those of all runs are the same, except where bodies are hidden.
pub(super) fn sent_poses(script: &Script) -> Vec<Vec<Pose>> {
    if script.has(Kind::OcclusionStorm) {
        return in_virtual_time(script).1;
    }
    let (bodies, mut poses) = (bodies(), Vec::new());
    let frame = |number| {
        bodies.poses(number, RATE_HZ, &mut poses);
        poses.clone()
    };
    (0..motion(script).n_frames() as u64).map(frame).collect()
}

/// The markers and poses of the same device without a line, in virtual time.
fn in_virtual_time(script: &Script) -> (Vec<Vec<MarkerSample>>, Vec<Vec<Pose>>) {
    let mut device = Device::new(motion(script), settings(&Arc::new(script.clone()))).unwrap();
    let mut host = HostLink::new();
    let mut command = Vec::new();
    host.command(Command::Start { line_bytes_per_s: 0 }, &mut command);
    let mut now_ns = 77;
    device.on_bytes(&command, now_ns);
    let (mut frames, mut poses) = (Vec::new(), Vec::new());
    while now_ns != u64::MAX {
        now_ns = device.poll(now_ns);
        let pending = device.pending().to_vec();
        device.sent(pending.len());
        host.push(&pending, &mut |event| match event {
            DeviceEvent::Frame(frame) => frames.push(frame.markers.to_vec()),
            DeviceEvent::Poses(frame) => poses.push(frame.poses.to_vec()),
            _ => {}
        });
    }
    (frames, poses)
}

/// Parses a frame from a line of the log file; `None` for other lines.
fn fate_of(line: &str) -> Option<FrameFate> {
    let mut cells = line.split(',');
    let mut cell = || cells.next();
    let frame = SentFrame {
        run: cell()?.parse().ok()?,
        seq: cell()?.parse().ok()?,
        device_ticks: cell()?.parse().ok()?,
        present: cell()?.parse().ok()?,
        dropped: cell()? == "1",
        host_ns: cell()?.parse().ok()?,
        unasked: cell()? == "1",
    };
    let fate = fate_named(cell()?)?;
    let again = cell()?.parse().ok()?;
    let faults = kinds_named(cell()?)?;
    let frames = cell()?.parse().ok()?;
    Some(FrameFate { frame, frames, fate, again, faults })
}

fn fate_named(name: &str) -> Option<Fate> {
    use Fate::{Damaged, Discarded, Dropped, Late, Lost, Unasked, Waiting, Whole};
    let fates = [Whole, Late, Unasked, Damaged, Lost, Dropped, Discarded, Waiting];
    fates.into_iter().find(|fate| fate.name() == name)
}

fn kinds_named(names: &str) -> Option<Kinds> {
    let mut faults = Kinds::default();
    for name in names.split('+').filter(|name| !name.is_empty()) {
        faults.add(Kinds::of(KINDS.iter().find(|keys| keys.name == name)?.kind));
    }
    Some(faults)
}
