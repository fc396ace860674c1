//! `SAMPLE_LEDGER`: what became of the samples of each group of sampled channels.

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};
use mocapd_codec::poses::PoseErrors;

use super::Record;
use crate::{chunk::types, sampled::SampleContent, timeline::LossCauses};

/// The largest errors of the poses of a group, rounded up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeasuredErrors {
    /// Of positions, in nanometres.
    pub position_nm: u64,
    /// Of angles, in billionths of a degree.
    pub angle_nanodegrees: u64,
}

impl MeasuredErrors {
    /// Takes the larger of each.
    pub fn add(&mut self, errors: &PoseErrors) {
        let position_nm = (errors.position_mm * 1e6).ceil() as u64;
        let angle_nanodegrees = (errors.angle_degrees * 1e9).ceil() as u64;
        self.take_larger(&Self { position_nm, angle_nanodegrees });
    }

    fn take_larger(&mut self, other: &Self) {
        self.position_nm = self.position_nm.max(other.position_nm);
        self.angle_nanodegrees = self.angle_nanodegrees.max(other.angle_nanodegrees);
    }

    /// Those that poses within these bounds may have.
    #[must_use]
    pub fn at_most([position_mm, angle_degrees]: [f64; 2]) -> Self {
        let mut errors = Self::default();
        errors.add(&PoseErrors { position_mm, angle_degrees });
        errors
    }

    /// In millimetres and degrees.
    #[must_use]
    pub fn errors(&self) -> PoseErrors {
        PoseErrors {
            position_mm: self.position_nm as f64 / 1e6,
            angle_degrees: self.angle_nanodegrees as f64 / 1e9,
        }
    }
}

/// The account of a group. All counts are samples of each channel, except [`jumps`](Self::jumps).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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
    /// The largest errors of its poses, if they are within bounds and the take states what was measured. The record does
    /// not have them, so that earlier versions read it: they are in a section of SUMMARY.
    pub errors: Option<MeasuredErrors>,
}

bincode::impl_borrow_decode!(GroupLedger);

impl Encode for GroupLedger {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.group.encode(encoder)?;
        self.counts().into_iter().try_for_each(|n| n.encode(encoder))
    }
}

