//! `OpenSim`'s motion file (`.mot`) with the loads of force plates, as its external loads read them.
//!
//! The layout is that of `OpenSim`'s documentation ("Motion (.mot) Files", "Preparing Force Data") and of the ground
//! reaction forces in its own examples: a header of `name`, `version`, `nRows`, `nColumns` and `inDegrees`, a line
//! `endheader`, and a table between tabs. `docs/formats.md` describes the columns.

use std::io::{self, Write};

use super::{
    InterchangeError, Result, c3d, check_frame_count, counted,
    recorded_rows::RecordedRows,
    sampled_table::{SampledKind, SampledTable},
    unsupported, write_frames,
};
use crate::{
    TakeError,
    foreign::{
        analog::AnalogSamples,
        force_plates::{Baseline, ForcePlate, ForcePlates, PlateLoad, PlateLoads},
    },
    motion::{FrameSource, MotionInfo},
    record::SampledChannel,
    sampled::{FILTER, Recording, Resampler, reach},
};

/// Columns of a plate: force, point and torque.
const COLUMNS: [&str; 3] = ["ground_force_{}_v", "ground_force_{}_p", "ground_torque_{}_"];

/// Writes a whole file: the loads of all usable plates at the analog rate, in newtons, metres and newton metres, in the
/// axes of the take. Times count from the first frame. Returns remarks for the user, one sentence each.
///
/// A plate is unloaded below [`LOADED_N`](crate::foreign::force_plates::LOADED_N): there is no centre of pressure then,
/// and all its columns are 0, because `OpenSim` would apply the rest of the force at the wrong place. Its splines turn
/// a single NaN into a column of them, so a sample that is missing is 0 as well.
///
/// If the plates of a recording are in several groups, the times are those of the fastest one. Groups of the same rate have
/// their nearest samples there, others are resampled if the [recording allows it](Recording::resamples).
///
/// # Errors
/// `Unsupported` if the take has no force plates that can be used, or no baseline, or plates of different rates; `Io` if reading or writing fails.
pub fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
    baseline: Baseline,
) -> Result<Vec<String>> {
    let info = frames.info().clone();
    let tables = SampledTable::all(&info)?.into_iter();
    let recorded: Vec<_> = tables.filter(|t| t.is_recorded() && t.kind().is_of_plates()).collect();
    if let (false, Some(recording)) = (recorded.is_empty(), &info.recording) {
        if baseline == Baseline::Subtracted {
            return unsupported(
                "a recording states no frames without load: export without --subtract-baseline",
            );
        }
        return write_recorded((recorded, recording), frames, &info, out);
    }
    let opened = PlateLoads::open(&info, baseline).map_err(of_take)?;
    let usable = opened.filter(|loads| !loads.plates().plates.is_empty());
    let Some(mut loads) = usable else { return Err(no_plates(&info)) };
    let mut remarks = loads.plates().warnings.clone();
    let numbers: Vec<usize> = loads.plates().plates.iter().map(|plate| plate.number).collect();
    let (ratio, rate_hz) = (loads.samples_per_frame(), loads.rate_hz());
    let per_frame = ratio * numbers.len();
    let header = header(info.n_frames.saturating_mul(ratio as u64), &numbers);
    let mut block = Vec::new();
    let mut next = 0;
    let mut counts = vec![LoadCounts::default(); numbers.len()];
    let n_written = write_frames(frames, out, header, |lines, frame, _| {
        if next >= block.len() {
            loads.next_block(&mut block)?;
            next = 0;
        }
        let of_frame = block.get(next..next + per_frame).unwrap_or(&[]);
        next += per_frame;
        for (sample, loads) in of_frame.chunks_exact(numbers.len()).enumerate() {
            let index = frame * ratio as u64 + sample as u64;
            write!(lines, "{}", index as f64 / rate_hz)?;
            for (load, counts) in loads.iter().zip(&mut counts) {
                counts.add(load, &info);
                put_load(lines, load)?;
            }
            lines.push(b'\n');
        }
        Ok(())
    })?;
    check_frame_count(info.n_frames, n_written)?;
    remarks
        .extend(numbers.iter().zip(&counts).flat_map(|(number, counts)| counts.remarks(*number)));
    Ok(remarks)
}

