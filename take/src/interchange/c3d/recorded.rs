//! The sampled channels and force plates of a recording, as the ANALOG and `FORCE_PLATFORM` groups of a C3D file.
//!
//! C3D has one number of analog samples in a frame, evenly spaced from the frame on. Samples of a recording are written
//! unchanged where they were taken like that: their rate is a whole multiple of the frames', and keeps in step with it.
//! Others are left out, unless the user allows resampling.

use std::io;

use super::{
    analog::{ANALOG, FORCE_PLATFORM, factor_of_unit},
    groups::Rotations,
    parameters::Parameters,
    stride::ANALOG_MAX,
};
use crate::{
    TakeError,
    foreign::force_plate::PlateType,
    interchange::{InterchangeError, Result, counted, recorded_rows::unknown_units},
    motion::MotionInfo,
    record::{RecordedPlate, SampledChannel, SampledGroup},
    sampled::{FILTER, GroupSamples, RecordedSamples, Recording, Resampler, SampleBlock, reach},
};

/// Largest distance between the earliest and the latest place of a run's samples against the frames, in samples, at which
/// they are written unchanged.
const APART_MAX: f64 = 1.0;

/// Stated times of which the earliest counts: a device stamps batches late, never early. Those of two seconds.
const TIMES_TOGETHER: usize = 8;

/// Distance of samples from the instants that C3D gives them, in samples, from which on the user is told.
const DISTANCE_TOLD: f64 = 0.01;

/// Difference of a ratio of two rates from a whole number that is rounding: rates are stated in thousandths of a hertz.
const WHOLE: f64 = 1e-6;

/// The number of the group of a plate, and its channels in it.
type PlateChannel = (u32, usize);

/// Consecutive samples that are written one after another: sample n is number n + `shift` among the samples of the file
/// from row 0 of the take on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct RunOfSlots {
    first: u64,
    shift: i64,
}

/// How the samples of a group come into the file.
#[derive(Debug, Clone, PartialEq)]
enum GroupPlacement {
    /// Unchanged.
    Unchanged { runs: Vec<RunOfSlots>, farthest: f64 },
    /// By the filter.
    Resampled,
}

/// The index of a group, and its samples in a frame if they fit, or why they do not.
type GroupFit = (usize, std::result::Result<(usize, GroupPlacement), String>);

/// What a C3D file has of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RecordedPlan {
    /// Samples in a frame.
    ratio: usize,
    /// Indices of the groups.
    groups: Vec<(usize, GroupPlacement)>,
    /// Groups that are left out, as text for the user.
    pub(crate) left_out: Vec<String>,
}

/// The samples of a group in a frame if they fit, or why they do not.
fn fit(
    recording: &Recording,
    index: usize,
    rate_hz: f64,
) -> std::result::Result<(usize, GroupPlacement), String> {
    let Some(group) = recording.groups().get(index) else { return Err(String::new()) };
    let multiple = group.group.rate_hz / rate_hz;
    let ratio = multiple.round();
    if ratio < 1.0 || (multiple - ratio).abs() > WHOLE * multiple {
        return Err(format!("its rate is no whole multiple of the frames' {rate_hz} Hz"));
    }
    let Some(clock) = recording.clock(index) else { return Err(String::new()) };
    let distance = |number: u64| Some(clock.position(number)? * ratio - number as f64);
    let (mut runs, mut farthest) = (Vec::new(), 0.0_f64);
    for anchors in group.anchors().chunk_by(|a, b| a.run_start == b.run_start) {
        let Some(first) = anchors.first() else { continue };
        let numbers = anchors.iter().map(|anchor| anchor.number);
        let at: Vec<f64> = numbers.filter_map(distance).collect();
        let earliest = |some: &[f64]| some.iter().copied().reduce(f64::min);
        let places: Vec<f64> = at.chunks(TIMES_TOGETHER).filter_map(earliest).collect();
        let high = places.iter().copied().reduce(f64::max);
        let (Some(low), Some(high)) = (earliest(&places), high) else { continue };
        if high - low > APART_MAX {
            let apart = high - low;
            return Err(format!("its clock and the frames' drift apart by {apart:.1} samples"));
        }
        let shift = (0.5 * (low + high)).round();
        farthest = farthest.max((high - shift).abs()).max((low - shift).abs());
        runs.push(RunOfSlots { first: first.run_start, shift: shift as i64 });
    }

    if runs.is_empty() {
        return Err("the take does not say when its samples were taken".to_owned());
    }
    Ok((ratio as usize, GroupPlacement::Unchanged { runs, farthest }))
}

