//! Schedules pings, which ask the device for its clock.
//!
//! Round trips come in bursts of eight; the best bounds of a burst count. On a line that sends in batches (an
//! FTDI adapter: every 16 ms), a pong waits for the next batch, and a burst timed at random never sees a short
//! way back. On such a line a burst therefore measures the batch interval and sends its pings shortly before the
//! next batch.

/// Round trips of a burst, as in LSL.
pub(super) const PROBES: u32 = 8;

/// Seconds between two bursts: short at the start, so that there is a rate after four seconds and a good one
/// after nine, then as long as a take can afford to store (some 50 bytes a burst). A full window holds four.
const INTERVALS_S: [u64; 6] = [1, 3, 5, 11, 20, 30];

/// Shortest time between bursts on request. The link's budget allows ten pongs a second (docs/link-protocol.md), and a
/// clock that jumps with every frame must not be queried all the time.
const RESTART_AFTER_NS: u64 = 2 * SECOND_NS;

const SECOND_NS: u64 = 1_000_000_000;

/// Time to wait for an answer.
const ANSWER_TIMEOUT_NS: u64 = 500_000_000;

/// Number of unanswered pings in a row after which the device is not queried again until a late answer comes.
const UNANSWERED_MAX: u32 = 2 * PROBES;

/// Number of pings that may still be answered.
const PENDING_MAX: usize = 8;

/// Time between two round trips of a burst on a line that sends at once, so that one disturbance does not
/// delay all of them.
const SPACING_NS: u64 = 10_000_000;

/// A shorter round trip did not wait for a batch.
const QUICK_NS: u64 = 400_000;

/// Longest batch interval to synchronise with: 16 ms, and what a scheduler adds. Nothing can
/// arrive during the wait.
const PERIOD_MAX_NS: u64 = 20_000_000;

/// Shortest time from a ping to the batch that answers it: the timer latency of an idle machine.
const LEAD_MIN_NS: u64 = 80_000;

/// Number of pings in a row that missed their batch, after which the interval is measured again.
const MISSES_MAX: u32 = 3;

/// Schedules pings. Sans-io: the caller reports what was sent and answered.
#[derive(Debug, Default)]
pub struct Prober {
    off: bool,
    bursts: usize,
    burst_began_ns: u64,
    next_burst_ns: u64,
    /// Probes of this burst that are still to be sent.
    remaining: u32,
    ready_ns: u64,
    sleeps: bool,
    waiting_since_ns: Option<u64>,
    unanswered: u32,
    pending: [Option<u64>; PENDING_MAX],
    timing: BatchTiming,
}

#[derive(Debug, Default)]
struct BatchTiming {
    /// The batch interval; 0 while unknown.
    period_ns: u64,
    lead_ns: u64,
    misses: u32,
    missed: bool,
    /// Arrival of this burst's last pong.
    last_pong_ns: Option<u64>,
    /// Whether the pending ping was timed to precede a batch.
    is_timed: bool,
}

impl Prober {
    /// A prober whose first burst is due at once.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// When to send the next ping, if that is now, or so soon that the caller should sleep until then.
    pub fn due(&mut self, now_ns: u64) -> Option<u64> {
        if self.off {
            return None;
        }
        if let Some(since_ns) = self.waiting_since_ns {
            if now_ns.saturating_sub(since_ns) < ANSWER_TIMEOUT_NS {
                return None;
            }
            self.waiting_since_ns = None;
            self.unanswered += 1;
            self.off = self.unanswered >= UNANSWERED_MAX;
            self.ready_ns = now_ns;
        }
        if self.remaining == 0 {
            if now_ns < self.next_burst_ns {
                return None;
            }
            self.begin(now_ns);
        }
        let soon =
            now_ns >= self.ready_ns || (self.sleeps && self.ready_ns - now_ns <= PERIOD_MAX_NS);
        (soon && !self.off).then_some(self.ready_ns.max(now_ns))
    }

    fn begin(&mut self, now_ns: u64) {
        let interval_s = INTERVALS_S[self.bursts.min(INTERVALS_S.len() - 1)];
        self.bursts += 1;
        self.remaining = PROBES;
        self.burst_began_ns = now_ns;
        self.next_burst_ns = now_ns.saturating_add(interval_s * SECOND_NS);
        self.ready_ns = now_ns;
        self.sleeps = false;
        self.timing.last_pong_ns = None;
        self.timing.is_timed = false;
    }

