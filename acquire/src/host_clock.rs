//! The clock that stamps arrivals, and a histogram of durations that never allocates: eight buckets per octave.

use rustix::time::{ClockId, clock_gettime};

/// The host's monotonic clock, in nanoseconds. A simulator on the same machine reads this clock too.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Buckets per octave: a quantile is accurate to 9 %.
const PER_OCTAVE: u32 = 8;
const N_BUCKETS: usize = 64 * PER_OCTAVE as usize;

/// A histogram of durations in nanoseconds.
#[derive(Debug, Clone)]
pub struct LatencyHistogram {
    buckets: Box<[u64; N_BUCKETS]>,
    n: u64,
    max_ns: u64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { buckets: Box::new([0; N_BUCKETS]), n: 0, max_ns: 0 }
    }
}

impl LatencyHistogram {
    /// Adds one duration.
    pub fn add(&mut self, ns: u64) {
        self.buckets[bucket(ns)] += 1;
        self.n += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// The number of durations added.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.n
    }

    /// The longest duration.
    #[must_use]
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The `q`-quantile (`q` from 0 to 1), rounded up to the end of its bucket.
    #[must_use]
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let rank = (q * self.n as f64).ceil() as u64;
        let mut n = 0;
        for (index, count) in self.buckets.iter().enumerate() {
            n += count;
            if n >= rank && *count > 0 {
                return bucket_end(index).min(self.max_ns);
            }
        }
        self.max_ns
    }
}

/// Divides the octave that contains `ns` into eight equal parts.
fn bucket(ns: u64) -> usize {
    let octave = ns.max(1).ilog2();
    let part = if octave >= 3 { (ns >> (octave - 3)) & 7 } else { (ns << (3 - octave)) & 7 };
    (octave * PER_OCTAVE) as usize + part as usize
}

fn bucket_end(index: usize) -> u64 {
    let (octave, part) = (index as u32 / PER_OCTAVE, index as u64 % u64::from(PER_OCTAVE));
    (((u128::from(part) + 9) << octave) >> 3).min(u128::from(u64::MAX)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_accurate_to_a_bucket() {
        let mut latency = LatencyHistogram::default();
        for ns in 1..=10_000 {
            latency.add(ns);
        }
        for (q, expected) in [(0.5, 5_000.0), (0.99, 9_900.0), (1.0, 10_000.0)] {
            let got = latency.quantile_ns(q) as f64;
            assert!(got >= expected && got < expected * 1.13, "{q}: {got}");
        }
        assert_eq!(LatencyHistogram::default().quantile_ns(0.99), 0);
        latency.add(u64::MAX);
        assert_eq!(latency.quantile_ns(1.0), u64::MAX);
    }
}
