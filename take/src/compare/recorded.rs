//! Compares the sampled channels and poses of two recordings: for `diff` everything, for `verify` the samples, and the
//! poses within their bounds.

use std::{
    collections::BTreeMap,
    io::{Read, Seek},
};

use mocapd_codec::poses::{POSE_CHANNELS, PoseErrors, PoseRow, RESIDUAL_ERROR_MM};
use serde::Serialize;

use super::{content::FieldDifference, distance_mm};
use crate::{
    TakeError, TakeMap,
    poses::{Pose, PoseReader},
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
    let numbers = |map: &TakeMap| map.sample_groups().map(|g| g.group.number).collect::<Vec<_>>();
    let mut all = [numbers(one), numbers(other)].concat();
    all.sort_unstable();
    all.dedup();
    let mut differences = Vec::new();
    for number in all {
        let of = |map: &TakeMap| map.sample_groups().find(|g| g.group.number == number).cloned();
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
    /// Samples that the original has and the take states as lost, has lost to damage, or lacks because it was cut off.
    pub samples_lost: u64,
    /// Samples that only one of the two has, beyond the end of the other.
    pub samples_missing: u64,
    /// Groups that only one of the two has, or that have other channels.
    pub groups_missing: usize,
    /// Groups of residuals that only one of the two has, which are not compared: they are recorded on request.
    pub residual_groups_skipped: usize,
}

impl SampledDifference {
    /// Whether every sample that was not lost is there, bit by bit.
    #[must_use]
    pub fn is_within(&self) -> bool {
        self.samples_differing == 0 && self.samples_missing == 0 && self.groups_missing == 0
    }
}

/// Whether two takes are recordings: the groups of only one of them are missing in the other.
fn are_recordings(one: &TakeMap, other: &TakeMap) -> bool {
    [one, other].iter().all(|map| map.header.source.is_none())
}

/// Compares every sample of a recording with its original, group by group: samples with equal numbers. `None` unless both
/// have sampled channels, or both are recordings and one has some.
///
/// # Errors
/// `Io`.
pub fn compare_samples(
    (take, a): (&TakeMap, &mut (impl Read + Seek)),
    (original, b): (&TakeMap, &mut (impl Read + Seek)),
) -> Result<Option<SampledDifference>, TakeError> {
    let have = [take, original].map(|map| map.recorded_groups().next().is_some());
    if have == [false; 2] || have != [true; 2] && !are_recordings(take, original) {
        return Ok(None);
    }
    let mut found = SampledDifference::default();
    let is_skipped = |group: &GroupSamples, other: &TakeMap| {
        let is_there = || other.recorded_groups().any(|of| of.group.number == group.group.number);
        group.group.has_residuals() && !is_there()
    };
    let mut n_matched = 0;
    for ours in take.recorded_groups() {
        let Some(theirs) = original.recorded_groups().find(|other| is_like(ours, other)) else {
            let is_skipped = is_skipped(ours, original);
            found.residual_groups_skipped += usize::from(is_skipped);
            found.groups_missing += usize::from(!is_skipped);
            continue;
        };
        n_matched += 1;
        let n_channels = ours.group.channels.len();
        let of_all = |n: u64| n.saturating_mul(n_channels as u64);
        let missing = in_step((ours, &mut *a), (theirs, &mut *b), |left, right, n| {
            match (&left.samples, &right.samples) {
                (Some(_), Some(_)) => {
                    found.samples += of_all(n);
                    found.samples_differing += left.differing(right, n_channels, n);
                }
                (None, Some(_)) => found.samples_lost += of_all(n),
                // The original does not say what they were.
                (_, None) => {}
            }
        })?;
        let [lost, missing] = missing.of_take(take.finished);
        found.samples_lost = found.samples_lost.saturating_add(of_all(lost));
        found.samples_missing = found.samples_missing.saturating_add(of_all(missing));
    }
    let n_skipped = original.recorded_groups().filter(|of| is_skipped(of, take)).count();
    found.residual_groups_skipped += n_skipped;
    let n_others = original.recorded_groups().count().saturating_sub(n_matched + n_skipped);
    found.groups_missing += n_others;
    Ok(Some(found))
}

/// How the poses of a recording differ from those of its original.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PoseDifference {
    /// Poses that both have.
    pub poses: u64,
    /// Those of them that are not bit-identical.
    pub poses_differing: u64,
    /// Those of them whose error exceeds what the takes state; in exact takes, those that differ.
    pub beyond_stated: u64,
    /// Poses that only one of the two has, and those that are missing for different reasons.
    pub states_differing: u64,
    /// Poses in frames that the original has and the take states as lost, has lost to damage, or lacks because it was cut
    /// off.
    pub poses_lost: u64,
    /// Poses in frames that only one of the two has, beyond the end of the other.
    pub poses_missing: u64,
    /// Rigid bodies that only one of the two has.
    pub bodies_missing: usize,
    /// The bodies that both have.
    pub bodies: Vec<BodyDifference>,
}

