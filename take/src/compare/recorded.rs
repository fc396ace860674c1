//! Compares the sampled channels of two recordings: for `diff` everything, for `verify` the samples.

use std::io::{Read, Seek};

use serde::Serialize;

use super::content::FieldDifference;
use crate::{
    TakeError, TakeMap,
    sampled::{GroupReader, GroupSamples},
};

/// Compares the groups of sampled channels of two recordings: descriptions, samples bit for bit, lost samples, and times
/// to within a tick. Each difference has the number of a group.
///
/// # Errors
/// `Io`.
pub fn compare_recorded(
    (one, a): (&TakeMap, &mut (impl Read + Seek)),
    (other, b): (&TakeMap, &mut (impl Read + Seek)),
) -> Result<Vec<FieldDifference>, TakeError> {
    let numbers = |map: &TakeMap| map.recorded_groups().map(|g| g.group.number).collect::<Vec<_>>();
    let mut all = [numbers(one), numbers(other)].concat();
    all.sort_unstable();
    all.dedup();
    let mut differences = Vec::new();
    for number in all {
        let of = |map: &TakeMap| map.recorded_groups().find(|g| g.group.number == number).cloned();
        let (left, right) = (of(one), of(other));
        let text = |group: &Option<GroupSamples>| group.as_ref().map(describe);
        let mut found = (text(&left), text(&right));
        if let (Some(left), Some(right)) = (&left, &right)
            && let Some(what) = difference((left, one, &mut *a), (right, other, &mut *b))?
        {
            found.1 = found.1.map(|text| format!("{text}, {what}"));
        }
        if found.0 != found.1 {
            let field = format!("sampled channels of group {number}");
            differences.push(FieldDifference { field, a: found.0, b: found.1 });
        }
    }
    let ledger = |map: &TakeMap| map.sample_ledger.as_ref().map(|ledger| format!("{ledger:?}"));
    if ledger(one) != ledger(other) {
        let field = "ledger of sampled channels".to_owned();
        differences.push(FieldDifference { field, a: ledger(one), b: ledger(other) });
    }
    Ok(differences)
}

/// How the samples of a recording differ from those of its original.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct SampledDifference {
    /// Samples of all channels that both have.
    pub samples: u64,
    /// Those of them that are not bit-identical.
    pub samples_differing: u64,
    /// Samples that the original has and the take states as lost, or has lost to damage.
    pub samples_lost: u64,
    /// Samples that only one of the two has, beyond the end of the other.
    pub samples_missing: u64,
    /// Groups that only one of the two has, or that have other channels.
    pub groups_missing: usize,
}

impl SampledDifference {
    /// Whether every sample that was not lost is there, bit by bit.
    #[must_use]
    pub fn is_within(&self) -> bool {
        self.samples_differing == 0 && self.samples_missing == 0 && self.groups_missing == 0
    }
}

/// Compares every sample of a recording with its original, group by group: samples with equal numbers. `None` unless both
/// have sampled channels.
///
/// # Errors
/// `Io`.
pub fn compare_samples(
    (take, a): (&TakeMap, &mut (impl Read + Seek)),
    (original, b): (&TakeMap, &mut (impl Read + Seek)),
) -> Result<Option<SampledDifference>, TakeError> {
    if take.recorded_groups().next().is_none() || original.recorded_groups().next().is_none() {
        return Ok(None);
    }
    let mut found = SampledDifference::default();
    let mut n_matched = 0;
    for ours in take.recorded_groups() {
        let is_like = |other: &&GroupSamples| {
            let (ours, other) = (&ours.group, &other.group);
            (ours.number, &ours.channels) == (other.number, &other.channels)
        };
        let Some(theirs) = original.recorded_groups().find(is_like) else {
            found.groups_missing += 1;
            continue;
        };
        n_matched += 1;
        let n_channels = ours.group.channels.len();
        let (mut left, mut right) = (Side::new(ours.reader()), Side::new(theirs.reader()));
        // The samples of a part have numbers of their own.
        let (skipped, ahead) = (offset(ours, theirs), offset(theirs, ours));
        found.samples_missing += right.skip(b, skipped)?.saturating_mul(n_channels as u64);
        found.samples_missing += left.skip(a, ahead)?.saturating_mul(n_channels as u64);
        let mut end = 0;
        while left.advance(a)? && right.advance(b)? {
            let n = left.left().min(right.left());
            let in_all = n.saturating_mul(n_channels as u64);
            match (&left.samples, &right.samples) {
                (Some(_), Some(_)) => {
                    found.samples += in_all;
                    found.samples_differing += left.differing(&right, n_channels, n);
                }
                (None, Some(_)) => found.samples_lost += in_all,
                // The original does not say what they were.
                (_, None) => {}
            }
            (left.at, right.at, end) = (left.at + n, right.at + n, end + n);
        }
        let left_over =
            [ours.n_samples().saturating_sub(ahead), theirs.n_samples().saturating_sub(skipped)];
        let longer = left_over[0].max(left_over[1]);
        found.samples_missing += longer.saturating_sub(end).saturating_mul(n_channels as u64);
    }
    found.groups_missing += original.recorded_groups().count().saturating_sub(n_matched);
    Ok(Some(found))
}

