//! What the engine's threads know together.

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
    pipeline::{FirstRow, NewTake, Progress, SeenCounters, TakeEnd, TakeOutput, Takes},
};
use mocapd_drivers::{device::Hello, registry::Candidate};
use mocapd_take::record::{EndingKind, Header};

use super::options::EngineOptions;
use crate::status::TakeSummary;

/// Removed files that are kept open: as many as may vanish one after the other, and few, for each fills the disk.
pub(super) const KEPT_OPEN_MAX: usize = 4;

/// The state. What `State` calls it follows from this.
#[derive(Debug)]
pub(super) struct Core {
    pub(super) options: Arc<EngineOptions>,
    /// It is to be armed.
    pub(super) wanted: bool,
    pub(super) failure: Option<String>,
    pub(super) device: KnownDevice,
    /// While armed.
    pub(super) session: Option<Session>,
    /// While recording.
    pub(super) take: Option<OpenTake>,
    pub(super) last_take: Option<TakeSummary>,
    /// Takes that are not recorded any more and still being closed or copied.
    pub(super) closing: u32,
    /// How the last take lost data, where a program that asks to stop it has to learn of that.
    pub(super) data_lost: Option<String>,
    /// The files of takes that were removed and could not be saved: they can be copied from /proc until the next take
    /// has begun. At most [`KEPT_OPEN_MAX`].
    pub(super) kept_open: Vec<Box<dyn TakeOutput>>,
}

/// What is known of the device, whether it is there or not.
#[derive(Debug, Default)]
pub(super) struct KnownDevice {
    pub(super) uri: String,
    pub(super) present: bool,
    pub(super) obstacle: Option<String>,
    pub(super) hello: Hello,
    pub(super) driver: String,
    pub(super) markers: usize,
    /// To be found again by.
    pub(super) identity: Option<Candidate>,
}

/// The device runs.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) number: u64,
    pub(super) takes: Takes,
    pub(super) progress: Arc<Progress>,
    pub(super) seen: SeenCounters,
    /// Of its takes, but for what is each one's own.
    pub(super) header: Header,
    pub(super) slots: usize,
    /// How much it was told to hold.
    pub(super) pre_roll: Duration,
    /// How long a device that went away is waited for.
    pub(super) reconnect: Duration,
    /// When it was armed, in nanoseconds of the monotonic clock.
    pub(super) armed_ns: u64,
    /// Ends it.
    pub(super) stop: Arc<AtomicBool>,
}

impl Session {
    /// A take with the header of this session's, but for what is its own.
    pub(super) fn with_header(&self, take: NewTake) -> NewTake {
        let Header { take_id, created_unix_ms, .. } = take.header;
        NewTake { header: Header { take_id, created_unix_ms, ..self.header.clone() }, ..take }
    }
}

/// A take by its name and its file.
#[derive(Debug, Clone)]
pub(super) struct NamedTake {
    /// 32 hexadecimal digits.
    pub(super) id: String,
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) file: FileId,
}

impl NamedTake {
    /// It does not come to it: an empty file helps nobody.
    pub(super) fn discard(&self) {
        // A disk that failed may fail here, too, and the file is listed as unreadable then.
        self.file.remove(&self.path).ok();
    }
}

/// A take that is being written.
#[derive(Debug)]
pub(super) struct OpenTake {
    pub(super) named: NamedTake,
    pub(super) asked_unix_ms: i64,
    pub(super) begun: Instant,
    pub(super) rate_hz: f64,
    pub(super) first: Option<FirstRow>,
    pub(super) ended: Receiver<TakeEnd>,
    /// How many changes of its file have been reported.
    pub(super) changes_reported: u32,
    /// Why it was told to end, once it was.
    pub(super) ending: Option<EndingKind>,
}

/// Figures that are measured now and then; f64 by their bits.
#[derive(Debug, Default)]
pub(super) struct Rates {
    /// The session that `frames_hz` is of, from its beginning to its end; 0: of none.
    pub(super) session: AtomicU64,
    pub(super) frames_hz: AtomicU64,
    pub(super) cpu_cores: AtomicU64,
    /// Bytes free in the takes' folder, and one more; 0 while nobody can tell.
    pub(super) free_bytes: AtomicU64,
}

impl Core {
    /// That the device is away, and what to do, while it is.
    pub(super) fn away(&self) -> Option<String> {
        let session = self.session.as_ref()?;
        session.progress.is_away.load(Ordering::Relaxed).then(|| {
            "the device is away: plug it in or switch it on, and it goes on by itself".to_owned()
        })
    }

    pub(super) fn new(options: EngineOptions) -> Self {
        Self {
            device: KnownDevice { uri: options.device.uri.to_string(), ..KnownDevice::default() },
            options: Arc::new(options),
            wanted: false,
            failure: None,
            session: None,
            take: None,
            last_take: None,
            closing: 0,
            data_lost: None,
            kept_open: Vec::new(),
        }
    }
}