/// Writes the loads of the plates of a recording, at the times of the samples of its fastest group of plates.
fn write_recorded(
    (mut tables, recording): (Vec<SampledTable<'_>>, &Recording),
    frames: &dyn FrameSource,
    info: &MotionInfo,
    out: &mut dyn Write,
) -> Result<Vec<String>> {
    let rate_hz = tables.iter().map(SampledTable::rate_hz).fold(0.0, f64::max);
    let fastest = tables.iter().position(|table| table.rate_hz() >= rate_hz).unwrap_or(0);
    let mut table = tables.remove(fastest);
    let others = tables.iter().map(|other| OtherGroup::open(other, recording, info, rate_hz));
    let mut others = others.collect::<Result<Vec<_>>>()?;
    let of_others = others.iter().flat_map(OtherGroup::plates);
    let numbers: Vec<usize> =
        table.plates().iter().chain(of_others).map(|plate| plate.number).collect();
    // Plates are in the order of their numbers, whatever groups they are in.
    let mut order: Vec<usize> = (0..numbers.len()).collect();
    order.sort_by_key(|&index| numbers.get(index));
    let numbers: Vec<usize> =
        order.iter().filter_map(|&index| numbers.get(index).copied()).collect();
    let mut counts = vec![LoadCounts::default(); numbers.len()];
    // OpenSim needs ascending times, which a device does not have whose clock begins again.
    let mut n_rows = 0;
    let mut last_s = f64::NEG_INFINITY;
    for time_s in table.times_s() {
        n_rows += u64::from(time_s > last_s);
        last_s = last_s.max(time_s);
    }
    let n_left_out = table.n_rows() - n_rows;
    out.write_all(&header(n_rows, &numbers))?;
    let (mut line, mut loads, mut last_s) = (Vec::new(), Vec::new(), f64::NEG_INFINITY);
    table.for_each_row(frames, |time, row| {
        if time.time_s <= last_s {
            return Ok(());
        }
        last_s = time.time_s;
        line.clear();
        loads.clear();
        write!(line, "{last_s}")?;
        loads.extend(loads_of(row));
        others.iter_mut().try_for_each(|other| other.push(time.frames, &mut loads))?;
        for (&index, counts) in order.iter().zip(&mut counts) {
            let load = loads.get(index).copied().unwrap_or(NO_LOAD);
            counts.add(&load, info);
            put_load(&mut line, &load)?;
        }
        line.push(b'\n');
        out.write_all(&line)
    })?;
    out.flush()?;
    let of_plates =
        numbers.iter().zip(&counts).flat_map(|(number, counts)| counts.remarks(*number));
    let of_groups = others.iter().map(|other| other.remark(info.rate_hz, rate_hz));
    let warnings = c3d::warnings_of(recording).into_iter();
    let mut remarks: Vec<String> = warnings.chain(of_groups).chain(of_plates).collect();
    remarks.extend((n_left_out > 0).then(|| {
        format!("{} left out, because their times do not ascend.", counted(n_left_out, "row"))
    }));
    Ok(remarks)
}

/// The loads of a row of a table: twelve numbers each.
fn loads_of(row: &[f32]) -> impl Iterator<Item = PlateLoad> {
    row.as_chunks::<3>().0.as_chunks::<4>().0.iter().map(|load| {
        let [force_n, moment_nm, cop_mm, free_moment_nm] = load.map(|of| of.map(f64::from));
        PlateLoad { force_n, moment_nm, cop_mm, free_moment_nm }
    })
}

/// The load where a plate has no sample.
const NO_LOAD: PlateLoad = PlateLoad {
    force_n: [f64::NAN; 3],
    moment_nm: [f64::NAN; 3],
    cop_mm: [f64::NAN; 3],
    free_moment_nm: [f64::NAN; 3],
};

/// Difference of two rates, as a share of them, that is rounding.
const SAME_RATE: f64 = 1e-6;

/// Largest distance of a sample from the time for which it stands, in periods: half of one where no sample was lost, and
/// room for devices whose rate is not quite the one that they state.
const REACH: f64 = 0.75;

/// The plates of another group, at the times of the fastest one.
struct OtherGroup<'a> {
    name: String,
    plates: Vec<ForcePlate>,
    first_row: f64,
    source: OtherSource<'a>,
}

/// How their loads are found.
enum OtherSource<'a> {
    /// Each time has the nearest sample, at most [`REACH`] away.
    Nearest(Box<NearestRows<'a>>),
    /// By the filter.
    Resampled { samples: Box<Resampler<'a>>, channels: &'a [SampledChannel], stored: Vec<f32> },
}

/// The rows of a group, of which the nearest ones to ascending times are taken.
struct NearestRows<'a> {
    rows: RecordedRows<'a>,
    /// The last row that was read: its place in frames, and its values.
    held: Option<(f64, Vec<f32>)>,
    /// How far away a row may be, in frames.
    reach: f64,
    /// The largest distance from a time, in frames.
    farthest: f64,
}

