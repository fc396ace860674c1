//! How well each marker is seen, counted where its samples pass anyway.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

/// By slot.
#[derive(Debug, Clone, Default)]
pub struct SeenCounters(pub(super) Arc<[ChannelSeen]>);

/// One channel's, in rows of the stretches that were coded.
#[derive(Debug, Default)]
pub(super) struct ChannelSeen {
    rows: AtomicU64,
    present: AtomicU64,
    gaps: AtomicU64,
    longest_gap: AtomicU64,
    /// Rows of the gap that is open; only the worker that holds the group uses it.
    open_gap: AtomicU64,
}

/// How well a channel was seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Seen {
    /// Rows since it has a channel; frames lost count as not seen.
    pub rows: u64,
    /// Of these, rows with a position.
    pub present: u64,
    /// Times that it vanished.
    pub gaps: u64,
    /// Rows of the longest gap.
    pub longest_gap: u64,
}

impl SeenCounters {
    pub(super) fn new(n_slots: usize) -> Self {
        Self((0..n_slots).map(|_| ChannelSeen::default()).collect())
    }

    /// How well the channel in `slot` was seen.
    #[must_use]
    pub fn get(&self, slot: usize) -> Option<Seen> {
        let channel = self.0.get(slot)?;
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        Some(Seen {
            rows: get(&channel.rows),
            present: get(&channel.present),
            gaps: get(&channel.gaps),
            longest_gap: get(&channel.longest_gap),
        })
    }
}

impl ChannelSeen {
    /// One stretch of it.
    pub(super) fn count(&self, present: &[bool]) {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        let (mut open, mut gaps, mut longest) =
            (get(&self.open_gap), get(&self.gaps), get(&self.longest_gap));
        let mut seen = 0;
        for &present in present {
            if present {
                seen += 1;
                open = 0;
            } else {
                gaps += u64::from(open == 0);
                open += 1;
                longest = longest.max(open);
            }
        }
        let put = |n: &AtomicU64, value| n.store(value, Ordering::Relaxed);
        put(&self.rows, get(&self.rows) + present.len() as u64);
        put(&self.present, get(&self.present) + seen);
        put(&self.gaps, gaps);
        put(&self.longest_gap, longest);
        put(&self.open_gap, open);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_go_on_from_stretch_to_stretch() {
        let seen = SeenCounters::new(1);
        seen.0[0].count(&[true, false, false]);
        seen.0[0].count(&[false, true, true, false]);
        let wanted = Seen { rows: 7, present: 3, gaps: 2, longest_gap: 3 };
        assert_eq!(seen.get(0), Some(wanted));
        assert_eq!(seen.get(1), None);
    }
}