/// `group 1 (16 channels at 2000 Hz)`.
pub(in crate::interchange) fn name_of(group: &SampledGroup) -> String {
    let channels = counted(group.channels.len() as u64, "channel");
    format!("group {} of sampled channels ({channels} at {} Hz)", group.number, group.rate_hz)
}

impl RecordedPlan {
    /// What a file of `info` has.
    pub(crate) fn of(info: &MotionInfo) -> Self {
        let Some(recording) = &info.recording else { return Self::default() };
        // Residuals are in the points.
        let is_analog = |(_, found): &(usize, &GroupSamples)| !found.group.has_residuals();
        let fits: Vec<GroupFit> = (recording.groups().iter().enumerate().filter(is_analog))
            .map(|(index, _)| (index, fit(recording, index, info.rate_hz)))
            .collect();
        let ratio = Self::choose_ratio(recording, &fits, info.rate_hz);
        let mut plan = Self { ratio, ..Self::default() };
        let mut n_channels = 0;
        for (index, fit) in fits {
            let Some(found) = recording.groups().get(index) else { continue };
            let more = found.group.channels.len();
            let name = name_of(&found.group);
            if (ratio * (n_channels + more)) as u64 > ANALOG_MAX {
                plan.left_out
                    .push(format!("{name}: a C3D frame holds at most {ANALOG_MAX} analog samples"));
                continue;
            }
            let placement = match fit {
                Ok((own, placement)) if own == ratio => placement,
                _ if recording.resamples() => GroupPlacement::Resampled,
                Ok((own, _)) => {
                    plan.left_out.push(format!(
                        "{name}: it has {own} samples in a frame, but others have {ratio}, and C3D has one number for all; \
                         --resample writes it"
                    ));
                    continue;
                }
                Err(why) => {
                    plan.left_out.push(format!("{name}: {why}; --resample writes it"));
                    continue;
                }
            };
            n_channels += more;
            plan.groups.push((index, placement));
        }
        let frame_bytes = 16 * info.markers.len() as u64 + 4 * (ratio * n_channels) as u64;
        if !recording.bodies().is_empty() && Rotations::of(info, frame_bytes).is_none() {
            let part_s = (Rotations::frames_max(frame_bytes) as f64 / info.rate_hz).floor();
            plan.left_out.push(format!(
                "the poses of rigid bodies: in C3D they begin within the first 16 MiB; --from and --to export them in \
                 parts of up to {part_s} s"
            ));
        }
        plan
    }

    /// The samples in a frame: those of the groups if they agree; else the most that any group has, if channels may be
    /// resampled, or those of the first group of force plates that fits, or of the first group that does.
    fn choose_ratio(recording: &Recording, fits: &[GroupFit], rate_hz: f64) -> usize {
        let ratio_of = |(_, fit): &GroupFit| fit.as_ref().ok().map(|(ratio, _)| *ratio);
        let own = |index: usize| fits.iter().find(|(of, _)| *of == index).and_then(ratio_of);
        let first = fits.iter().find_map(ratio_of);
        let all_agree = fits.iter().all(|fit| ratio_of(fit).is_some() && ratio_of(fit) == first);
        if let (true, Some(ratio)) = (all_agree, first) {
            return ratio;
        }
        if recording.resamples() {
            let rates = fits.iter().filter_map(|(index, _)| recording.groups().get(*index));
            let highest = rates.map(|found| found.group.rate_hz).fold(0.0, f64::max);
            return (highest / rate_hz - WHOLE).ceil().clamp(1.0, ANALOG_MAX as f64) as usize;
        }
        let of_plate = |group: u32| {
            let index = recording.groups().iter().position(|found| found.group.number == group);
            index.and_then(own)
        };
        let of_plates = recording.plates().iter().find_map(|plate| of_plate(plate.group));
        of_plates.or(first).unwrap_or(1)
    }