impl NearestRows<'_> {
    /// The row that is nearest to a time; `None` if none is within reach.
    fn at(&mut self, frames: f64) -> io::Result<Option<&[f32]>> {
        while let Some(next) = self.rows.peek()? {
            let is_nearer = self
                .held
                .as_ref()
                .is_none_or(|(at, _)| (next - frames).abs() <= (at - frames).abs());
            if !is_nearer {
                break;
            }
            let mut values = self.held.take().map(|(_, values)| values).unwrap_or_default();
            values.clear();
            self.rows.take(&mut values);
            self.held = Some((next, values));
        }
        let Some((at, values)) = &self.held else { return Ok(None) };
        let distance = (at - frames).abs();
        if distance > self.reach {
            return Ok(None);
        }
        self.farthest = self.farthest.max(distance);
        Ok(Some(values))
    }
}

impl<'a> OtherGroup<'a> {
    /// # Errors
    /// `Unsupported` if the rates differ, and the user did not allow resampling; those of reading the take.
    fn open(
        table: &SampledTable<'_>,
        recording: &'a Recording,
        info: &MotionInfo,
        rate_hz: f64,
    ) -> Result<Self> {
        let SampledKind::ForcePlates(Some(number)) = table.kind() else {
            return unsupported(
                "the force plates of a group have no number: please report this bug",
            );
        };
        let index = recording.groups().iter().position(|found| found.group.number == number);
        let group = index.and_then(|index| Some((index, recording.groups().get(index)?)));
        let Some((index, found)) = group else {
            return unsupported(
                "the force plates are in a group that is not there: please report this bug",
            );
        };
        let (name, plates, own_hz) =
            (c3d::name_of(&found.group), table.plates().to_vec(), found.group.rate_hz);
        let rows = info.rows();
        let first_row = rows.start as f64;
        if (own_hz - rate_hz).abs() <= SAME_RATE * rate_hz {
            let period = info.rate_hz / own_hz;
            // The sample that is nearest to the first or the last time may lie outside of what is exported.
            let more = period.ceil() as u64 + 1;
            let wider = rows.start.saturating_sub(more)..rows.end.saturating_add(more);
            let within = (&wider, rows.start);
            let rows = RecordedRows::within(recording, index, plates.clone(), within);
            let rows = rows.map_err(of_take)?;
            let nearest = NearestRows { rows, held: None, reach: REACH * period, farthest: 0.0 };
            let source = OtherSource::Nearest(Box::new(nearest));
            return Ok(Self { name, plates, first_row, source });
        }
        if !recording.resamples() {
            return Err(InterchangeError::Unsupported(format!(
                "the force plates are in groups of {rate_hz} and {own_hz} Hz, but .mot has one column of times: \
                 export with --resample, or to csv, which writes a file for each group"
            )));
        }
        let reach_s = (reach(own_hz, rate_hz) + 1) as f64 / own_hz;
        let more = (reach_s * info.rate_hz).ceil() as u64 + 1;
        let wider = rows.start.saturating_sub(more)..rows.end.saturating_add(more);
        let samples = recording.samples(index, &wider).map_err(of_take)?;
        let channels = samples.channels();
        let samples = Box::new(Resampler::new(samples, own_hz, rate_hz));
        let source = OtherSource::Resampled { samples, channels, stored: Vec::new() };
        Ok(Self { name, plates, first_row, source })
    }

    fn plates(&self) -> &[ForcePlate] {
        &self.plates
    }

    /// Appends the loads at a time, in frames from the first one.
    fn push(&mut self, frames: f64, loads: &mut Vec<PlateLoad>) -> io::Result<()> {
        let missing = std::iter::repeat_n(NO_LOAD, self.plates.len());
        match &mut self.source {
            OtherSource::Nearest(nearest) => match nearest.at(frames)? {
                Some(values) => loads.extend(loads_of(values)),
                None => loads.extend(missing),
            },
            OtherSource::Resampled { samples, channels, stored } => {
                stored.clear();
                if !samples.at(self.first_row + frames, stored)? {
                    loads.extend(missing);
                    return Ok(());
                }
                let value = |&channel: &usize| {
                    let found = channels.get(channel).zip(stored.get(channel));
                    found.map_or(f64::NAN, |(channel, &stored)| channel.value(stored))
                };
                loads.extend(self.plates.iter().map(|plate| {
                    let values: Vec<f64> = plate.channels.iter().map(value).collect();
                    plate.load(&values)
                }));
            }
        }
        Ok(())
    }

    /// What happened to its samples.
    fn remark(&self, frames_hz: f64, rate_hz: f64) -> String {
        let name = &self.name;
        match &self.source {
            OtherSource::Nearest(nearest) => format!(
                "The samples of {name} are those nearest to the times of the fastest group of plates, up to {:.3} ms away.",
                nearest.farthest / frames_hz * 1e3
            ),
            OtherSource::Resampled { .. } => {
                format!("{name} was resampled to {rate_hz} Hz: {FILTER}.")
            }
        }
    }
}