/// The errors of the poses of a rigid body.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BodyDifference {
    /// Its name, which may be empty or that of another one, too.
    pub name: String,
    /// The driver's number of the body.
    pub number: u32,
    /// Poses that both have.
    pub poses: u64,
    /// The largest error of positions that the takes state, in millimetres; 0 for exact poses.
    pub stated_max_error_mm: f64,
    /// The largest distance found between positions, in millimetres.
    pub max_error_mm: f64,
    /// The largest error of rotations that the takes state, in degrees; 0 for exact poses.
    pub stated_max_error_degrees: f64,
    /// The largest angle found between rotations, in degrees.
    pub max_error_degrees: f64,
}

impl PoseDifference {
    /// Whether every pose that was not lost is there, within what the takes state.
    #[must_use]
    pub fn is_within(&self) -> bool {
        self.beyond_stated == 0
            && self.states_differing == 0
            && self.poses_missing == 0
            && self.bodies_missing == 0
    }
}

/// Compares every pose of a recording with its original, body by body: frames with equal numbers. `None` unless both have
/// rigid bodies, or both are recordings and one has some.
///
/// The takes state the largest error of their poses: the one that was measured, or where it is not known the bound. Of two
/// takes within bounds each may have its own.
///
/// # Errors
/// `Io`.
pub fn compare_poses(
    (take, a): (&TakeMap, &mut (impl Read + Seek)),
    (original, b): (&TakeMap, &mut (impl Read + Seek)),
) -> Result<Option<PoseDifference>, TakeError> {
    let n_bodies =
        |map: &TakeMap| map.pose_groups().map(|of| of.group.bodies().count()).sum::<usize>();
    let (of_take, of_original) = (n_bodies(take), n_bodies(original));
    let is_one_without = of_take == 0 || of_original == 0;
    if of_take + of_original == 0 || is_one_without && !are_recordings(take, original) {
        return Ok(None);
    }
    let mut found = PoseDifference::default();
    for ours in take.pose_groups() {
        let Some(theirs) = original.pose_groups().find(|other| is_like(ours, other)) else {
            continue;
        };
        let mut bodies = BodiesInStep::new((ours, take), (theirs, original));
        let n_of_group = bodies.bodies.len() as u64;
        let of_all = |n: u64| n.saturating_mul(n_of_group);
        let missing = in_step((ours, &mut *a), (theirs, &mut *b), |left, right, n| {
            match (&left.samples, &right.samples) {
                (Some(_), Some(_)) => bodies.compare(left, right, n, &mut found),
                (None, Some(_)) => found.poses_lost += of_all(n),
                (_, None) => {}
            }
        })?;
        let [lost, missing] = missing.of_take(take.finished);
        found.poses_lost = found.poses_lost.saturating_add(of_all(lost));
        found.poses_missing = found.poses_missing.saturating_add(of_all(missing));
        found.bodies.append(&mut bodies.bodies);
    }
    let n_matched = found.bodies.len();
    found.bodies_missing = (of_take + of_original).saturating_sub(2 * n_matched);
    found.poses = found.bodies.iter().map(|body| body.poses).sum();
    Ok(Some(found))
}

