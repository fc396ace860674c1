//! Limits on when a line hands bytes over: its baud rate, and the latency timer of a USB serial adapter.

/// Bits per byte on an 8N1 line.
const BITS_PER_BYTE: u64 = 10;

/// How far ahead of the line bytes are handed over: about a UART's FIFO at the common speeds.
const FIFO_NS: u64 = 1_000_000;

/// Idle time that a burst may make up for, so that a late wake-up does not cost throughput.
const CREDIT_NS: u64 = 5_000_000;

const SECOND_NS: u128 = 1_000_000_000;

/// Limits the throughput to a speed in baud.
#[derive(Debug)]
pub(super) struct BaudLimiter {
    baud: u64,
    /// When the last byte handed over has left the line.
    free_ns: u64,
}

impl BaudLimiter {
    pub(super) fn new(baud: u32) -> Self {
        Self { baud: u64::from(baud.max(1)), free_ns: 0 }
    }

    pub(super) fn baud(&self) -> u32 {
        u32::try_from(self.baud).unwrap_or(u32::MAX)
    }

    /// The number of bytes that may be handed over now.
    pub(super) fn allowed(&mut self, now_ns: u64) -> usize {
        self.free_ns = self.free_ns.max(now_ns.saturating_sub(CREDIT_NS));
        let ahead_ns = (now_ns + FIFO_NS).saturating_sub(self.free_ns);
        let bytes =
            u128::from(ahead_ns) * u128::from(self.baud) / u128::from(BITS_PER_BYTE) / SECOND_NS;
        // A slow line takes less than a byte in that time; one byte goes as soon as the line is free.
        let one = usize::from(self.free_ns <= now_ns);
        usize::try_from(bytes).unwrap_or(usize::MAX).max(one)
    }

    pub(super) fn sent(&mut self, bytes: usize) {
        let ns = bytes as u128 * u128::from(BITS_PER_BYTE) * SECOND_NS / u128::from(self.baud);
        self.free_ns = self.free_ns.saturating_add(u64::try_from(ns).unwrap_or(u64::MAX));
    }

    /// When the line is free again.
    pub(super) fn next_ns(&self) -> u64 {
        self.free_ns
    }
}

/// The latency timer of a USB serial adapter: it releases the waiting bytes once per period. It runs even when nothing
/// waits.
#[derive(Debug)]
pub(crate) struct LatencyTimer {
    period_ns: u64,
    /// When it expires next.
    pub(crate) next_ns: u64,
    /// Bytes released at the last expiry and not handed over yet.
    pub(crate) released: usize,
}

impl LatencyTimer {
    pub(crate) fn new(period_ns: u64, now_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        Self { period_ns, next_ns: now_ns + period_ns, released: 0 }
    }

    /// Advances the time. `waiting` bytes were there before it; newer ones wait for the next expiry.
    pub(crate) fn tick(&mut self, now_ns: u64, waiting: usize) {
        if now_ns >= self.next_ns {
            // A late wake-up does not move the timer.
            self.next_ns +=
                (now_ns - self.next_ns) / self.period_ns * self.period_ns + self.period_ns;
            self.released = waiting;
        }
    }

    pub(crate) fn sent(&mut self, bytes: usize) {
        self.released = self.released.saturating_sub(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_line_carries_a_tenth_of_its_baud_rate() {
        for baud in [300, 9_600, 115_200, 3_000_000] {
            let mut pace = BaudLimiter::new(baud);
            let (mut now_ns, mut bytes) = (10 * CREDIT_NS, 0);
            let start_ns = now_ns;
            while now_ns < start_ns + 10_000_000_000 {
                let n = pace.allowed(now_ns);
                pace.sent(n);
                bytes += n;
                // Always woken 0.3 ms late.
                now_ns = pace.next_ns().max(now_ns) + 300_000;
            }
            let expected = baud as f64;
            assert!((bytes as f64 / expected - 1.0).abs() < 0.01, "{baud}: {bytes}");
        }
    }

    #[test]
    fn bytes_after_an_expiry_wait_for_the_next() {
        let mut timer = LatencyTimer::new(16, 100);
        let mut allowed = |now_ns, waiting, sent| {
            timer.sent(sent);
            timer.tick(now_ns, waiting);
            (timer.released, timer.next_ns)
        };
        assert_eq!(allowed(115, 50, 0), (0, 116));
        assert_eq!(allowed(117, 50, 0), (50, 132));
        assert_eq!(allowed(118, 90, 30), (20, 132));
        assert_eq!(allowed(131, 70, 20), (0, 132));
        // A late wake-up does not shift the timer.
        assert_eq!(allowed(170, 70, 0), (70, 180));
        // It expires even when nothing waits, and later bytes wait for the next expiry.
        assert_eq!(allowed(200, 0, 70), (0, 212));
        assert_eq!(allowed(201, 10, 0), (0, 212));
    }
}
