//! `SAMPLE_LEDGER`: what became of the samples of each group of sampled channels.

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};
use mocapd_codec::poses::PoseErrors;

use super::Record;
use crate::{TakeError, chunk::types, sampled::SampleContent, timeline::LossCauses};

/// The largest errors of the poses of a group, rounded up; 0 for a group without poses, and for poses as the device sent
/// them. They are not part of version 1 of the record; version 2 has them after all else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeasuredErrors {
    /// Of positions, in nanometres.
    pub position_nm: u64,
    /// Of angles, in billionths of a degree.
    pub angle_nanodegrees: u64,
}

bincode::impl_borrow_decode!(MeasuredErrors);

impl Encode for MeasuredErrors {
    fn encode<E: Encoder>(&self, _: &mut E) -> Result<(), EncodeError> {
        Ok(())
    }
}

impl<C> Decode<C> for MeasuredErrors {
    fn decode<D: Decoder<Context = C>>(_: &mut D) -> Result<Self, DecodeError> {
        Ok(Self::default())
    }
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
    /// The largest errors of its poses.
    pub errors: MeasuredErrors,
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
        self.errors.take_larger(&other.errors);
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

    fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let errors: Vec<MeasuredErrors> = self.groups.iter().map(|group| group.errors).collect();
        if errors.iter().all(|errors| *errors == MeasuredErrors::default()) {
            return Counts(self.clone()).to_payload();
        }
        let errors = errors.iter().map(|e| (e.position_nm, e.angle_nanodegrees)).collect();
        WithErrors { counts: self.clone(), errors }.to_payload()
    }

    fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let (what, supported) = (Self::NAME, WithErrors::VERSION);
        match Counts::from_payload(payload, offset) {
            Err(TakeError::Unsupported { found, .. }) if found == supported => {}
            Err(TakeError::Unsupported { found, .. }) => {
                return Err(TakeError::Unsupported { what, found, supported });
            }
            read => return read.map(|counts| counts.0),
        }
        let WithErrors { mut counts, errors } = WithErrors::from_payload(payload, offset)?;
        if errors.len() != counts.groups.len() {
            return Err(TakeError::corrupt(what, offset, "it has no errors of some group"));
        }
        for (group, (position_nm, angle_nanodegrees)) in counts.groups.iter_mut().zip(errors) {
            group.errors = MeasuredErrors { position_nm, angle_nanodegrees };
        }
        Ok(counts)
    }
}

/// Version 1.
#[derive(Debug, Encode, Decode)]
struct Counts(SampleLedger);

impl Record for Counts {
    const NAME: &'static str = SampleLedger::NAME;
    const KIND: u8 = types::SAMPLE_LEDGER;
    const VERSION: u16 = 1;
}

/// Version 2: the largest errors of the poses of each group, in nanometres and in billionths of a degree.
#[derive(Debug, Encode, Decode)]
struct WithErrors {
    counts: SampleLedger,
    errors: Vec<(u64, u64)>,
}

impl Record for WithErrors {
    const NAME: &'static str = SampleLedger::NAME;
    const KIND: u8 = types::SAMPLE_LEDGER;
    const VERSION: u16 = 2;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ledger_without_errors_is_of_version_1_and_one_with_errors_of_version_2() {
        let group = |group| GroupLedger { group, taken: 300, stored: 300, ..Default::default() };
        let mut ledger =
            SampleLedger { finished: true, groups: vec![group(0), group(16)], batches_refused: 0 };
        let first = ledger.to_payload().unwrap();
        assert_eq!(first[..2], [1, 0]);
        assert_eq!(SampleLedger::from_payload(&first, 8).unwrap(), ledger);
        let errors = PoseErrors { position_mm: 0.099_999_999_5, angle_degrees: 0.028 };
        ledger.groups[1].errors.add(&errors);
        ledger.groups[1].errors.add(&PoseErrors::default());
        let found = ledger.groups[1].errors;
        assert_eq!((found.position_nm, found.angle_nanodegrees), (100_000, 28_000_000));
        let second = ledger.to_payload().unwrap();
        // 2 groups: nothing, and two numbers.
        let numbers = [2, 0, 0, 0xFC, 0xA0, 0x86, 1, 0, 0xFC, 0, 0x3F, 0xAB, 1];
        assert_eq!(second, [&[2, 0], &first[2..], &numbers].concat());
        assert_eq!(SampleLedger::from_payload(&second, 8).unwrap(), ledger);
        let mut sum = ledger.clone();
        sum.add_counters(&SampleLedger { groups: vec![group(16)], ..Default::default() });
        assert_eq!((sum.groups[1].errors, sum.groups[1].taken), (found, 600));
        // Of a later version, cut off, and without the errors of a group.
        let later = [&[3, 0], &second[2..]].concat();
        let read = SampleLedger::from_payload(&later, 8);
        assert!(matches!(read, Err(TakeError::Unsupported { found: 3, supported: 2, .. })));
        for n in 2..second.len() {
            assert!(SampleLedger::from_payload(&second[..n], 8).is_err(), "{n}");
        }
        let mut short = second[..second.len() - numbers.len()].to_vec();
        short.extend([1, 5, 5]);
        assert!(SampleLedger::from_payload(&short, 8).is_err());
    }
}