/// By how much the samples of a group have higher numbers in `other`, by a time that both state; 0 if there is none.
fn offset(group: &GroupSamples, other: &GroupSamples) -> u64 {
    let shared = group.anchors().iter().find_map(|anchor| {
        let same =
            other.anchors().iter().find(|found| found.device_ticks == anchor.device_ticks)?;
        Some(same.number.saturating_sub(anchor.number))
    });
    shared.unwrap_or(0)
}

/// A group in a few words, which are equal for equal descriptions.
fn describe(group: &GroupSamples) -> String {
    let info = &group.group;
    let channels = info.channels.iter().map(|channel| {
        format!("{} ({}, {}, {})", channel.name, channel.unit, channel.scale, channel.offset)
    });
    let channels: Vec<String> = channels.collect();
    format!(
        "{} samples at {} Hz, {}: {}",
        group.n_samples(),
        info.rate_hz,
        info.form.name(),
        channels.join(", ")
    )
}

type Input<'a, R> = (&'a GroupSamples, &'a TakeMap, &'a mut R);

/// How the samples or times of two groups differ.
fn difference<A: Read + Seek, B: Read + Seek>(
    (left, one, a): Input<'_, A>,
    (right, other, b): Input<'_, B>,
) -> Result<Option<String>, TakeError> {
    if left.lost() != right.lost() {
        return Ok(Some("others of them lost".to_owned()));
    }
    if left.n_samples() != right.n_samples()
        || left.group.channels.len() != right.group.channels.len()
    {
        return Ok(None);
    }
    let n_channels = left.group.channels.len();
    let (mut ours, mut theirs) = (Side::new(left.reader()), Side::new(right.reader()));
    let mut n_differing = 0_u64;
    while ours.advance(a)? && theirs.advance(b)? {
        // Blocks may be divided otherwise: what both have now is compared.
        let n = ours.left().min(theirs.left());
        match (&ours.samples, &theirs.samples) {
            (Some(_), Some(_)) => n_differing += ours.differing(&theirs, n_channels, n),
            (None, None) => {}
            _ => return Ok(Some("others of them damaged".to_owned())),
        }
        (ours.at, theirs.at) = (ours.at + n, theirs.at + n);
    }
    if n_differing > 0 {
        return Ok(Some(format!("{n_differing} of them different")));
    }
    Ok(times_differ((left, one), (right, other)).then(|| "at other times".to_owned()))
}

/// One of two groups that are read in step: the run that is compared.
struct Side<'a> {
    reader: GroupReader<'a>,
    /// Samples of each channel in the run, and how many were compared.
    n: u64,
    at: u64,
    /// Channel after channel; `None` if they are lost.
    samples: Option<Vec<f32>>,
}

impl<'a> Side<'a> {
    fn new(reader: GroupReader<'a>) -> Self {
        Self { reader, n: 0, at: 0, samples: None }
    }

    fn left(&self) -> u64 {
        self.n - self.at
    }

    /// Passes the next `n` samples of each channel. Returns how many there were.
    fn skip(&mut self, input: &mut (impl Read + Seek), n: u64) -> Result<u64, TakeError> {
        let mut skipped = 0;
        while skipped < n && self.advance(input)? {
            let step = self.left().min(n - skipped);
            self.at += step;
            skipped += step;
        }
        Ok(skipped)
    }

    /// Reads the next run if all of this one was compared. Returns `false` at the end.
    fn advance(&mut self, input: &mut (impl Read + Seek)) -> Result<bool, TakeError> {
        while self.left() == 0 {
            let Some((span, samples)) = self.reader.next(input)? else { return Ok(false) };
            (self.n, self.at, self.samples) = (span.n, 0, samples.map(<[f32]>::to_vec));
        }
        Ok(true)
    }

    /// How many of the next `n` samples of each channel are not bit-identical.
    fn differing(&self, other: &Self, n_channels: usize, n: u64) -> u64 {
        let of = |side: &Self, channel: usize| {
            let first = channel as u64 * side.n + side.at;
            let all = side.samples.as_deref().unwrap_or_default();
            all.get(first as usize..(first + n) as usize).unwrap_or_default().to_vec()
        };
        let in_channel = |channel| {
            let pairs = of(self, channel).into_iter().zip(of(other, channel));
            pairs.filter(|(a, b)| a.to_bits() != b.to_bits()).count() as u64
        };
        (0..n_channels).map(in_channel).sum()
    }
}

/// Whether the times of any sample differ by more than a tick: those of all stated ones are compared, and of the ends.
fn times_differ(
    (left, one): (&GroupSamples, &TakeMap),
    (right, other): (&GroupSamples, &TakeMap),
) -> bool {
    let tick_hz = |map: &TakeMap| map.header.device.as_ref().map_or(1, |device| device.tick_hz);
    let (a, b) = (left.clock(tick_hz(one)), right.clock(tick_hz(other)));
    let stated = left.anchors().iter().chain(right.anchors()).map(|anchor| anchor.number);
    let ends = [0, left.n_samples().saturating_sub(1)];
    let mut numbers = stated.chain(ends).filter(|number| *number < left.n_samples());
    numbers.any(|number| match (a.at(number), b.at(number)) {
        (Some(a), Some(b)) => {
            let ticks = a.device_ticks.wrapping_sub(b.device_ticks).cast_signed() as f64;
            (ticks + a.fraction - b.fraction).abs() > 1.0
        }
        (a, b) => a.is_some() != b.is_some(),
    })
}