/// Two groups with the same bodies, and what was found of these.
struct BodiesInStep {
    readers: [PoseReader; 2],
    /// Largest difference of residuals, in millimetres.
    residual_mm: f64,
    bodies: Vec<BodyDifference>,
}

impl BodiesInStep {
    fn new(ours: (&GroupSamples, &TakeMap), theirs: (&GroupSamples, &TakeMap)) -> Self {
        let errors = [ours, theirs].map(|(group, map)| {
            let stated = group.pose_errors(map.sample_ledger.as_ref());
            stated.map(|stated| stated.errors())
        });
        let sum = |of: fn(&PoseErrors) -> f64| errors.iter().flatten().map(of).sum::<f64>();
        let stated_max_error_mm = sum(|stated| stated.position_mm);
        let stated_max_error_degrees = sum(|stated| stated.angle_degrees);
        let bodies = ours.0.group.numbered_bodies().map(|(number, name)| BodyDifference {
            name: name.to_owned(),
            number,
            stated_max_error_mm,
            stated_max_error_degrees,
            ..BodyDifference::default()
        });
        Self {
            readers: [ours.0, theirs.0].map(|of| PoseReader::new(&of.group)),
            residual_mm: errors.iter().flatten().count() as f64 * RESIDUAL_ERROR_MM,
            bodies: bodies.collect(),
        }
    }

    /// Compares the poses of the next `n` frames.
    fn compare(&mut self, left: &Side<'_>, right: &Side<'_>, n: u64, found: &mut PoseDifference) {
        let [of_left, of_right] = self.readers;
        for (index, body) in self.bodies.iter_mut().enumerate() {
            for frame in 0..n {
                let ours = of_left.pose(&left.row(index, frame));
                let theirs = of_right.pose(&right.row(index, frame));
                if ours.state != theirs.state {
                    found.states_differing += 1;
                    continue;
                }
                if !ours.is_tracked() {
                    continue;
                }
                body.poses += 1;
                let is_same = bits(&ours) == bits(&theirs);
                found.poses_differing += u64::from(!is_same);
                if !is_same {
                    let is_within = body.add(&ours, &theirs, self.residual_mm);
                    found.beyond_stated += u64::from(!is_within);
                }
            }
        }
    }
}

/// All numbers of a pose as bits.
fn bits(pose: &Pose) -> [u32; POSE_CHANNELS] {
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.position_mm, pose.quaternion);
    [x, y, z, qw, qx, qy, qz, pose.residual_mm].map(f32::to_bits)
}

impl BodyDifference {
    /// Adds the errors of a pose that differs. Returns whether they are within what the takes state.
    fn add(&mut self, ours: &Pose, theirs: &Pose, residual_mm: f64) -> bool {
        let error_mm = distance_mm(ours.position_mm, theirs.position_mm);
        let degrees = angle_degrees(ours.quaternion, theirs.quaternion);
        self.max_error_mm = self.max_error_mm.max(error_mm);
        self.max_error_degrees = self.max_error_degrees.max(degrees);
        let residuals = [ours, theirs].map(|pose| f64::from(pose.residual_mm));
        let is_residual_within = residuals.iter().all(|of| of.is_nan())
            || (residuals[0] - residuals[1]).abs() <= residual_mm;
        let is_exact = self.stated_max_error_mm == 0.0 && self.stated_max_error_degrees == 0.0;
        // The stated errors were rounded up, and are measured again here.
        !is_exact
            && is_residual_within
            && error_mm <= self.stated_max_error_mm + ROUNDING
            && degrees <= self.stated_max_error_degrees + ROUNDING
    }
}