    /// What happened to the samples, one sentence each.
    fn remarks(&self, info: &MotionInfo) -> Vec<String> {
        let Some(recording) = &info.recording else { return Vec::new() };
        let mut remarks = warnings_of(recording);
        for (index, placement) in &self.groups {
            let Some(found) = recording.groups().get(*index) else { continue };
            let name = name_of(&found.group);
            match placement {
                GroupPlacement::Unchanged { farthest, .. } if *farthest > DISTANCE_TOLD => {
                    remarks.push(format!(
                        "The samples of {name} are unchanged; they were taken up to {:.3} ms from the instants that C3D \
                         gives them.",
                        farthest / (self.ratio as f64 * info.rate_hz) * 1e3
                    ));
                }
                GroupPlacement::Unchanged { .. } => {}
                GroupPlacement::Resampled => remarks.push(format!(
                    "{name} was resampled to {} Hz, {} samples in a frame: {FILTER}.",
                    self.ratio as f64 * info.rate_hz,
                    self.ratio
                )),
            }
        }
        remarks
    }
}

/// What is wrong with the force plates of a recording, and the times of its samples, one sentence each.
pub(in crate::interchange) fn warnings_of(recording: &Recording) -> Vec<String> {
    let mut warnings = recording.warnings().to_vec();
    let of_units = |plate| unknown_units(plate, recording.groups());
    warnings.extend(recording.plates().iter().filter_map(of_units));
    for (index, found) in recording.groups().iter().enumerate() {
        let n = recording.n_without_time(index).unwrap_or_default();
        warnings.extend((n > 0).then(|| {
            format!(
                "{} of group {} left out: the take does not say when they were taken, has no frame around them, or lost too \
                 many in one place.",
                counted(n, "sample"),
                found.group.number
            )
        }));
    }
    warnings
}

/// The samples of a group that are written as they are.
#[derive(Debug)]
struct UnchangedSamples<'a> {
    samples: RecordedSamples<'a>,
    runs: Vec<RunOfSlots>,
    block: SampleBlock,
    /// The next sample of the block.
    next: usize,
}

/// Where the samples of a group come from.
#[derive(Debug)]
enum GroupSource<'a> {
    Unchanged(Box<UnchangedSamples<'a>>),
    Resampled(Box<Resampler<'a>>),
}

/// The samples of a group, frame by frame.
#[derive(Debug)]
struct GroupWriter<'a> {
    name: String,
    channels: &'a [SampledChannel],
    source: GroupSource<'a>,
    /// Samples of each channel that the take does not have: before its first one in these frames, after others.
    n_before: u64,
    n_written: u64,
    /// By channel, its samples that are no numbers.
    not_numbers: Vec<u64>,
    n_missing: u64,
    /// Of these, the last ones.
    n_trailing: u64,
    /// Samples whose instant another one has.
    n_passed: u64,
}

/// The analog samples of a C3D file that come from a recording.
#[derive(Debug)]
pub(super) struct RecordedAnalog<'a> {
    pub(super) ratio: usize,
    groups: Vec<GroupWriter<'a>>,
    remarks: Vec<String>,
    /// The next frame.
    row: u64,
    values: Vec<f32>,
}

impl<'a> RecordedAnalog<'a> {
    /// The samples of the frames of `info`; `None` if it has none that can be written.
    ///
    /// # Errors
    /// Those of [`Recording::samples`].
    pub(super) fn open(info: &'a MotionInfo) -> Result<Option<Self>> {
        let Some(recording) = &info.recording else { return Ok(None) };
        let plan = RecordedPlan::of(info);
        let (rows, remarks) = (info.rows(), plan.remarks(info));
        // Samples at the ends may belong to the frames beside the row that they are rounded to.
        let wider = rows.start.saturating_sub(1)..rows.end.saturating_add(1);
        let mut groups = Vec::new();
        for (index, placement) in plan.groups {
            let Some(found) = recording.groups().get(index) else { continue };
            let to_hz = plan.ratio as f64 * info.rate_hz;
            let samples = recording.samples(index, &wider).map_err(of_take)?;
            let channels = samples.channels();
            let source = match placement {
                GroupPlacement::Unchanged { runs, .. } => {
                    GroupSource::Unchanged(Box::new(UnchangedSamples {
                        samples,
                        runs,
                        block: SampleBlock::default(),
                        next: 0,
                    }))
                }
                GroupPlacement::Resampled => {
                    let from_hz = found.group.rate_hz;
                    let reach_s = (reach(from_hz, to_hz) + 1) as f64 / from_hz;
                    let rows = (reach_s * info.rate_hz).ceil() as u64 + 1;
                    let rows = wider.start.saturating_sub(rows)..wider.end.saturating_add(rows);
                    let samples = recording.samples(index, &rows).map_err(of_take)?;
                    GroupSource::Resampled(Box::new(Resampler::new(samples, from_hz, to_hz)))
                }
            };
            let name = name_of(&found.group);
            let [n_before, n_written, n_missing, n_trailing, n_passed] = [0; 5];
            groups.push(GroupWriter {
                name,
                channels,
                source,
                n_before,
                n_written,
                not_numbers: vec![0; channels.len()],
                n_missing,
                n_trailing,
                n_passed,
            });
        }
        let (row, values) = (rows.start, Vec::new());
        let all = Self { ratio: plan.ratio, groups, remarks, row, values };
        Ok(Some(all))
    }

