//! The sampled channels and force plates of a recording, as the ANALOG and `FORCE_PLATFORM` groups of a C3D file.
//!
//! C3D has one number of analog samples in a frame, evenly spaced from the frame on. Samples of a recording are written
//! unchanged where they were taken like that: their rate is a whole multiple of the frames', and keeps in step with it.
//! Others are left out, unless the user allows resampling.

use std::io;

use super::{
    analog::ANALOG,
    force_platform::{FORCE_PLATFORM, moment_nm},
    parameters::Parameters,
    stride::ANALOG_MAX,
};
use crate::{
    TakeError,
    foreign::force_plate::PlateType,
    interchange::{InterchangeError, Result, counted},
    motion::MotionInfo,
    record::{SampledChannel, SampledGroup},
    sampled::{FILTER, RecordedSamples, Recording, Resampler, SampleBlock},
};

/// Largest drift against the frames over a run, in samples, at which samples are written unchanged.
const DRIFT_MAX: f64 = 0.5;

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
enum Placement {
    /// Unchanged.
    Unchanged { runs: Vec<RunOfSlots>, farthest: f64 },
    /// By the filter.
    Resampled,
}

/// What a C3D file has of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RecordedPlan {
    /// Samples in a frame.
    ratio: usize,
    /// Indices of the groups.
    groups: Vec<(usize, Placement)>,
    /// Groups that are left out, as text for the user.
    pub(crate) left_out: Vec<String>,
}

/// The samples of a group in a frame if they fit, or why they do not.
fn fit(
    recording: &Recording,
    index: usize,
    rate_hz: f64,
) -> std::result::Result<(usize, Placement), String> {
    let Some(group) = recording.groups().get(index) else { return Err(String::new()) };
    let multiple = group.group.rate_hz / rate_hz;
    let ratio = multiple.round();
    if ratio < 1.0 || (multiple - ratio).abs() > WHOLE * multiple {
        return Err(format!("its rate is no whole multiple of the frames' {rate_hz} Hz"));
    }
    let Some(clock) = recording.clock(index) else { return Err(String::new()) };
    let distance =
        |number: u64| Some((number as f64, clock.position(number)? * ratio - number as f64));
    let (mut runs, mut farthest) = (Vec::new(), 0.0_f64);
    let same_run = |a: &crate::sampled::SampleAnchor, b: &crate::sampled::SampleAnchor| {
        (a.run_start, a.segment) == (b.run_start, b.segment)
    };
    let mut all = group.anchors().chunk_by(same_run).peekable();
    while let Some(anchors) = all.next() {
        let end = all
            .peek()
            .and_then(|next| next.first())
            .map_or(group.n_samples(), |next| next.run_start);
        let Some(first) = anchors.first() else { continue };
        let numbers =
            anchors.iter().map(|anchor| anchor.number).chain([first.run_start, end.max(1) - 1]);
        let at: Vec<(f64, f64)> = numbers.filter_map(distance).collect();
        let Some((mean, slope)) = line(&at) else { continue };
        let drift = slope * end.saturating_sub(first.run_start) as f64;
        if drift.abs() > DRIFT_MAX {
            return Err(format!(
                "its clock and the frames' drift apart by {:.1} samples",
                drift.abs()
            ));
        }
        let shift = mean.round();
        farthest = at.iter().map(|(_, d)| (d - shift).abs()).fold(farthest, f64::max);
        runs.push(RunOfSlots { first: first.run_start, shift: shift as i64 });
    }
    if runs.is_empty() {
        return Err("the take does not say when its samples were taken".to_owned());
    }
    Ok((ratio as usize, Placement::Unchanged { runs, farthest }))
}

