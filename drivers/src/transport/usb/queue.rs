//! Reads that are queued ahead, and their bytes in order.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Buffer, Bulk, Completion, In, TransferError},
};

/// Transfers that wait for the device: while one is read, the controller fills the others.
pub const TRANSFERS: usize = 8;

/// Bytes of one: a multiple of every packet size there is (1024 and less). Eight of them hold what high
/// speed carries in 6 ms (40 MB/s), a scheduler's delay; a device whose frames end a transfer each is not
/// held up before eight frames wait. Together 256 KiB, a 64th of the kernel's default limit.
pub const TRANSFER_BYTES: usize = 32 << 10;

/// Transfers without which there is no queue: one is filled while the other is read.
const TRANSFERS_MIN: usize = 2;

/// Failures in a row that are mended: noise does not come four times in 10 ms, and a pulled cable must be
/// told within 100 ms.
const FAILURES_MAX: u32 = 4;

/// Between a failure and the next try: some microframes.
pub(super) const PAUSE: Duration = Duration::from_millis(3);

/// How long cancelled transfers may take to come back; the kernel's do so at once.
pub(super) const CANCEL_WITHIN: Duration = Duration::from_millis(500);

/// The transfers of an endpoint: each is with the kernel, holds bytes to be read, or is at rest.
#[derive(Debug)]
pub(super) struct Queue {
    rx: Endpoint<Bulk, In>,
    /// Read but not given on, oldest first. At most all of them.
    full: VecDeque<Buffer>,
    /// What of the first is given already.
    given: usize,
    rest: Vec<Buffer>,
    /// How many there are.
    pub(super) transfers: usize,
    failures: u32,
    /// The first failure that nobody has mended yet.
    pub(super) error: Option<TransferError>,
}

impl Queue {
    /// Queues as many transfers as the kernel has memory for; `None` when that is not enough for a queue.
    pub(super) fn start(rx: Endpoint<Bulk, In>) -> Option<Self> {
        // Memory of the kernel's, so that it need not copy. It counts against the limit from here on, and
        // where there is none left nusb gives memory of our own instead.
        let mut rest: Vec<Buffer> = (0..TRANSFERS).map(|_| rx.allocate(TRANSFER_BYTES)).collect();
        let from_kernel = rest.iter().filter(|buffer| buffer.is_zero_copy()).count();
        if from_kernel >= TRANSFERS_MIN {
            rest.retain(Buffer::is_zero_copy);
        }
        let transfers = rest.len();
        let full = VecDeque::with_capacity(TRANSFERS);
        let mut queue = Self { rx, full, given: 0, rest, transfers, failures: 0, error: None };
        queue.refill();
        (from_kernel > 0 || queue.has_memory()).then_some(queue)
    }

    /// Without the kernel's memory the limit may be used up, or it has no such memory to give: the first
    /// transfer, which fails at once where there is no room for it, tells which.
    fn has_memory(&mut self) -> bool {
        match self.rx.wait_next_complete(Duration::ZERO) {
            Some(done) if matches!(done.status, Err(TransferError::Unknown(_))) => false,
            Some(done) => {
                self.keep(done);
                true
            }
            None => true,
        }
    }

    /// Bytes that came, waiting for the first so long.
    pub(super) fn take(&mut self, buf: &mut [u8], at_most: Duration) -> usize {
        let mut n = self.give(buf);
        if n == 0 && self.error.is_none() && self.rx.pending() == 0 {
            // Never: but a reader without a transfer would not wait for anything.
            self.submit_rest();
        }
        let mut wait = if n > 0 { Duration::ZERO } else { at_most };
        // No more turns than transfers: a device that floods with empty packets must not keep the reader here.
        let mut turns = self.transfers;
        while n < buf.len() && self.error.is_none() && self.rx.pending() > 0 && turns > 0 {
            turns -= 1;
            let Some(done) = self.rx.wait_next_complete(wait) else { break };
            wait = Duration::ZERO;
            let is_full = done.actual_len == TRANSFER_BYTES;
            self.keep(done);
            n += self.give(buf.get_mut(n..).unwrap_or_default());
            if is_full {
                // Worth a turn of its own: to look for another costs, and only short ones are gathered.
                break;
            }
        }
        n
    }

    /// What a transfer brought, and how it ended. A failed one may hold packets that came before.
    fn keep(&mut self, done: Completion) {
        match done.status {
            Ok(()) => self.failures = 0,
            // The first failure is the cause, and those behind it are its consequence.
            Err(error) => self.error = self.error.or(Some(error)),
        }
        if done.actual_len > 0 {
            self.full.push_back(done.buffer);
        } else if done.status.is_ok() {
            // An empty packet: it ends a transfer, and says nothing.
            self.rx.submit(done.buffer);
        } else {
            self.rest.push(done.buffer);
        }
    }

    fn give(&mut self, buf: &mut [u8]) -> usize {
        let mut n = 0;
        while let Some(first) = self.full.front() {
            let left = first.get(self.given..).unwrap_or_default();
            let (to, from) = (buf.get_mut(n..).unwrap_or_default(), left);
            let count = to.len().min(from.len());
            to[..count].copy_from_slice(&from[..count]);
            n += count;
            self.given += count;
            if count < left.len() {
                break;
            }
            self.given = 0;
            if let Some(read) = self.full.pop_front() {
                self.rest.push(read);
            }
        }
        // Not to an endpoint that has failed: what is at rest waits until that is mended.
        if n > 0 && self.error.is_none() {
            self.submit_rest();
        }
        n
    }

    fn submit_rest(&mut self) {
        while let Some(mut buffer) = self.rest.pop() {
            buffer.clear();
            buffer.set_requested_len(TRANSFER_BYTES);
            self.rx.submit(buffer);
        }
    }

    /// Counts a failure: whether it is worth another try.
    pub(super) fn failed_again(&mut self) -> bool {
        self.failures += 1;
        self.failures <= FAILURES_MAX
    }

    /// Takes every transfer back and clears the endpoint's halt. `false` when the device does not let us.
    pub(super) fn clear_halt(&mut self) -> bool {
        self.cancel() && self.rx.clear_halt().wait().is_ok()
    }

    /// Queues every transfer again. `false` when the kernel keeps one.
    pub(super) fn refill(&mut self) -> bool {
        let all_back = self.cancel();
        // What failed since then failed for the same cause, or was cancelled.
        self.error = None;
        self.submit_rest();
        all_back
    }

    fn cancel(&mut self) -> bool {
        let give_up_at = Instant::now() + CANCEL_WITHIN;
        self.rx.cancel_all();
        while self.rx.pending() > 0 {
            let left = give_up_at.saturating_duration_since(Instant::now());
            let Some(done) = self.rx.wait_next_complete(left) else { return false };
            if done.actual_len > 0 {
                self.full.push_back(done.buffer);
            } else {
                self.rest.push(done.buffer);
            }
        }
        true
    }
}

/// The interface is free for the next program when the last transfer is back.
impl Drop for Queue {
    fn drop(&mut self) {
        self.cancel();
    }
}
