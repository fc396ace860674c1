//! `SAMPLE_LEDGER`: what became of the samples of each group of sampled channels.

use bincode::{Decode, Encode};

use super::Record;
use crate::{chunk::types, sampled::SampleContent, timeline::LossCauses};

/// The account of a group. All counts are samples of each channel, except [`jumps`](Self::jumps).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Encode, Decode)]
pub struct GroupLedger {
    /// Number of the group.
    pub group: u32,
    /// Samples that the device took since the take began, as far as its numbers show.
    pub taken: u64,
    /// Samples in the take.
    pub stored: u64,
    /// Taken, never arrived, and not known to be dropped by the device.
    pub lost_on_link: u64,
    /// Never left the device, by its numbers of batches.
    pub dropped_by_device: u64,
    /// Arrived, and dropped in whole batches because a ring was full.
    pub lost_ring_full: u64,
    /// Arrived, and dropped for another reason; or stored, and lost when the take was damaged and recovered.
    pub lost_other: u64,
    /// May have been taken while the device was disconnected.
    pub unknown_after_disconnect: u64,
    /// Arrived again, or out of order; not stored a second time.
    pub duplicates: u64,
    /// Times that the numbers of samples began again or jumped as no loss explains. How many samples the device took
    /// meanwhile is unknown.
    pub jumps: u64,
}

impl GroupLedger {
    /// Samples that the take lacks, by cause.
    #[must_use]
    pub fn lost_by_cause(&self) -> [u64; 5] {
        [
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ]
    }

    /// Samples that the take lacks.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost_by_cause().iter().fold(0, |sum, &n| sum.saturating_add(n))
    }

    /// Whether every sample taken is stored or lost.
    #[must_use]
    pub fn closes(&self) -> bool {
        self.taken == self.stored.saturating_add(self.lost())
    }

    /// Counts samples of the group that are in a take, or that it states as lost.
    pub(crate) fn count(&mut self, content: SampleContent, n: u64) {
        let counter = match content {
            SampleContent::Key | SampleContent::Continued => &mut self.stored,
            // Each run has one cause, except that of a later version.
            SampleContent::Lost(LossCauses::NOT_RECEIVED) => &mut self.lost_on_link,
            SampleContent::Lost(LossCauses::DROPPED_BY_DEVICE) => &mut self.dropped_by_device,
            SampleContent::Lost(LossCauses::RING_FULL) => &mut self.lost_ring_full,
            SampleContent::Lost(LossCauses::DISCONNECTED) => &mut self.unknown_after_disconnect,
            SampleContent::Lost(_) => &mut self.lost_other,
        };
        *counter = counter.saturating_add(n);
        self.taken = self.taken.saturating_add(n);
    }

    /// The account of the same samples where those that were stored are lost.
    pub(crate) fn without_samples(&self) -> Self {
        let lost_other = self.lost_other.saturating_add(self.stored);
        Self { stored: 0, lost_other, ..*self }
    }

    /// Adds the counts of the same group in a take that follows.
    fn add(&mut self, other: &Self) {
        for (sum, n) in [
            (&mut self.taken, other.taken),
            (&mut self.stored, other.stored),
            (&mut self.lost_on_link, other.lost_on_link),
            (&mut self.dropped_by_device, other.dropped_by_device),
            (&mut self.lost_ring_full, other.lost_ring_full),
            (&mut self.lost_other, other.lost_other),
            (&mut self.unknown_after_disconnect, other.unknown_after_disconnect),
            (&mut self.duplicates, other.duplicates),
            (&mut self.jumps, other.jumps),
        ] {
            *sum = sum.saturating_add(n);
        }
    }
}

/// The account of the sampled channels of a recording, up to its place in the file.
#[derive(Debug, Clone, PartialEq, Eq, Default, Encode, Decode)]
pub struct SampleLedger {
    /// The last one of a take that was closed in order.
    pub finished: bool,
    /// The groups, in order of their numbers.
    pub groups: Vec<GroupLedger>,
    /// Batches of groups that were not announced when the recording began, or that did not fit their announcement.
    pub batches_refused: u64,
}

impl SampleLedger {
    /// Adds the counts of a take that follows, group by group.
    pub fn add_counters(&mut self, other: &Self) {
        self.batches_refused = self.batches_refused.saturating_add(other.batches_refused);
        for group in &other.groups {
            match self.groups.iter_mut().find(|known| known.group == group.group) {
                Some(known) => known.add(group),
                None => self.groups.push(*group),
            }
        }
    }

    /// Whether the take lacks samples that the device took, as far as is known.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        self.batches_refused > 0
            || self.groups.iter().any(|group| group.lost() > 0 || group.jumps > 0)
    }
}

impl Record for SampleLedger {
    const NAME: &'static str = "ledger of samples";
    const KIND: u8 = types::SAMPLE_LEDGER;
    const VERSION: u16 = 1;
}