/// The mean and the slope of the line of least squares; `None` without points.
fn line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let along: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    let both: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    (n > 0.0).then_some((y, if along > 0.0 { both / along } else { 0.0 }))
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
        let fits: Vec<_> = (0..recording.groups().len())
            .map(|index| fit(recording, index, info.rate_hz))
            .collect();
        let ratio = Self::choose_ratio(recording, &fits, info.rate_hz);
        let mut plan = Self { ratio, ..Self::default() };
        let mut n_channels = 0;
        for (index, (found, fit)) in recording.groups().iter().zip(fits).enumerate() {
            let more = found.group.channels.len();
            let name = name_of(&found.group);
            if (ratio * (n_channels + more)) as u64 > ANALOG_MAX {
                plan.left_out
                    .push(format!("{name}: a C3D frame holds at most {ANALOG_MAX} analog samples"));
                continue;
            }
            let placement = match fit {
                Ok((own, placement)) if own == ratio => placement,
                _ if recording.resamples() => Placement::Resampled,
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
        plan
    }

    /// The samples in a frame: those of the groups if they agree; else the most that any group has, if channels may be
    /// resampled, or those of the first group of force plates that fits, or of the first group that does.
    fn choose_ratio(
        recording: &Recording,
        fits: &[std::result::Result<(usize, Placement), String>],
        rate_hz: f64,
    ) -> usize {
        let own = |index: usize| {
            fits.get(index).and_then(|fit| fit.as_ref().ok()).map(|(ratio, _)| *ratio)
        };
        let first = (0..fits.len()).find_map(own);
        let all_agree = (0..fits.len()).all(|index| own(index).is_some() && own(index) == first);
        if let (true, Some(ratio)) = (all_agree, first) {
            return ratio;
        }
        if recording.resamples() {
            let highest =
                recording.groups().iter().map(|found| found.group.rate_hz).fold(0.0, f64::max);
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
        let mut remarks = recording.warnings().to_vec();
        for (index, placement) in &self.groups {
            let Some(found) = recording.groups().get(*index) else { continue };
            let name = name_of(&found.group);
            match placement {
                Placement::Unchanged { farthest, .. } if *farthest > DISTANCE_TOLD => {
                    remarks.push(format!(
                        "The samples of {name} are unchanged; they were taken up to {:.3} ms from the instants that C3D \
                         gives them.",
                        farthest / (self.ratio as f64 * info.rate_hz) * 1e3
                    ));
                }
                Placement::Unchanged { .. } => {}
                Placement::Resampled => remarks.push(format!(
                    "{name} was resampled to {} Hz, {} samples in a frame: {FILTER}.",
                    self.ratio as f64 * info.rate_hz,
                    self.ratio
                )),
            }
        }
        remarks
    }
}

/// Where the samples of a group come from.
#[derive(Debug)]
enum GroupSource<'a> {
    Unchanged {
        samples: RecordedSamples<'a>,
        runs: Vec<RunOfSlots>,
        block: SampleBlock,
        next: usize,
    },
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
                Placement::Unchanged { runs, .. } => {
                    GroupSource::Unchanged { samples, runs, block: SampleBlock::default(), next: 0 }
                }
                Placement::Resampled => {
                    let whole =
                        recording.samples(index, &(0..recording.n_rows())).map_err(of_take)?;
                    GroupSource::Resampled(Box::new(Resampler::new(
                        whole,
                        found.group.rate_hz,
                        to_hz,
                    )))
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
                n_missing,
                n_trailing,
                n_passed,
            });
        }
        let (row, values) = (rows.start, Vec::new());
        let all = Self { ratio: plan.ratio, groups, remarks, row, values };
        Ok(Some(all).filter(|all| all.n_channels() > 0))
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
        let mut moments = vec![false; numbers.len()];
        for (plate, channels) in &plates {
            let from = if plate.kind == PlateType::Type1 { 5 } else { 3 };
            let of_moments = channels.iter().skip(from).filter(|_| plate.kind != PlateType::Type3);
            of_moments.for_each(|&channel| moments[channel] = true);
        }
        let all = self.groups.iter().flat_map(|group| group.channels);
        let (mut labels, mut units, mut scales, mut offsets) = (vec![], vec![], vec![], vec![]);
        for (channel, is_moment) in all.zip(moments) {
            labels.push(channel.name.clone());
            // Other programs read the moments of a plate in N times POINT:UNITS, whatever the unit says.
            let to_mm = Some(&channel.unit).filter(|_| is_moment).and_then(|unit| moment_nm(unit));
            units.push(to_mm.map_or_else(|| channel.unit.clone(), |_| "Nmm".to_owned()));
            scales.push((channel.scale * to_mm.map_or(1.0, |nm| nm * 1000.0)) as f32);
            offsets.push(channel.offset as f32);
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

/// Sets the `FORCE_PLATFORM` group, with the indices of each plate's analog channels.
fn set_plates(parameters: &mut Parameters, plates: &[(&crate::record::RecordedPlate, Vec<usize>)]) {
    let n = u8::try_from(plates.len()).unwrap_or(u8::MAX);
    let plates = &plates[..usize::from(n)];
    let floats = |values: Vec<f64>| {
        values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect::<Vec<u8>>()
    };
    let words = |values: Vec<usize>| {
        values.iter().flat_map(|v| (*v as u16).to_le_bytes()).collect::<Vec<u8>>()
    };
    let corners = plates.iter().flat_map(|(plate, _)| plate.geometry.corners_mm()).flatten();
    let origins = plates.iter().flat_map(|(plate, _)| plate.geometry.origin_mm());
    let n_channels = plates.iter().map(|(_, channels)| channels.len()).max().unwrap_or(6);
    let channels = plates.iter().flat_map(|(_, channels)| {
        // Numbers count from 1; 0 is none.
        let numbers = channels.iter().map(|channel| channel + 1).chain(std::iter::repeat(0));
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
            GroupSource::Unchanged { .. } => {
                let slot = row.saturating_mul(ratio as u64).saturating_add(sample as u64);
                self.push_unchanged(slot as i64, values)?
            }
        };
        if is_there && values.iter().skip(before).all(|value| value.is_finite()) {
            self.n_written += 1;
            self.n_missing += std::mem::take(&mut self.n_trailing);
            return Ok(());
        }
        // C3D cannot say that a sample is missing: the value is 0.
        values.truncate(before);
        values.extend(self.channels.iter().map(|channel| channel.offset as f32));
        if self.n_written == 0 {
            self.n_before += 1
        } else {
            self.n_trailing += 1
        }
        Ok(())
    }

    /// Appends the sample of a slot, if there is one.
    fn push_unchanged(&mut self, slot: i64, values: &mut Vec<f32>) -> io::Result<bool> {
        let GroupSource::Unchanged { samples, runs, block, next } = &mut self.source else {
            return Ok(false);
        };
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
            let shift = run.and_then(|run| runs.get(run)).map_or(0, |run| run.shift);
            let own = number.cast_signed().saturating_add(shift);
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
        if self.n_passed > 0 {
            remarks.push(format!(
                "{name}: {} left out, because others have their time.",
                counted(self.n_passed, "sample")
            ));
        }
        remarks
    }
}

fn of_take(error: TakeError) -> InterchangeError {
    match error {
        TakeError::Io(error) => error.into(),
        other => InterchangeError::Unsupported(other.to_string()),
    }
}
