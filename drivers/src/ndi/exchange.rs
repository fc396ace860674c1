//! One request at a time: said, answered, damaged, said again.

use super::{
    frame::{read_bx, read_bx2},
    host::{Asked, Drain, MS, NdiHost, OnEvent, Outcome, Owed, State, Task},
    message::{self, Look, REPLY_BYTES_MAX, code},
};
use crate::transport::turns::{Order, Request};

/// How long a line has to be silent after damage before the next request: more than the 16 ms for
/// which an adapter may hold the rest of an answer back.
const QUIET_NS: u64 = 20 * MS;

/// How long a device may babble after damage before it is reset. The longest answer takes 0.7 s at
/// 921600 baud.
const BABBLE_NS: u64 = 2_000 * MS;

/// The same while the device is looked for: none of what it says then is long.
const BABBLE_SEEKING_NS: u64 = 300 * MS;

/// The longest answer while the device is looked for has 12 bytes, `ERRORxx` with its checksum; the rest
/// is room for what stood on the line before.
const SEEKING_BYTES_MAX: usize = 64;

/// How often a request is said before its silence, or its refusal, counts.
const TRIES: u32 = 3;

/// Polls in a row without a good answer after which the device counts as switched off or reset:
/// half a second, beyond what any damage to single answers lasts.
const POLLS_LOST_MAX: u32 = 5;

impl NdiHost {
    /// Sends a request; its answer goes to the task.
    pub(super) fn ask(
        &mut self,
        task: Task,
        request: Request,
        patience_ms: u64,
        not_before_ns: u64,
    ) {
        let patience_ns = patience_ms * MS;
        self.asked = Some(Asked { task, request, patience_ns, tries: 0, active_ns: 0 });
        self.send(not_before_ns);
    }

    /// Waits for an answer to what is no request.
    pub(super) fn expect(&mut self, task: Task, patience_ms: u64) {
        self.reply.clear();
        let (request, patience_ns) = (Request::default(), patience_ms * MS);
        let active_ns = self.desk.now_ns();
        self.asked = Some(Asked { task, request, patience_ns, tries: TRIES, active_ns });
    }

    /// Says what was asked (again).
    fn send(&mut self, not_before_ns: u64) {
        let now_ns = self.desk.now_ns();
        self.reply.clear();
        if let Some(asked) = &mut self.asked {
            asked.tries += 1;
            asked.active_ns = not_before_ns.max(now_ns);
            let request = asked.request;
            if !self.desk.order(Order::Write { request, not_before_ns }) {
                // The line is gone, and the next read says so.
                self.asked = None;
            }
        }
    }

    /// Ends the session with words, and begins anew when the host asks again.
    pub(super) fn fail(&mut self, words: String) {
        self.state = State::Off;
        self.asked = None;
        self.owed = Owed::default();
        self.desk.order(Order::Fail(words));
    }

    /// The request failed for good: what the device said, and what to do.
    pub(super) fn fail_refused(&mut self, what: &str, code: u8) {
        let words = message::advice(code);
        self.fail(format!("the NDI system cannot {what} (ERROR{code:02X}): {words}"));
    }

    pub(super) fn receive(&mut self, bytes: &[u8], on_event: OnEvent<'_>) {
        let now_ns = self.desk.now_ns();
        if let Some(drain) = &mut self.drain {
            if !bytes.is_empty() {
                drain.last_byte_ns = now_ns;
                self.counters.bytes_skipped += bytes.len() as u64;
            }
            let Drain { since_ns, last_byte_ns } = *drain;
            if now_ns - last_byte_ns >= QUIET_NS {
                self.drain = None;
                self.again(on_event);
            } else if now_ns - since_ns > self.babble_ns() {
                self.drain = None;
                self.babbled(on_event);
            }
            return;
        }
        let Some(asked) = &mut self.asked else {
            self.counters.bytes_skipped += bytes.len() as u64;
            return;
        };
        if !bytes.is_empty() {
            asked.active_ns = asked.active_ns.max(now_ns);
            let room = REPLY_BYTES_MAX - self.reply.len();
            self.reply.extend_from_slice(bytes.get(..room).unwrap_or(bytes));
            let fits = bytes.len() <= room
                && (!self.is_guessing() || self.reply.len() <= SEEKING_BYTES_MAX);
            if fits {
                self.look(on_event);
            } else {
                self.damaged(now_ns);
            }
        } else if now_ns.saturating_sub(asked.active_ns) > asked.patience_ns {
            if !self.reply.is_empty() {
                // The end is missing, and more will not come.
                self.count_damage();
            }
            self.again(on_event);
        }
    }