    pub(super) fn n_channels(&self) -> usize {
        self.groups.iter().map(|group| group.channels.len()).sum()
    }

    /// Appends the samples of the next frame.
    ///
    /// # Errors
    /// Those of reading the take.
    pub(super) fn push_frame(&mut self, offsets: &[f64], buffer: &mut Vec<u8>) -> io::Result<()> {
        for sample in 0..self.ratio {
            self.values.clear();
            for group in &mut self.groups {
                group.push((self.row, sample, self.ratio), &mut self.values)?;
            }
            for (channel, &value) in self.values.iter().enumerate() {
                let value = match offsets.get(channel) {
                    Some(offset) => (f64::from(value) - offset) as f32,
                    None => value,
                };
                buffer.extend(value.to_le_bytes());
            }
        }
        self.row += 1;
        Ok(())
    }

    /// What happened to the samples, one sentence each. Complete after the last frame.
    pub(super) fn remarks(&self) -> Vec<String> {
        self.remarks
            .iter()
            .cloned()
            .chain(self.groups.iter().flat_map(GroupWriter::remarks))
            .collect()
    }

    /// Sets the ANALOG and `FORCE_PLATFORM` groups.
    pub(super) fn fill_parameters(
        &self,
        parameters: &mut Parameters,
        recording: &Recording,
    ) -> Result<()> {
        let numbers: Vec<PlateChannel> = self.numbers(recording);
        let place =
            |plate_channel: PlateChannel| numbers.iter().position(|found| *found == plate_channel);
        let plates: Vec<_> = recording
            .plates()
            .iter()
            .filter_map(|plate| {
                let channels = plate.channels.iter().map(|&channel| place((plate.group, channel)));
                Some((plate, channels.collect::<Option<Vec<usize>>>()?))
            })
            .collect();
        let mut of_plates: Vec<Option<(PlateType, usize, bool)>> = vec![None; numbers.len()];
        for (plate, channels) in &plates {
            let is_turned = turned(plate).is_some();
            for (place, &channel) in channels.iter().enumerate() {
                if let Some(found) = of_plates.get_mut(channel) {
                    *found = Some((plate.kind, place, is_turned));
                }
            }
        }
        let all = self.groups.iter().flat_map(|group| group.channels);
        let (mut labels, mut units, mut scales, mut offsets) = (vec![], vec![], vec![], vec![]);
        for (channel, of_plate) in all.zip(of_plates) {
            labels.push(channel.name.clone());
            offsets.push(channel.offset as f32);
            let in_file = of_plate.map(|of| in_file_units(of, &channel.unit));
            let (unit, factor) = in_file.unwrap_or((&channel.unit, 1.0));
            units.push(unit.to_owned());
            scales.push((channel.scale * factor) as f32);
        }

        for (name, texts) in [("LABELS", &labels), ("UNITS", &units)] {
            parameters.set_texts(ANALOG, name, texts).map_err(|text| {
                InterchangeError::Unsupported(format!(
                    "C3D texts have at most 255 bytes: `{text}` has {}",
                    text.len()
                ))
            })?;
        }
        parameters.set_float_list(ANALOG, "SCALE", &scales);
        parameters.set_float(ANALOG, "GEN_SCALE", 1.0);
        parameters.set_float_list(ANALOG, "OFFSET", &offsets);
        if !plates.is_empty() {
            set_plates(parameters, &plates);
        }
        Ok(())
    }

