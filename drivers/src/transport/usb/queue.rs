//! A queue of read transfers that always has some pending, and returns their bytes in order.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Buffer, Bulk, Completion, In, TransferError},
};

/// Transfers in the queue: the controller fills the others while one is read.
pub const TRANSFERS: usize = 8;

/// Bytes of a transfer: a multiple of every packet size (at most 1024). Eight of them hold what high speed
/// delivers in 6 ms (40 MB/s), a scheduling delay. A device that ends a transfer after each frame is not
/// delayed until eight frames wait. Together they take 256 KiB, a 64th of the kernel's default limit.
pub const TRANSFER_BYTES: usize = 32 << 10;

/// Minimum number of transfers of a queue: one is filled while the other is read.
const TRANSFERS_MIN: usize = 2;

/// Consecutive failures that are retried: noise does not strike four times in 10 ms, and an unplugged cable
/// must be reported within 100 ms.
const FAILURES_MAX: u32 = 4;

/// Pause between a failure and the next attempt: some microframes.
pub(super) const RETRY_PAUSE: Duration = Duration::from_millis(3);

/// Time-out of cancelled transfers; the kernel normally returns them immediately.
pub(super) const CANCEL_TIMEOUT: Duration = Duration::from_millis(500);

/// The transfers of an endpoint: each is pending in the kernel, holds unread bytes, or is idle.
#[derive(Debug)]
pub(super) struct ReadQueue {
    rx: Endpoint<Bulk, In>,
    /// Completed transfers with unread bytes, oldest first.
    filled: VecDeque<Buffer>,
    /// Bytes of the first one that are already read.
    n_read: usize,
    idle: Vec<Buffer>,
    /// Number of transfers.
    pub(super) transfers: usize,
    failures: u32,
    /// The first failure that is not recovered from yet.
    pub(super) error: Option<TransferError>,
}

impl ReadQueue {
    /// Queues as many transfers as the kernel has memory for; `None` if these are too few for a queue.
    pub(super) fn start(rx: Endpoint<Bulk, In>) -> Option<Self> {
        // Kernel memory saves a copy. It counts against the limit from here on; when none is left, nusb
        // allocates user memory instead.
        let mut idle: Vec<Buffer> = (0..TRANSFERS).map(|_| rx.allocate(TRANSFER_BYTES)).collect();
        let from_kernel = idle.iter().filter(|buffer| buffer.is_zero_copy()).count();
        if from_kernel >= TRANSFERS_MIN {
            idle.retain(Buffer::is_zero_copy);
        }
        let transfers = idle.len();
        let filled = VecDeque::with_capacity(TRANSFERS);
        let mut queue = Self { rx, filled, n_read: 0, idle, transfers, failures: 0, error: None };
        queue.refill();
        (from_kernel > 0 || queue.has_memory()).then_some(queue)
    }

    /// Without kernel memory either the limit is exhausted, or the kernel has no such memory at all. The first
    /// transfer shows which: it fails at once when the limit is exhausted.
    fn has_memory(&mut self) -> bool {
        match self.rx.wait_next_complete(Duration::ZERO) {
            Some(done) if matches!(done.status, Err(TransferError::Unknown(_))) => false,
            Some(done) => {
                self.store(done);
                true
            }
            None => true,
        }
    }

    /// Reads available bytes, and waits up to `timeout` for the first.
    pub(super) fn take(&mut self, buf: &mut [u8], timeout: Duration) -> usize {
        let mut n = self.copy_to(buf);
        if n == 0 && self.error.is_none() && self.rx.pending() == 0 {
            // Cannot happen, but without a pending transfer every read would return immediately.
            self.submit_idle();
        }
        let mut wait = if n > 0 { Duration::ZERO } else { timeout };
        // No more rounds than transfers: a device that floods with empty packets must not keep the reader here.
        let mut rounds = self.transfers;
        while n < buf.len() && self.error.is_none() && self.rx.pending() > 0 && rounds > 0 {
            rounds -= 1;
            let Some(done) = self.rx.wait_next_complete(wait) else { break };
            wait = Duration::ZERO;
            let is_full = done.actual_len == TRANSFER_BYTES;
            self.store(done);
            n += self.copy_to(buf.get_mut(n..).unwrap_or_default());
            if is_full {
                // Return full transfers one by one: polling for another costs time, and only short ones are merged.
                break;
            }
        }
        n
    }

    /// Stores a completed transfer and its status. A failed one may hold packets that arrived before.
    fn store(&mut self, done: Completion) {
        match done.status {
            Ok(()) => self.failures = 0,
            // The first failure is the cause, the later ones its consequences.
            Err(error) => self.error = self.error.or(Some(error)),
        }
        if done.actual_len > 0 {
            self.filled.push_back(done.buffer);
        } else if done.status.is_ok() {
            // An empty packet only ends a transfer.
            self.rx.submit(done.buffer);
        } else {
            self.idle.push(done.buffer);
        }
    }

    fn copy_to(&mut self, buf: &mut [u8]) -> usize {
        let mut n = 0;
        while let Some(first) = self.filled.front() {
            let left = first.get(self.n_read..).unwrap_or_default();
            let (to, from) = (buf.get_mut(n..).unwrap_or_default(), left);
            let count = to.len().min(from.len());
            to[..count].copy_from_slice(&from[..count]);
            n += count;
            self.n_read += count;
            if count < left.len() {
                break;
            }
            self.n_read = 0;
            if let Some(read) = self.filled.pop_front() {
                self.idle.push(read);
            }
        }
        // Not to a failed endpoint: idle transfers wait for its recovery.
        if n > 0 && self.error.is_none() {
            self.submit_idle();
        }
        n
    }

    fn submit_idle(&mut self) {
        while let Some(mut buffer) = self.idle.pop() {
            buffer.clear();
            buffer.set_requested_len(TRANSFER_BYTES);
            self.rx.submit(buffer);
        }
    }

    /// Counts a failure, and returns whether another attempt is worthwhile.
    pub(super) fn may_retry(&mut self) -> bool {
        self.failures += 1;
        self.failures <= FAILURES_MAX
    }

    /// Cancels all transfers and clears the endpoint's halt; `false` when that fails.
    pub(super) fn clear_halt(&mut self) -> bool {
        self.cancel() && self.rx.clear_halt().wait().is_ok()
    }

    /// Queues all transfers again; `false` when the kernel kept one.
    pub(super) fn refill(&mut self) -> bool {
        let all_back = self.cancel();
        // Later failures have the same cause, or come from cancelling.
        self.error = None;
        self.submit_idle();
        all_back
    }

    fn cancel(&mut self) -> bool {
        let give_up_at = Instant::now() + CANCEL_TIMEOUT;
        self.rx.cancel_all();
        while self.rx.pending() > 0 {
            let left = give_up_at.saturating_duration_since(Instant::now());
            let Some(done) = self.rx.wait_next_complete(left) else { return false };
            if done.actual_len > 0 {
                self.filled.push_back(done.buffer);
            } else {
                self.idle.push(done.buffer);
            }
        }
        true
    }
}

/// Waits for all transfers, so that the interface is free for the next program.
impl Drop for ReadQueue {
    fn drop(&mut self) {
        self.cancel();
    }
}