    /// No speed is known at which it answers.
    fn is_guessing(&self) -> bool {
        matches!(self.asked, Some(Asked { task: Task::Seek(_) | Task::Break(_), .. }))
    }

    fn is_seeking(&self) -> bool {
        self.is_guessing() || self.asked.is_some_and(|asked| asked.task == Task::Check)
    }

    fn babble_ns(&self) -> u64 {
        if self.is_seeking() { BABBLE_SEEKING_NS } else { BABBLE_NS }
    }

    /// It sends without being asked: at the wrong speed, or because it is something else.
    fn babbled(&mut self, on_event: OnEvent<'_>) {
        match self.asked.take() {
            Some(Asked { task: task @ (Task::Seek(_) | Task::Break(_) | Task::Check), .. }) => {
                self.done(task, Outcome::Silence, on_event);
            }
            _ => self.seek_anew(),
        }
    }

    fn look(&mut self, on_event: OnEvent<'_>) {
        let now_ns = self.desk.now_ns();
        let Some(task) = self.asked.map(|asked| asked.task) else { return };
        match message::look(&self.reply) {
            Look::NotYet => {}
            Look::Damaged => self.damaged(now_ns),
            Look::Binary(block) => {
                let read = if self.bx2 { read_bx2 } else { read_bx };
                if task == Task::Poll && read(block, &mut self.seen).is_some() {
                    self.counters.messages += 1;
                    self.asked = None;
                    self.polls_lost = 0;
                    self.polled(on_event);
                } else {
                    self.damaged(now_ns);
                }
            }
            Look::Text(text) => {
                // Answers are ASCII, and the copy is of a rare one.
                let text = String::from_utf8_lossy(text).into_owned();
                self.counters.messages += 1;
                match message::error_code(&text) {
                    Some(code) => self.refused(task, code, on_event),
                    None => {
                        self.asked = None;
                        self.done(task, Outcome::Text(&text), on_event);
                    }
                }
            }
        }
    }

    /// A request may have been damaged on its way: it is said again before its refusal counts.
    fn refused(&mut self, task: Task, code: u8, on_event: OnEvent<'_>) {
        let for_good = task == Task::Poll && code == code::WRONG_MODE;
        if !for_good && self.asked.is_some_and(|asked| asked.tries < TRIES) {
            self.send(0);
        } else {
            self.asked = None;
            self.done(task, Outcome::Refused(code), on_event);
        }
    }

    fn count_damage(&mut self) {
        self.counters.bytes_skipped += self.reply.len() as u64;
        // While the speed is not known yet, damage is what wrong guesses look like.
        if !self.is_seeking() {
            self.counters.messages_damaged += 1;
        }
        self.reply.clear();
    }

    fn damaged(&mut self, now_ns: u64) {
        self.count_damage();
        self.drain = Some(Drain { since_ns: now_ns, last_byte_ns: now_ns });
    }

    /// The request had no good answer.
    fn again(&mut self, on_event: OnEvent<'_>) {
        let Some(Asked { task, tries, .. }) = self.asked else { return };
        if task == Task::Poll {
            self.polls_lost += 1;
            self.run.unread();
            self.asked = None;
            if self.polls_lost >= POLLS_LOST_MAX {
                self.seek_anew();
            } else {
                self.next_poll();
            }
        } else if tries < TRIES && !matches!(task, Task::Seek(_) | Task::Break(_)) {
            self.send(0);
        } else {
            self.asked = None;
            self.done(task, Outcome::Silence, on_event);
        }
    }

    fn done(&mut self, task: Task, outcome: Outcome<'_>, on_event: OnEvent<'_>) {
        match task {
            Task::Start | Task::Poll | Task::Stop => self.tracked(task, outcome, on_event),
            _ => self.brought_up(task, outcome),
        }
    }
}
