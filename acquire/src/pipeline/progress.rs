//! What other threads may look at while a pipeline runs.

use std::sync::{
    Arc, Mutex, MutexGuard, OnceLock, PoisonError,
    atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU32, AtomicU64, Ordering},
};

use mocapd_take::record::{Channel, Ledger, TakeEnding};

use crate::files::{Displaced, FileState};

/// What other threads may look at while it runs. Counters only: the truth is in the ledger.
#[derive(Debug, Default)]
pub struct Progress {
    /// Frames taken in.
    pub frames: AtomicU64,
    /// Frames lost so far, for whatever reason.
    pub lost: AtomicU64,
    /// How much faster the host's clock runs than the device's, in parts per billion, as an `i64` has it.
    pub drift_ppb: AtomicI64,
    /// What 99 of 100 frames were no later than after the clock's line, in microseconds; 0 while unknown.
    pub jitter_p99_us: AtomicU64,
    /// Bytes written.
    pub file_bytes: AtomicU64,
    /// Samples in the stretches written.
    pub samples: AtomicU64,
    /// Bytes of another file of ours that grows on the same disk, where there is one: it takes the disk's room, too.
    pub beside_bytes: OnceLock<Arc<AtomicU64>>,
    /// How long the disk will do, in seconds; `u64::MAX` while unknown.
    pub disk_left_s: AtomicU64,
    /// So little is left of the disk that the take has to end: stop feeding, and it is closed.
    pub disk_full: AtomicBool,
    /// The writer met an error and writes no more, or a worker is gone: stop feeding.
    pub failed: AtomicBool,
    /// How full the fullest ring was at the last end of a stretch, of a thousand.
    pub ring_fill_permille: AtomicU64,
    /// What 99 of 100 frames took at most from their last byte into every ring, in nanoseconds; told every second.
    pub ring_latency_p99_ns: AtomicU64,
    /// Times that the device went away and came back.
    pub outages: AtomicU64,
    /// It is away now.
    pub is_away: AtomicBool,
    /// When the last recorded frame arrived, in nanoseconds of the monotonic clock; 0 before the first.
    pub last_arrival_ns: AtomicU64,
    /// All channels so far, by slot: those that appeared, too.
    pub channels: Mutex<Vec<Channel>>,
    /// Bytes of the pre-roll.
    pub held_bytes: AtomicU64,
    /// Its length, in milliseconds.
    pub held_ms: AtomicU64,
    /// Some of it went because of the bytes that it took.
    pub held_cut: AtomicBool,
    /// What others did to the take's file, by its code; and more about that.
    file_state: AtomicU8,
    displaced: Mutex<Option<Displaced>>,
    file_changes: AtomicU32,
    /// Why the reading ended, once it has: how a take that is open then ends.
    pub ending: OnceLock<TakeEnding>,
    /// The take that is being written. The writer and whoever watches meet here, and nobody else.
    pub take: Mutex<Option<TakeNow>>,
}

impl Progress {
    pub(super) fn new(channels: &[Channel]) -> Self {
        Self { channels: Mutex::new(channels.to_vec()), ..Self::default() }
    }

    /// What others did to the file of the take that is being written, or was written last.
    #[must_use]
    pub fn file_state(&self) -> FileState {
        FileState::from_code(self.file_state.load(Ordering::Relaxed))
    }

    /// More about that, while it is not in its place.
    #[must_use]
    pub fn displaced(&self) -> Option<Displaced> {
        lock(&self.displaced).clone()
    }

    /// First the words, then what makes others look for them.
    pub(super) fn set_file_state(&self, state: FileState, displaced: Option<Displaced>) {
        *lock(&self.displaced) = displaced;
        self.file_state.store(state.code(), Ordering::Release);
        self.file_changes.fetch_add(1, Ordering::Release);
    }

    /// How often the file's state, or the name that it has, became another one.
    #[must_use]
    pub fn file_changes(&self) -> u32 {
        self.file_changes.load(Ordering::Acquire)
    }
}

/// A take that grows.
#[derive(Debug, Clone, Default)]
pub struct TakeNow {
    /// Rows, lost ones included.
    pub rows: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Of these, bytes that were synced.
    pub durable_bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
    /// The ledger so far.
    pub ledger: Ledger,
}

/// The state behind a lock, whatever became of who held it last: a count or a name is never half written.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
