//! State shared by the engine's threads, and the status that it assembles from the state and the counters of the data plane.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime},
};

use crossbeam_channel::Receiver;
use mocapd_acquire::{
    files::FileId,
    header::SOFTWARE,
    host_clock::monotonic_ns,
    pipeline::{
        CommandSender, FirstRow, NewTake, PipelineProgress, RESERVE_MIN_BYTES, TakeOutput,
        TakeResult, VisibilityCounters, lock,
    },
};
use mocapd_drivers::{device::Hello, registry::Candidate};
use mocapd_take::record::{EndingKind, Header};
use rustix::fs::statvfs;

use super::{EngineOptions, Inner};
use crate::{
    control::Start,
    status::{
        DeviceStatus, DiskStatus, InputStatus, OutageStatus, PendingStart, PreRollStatus, Presence,
        State, Status, TakeStatus, TakeSummary, TrialNames,
    },
};

/// Maximum number of removed files that are kept open: several takes may be removed in a row, but each occupies the
/// disk.
pub(super) const KEPT_OPEN_MAX: usize = 4;

/// The engine's state, from which [`State`](crate::status::State) is derived.
#[derive(Debug)]
pub(super) struct Core {
    pub(super) options: Arc<EngineOptions>,
    /// Whether the device should be armed, now or when it is back.
    pub(super) arm_requested: bool,
    pub(super) failure: Option<String>,
    pub(super) device: KnownDevice,
    /// While armed.
    pub(super) session: Option<Session>,
    /// While recording.
    pub(super) take: Option<OpenTake>,
    pub(super) last_take: Option<TakeSummary>,
    /// A start that waits for its time.
    pub(super) scheduled: Option<ScheduledStart>,
    /// Why the last one did not take place.
    pub(super) missed_start: Option<String>,
    /// The names of the last start that had any.
    pub(super) names: Option<TrialNames>,
    /// Number of takes that are no longer recorded but still being closed or copied.
    pub(super) closing: u32,
    /// How the last take lost data; a program that asks to stop it has to learn of it.
    pub(super) data_lost: Option<String>,
    /// Files of removed takes that could not be saved: they can be copied from /proc until the next take has begun. At
    /// most [`KEPT_OPEN_MAX`].
    pub(super) kept_open: Vec<Box<dyn TakeOutput>>,
}

/// A start that waits for its time of day.
#[derive(Debug)]
pub(super) struct ScheduledStart {
    pub(super) start: Start,
    pub(super) pending: PendingStart,
}

/// What is known about the device, whether it is connected or not.
#[derive(Debug, Default)]
pub(super) struct KnownDevice {
    pub(super) uri: String,
    pub(super) present: bool,
    pub(super) obstacle: Option<String>,
    pub(super) hello: Hello,
    pub(super) driver: String,
    pub(super) markers: usize,
    /// The identity used to find it again.
    pub(super) identity: Option<Candidate>,
}

/// A session: the time for which the device runs.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) number: u64,
    pub(super) takes: CommandSender,
    pub(super) progress: Arc<PipelineProgress>,
    pub(super) seen: VisibilityCounters,
    /// The header of its takes, except for their own fields.
    pub(super) header: Header,
    pub(super) slots: usize,
    /// Length of the pre-roll.
    pub(super) pre_roll: Duration,
    /// How long to wait for a device that has disconnected.
    pub(super) reconnect: Duration,
    /// When it was armed, in nanoseconds of the monotonic clock.
    pub(super) armed_ns: u64,
    /// Ends the session when set.
    pub(super) stop: Arc<AtomicBool>,
}

impl Session {
    /// Gives a take the session's header, and keeps the take's own fields.
    pub(super) fn with_header(&self, take: NewTake) -> NewTake {
        let Header { take_id, created_unix_ms, .. } = take.header;
        NewTake { header: Header { take_id, created_unix_ms, ..self.header.clone() }, ..take }
    }
}

/// The name and file of a take.
#[derive(Debug, Clone)]
pub(super) struct NamedTake {
    /// Id of the take, 32 hexadecimal digits.
    pub(super) id: String,
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) file: FileId,
}

impl NamedTake {
    /// Removes the empty file of a take that does not begin.
    pub(super) fn discard(&self) {
        // A failed disk may fail here as well; the file is then listed as unreadable.
        self.file.remove(&self.path).ok();
    }
}