    /// For each channel the number of its group and its index there.
    fn numbers(&self, recording: &Recording) -> Vec<PlateChannel> {
        let number = |group: &GroupWriter<'_>| {
            let mut all = recording.groups().iter();
            all.find(|found| name_of(&found.group) == group.name)
                .map_or(0, |found| found.group.number)
        };
        let of = |group: &GroupWriter<'_>| {
            let number = number(group);
            (0..group.channels.len()).map(move |channel| (number, channel)).collect::<Vec<_>>()
        };
        self.groups.iter().flat_map(of).collect()
    }
}

/// The unit that a plate's channel has in the file, and the factor of its scale: other programs read forces in N, and moments
/// in N times POINT:UNITS, whatever the unit says. Turned plates have y and z in the other direction.
fn in_file_units(
    (kind, place, is_turned): (PlateType, usize, bool),
    unit: &str,
) -> (&'static str, f64) {
    let known = factor_of_unit(kind, place, unit.trim()).unwrap_or(1.0);
    let (name, factor) = match (kind, place) {
        (PlateType::Type3, _) | (_, 0..=2) => ("N", known),
        (PlateType::Type1, 3 | 4) => ("mm", known),
        _ => ("Nmm", known * 1000.0),
    };
    let is_along_x = match kind {
        PlateType::Type3 => place < 2,
        _ => matches!(place, 0 | 3),
    };
    (name, if is_turned && !is_along_x { -factor } else { factor })
}

/// A plate as C3D has it, if that is not how the take has it: the third number of ORIGIN is not positive there, so readers
/// reverse one that is. The axes are turned about x by half a turn, so that z points the other way.
fn turned(plate: &RecordedPlate) -> Option<([[f64; 3]; 4], [f64; 3])> {
    let ([a, b, c, d], [x, y, z]) = (plate.geometry.corners_mm(), plate.geometry.origin_mm());
    let origin_mm = match plate.kind {
        PlateType::Type2 => [x, -y, -z],
        // x and y are distances.
        PlateType::Type3 => [x, y, -z],
        PlateType::Type1 | PlateType::Type4 => return None,
    };
    (z > 0.0).then_some(([d, c, b, a], origin_mm))
}

/// The channels of a plate in the order of its axes in the file. When a plate of type 3 is turned, the sensors 1 and 4, and
/// 2 and 3, change places.
fn in_file_order(plate: &RecordedPlate, channels: &[usize]) -> Vec<usize> {
    match (plate.kind, turned(plate), channels) {
        (PlateType::Type3, Some(_), &[fx12, fx34, fy14, fy23, fz1, fz2, fz3, fz4]) => {
            vec![fx34, fx12, fy14, fy23, fz4, fz3, fz2, fz1]
        }
        _ => channels.to_vec(),
    }
}

/// Sets the `FORCE_PLATFORM` group, with the indices of each plate's analog channels.
fn set_plates(parameters: &mut Parameters, plates: &[(&RecordedPlate, Vec<usize>)]) {
    let n = u8::try_from(plates.len()).unwrap_or(u8::MAX);
    let plates = &plates[..usize::from(n)];
    let floats = |values: Vec<f64>| {
        values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect::<Vec<u8>>()
    };
    let words = |values: Vec<usize>| {
        values.iter().flat_map(|v| (*v as u16).to_le_bytes()).collect::<Vec<u8>>()
    };
    let places = plates.iter().map(|(plate, _)| {
        turned(plate).unwrap_or((plate.geometry.corners_mm(), plate.geometry.origin_mm()))
    });
    let (corners, origins): (Vec<_>, Vec<_>) = places.unzip();
    let (corners, origins) =
        (corners.into_iter().flatten().flatten(), origins.into_iter().flatten());

    let n_channels = plates.iter().map(|(_, channels)| channels.len()).max().unwrap_or(6);
    let channels = plates.iter().flat_map(|(plate, channels)| {
        // Numbers count from 1; 0 is none.
        let channels = in_file_order(plate, channels).into_iter();
        let numbers = channels.map(|channel| channel + 1).chain(std::iter::repeat(0));
        numbers.take(n_channels).collect::<Vec<_>>()
    });
    let types = plates.iter().map(|(plate, _)| usize::from(plate.kind.code()));
    parameters.set_integer(FORCE_PLATFORM, "USED", u16::from(n));
    parameters.set(FORCE_PLATFORM, "TYPE", 2, vec![n], words(types.collect()));
    // No frames are known to be without load.
    parameters.set(FORCE_PLATFORM, "ZERO", 2, vec![2], words(vec![0, 0]));
    parameters.set(FORCE_PLATFORM, "CORNERS", 4, vec![3, 4, n], floats(corners.collect()));
    parameters.set(FORCE_PLATFORM, "ORIGIN", 4, vec![3, n], floats(origins.collect()));
    parameters.set(
        FORCE_PLATFORM,
        "CHANNEL",
        2,
        vec![n_channels as u8, n],
        words(channels.collect()),
    );
}

