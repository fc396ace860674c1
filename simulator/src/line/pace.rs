//! How many bytes a real line of a speed would have taken by now.

/// Bits on an 8N1 line for every byte.
const BITS_PER_BYTE: u64 = 10;

/// How far ahead bytes are handed over: about a UART's FIFO at the common speeds.
const AHEAD_NS: u64 = 1_000_000;

/// How much idle time may be made up for: a late wake-up must not cost throughput.
const CREDIT_NS: u64 = 5_000_000;

const SECOND_NS: u128 = 1_000_000_000;

/// A line of a speed in baud.
#[derive(Debug)]
pub(super) struct Pace {
    baud: u64,
    /// When the last byte handed over has left.
    free_ns: u64,
}

impl Pace {
    pub(super) fn new(baud: u32) -> Self {
        Self { baud: u64::from(baud.max(1)), free_ns: 0 }
    }

    pub(super) fn baud(&self) -> u32 {
        u32::try_from(self.baud).unwrap_or(u32::MAX)
    }

    /// How many bytes may be handed over now.
    pub(super) fn allowed(&mut self, now_ns: u64) -> usize {
        self.free_ns = self.free_ns.max(now_ns.saturating_sub(CREDIT_NS));
        let room_ns = (now_ns + AHEAD_NS).saturating_sub(self.free_ns);
        let bytes =
            u128::from(room_ns) * u128::from(self.baud) / u128::from(BITS_PER_BYTE) / SECOND_NS;
        // A slow line takes less than a byte in that time: one goes as soon as the line is free.
        let one = usize::from(self.free_ns <= now_ns);
        usize::try_from(bytes).unwrap_or(usize::MAX).max(one)
    }

    pub(super) fn sent(&mut self, bytes: usize) {
        let ns = bytes as u128 * u128::from(BITS_PER_BYTE) * SECOND_NS / u128::from(self.baud);
        self.free_ns = self.free_ns.saturating_add(u64::try_from(ns).unwrap_or(u64::MAX));
    }

    /// When it is worth asking again.
    pub(super) fn next_ns(&self) -> u64 {
        self.free_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_line_carries_a_tenth_of_its_baud_rate() {
        for baud in [300, 9_600, 115_200, 3_000_000] {
            let mut pace = Pace::new(baud);
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
}
