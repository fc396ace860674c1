//! When a growing take gets a ledger.

use std::time::{Duration, Instant};

use crate::pipeline::Counts;

/// Time between two ledgers at least.
const AT_LEAST: Duration = Duration::from_secs(5);

/// Time between two ledgers at most: by so much the last one of a killed take can be older than its last
/// frame, as far as its counters of what went well go.
const AT_MOST: Duration = Duration::from_secs(60);

/// A ledger stands in the take from the first stretch on; then, while all goes well, when the recording is
/// twice as old as at the last one. What went wrong is there within five seconds.
#[derive(Debug, Default)]
pub(super) struct Ledgers {
    begun: Option<Instant>,
    last: Option<(Instant, Troubles)>,
}

/// The counters that stand still while all goes well.
type Troubles = [u64; 13];

impl Ledgers {
    /// Whether one is to be written now; then it counts as written.
    pub(super) fn are_due(&mut self, counts: &Counts, now: Instant) -> bool {
        let begun = *self.begun.get_or_insert(now);
        let troubles = troubles(counts);
        let due = self.last.is_none_or(|(last, known)| {
            let wait = if known == troubles {
                last.duration_since(begun).clamp(AT_LEAST, AT_MOST)
            } else {
                AT_LEAST
            };
            now.duration_since(last) >= wait
        });
        if due {
            self.last = Some((now, troubles));
        }
        due
    }
}

fn troubles(counts: &Counts) -> Troubles {
    [
        counts.not_received,
        counts.ring_full,
        counts.lost_in_outages,
        counts.duplicates,
        counts.samples_not_finite + counts.link.samples_not_finite,
        counts.markers_dropped,
        counts.counter_jumps,
        counts.clock_jumps,
        counts.events_dropped,
        counts.link.bytes_skipped,
        counts.link.messages_damaged,
        counts.link.messages_unknown,
        counts.status.map_or(0, |status| status.frames_dropped),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_while_all_goes_well_and_soon_when_not() {
        let (mut ledgers, start) = (Ledgers::default(), Instant::now());
        let mut counts = Counts::default();
        let mut written = Vec::new();
        for half_second in 0..600 {
            counts.recorded += 30;
            counts.duplicates += u64::from([250, 251, 252].contains(&half_second));
            if ledgers.are_due(&counts, start + Duration::from_millis(500 * half_second)) {
                written.push(half_second / 2);
            }
        }
        assert_eq!(written, [0, 5, 10, 20, 40, 80, 125, 130, 190, 250]);
    }
}