impl<C> Decode<C> for GroupLedger {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let mut ledger = Self { group: u32::decode(decoder)?, ..Self::default() };
        for n in ledger.counts_mut() {
            *n = u64::decode(decoder)?;
        }
        Ok(ledger)
    }
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

    /// All counts, in the order of the record.
    fn counts(&self) -> [u64; 9] {
        [
            self.taken,
            self.stored,
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
            self.duplicates,
            self.jumps,
        ]
    }

    /// The same, to be changed.
    fn counts_mut(&mut self) -> [&mut u64; 9] {
        [
            &mut self.taken,
            &mut self.stored,
            &mut self.lost_on_link,
            &mut self.dropped_by_device,
            &mut self.lost_ring_full,
            &mut self.lost_other,
            &mut self.unknown_after_disconnect,
            &mut self.duplicates,
            &mut self.jumps,
        ]
    }

    /// Adds the counts of the same group in a take that follows. Its errors are known only if both are.
    fn add(&mut self, other: &Self) {
        for (sum, n) in self.counts_mut().into_iter().zip(other.counts()) {
            *sum = sum.saturating_add(n);
        }
        self.errors = self.errors.zip(other.errors).map(|(mut larger, errors)| {
            larger.take_larger(&errors);
            larger
        });
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

/// The largest errors of poses that were measured in a take, by group; a section of the summary.
#[derive(Debug, PartialEq, Eq, Encode, Decode)]
pub(super) struct PoseErrorsRecord {
    /// Number of the group, nanometres, billionths of a degree.
    groups: Vec<(u32, u64, u64)>,
}

impl Record for PoseErrorsRecord {
    const NAME: &'static str = "errors of poses";
    const KIND: u8 = types::SUMMARY;
    const VERSION: u16 = 1;
}

impl PoseErrorsRecord {
    /// Those of a ledger; `None` if it has none.
    pub(super) fn of(ledger: &SampleLedger) -> Option<Self> {
        let errors = |group: &GroupLedger| {
            group.errors.map(|errors| (group.group, errors.position_nm, errors.angle_nanodegrees))
        };
        let groups: Vec<_> = ledger.groups.iter().filter_map(errors).collect();
        (!groups.is_empty()).then_some(Self { groups })
    }

    /// States them in the ledger; those of other groups are ignored.
    pub(super) fn state_in(&self, ledger: &mut SampleLedger) {
        for &(number, position_nm, angle_nanodegrees) in &self.groups {
            let mut groups = ledger.groups.iter_mut();
            if let Some(group) = groups.find(|group| group.group == number) {
                group.errors = Some(MeasuredErrors { position_nm, angle_nanodegrees });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::SummaryRecord;

    fn ledger() -> SampleLedger {
        let group = |group| GroupLedger { group, taken: 300, stored: 300, ..Default::default() };
        SampleLedger { finished: true, groups: vec![group(0), group(16)], batches_refused: 0 }
    }

    /// A reader of the version before poses has all counts, and skips the section with the errors.
    #[test]
    fn errors_of_poses_are_in_a_section_of_the_summary_and_not_in_the_ledger() {
        let without = ledger();
        let mut with = without.clone();
        let errors = with.groups[1].errors.insert(MeasuredErrors::default());
        errors.add(&PoseErrors { position_mm: 0.099_999_999_5, angle_degrees: 0.028 });
        errors.add(&PoseErrors::default());
        assert_eq!((errors.position_nm, errors.angle_nanodegrees), (100_000, 28_000_000));
        let payload = with.to_payload().unwrap();
        assert_eq!(payload, without.to_payload().unwrap());
        let group = |n| [n, 251, 44, 1, 251, 44, 1, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(payload, [&[1, 0, 1, 2][..], &group(0), &group(16), &[0]].concat());
        assert_eq!(SampleLedger::from_payload(&payload, 8).unwrap(), without);
        let summary = |ledger: &SampleLedger| SummaryRecord {
            sample_ledger: Some(ledger.clone()),
            ..SummaryRecord::default()
        };
        let (short, long) =
            (summary(&without).to_payload().unwrap(), summary(&with).to_payload().unwrap());
        // Tag 7, 14 bytes, version 1, and one group: 100 000 and 28 000 000.
        let section = [7, 14, 1, 0, 1, 16, 252, 0xA0, 0x86, 1, 0, 252, 0, 0x3F, 0xAB, 1];
        assert_eq!(long, [&short[..], &section].concat());
        assert_eq!(SummaryRecord::from_payload(&short, 8).unwrap(), summary(&without));
        assert_eq!(SummaryRecord::from_payload(&long, 8).unwrap(), summary(&with));
        // Of a later version; before the ledger; twice; cut off.
        let mut later = long.clone();
        later[short.len() + 2] = 2;
        assert_eq!(SummaryRecord::from_payload(&later, 8).unwrap(), summary(&without));
        let before = [&short[..2], &section, &short[2..]].concat();
        assert_eq!(SummaryRecord::from_payload(&before, 8).unwrap(), summary(&with));
        assert!(SummaryRecord::from_payload(&[&long[..], &section].concat(), 8).is_err());
        for n in short.len() + 1..long.len() {
            assert!(SummaryRecord::from_payload(&long[..n], 8).is_err(), "{n}");
        }
        let alone = [&short[..2], &section].concat();
        let read = SummaryRecord::from_payload(&alone, 8).unwrap();
        assert_eq!(read, SummaryRecord::default(), "errors without a ledger mean nothing");
    }

    #[test]
    fn the_errors_of_joined_takes_are_the_larger_ones_and_unknown_if_those_of_one_are() {
        let errors = |position_nm, angle_nanodegrees| {
            Some(MeasuredErrors { position_nm, angle_nanodegrees })
        };
        let of = |errors| {
            let mut ledger = ledger();
            ledger.groups[1].errors = errors;
            ledger
        };
        for (one, other, sum) in [
            (errors(5, 9), errors(7, 2), errors(7, 9)),
            (errors(5, 9), None, None),
            (None, errors(7, 2), None),
        ] {
            let mut found = of(one);
            found.add_counters(&of(other));
            assert_eq!((found.groups[1].errors, found.groups[1].taken), (sum, 600));
            assert_eq!(found.groups[0].errors, None);
        }
    }
}
