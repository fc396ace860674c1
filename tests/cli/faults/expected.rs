//! The expected ledger, computed independently from the known fates of all frames.

use mocapd_simulator::faults::{Fate, FrameFate};

/// The counts of a ledger.
#[derive(Debug, Default)]
pub(crate) struct Expected {
    pub(crate) recorded: u64,
    pub(crate) duplicates: u64,
    pub(crate) dropped: u64,
    pub(crate) lost_on_link: u64,
    pub(crate) unknown: u64,
    /// Time from the last frame before each outage to the first one after it, by the device's log.
    pub(crate) away_s: f64,
}

pub(crate) fn expected(fates: &[FrameFate]) -> Expected {
    let mut expected = Expected::default();
    let is_whole = |fate: &&FrameFate| fate.fate == Fate::Whole;
    let mut from = 0;
    let mut last: Option<&FrameFate> = None;
    for (index, fate) in fates.iter().enumerate().filter(|(_, fate)| is_whole(fate)) {
        let between = &fates[from..index];
        match last {
            // Between two runs the host was not connected, so the fates of frames do not matter.
            Some(before) if before.frame.run != fate.frame.run => {
                expected.unknown += between.len() as u64;
                expected.away_s += (fate.frame.host_ns - before.frame.host_ns) as f64 * 1e-9;
            }
            _ => expected.missing(between),
        }
        (from, last) = (index + 1, Some(fate));
    }
    expected.missing(&fates[from..]);
    for fate in fates.iter().filter(|fate| matches!(fate.fate, Fate::Whole | Fate::Late)) {
        expected.recorded += u64::from(fate.fate == Fate::Whole);
        expected.duplicates += u64::from(fate.again) + u64::from(fate.fate == Fate::Late);
    }
    expected
}

impl Expected {
    fn missing(&mut self, frames: &[FrameFate]) {
        let dropped = frames.iter().filter(|fate| fate.fate == Fate::Dropped).count() as u64;
        self.dropped += dropped;
        self.lost_on_link += frames.len() as u64 - dropped;
    }
}