/// The take being recorded.
#[derive(Debug)]
pub(super) struct OpenTake {
    pub(super) named: NamedTake,
    pub(super) requested_unix_ms: i64,
    pub(super) begun: Instant,
    pub(super) rate_hz: f64,
    /// The requested length, from its start on.
    pub(super) length: Option<Duration>,
    pub(super) first: Option<FirstRow>,
    pub(super) ended: Receiver<TakeResult>,
    /// Number of changes to its file that have been reported.
    pub(super) changes_reported: u32,
    /// The requested ending, once one was requested.
    pub(super) ending: Option<EndingKind>,
}

/// Rates that are measured regularly; f64 values are stored as bits.
#[derive(Debug, Default)]
pub(super) struct Rates {
    /// The session measured by `frames_hz` from its beginning; 0 if there is none.
    pub(super) session: AtomicU64,
    pub(super) frames_hz: AtomicU64,
    pub(super) cpu_cores: AtomicU64,
    /// Free bytes in the takes' folder plus one; 0 while unknown.
    pub(super) free_bytes: AtomicU64,
}

impl Core {
    /// A message with the remedy, while the device is away.
    pub(super) fn away(&self) -> Option<String> {
        let session = self.session.as_ref()?;
        let message =
            "the device is absent: plug it in or switch it on; recording continues by itself";
        session.progress.is_away.load(Ordering::Relaxed).then(|| message.to_owned())
    }

    pub(super) fn new(options: EngineOptions) -> Self {
        Self {
            names: TrialNames::last(&options.take.directory),
            device: KnownDevice { uri: options.device.uri.to_string(), ..KnownDevice::default() },
            options: Arc::new(options),
            arm_requested: false,
            failure: None,
            session: None,
            take: None,
            last_take: None,
            scheduled: None,
            missed_start: None,
            closing: 0,
            data_lost: None,
            kept_open: Vec::new(),
        }
    }
}

pub(super) fn unix_ms() -> i64 {
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_1970.as_millis()).unwrap_or(i64::MAX)
}

impl Core {
    pub(super) fn state(&self) -> State {
        match (&self.failure, &self.take, &self.session) {
            (_, Some(_), _) => State::Recording,
            (Some(_), None, _) => State::Failed,
            (None, None, Some(_)) => State::Armed,
            (None, None, None) => State::Idle,
        }
    }

    fn presence(&self, rate_hz: f64, measured_in: u64) -> Presence {
        match &self.session {
            Some(session) if session.progress.is_away.load(Ordering::Relaxed) => Presence::Absent,
            Some(session) if rate_hz == 0.0 && measured_in == session.number => Presence::Silent,
            Some(_) => Presence::Streaming,
            None if self.device.present => Presence::Present,
            None => Presence::Absent,
        }
    }
}

fn load(n: &AtomicU64) -> u64 {
    n.load(Ordering::Relaxed)
}

impl Inner {
    pub(super) fn status(&self) -> Status {
        let measured_hz = f64::from_bits(load(&self.rates.frames_hz));
        let core = self.core();
        let options = &core.options;
        let mut status = Status {
            rig: options.rig.clone(),
            state: core.state(),
            failure: core.failure.clone(),
            software: SOFTWARE.to_owned(),
            uptime_s: self.began.elapsed().as_secs_f64(),
            device: DeviceStatus {
                uri: core.device.uri.clone(),
                presence: core.presence(measured_hz, load(&self.rates.session)),
                model: core.device.hello.model.clone(),
                serial: core.device.hello.serial.clone(),
                firmware: core.device.hello.firmware.clone(),
                driver: core.device.driver.clone(),
                rate_hz: f64::from(core.device.hello.rate_millihertz) / 1000.0,
                markers: core.device.markers,
                obstacle: core.device.obstacle.clone().or_else(|| core.away()),
                ..DeviceStatus::default()
            },
            input: InputStatus {
                cpu_cores: f64::from_bits(load(&self.rates.cpu_cores)),
                ..InputStatus::default()
            },
            pre_roll: PreRollStatus {
                wanted_s: options.arm.pre_roll.as_secs_f64(),
                ..PreRollStatus::default()
            },
            take: None,
            pending_start: core.scheduled.as_ref().map(|it| it.pending.clone()),
            missed_start: core.missed_start.clone(),
            names: core.names.clone(),
            last_take: core.last_take.clone(),
            disk: DiskStatus {
                directory: options.take.directory.display().to_string(),
                free_bytes: load(&self.rates.free_bytes).checked_sub(1),
                keep_free_bytes: options.take.keep_free_bytes,
                left_s: None,
            },
            archive: self.uploads.status(&options.archive),
            publish: self.publications.status(),
        };
        status.device.is_awaited = core.arm_requested && status.device.presence == Presence::Absent;
        core.fill_session(&mut status, measured_hz);
        drop(core);
        status.disk.left_s = status.disk.left_s.or_else(|| estimated_left_s(&status));
        status
    }
}

