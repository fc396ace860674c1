//! Live counters of a running pipeline, for other threads.

use std::sync::{
    Arc, Mutex, MutexGuard, OnceLock, PoisonError,
    atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU32, AtomicU64, Ordering},
};

use mocapd_take::record::{Channel, ClockLine, Ledger, SampleLedger, TakeEnding};

use crate::files::{DisplacedFile, FileState};

/// Live counters of a running pipeline. For display: the ledger is authoritative.
#[derive(Debug, Default)]
pub struct PipelineProgress {
    /// Frames accepted.
    pub frames: AtomicU64,
    /// Frames lost so far, for any reason.
    pub lost: AtomicU64,
    /// How much faster the host's clock runs than the device's, in parts per billion.
    pub drift_ppb: AtomicI64,
    /// The line from the device's clock to the host's, refitted with every stretch. Only the writer and observers use this lock.
    pub clock_line: Mutex<Option<ClockLine>>,
    /// 99th percentile of the frames' lateness against the clock line, in microseconds; 0 while unknown.
    pub jitter_p99_us: AtomicU64,
    /// Bytes written.
    pub file_bytes: AtomicU64,
    /// Samples in the stretches written.
    pub samples: AtomicU64,
    /// Bytes of the raw log, if it grows on the same disk: the estimate of the time left includes it.
    pub raw_log_bytes: OnceLock<Arc<AtomicU64>>,
    /// Seconds until the disk is full; `u64::MAX` while unknown.
    pub disk_left_s: AtomicU64,
    /// Whether the disk is so full that the take has to end: stop feeding the pipeline, and it is closed.
    pub disk_full: AtomicBool,
    /// Whether the writer failed and writes no more, or a worker is gone: stop feeding the pipeline.
    pub failed: AtomicBool,
    /// Fill level of the fullest ring when the last stretch was closed, in thousandths.
    pub ring_fill_permille: AtomicU64,
    /// 99th percentile of the time from a frame's last byte until it is in every ring, in nanoseconds; updated every
    /// second.
    pub ring_latency_p99_ns: AtomicU64,
    /// Times that the device was disconnected and came back.
    pub outages: AtomicU64,
    /// Whether the device is disconnected.
    pub is_away: AtomicBool,
    /// Arrival of the last recorded frame, in nanoseconds of the monotonic clock; 0 before the first.
    pub last_arrival_ns: AtomicU64,
    /// All channels so far by slot, including those that appeared later.
    pub channels: Mutex<Vec<Channel>>,
    /// Bytes of the pre-roll buffer.
    pub pre_roll_bytes: AtomicU64,
    /// Length of the pre-roll buffer in milliseconds.
    pub pre_roll_ms: AtomicU64,
    /// Whether the pre-roll is shorter than configured because it reached its memory limit.
    pub pre_roll_is_cut: AtomicBool,
    /// Takes begun by a recording that is divided; 0 for one that is not.
    pub takes_begun: AtomicU32,
    /// Whether the writer found the take long enough: divide the recording at the end of the open stretch.
    pub(super) split_is_due: AtomicBool,
    /// Messages of the writer to the user, and whether there are any.
    notices: Mutex<Vec<String>>,
    has_notices: AtomicBool,
    /// The state of the take's file as a code, and details of it.
    file_state: AtomicU8,
    displaced: Mutex<Option<DisplacedFile>>,
    file_changes: AtomicU32,
    /// Why the reading ended, once it has: the ending of a take that is open then.
    pub ending: OnceLock<TakeEnding>,
    /// The take that is being written. Only the writer and observers use this lock.
    pub take: Mutex<Option<TakeProgress>>,
}

impl PipelineProgress {
    pub(super) fn new(channels: &[Channel]) -> Self {
        Self { channels: Mutex::new(channels.to_vec()), ..Self::default() }
    }

    /// The state of the file that is being written, or was written last.
    #[must_use]
    pub fn file_state(&self) -> FileState {
        FileState::from_code(self.file_state.load(Ordering::Relaxed))
    }

    /// Details of that state, while the file is not in its place.
    #[must_use]
    pub fn displaced(&self) -> Option<DisplacedFile> {
        lock(&self.displaced).clone()
    }

    /// Stores the details before the counter that makes others read them.
    pub(super) fn set_file_state(&self, state: FileState, displaced: Option<DisplacedFile>) {
        *lock(&self.displaced) = displaced;
        self.file_state.store(state.code(), Ordering::Release);
        self.file_changes.fetch_add(1, Ordering::Release);
    }

    /// How often the file's state or name has changed.
    #[must_use]
    pub fn file_changes(&self) -> u32 {
        self.file_changes.load(Ordering::Acquire)
    }
}

/// Messages that wait for the reader, which takes them many times a second; more would say the same.
const NOTICES_MAX: usize = 32;

impl PipelineProgress {
    /// Leaves a message for the user.
    pub(super) fn add_notice(&self, text: String) {
        let mut notices = lock(&self.notices);
        if notices.len() < NOTICES_MAX {
            notices.push(text);
            self.has_notices.store(true, Ordering::Release);
        }
    }

    /// Takes the messages for the user. One load when there is none.
    #[must_use]
    pub fn take_notices(&self) -> Vec<String> {
        if !self.has_notices.load(Ordering::Acquire) {
            return Vec::new();
        }
        let mut notices = lock(&self.notices);
        self.has_notices.store(false, Ordering::Relaxed);
        std::mem::take(&mut *notices)
    }
}

/// Progress of a take that is being written.
#[derive(Debug, Clone, Default)]
pub struct TakeProgress {
    /// Rows, including lost ones.
    pub rows: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes synced to disk.
    pub durable_bytes: u64,
    /// Samples in the take.
    pub samples: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
    /// The ledger so far.
    pub ledger: Ledger,
    /// The ledger of sampled channels so far, if there are any.
    pub sample_ledger: Option<SampleLedger>,
}

/// Locks a mutex even if a thread panicked with it: a counter or a name is never half written.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
