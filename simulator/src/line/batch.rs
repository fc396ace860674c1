//! A line that hands over what it has once in a while only, as USB serial adapters do with a latency timer.

/// The timer: it runs whether there is something to send or not.
#[derive(Debug)]
pub(crate) struct Batch {
    period_ns: u64,
    /// The next time that it goes off.
    next_ns: u64,
    /// Bytes that were there when it went off last, and are not handed over yet.
    released: usize,
}

impl Batch {
    pub(crate) fn new(period_ns: u64, now_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        Self { period_ns, next_ns: now_ns + period_ns, released: 0 }
    }

    /// Time passed. `waiting` bytes were there all the while: what is new is told next time.
    pub(crate) fn tick(&mut self, now_ns: u64, waiting: usize) {
        if now_ns >= self.next_ns {
            // A late wake-up does not move the timer.
            self.next_ns +=
                (now_ns - self.next_ns) / self.period_ns * self.period_ns + self.period_ns;
            self.released = waiting;
        }
    }

    /// How many bytes may be handed over.
    pub(crate) fn allowed(&self) -> usize {
        self.released
    }

    pub(crate) fn sent(&mut self, bytes: usize) {
        self.released = self.released.saturating_sub(bytes);
    }

    /// When it is worth asking again.
    pub(crate) fn next_ns(&self) -> u64 {
        self.next_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_after_the_timer_waits_for_the_next_time() {
        let mut batch = Batch::new(16, 100);
        let mut allowed = |now_ns, waiting, sent| {
            batch.sent(sent);
            batch.tick(now_ns, waiting);
            (batch.allowed(), batch.next_ns())
        };
        assert_eq!(allowed(115, 50, 0), (0, 116));
        assert_eq!(allowed(117, 50, 0), (50, 132));
        assert_eq!(allowed(118, 90, 30), (20, 132));
        assert_eq!(allowed(131, 70, 20), (0, 132));
        // Woken late: the timer goes on as if it had not been.
        assert_eq!(allowed(170, 70, 0), (70, 180));
        // It goes off whether there is something or not, and what comes then waits.
        assert_eq!(allowed(200, 0, 70), (0, 212));
        assert_eq!(allowed(201, 10, 0), (0, 212));
    }
}
