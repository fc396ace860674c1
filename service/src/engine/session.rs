//! State shared by the engine's threads.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crossbeam_channel::Receiver;
use mocapd_acquire::{
    files::FileId,
    pipeline::{
        CommandSender, FirstRow, NewTake, PipelineProgress, TakeOutput, TakeResult,
        VisibilityCounters,
    },
};
use mocapd_drivers::{device::Hello, registry::Candidate};
use mocapd_take::record::{EndingKind, Header};

use super::EngineOptions;
use crate::{
    control::Start,
    status::{PendingStart, TakeSummary, TrialNames},
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