    /// Starts the schedule again because the clocks changed, but not before the link allows it.
    pub fn restart_schedule(&mut self) {
        if self.bursts > 0 {
            self.bursts = 0;
            self.next_burst_ns =
                self.next_burst_ns.min(self.burst_began_ns.saturating_add(RESTART_AFTER_NS));
        }
    }

    /// Reports that a ping was sent.
    pub fn sent(&mut self, at_ns: u64) {
        self.remaining = self.remaining.saturating_sub(1);
        self.waiting_since_ns = Some(at_ns);
        self.pending.rotate_right(1);
        self.pending[0] = Some(at_ns);
        self.timing.is_timed = std::mem::take(&mut self.sleeps);
    }

    /// Stops probing: the device cannot be queried.
    pub fn disable(&mut self) {
        self.off = true;
    }

    /// Reports a pong that carries `sent_ns`. Returns whether it answers one of these pings.
    pub fn answered(&mut self, sent_ns: u64, now_ns: u64) -> bool {
        let Some(ping) = self.pending.iter_mut().find(|ping| **ping == Some(sent_ns)) else {
            return false;
        };
        *ping = None;
        self.unanswered = 0;
        self.off = false;
        // A late answer is as good a bound as any, but says nothing about when to send.
        if self.waiting_since_ns == Some(sent_ns) {
            self.waiting_since_ns = None;
            (self.ready_ns, self.sleeps) = self.timing.next(sent_ns, now_ns);
        }
        true
    }
}

impl BatchTiming {
    /// Corrects the batch interval, which a pong noticed late has made wrong: later pongs show it again, or
    /// twice its length.
    fn correct(&mut self, now_ns: u64, before_ns: Option<u64>) {
        let elapsed_ns = now_ns.saturating_sub(before_ns.unwrap_or(now_ns));
        let times = (elapsed_ns + self.period_ns / 2) / self.period_ns.max(1);
        if (1..=2).contains(&times) && self.period_ns.abs_diff(elapsed_ns / times) > self.lead_ns {
            self.period_ns = u64::midpoint(self.period_ns, elapsed_ns / times);
        }
    }

    /// After a round trip: when to send the next ping, and whether to sleep until then.
    fn next(&mut self, sent_ns: u64, now_ns: u64) -> (u64, bool) {
        let trip_ns = now_ns.saturating_sub(sent_ns);
        let before_ns = self.last_pong_ns.replace(now_ns);
        if self.is_timed {
            self.correct(now_ns, before_ns);
            if trip_ns <= self.period_ns / 2 {
                self.misses = 0;
                // Halve it until a ping was too late, then reduce it carefully.
                let step_ns = self.lead_ns / if self.missed { 4 } else { 2 };
                self.lead_ns = (self.lead_ns - step_ns).max(LEAD_MIN_NS);
            } else if trip_ns <= 2 * self.period_ns {
                self.misses += 1;
                self.missed = true;
                self.lead_ns = self.lead_ns.saturating_mul(2).min(self.period_ns / 2);
                if self.misses >= MISSES_MAX {
                    *self = Self { last_pong_ns: self.last_pong_ns, ..Self::default() };
                    return (now_ns, false);
                }
            }
        } else if trip_ns < QUICK_NS {
            self.period_ns = 0;
            return (now_ns.saturating_add(SPACING_NS), false);
        } else if self.period_ns == 0 {
            // A ping sent as soon as the preceding pong came, with a batch, was answered with the next batch.
            if let Some(before_ns) = before_ns
                && sent_ns.saturating_sub(before_ns) < QUICK_NS
            {
                self.period_ns = now_ns.saturating_sub(before_ns);
                self.lead_ns = (self.period_ns / 16).max(LEAD_MIN_NS);
                (self.misses, self.missed) = (0, false);
            } else {
                return (now_ns, false);
            }
        }
        if (QUICK_NS..=PERIOD_MAX_NS).contains(&self.period_ns) {
            return (now_ns.saturating_add(self.period_ns - self.lead_ns), true);
        }
        self.period_ns = 0;
        (now_ns.saturating_add(SPACING_NS), false)
    }
}