impl Core {
    fn fill_session(&self, status: &mut Status, measured_hz: f64) {
        let Some(session) = &self.session else { return };
        let progress = &session.progress;
        status.device.outages = u32::try_from(load(&progress.outages)).unwrap_or(u32::MAX);
        status.device.markers = lock(&progress.channels).len();
        status.device.outage = match status.device.presence {
            Presence::Absent => Some(session.outage(Some(session.reconnect))),
            Presence::Silent => Some(session.outage(None)),
            Presence::Present | Presence::Streaming | Presence::Other => None,
        };
        let input = &mut status.input;
        input.frames = load(&progress.frames);
        input.lost = load(&progress.lost);
        input.measured_hz = measured_hz;
        input.ring_fill = load(&progress.ring_fill_permille) as f64 / 1000.0;
        input.ring_latency_p99_us = load(&progress.ring_latency_p99_ns).div_ceil(1000);
        input.jitter_p99_us = load(&progress.jitter_p99_us);
        input.drift_ppm = progress.drift_ppb.load(Ordering::Relaxed) as f64 / 1e3;
        status.pre_roll.wanted_s = session.pre_roll.as_secs_f64();
        status.pre_roll.held_s = load(&progress.pre_roll_ms) as f64 / 1e3;
        status.pre_roll.held_bytes = load(&progress.pre_roll_bytes);
        status.pre_roll.is_cut = progress.pre_roll_is_cut.load(Ordering::Relaxed);
        let Some(take) = &self.take else { return };
        let left_s = load(&progress.disk_left_s);
        status.disk.left_s = (left_s != u64::MAX && left_s > 0).then_some(left_s);
        let now = lock(&progress.take).clone().unwrap_or_default();
        status.take = Some(TakeStatus {
            take_id: take.named.id.clone(),
            name: take.named.name.clone(),
            path: take.named.path.display().to_string(),
            started_unix_ms: take.requested_unix_ms,
            rows: now.rows,
            seconds: now.rows as f64 / take.rate_hz,
            wanted_s: take.length.map(|length| length.as_secs_f64()),
            bytes: now.bytes,
            durable_bytes: now.durable_bytes,
            ratio: match now.bytes {
                0 => 0.0,
                bytes => (now.samples * 12) as f64 / bytes as f64,
            },
            max_error_mm: now.max_error_mm,
            ledger: (&now.ledger).into(),
            sample_ledger: now.sample_ledger.as_ref().map(Into::into),
            file: progress.file_state(),
            file_notice: progress.displaced().map(|displaced| displaced.message()),
        });
    }
}

impl Session {
    /// Whether no frame has arrived for this long.
    pub(super) fn is_without_frames(&self, since: Duration) -> bool {
        let since_ns = monotonic_ns().saturating_sub(load(&self.progress.last_arrival_ns));
        Duration::from_nanos(since_ns) >= since
    }

    /// The time since the last frame. The device is given up after `patience`.
    fn outage(&self, patience: Option<Duration>) -> OutageStatus {
        let since_ns = load(&self.progress.last_arrival_ns).max(self.armed_ns);
        let seconds = monotonic_ns().saturating_sub(since_ns) as f64 * 1e-9;
        OutageStatus {
            seconds,
            frames: (seconds * self.header.rate_hz) as u64,
            ends_in_s: patience.map(|patience| (patience.as_secs_f64() - seconds).max(0.0)),
        }
    }
}

/// Free space in bytes. The disk may be slow to answer.
pub(super) fn free_bytes(directory: &Path) -> Option<u64> {
    let disk = statvfs(directory).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Seconds until the disk is full, estimated from the pre-roll until the take has a data rate.
fn estimated_left_s(status: &Status) -> Option<u64> {
    let pre_roll = &status.pre_roll;
    if pre_roll.held_s < 2.0 || pre_roll.held_bytes == 0 {
        return None;
    }
    let bytes_per_s = pre_roll.held_bytes as f64 / pre_roll.held_s;
    // The space needed to close a take is not available for its frames.
    let reserved = status.disk.keep_free_bytes.saturating_add(RESERVE_MIN_BYTES);
    let spare = status.disk.free_bytes?.saturating_sub(reserved);
    Some((spare as f64 / bytes_per_s) as u64)
}
