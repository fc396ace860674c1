//! The request-reply exchange: one request at a time, with time-outs, damage handling and retries.

use super::{
    Drain, HostState, MS, NdiHost, OnEvent, Outcome, Pending, PendingCommands, Task,
    frame::{read_bx, read_bx2},
    message::{self, REPLY_BYTES_MAX, Reply, code},
};
use crate::transport::polled::{LineCommand, Request};

/// Silence on the line that ends a drain after damage: longer than the 16 ms for which an adapter may hold
/// back the rest of a reply.
const QUIET_NS: u64 = 20 * MS;

/// Time-out of a drain: a device that still sends then is reset. The longest reply takes 0.7 s at
/// 921600 baud.
const DRAIN_TIMEOUT_NS: u64 = 2_000 * MS;

/// Time-out of a drain during the search for the device, whose replies are short then.
const SEARCH_DRAIN_TIMEOUT_NS: u64 = 300 * MS;

/// Maximum number of bytes of a reply during the search. The longest has 12 bytes, `ERRORxx` with its checksum; the
/// rest allows for bytes that were on the line before.
const PROBE_REPLY_BYTES_MAX: usize = 64;

/// Attempts at a request before its time-out or refusal counts.
const ATTEMPTS: u32 = 3;

/// Consecutive polls without a valid reply after which the device counts as switched off or reset: half a
/// second, beyond the duration of any damage to single replies.
const POLLS_LOST_MAX: u32 = 5;

impl NdiHost {
    /// Sends a request. Its outcome is dispatched by `task`.
    pub(super) fn request(
        &mut self,
        task: Task,
        request: Request,
        timeout_ms: u64,
        not_before_ns: u64,
    ) {
        let timeout_ns = timeout_ms * MS;
        self.pending = Some(Pending { task, request, timeout_ns, attempts: 0, active_ns: 0 });
        self.transmit(not_before_ns);
    }

    /// Waits for a reply without sending a request, as after a break.
    pub(super) fn await_reply(&mut self, task: Task, timeout_ms: u64) {
        self.reply.clear();
        let (request, timeout_ns) = (Request::default(), timeout_ms * MS);
        let active_ns = self.line.now_ns();
        self.pending = Some(Pending { task, request, timeout_ns, attempts: ATTEMPTS, active_ns });
    }

    /// Sends the pending request, possibly again.
    fn transmit(&mut self, not_before_ns: u64) {
        let now_ns = self.line.now_ns();
        self.reply.clear();
        if let Some(pending) = &mut self.pending {
            pending.attempts += 1;
            pending.active_ns = not_before_ns.max(now_ns);
            let request = pending.request;
            if !self.line.send(LineCommand::Write { request, not_before_ns }) {
                // The line is gone; the next read returns the error.
                self.pending = None;
            }
        }
    }

    /// Ends the session with an error. The next command of the host starts a new search.
    pub(super) fn fail(&mut self, message: String) {
        self.state = HostState::Off;
        self.pending = None;
        self.todo = PendingCommands::default();
        self.line.send(LineCommand::Fail(message));
    }

    /// Ends the session with the refusal of a request, its error code and advice.
    pub(super) fn fail_code(&mut self, what: &str, code: u8) {
        let advice = message::advice(code);
        self.fail(format!("the NDI system cannot {what} (ERROR{code:02X}): {advice}"));
    }

    pub(super) fn receive(&mut self, bytes: &[u8], on_event: OnEvent<'_>) {
        let now_ns = self.line.now_ns();
        if let Some(drain) = &mut self.drain {
            if !bytes.is_empty() {
                drain.last_byte_ns = now_ns;
                self.counters.bytes_skipped += bytes.len() as u64;
            }
            let Drain { since_ns, last_byte_ns } = *drain;
            if now_ns - last_byte_ns >= QUIET_NS {
                self.drain = None;
                self.retry(on_event);
            } else if now_ns - since_ns > self.drain_timeout_ns() {
                self.drain = None;
                self.drain_timed_out(on_event);
            }
            return;
        }
        let Some(pending) = &mut self.pending else {
            self.counters.bytes_skipped += bytes.len() as u64;
            return;
        };
        if !bytes.is_empty() {
            pending.active_ns = pending.active_ns.max(now_ns);
            let room = REPLY_BYTES_MAX - self.reply.len();
            self.reply.extend_from_slice(bytes.get(..room).unwrap_or(bytes));
            let fits = bytes.len() <= room
                && (!self.is_probing() || self.reply.len() <= PROBE_REPLY_BYTES_MAX);
            if fits {
                self.check_reply(on_event);
            } else {
                self.start_drain(now_ns);
            }
        } else if now_ns.saturating_sub(pending.active_ns) > pending.timeout_ns {
            if !self.reply.is_empty() {
                // The reply is incomplete, and no more bytes arrive.
                self.count_damage();
            }
            self.retry(on_event);
        }
    }