/// What measuring an error twice may differ by, in millimetres and degrees: more than 2^-52 of any position in a
/// laboratory, and less than the billionths in which errors are stated of degrees.
const ROUNDING: f64 = 1e-9;

/// The angle between two rotations, in degrees, whatever the signs and the lengths of their quaternions.
fn angle_degrees(a: [f32; 4], b: [f32; 4]) -> f64 {
    let unit = |quaternion: [f32; 4]| {
        let numbers = quaternion.map(f64::from);
        let length = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
        numbers.map(|number| number / length)
    };
    let (a, b) = (unit(a), unit(b));
    let chord = |sign: f64| {
        let squares = a.iter().zip(&b).map(|(a, b)| (a - sign * b).powi(2));
        squares.sum::<f64>().sqrt()
    };
    // The angle of quaternions is half that of rotations.
    (4.0 * (0.5 * chord(1.0).min(chord(-1.0))).min(1.0).asin()).to_degrees()
}

/// Whether two groups have the same number and the same channels.
fn is_like(ours: &GroupSamples, other: &GroupSamples) -> bool {
    let (ours, other) = (&ours.group, &other.group);
    (ours.number, &ours.channels) == (other.number, &other.channels)
}

/// Samples of each channel that only one of two groups has.
struct MissingSamples {
    /// Those that the original has behind the take's last one.
    after_take: u64,
    others: u64,
}

impl MissingSamples {
    /// Those that the take lost, because it was cut off, and those that are missing.
    fn of_take(&self, is_finished: bool) -> [u64; 2] {
        let Self { after_take, others } = *self;
        if is_finished { [0, after_take.saturating_add(others)] } else { [after_take, others] }
    }
}

/// Reads two groups in step. `each` receives both, and of how many samples of each channel they have the same numbers from
/// their places on.
fn in_step<A: Read + Seek, B: Read + Seek>(
    (ours, a): (&GroupSamples, &mut A),
    (theirs, b): (&GroupSamples, &mut B),
    mut each: impl FnMut(&Side<'_>, &Side<'_>, u64),
) -> Result<MissingSamples, TakeError> {
    let (mut left, mut right) = (Side::new(ours.reader()), Side::new(theirs.reader()));
    // The samples of a part have numbers of their own.
    let (skipped, ahead) = (offset(ours, theirs), offset(theirs, ours));
    let before = right.skip(b, skipped)?.saturating_add(left.skip(a, ahead)?);
    let mut end = 0;
    while left.advance(a)? && right.advance(b)? {
        let n = left.left().min(right.left());
        each(&left, &right, n);
        (left.at, right.at, end) = (left.at + n, right.at + n, end + n);
    }
    let left_over = |group: &GroupSamples, skipped: u64| {
        group.n_samples().saturating_sub(skipped).saturating_sub(end)
    };
    let after_take = left_over(theirs, skipped);
    Ok(MissingSamples { after_take, others: before.saturating_add(left_over(ours, ahead)) })
}

/// By how much the samples of a group have higher numbers in `other`, by a time that both state; 0 if there is none.
fn offset(group: &GroupSamples, other: &GroupSamples) -> u64 {
    // Devices whose clock goes on between two runs share no time: not every pair is compared.
    let mut of_other = BTreeMap::new();
    for anchor in other.anchors() {
        of_other.entry(anchor.device_ticks).or_insert(anchor.number);
    }
    let shared = group.anchors().iter().find_map(|anchor| {
        let number = of_other.get(&anchor.device_ticks)?;
        Some(number.saturating_sub(anchor.number))
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

    /// The numbers of a body in one of the next samples; NaN where there are none.
    fn row(&self, body: usize, after: u64) -> PoseRow {
        let samples = self.samples.as_deref().unwrap_or_default();
        std::array::from_fn(|channel| {
            let column = (body * POSE_CHANNELS + channel) as u64 * self.n;
            let at = usize::try_from(column + self.at + after).unwrap_or(usize::MAX);
            samples.get(at).copied().unwrap_or(f32::NAN)
        })
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