impl GroupWriter<'_> {
    /// Appends one sample of a frame.
    fn push(&mut self, place: (u64, usize, usize), values: &mut Vec<f32>) -> io::Result<()> {
        let (row, sample, ratio) = place;
        let before = values.len();
        let is_there = match &mut self.source {
            GroupSource::Resampled(resampler) => {
                resampler.at(row as f64 + sample as f64 / ratio as f64, values)?
            }
            GroupSource::Unchanged(_) => {
                let slot = row.saturating_mul(ratio as u64).saturating_add(sample as u64);
                self.push_unchanged(slot as i64, values)?
            }
        };
        if is_there {
            let channels = self.channels.iter().zip(&mut self.not_numbers);
            let written = values.iter_mut().skip(before).zip(channels);
            for (value, (channel, n)) in written.filter(|(value, _)| !value.is_finite()) {
                *value = channel.offset as f32;
                *n += 1;
            }
            self.n_written += 1;
            self.n_missing += std::mem::take(&mut self.n_trailing);
            return Ok(());
        }
        // C3D cannot say that a sample is missing: the value is 0.
        values.truncate(before);
        values.extend(self.channels.iter().map(|channel| channel.offset as f32));
        if self.n_written == 0 {
            self.n_before += 1;
        } else {
            self.n_trailing += 1;
        }
        Ok(())
    }

    /// Appends the sample of a slot, if there is one.
    fn push_unchanged(&mut self, slot: i64, values: &mut Vec<f32>) -> io::Result<bool> {
        let GroupSource::Unchanged(source) = &mut self.source else { return Ok(false) };
        let UnchangedSamples { samples, runs, block, next } = &mut **source;
        let n_channels = self.channels.len();
        loop {
            if *next >= block.numbers.len() {
                *next = 0;
                if !samples.next_block(block)? {
                    *block = SampleBlock::default();
                    return Ok(false);
                }
            }
            let number = block.numbers[*next];
            let run = runs.partition_point(|run| run.first <= number).checked_sub(1);
            let Some(run) = run.and_then(|run| runs.get(run)) else {
                *next += 1;
                self.n_passed += 1;
                continue;
            };
            let own = number.cast_signed().saturating_add(run.shift);
            if own > slot {
                return Ok(false);
            }
            let at = *next;
            *next += 1;
            if own == slot && !block.is_lost {
                values.extend_from_slice(&block.stored[at * n_channels..(at + 1) * n_channels]);
                return Ok(true);
            }
            // Those before the first frame are expected.
            self.n_passed += u64::from(own < slot && self.n_written > 0 && !block.is_lost);
        }
    }

    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let name = &self.name;
        if self.n_missing > 0 {
            remarks.push(format!(
                "{name} lacks {} of each channel, which the recording lost; C3D has no mark for them, and they were \
                 written as 0.",
                counted(self.n_missing, "sample")
            ));
        }
        for (n, which) in [(self.n_before, "first"), (self.n_trailing, "last")] {
            if n > 0 {
                remarks.push(format!(
                    "{name} has no samples at the {which} {n} instants of the frames; they were written as 0."
                ));
            }
        }
        let of_channels = self.channels.iter().zip(&self.not_numbers).filter(|(_, n)| **n > 0);
        let of_channels = of_channels
            .map(|(channel, n)| format!("{} of {}", counted(*n, "sample"), channel.name));
        let of_channels: Vec<String> = of_channels.collect();
        if !of_channels.is_empty() {
            remarks.push(format!(
                "{name} has samples that are no numbers, which were written as 0: {}.",
                of_channels.join(", ")
            ));
        }
        if self.n_passed > 0 {
            remarks.push(format!(
                "{name}: {} left out, because others have their time, or their run has none.",
                counted(self.n_passed, "sample")
            ));
        }
        remarks
    }
}

pub(super) fn of_take(error: TakeError) -> InterchangeError {
    match error {
        TakeError::Io(error) => error.into(),
        other => InterchangeError::Unsupported(other.to_string()),
    }
}