    /// Whether the device's baud rate is still unknown.
    fn is_probing(&self) -> bool {
        matches!(self.pending, Some(Pending { task: Task::Probe(_) | Task::Break(_), .. }))
    }

    fn is_searching(&self) -> bool {
        self.is_probing() || self.pending.is_some_and(|pending| pending.task == Task::Verify)
    }

    fn drain_timeout_ns(&self) -> u64 {
        if self.is_searching() { SEARCH_DRAIN_TIMEOUT_NS } else { DRAIN_TIMEOUT_NS }
    }

    /// Handles a device that keeps sending unrequested bytes: at the wrong baud rate, or of another kind.
    fn drain_timed_out(&mut self, on_event: OnEvent<'_>) {
        match self.pending.filter(|_| self.is_searching()) {
            Some(pending) => self.dispatch(pending.task, Outcome::Timeout, on_event),
            None => self.restart_search(),
        }
    }

    fn check_reply(&mut self, on_event: OnEvent<'_>) {
        let now_ns = self.line.now_ns();
        let Some(task) = self.pending.map(|pending| pending.task) else { return };
        match message::parse_reply(&self.reply) {
            Reply::Incomplete => {}
            Reply::Damaged => self.start_drain(now_ns),
            Reply::Binary(block) => {
                let read = if self.bx2 { read_bx2 } else { read_bx };
                if task == Task::Poll && read(block, &mut self.frame).is_some() {
                    self.counters.messages += 1;
                    self.pending = None;
                    self.polls_lost = 0;
                    self.frame_reply(on_event);
                } else {
                    self.start_drain(now_ns);
                }
            }
            Reply::Text(text) => {
                // Replies are ASCII. Text replies are rare, so a copy is acceptable.
                let text = String::from_utf8_lossy(text).into_owned();
                self.counters.messages += 1;
                match message::error_code(&text) {
                    Some(code) => self.on_refusal(task, code, on_event),
                    None => self.dispatch(task, Outcome::Text(&text), on_event),
                }
            }
        }
    }

    /// Repeats a refused request before the refusal counts: the request may have been damaged on its way.
    fn on_refusal(&mut self, task: Task, code: u8, on_event: OnEvent<'_>) {
        let for_good = task == Task::Poll && code == code::WRONG_MODE;
        if !for_good && self.pending.is_some_and(|pending| pending.attempts < ATTEMPTS) {
            self.transmit(0);
        } else {
            self.dispatch(task, Outcome::Refused(code), on_event);
        }
    }

    fn count_damage(&mut self) {
        self.counters.bytes_skipped += self.reply.len() as u64;
        // While the baud rate is unknown, damage only means a wrong guess.
        if !self.is_searching() {
            self.counters.messages_damaged += 1;
        }
        self.reply.clear();
    }

    fn start_drain(&mut self, now_ns: u64) {
        self.count_damage();
        self.drain = Some(Drain { since_ns: now_ns, last_byte_ns: now_ns });
    }

    /// Repeats a request that had no valid reply, or gives up.
    fn retry(&mut self, on_event: OnEvent<'_>) {
        let Some(Pending { task, attempts, .. }) = self.pending else { return };
        if task == Task::Poll {
            self.polls_lost += 1;
            self.run.count_unread();
            self.pending = None;
            if self.polls_lost >= POLLS_LOST_MAX {
                self.restart_search();
            } else {
                self.next_poll();
            }
        } else if attempts < ATTEMPTS && !matches!(task, Task::Probe(_) | Task::Break(_)) {
            self.transmit(0);
        } else {
            self.dispatch(task, Outcome::Timeout, on_event);
        }
    }

    /// Ends the pending request, and handles its outcome.
    fn dispatch(&mut self, task: Task, outcome: Outcome<'_>, on_event: OnEvent<'_>) {
        self.pending = None;
        match task {
            Task::Start | Task::Poll | Task::Stop => self.track_reply(task, outcome, on_event),
            _ => self.bring_up_reply(task, outcome),
        }
    }
}
