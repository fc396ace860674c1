//! What the server counts of itself, for /metrics.

use std::sync::atomic::{AtomicU64, Ordering};

/// Of all connections since the start.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Open now.
    pub(super) connections: AtomicU64,
    /// Closed at once, because there were too many.
    pub(super) connections_refused: AtomicU64,
    /// Closed to make room for another one.
    pub(super) connections_evicted: AtomicU64,
    /// Requests that reached a route, or found none.
    pub(super) requests: AtomicU64,
    /// Of these, answered with 400 or more.
    pub(super) requests_refused: AtomicU64,
    /// Frames that viewers were too slow for.
    pub(super) live_frames_skipped: AtomicU64,
    /// Events that listeners missed.
    pub(super) events_missed: AtomicU64,
}

impl Counts {
    pub(super) fn add(counter: &AtomicU64, n: u64) {
        counter.fetch_add(n, Ordering::Relaxed);
    }
}

/// Counts a connection as open while it lives.
#[derive(Debug)]
pub(super) struct Open(pub(super) std::sync::Arc<Counts>);

impl Open {
    pub(super) fn new(counts: std::sync::Arc<Counts>) -> Self {
        counts.connections.fetch_add(1, Ordering::Relaxed);
        Self(counts)
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::Relaxed);
    }
}