/// The header and the line of column names.
fn header(n_rows: u64, plates: &[usize]) -> Vec<u8> {
    let n_columns = 1 + 9 * plates.len();
    let mut text = format!(
        "ground_reaction_forces\nversion=1\nnRows={n_rows}\nnColumns={n_columns}\ninDegrees=no\nendheader\ntime"
    );
    for number in plates {
        for column in COLUMNS {
            for axis in ["x", "y", "z"] {
                text += &format!("\t{}{axis}", column.replace("{}", &number.to_string()));
            }
        }
    }
    text.push('\n');
    text.into_bytes()
}

/// Appends the nine cells of a load.
fn put_load(out: &mut Vec<u8>, load: &PlateLoad) -> io::Result<()> {
    let is_loaded = load.cop_mm.iter().all(|v| v.is_finite());
    let [force, point, torque] = if is_loaded {
        [load.force_n, load.cop_mm.map(|v| v / 1000.0), load.free_moment_nm]
    } else {
        [[0.0; 3]; 3]
    };
    for value in [force, point, torque].into_iter().flatten() {
        // Analog samples are float32 or 16-bit integers. Adding 0 turns -0 into 0.
        write!(out, "\t{}", value as f32 + 0.0)?;
    }
    Ok(())
}

/// What the loads of a plate were.
#[derive(Debug, Clone, Default)]
struct LoadCounts {
    missing: u64,
    /// The largest vertical forces, upwards and downwards. Their numbers would not tell: a plate whose zero has drifted has a
    /// force in every sample without a step.
    most_up_n: f64,
    most_down_n: f64,
}

impl LoadCounts {
    fn add(&mut self, load: &PlateLoad, info: &MotionInfo) {
        if load.force_n.iter().any(|v| !v.is_finite()) {
            self.missing += 1;
        } else if load.cop_mm.iter().all(|v| v.is_finite()) {
            let vertical = info.up.index().and_then(|axis| load.force_n.get(axis));
            let vertical_n = vertical.copied().unwrap_or_default();
            self.most_up_n = self.most_up_n.max(vertical_n);
            self.most_down_n = self.most_down_n.max(-vertical_n);
        }
    }

    fn remarks(&self, number: usize) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.missing > 0 {
            remarks.push(format!(
                "Force plate {number} has no values in {} samples, which were written as 0.",
                self.missing
            ));
        }
        if self.most_down_n > self.most_up_n {
            remarks.push(format!(
                "The largest forces of force plate {number} point down: the file may state the forces of the subject \
                 on the plate; OpenSim needs those of the plate on the subject."
            ));
        }
        remarks
    }
}

/// What a file of the plates leaves out, as text for the user: markers, other analog channels, plates that cannot be
/// used.
pub(super) fn left_out(info: &MotionInfo) -> Vec<String> {
    let mut left_out = vec![counted(info.markers.len() as u64, "marker")];
    if let Some(recording) = &info.recording {
        let channels =
            recording.groups().iter().map(|found| found.group.channels.len()).sum::<usize>();
        let n_used: usize = recording.plates().iter().map(|plate| plate.channels.len()).sum();
        let others = channels.saturating_sub(n_used) as u64;
        left_out.extend((others > 0).then(|| counted(others, "other sampled channel")));
        return left_out;
    }
    let Ok(Some(plates)) = ForcePlates::of(info) else { return left_out };
    let n_channels = AnalogSamples::open(info).ok().flatten().map_or(0, |s| s.channels().len());
    let n_used: usize = plates.plates.iter().map(|plate| plate.channels.len()).sum();
    if let Some(others) = n_channels.checked_sub(n_used).filter(|&others| others > 0) {
        left_out.push(counted(others as u64, "other analog channel"));
    }
    left_out.extend(unusable_plates(info));
    left_out
}

/// The plates that cannot be used, as text for the user.
pub(super) fn unusable_plates(info: &MotionInfo) -> Vec<String> {
    let plates = ForcePlates::of(info).ok().flatten().unwrap_or_default();
    let unusable = plates.unusable.iter();
    unusable.map(|plate| format!("force plate {} ({})", plate.number, plate.reason)).collect()
}

/// The error for a take without usable plates.
fn no_plates(info: &MotionInfo) -> InterchangeError {
    let unusable = ForcePlates::of(info).ok().flatten().map(|plates| plates.unusable);
    let reasons: Vec<String> = unusable
        .unwrap_or_default()
        .iter()
        .map(|plate| format!("force plate {}: {}", plate.number, plate.reason))
        .collect();
    InterchangeError::Unsupported(if reasons.is_empty() {
        "the take has no force plates, which .mot needs: import a C3D file with force plates, without --drop-foreign, or \
         record a device that describes its own"
            .to_owned()
    } else {
        format!("no force plate can be used: {}", reasons.join("; "))
    })
}

fn of_take(error: TakeError) -> InterchangeError {
    match error {
        TakeError::Io(error) => error.into(),
        other => InterchangeError::Unsupported(other.to_string()),
    }
}
