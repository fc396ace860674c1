//! The forces of a take for a player: its force plates, and windows of their loads.
//!
//! A take that was imported from a C3D file has the parameters of its plates, and so their places. A recording has channels
//! that are named as those of force plates; devices do not state where the plates are, so there are forces without a place.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use mocapd_acquire::files;
use mocapd_take::{
    TakeError, TakeFrames, TakeMap, TakeTraversal,
    foreign::{
        analog::AnalogChannel,
        force_plates::{ForcePlate, ForcePlates},
    },
    motion::{FrameSource, MotionInfo},
    sampled::GroupSamples,
    traversal::Decode,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    plate_names::{PlateColumns, named_plates},
    window::{
        DAMAGED, EVERY_MAX, HEADER_BYTES, SHORTENED, WINDOW_BYTES_MAX, WindowError, WindowRequest,
        put_header, rows_of,
    },
};

/// The signature of a window of forces: "mocapd forces", version 1.
const MAGIC: &[u8; 4] = b"MPF1";

/// Numbers of a load: force, centre of pressure, free moment, and the least and the largest upward force.
const LOAD_VALUES: usize = 9;

/// Maximum number of plates: the response to a request for one frame has to be small. Laboratories have up to a dozen.
const PLATES_MAX: usize = 64;

/// Values of channels of a plate that are held at once, in 4 MiB.
const PIECE_VALUES: u64 = 1 << 19;

/// Maximum number of values of channels that a window is made of, unless a single frame of it needs more: about a tenth of a
/// second of work.
const WINDOW_VALUES_MAX: f64 = 4_194_304.0;

/// Maximum number of values that a single frame of a window may need, with those up to the next: some seconds of work. Ten
/// thousand frames at 240 Hz with eight plates at 10 kHz have 20 million.
const COLUMN_VALUES_MAX: f64 = 67_108_864.0;

/// The kinds of the foreign parts of an imported C3D file.
const PARAMETERS: &str = "c3d/parameters";
const ANALOG: &str = "c3d/analog";

/// The force plates of a take.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct PlateList {
    /// The plates whose forces [`TakeForces::window`] gives, in order.
    pub plates: Vec<PlateOverview>,
    /// Maximum number of frames of a window: a response has at most a megabyte.
    pub window_frames_max: u64,
    /// Plates that cannot be used, and why, one sentence each.
    pub unusable: Vec<String>,
}

/// A force plate.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct PlateOverview {
    /// Its name, such as `1`.
    pub name: String,
    /// Its corners in millimetres, in the axes of the markers; null if the take does not state where it is: then there is no
    /// centre of pressure either.
    pub corners_mm: Option<[[f64; 3]; 4]>,
}

/// Where the values of a plate come from.
#[derive(Debug, Clone)]
struct Plate {
    name: String,
    /// By quantity, its column: six, or up to eight of a plate of a file.
    columns: Vec<Column>,
    load: LoadOf,
}

/// How values become a load.
#[derive(Debug, Clone)]
enum LoadOf {
    /// A plate of a C3D file.
    File(Box<ForcePlate>),
    /// A plate of a recording: three forces and, if there are any, three moments, in N and N m.
    Recording,
}

/// A channel of a group of sampled channels.
#[derive(Debug, Clone, Copy)]
struct Column {
    /// The index of the group in [`TakeForces::groups`].
    group: usize,
    /// The channel in the group.
    channel: usize,
    scale: f64,
    offset: f64,
}

/// The force plates of a take, and where their samples are.
#[derive(Debug, Clone)]
pub struct TakeForces {
    map: TakeMap,
    groups: Vec<GroupSamples>,
    plates: Vec<Plate>,
    unusable: Vec<String>,
    /// Samples in a frame, and the sample of the first; `None` in a recording, whose samples have times.
    per_frame: Option<(u64, i128)>,
    /// The vertical axis.
    up: usize,
}

/// The loads of all plates in some frames.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceWindow {
    n_plates: u32,
    first_row: u64,
    every: u32,
    flags: u32,
    /// By frame and plate.
    loads: Vec<[f32; LOAD_VALUES]>,
}

impl TakeForces {
    /// Reads the take for its plates, without decoding anything.
    ///
    /// # Errors
    /// Those of the reader.
    pub fn open(input: impl Read + Seek) -> Result<Self, TakeError> {
        let frames = TakeFrames::open_with(input, |kind| kind == PARAMETERS, files::scratch)?;
        let map = frames.map().clone();
        let up = frames.info().up.index().unwrap_or(2);
        let mut forces = Self {
            groups: Vec::new(),
            plates: Vec::new(),
            unusable: Vec::new(),
            per_frame: None,
            up,
            map,
        };
        forces.add_plates_of_file(frames.info())?;
        if forces.plates.is_empty() {
            forces.add_plates_of_recording();
        }
        let others = forces.plates.iter().skip(PLATES_MAX);
        let others: Vec<String> = others
            .map(|plate| format!("{}: a player shows {PLATES_MAX} plates", plate.name))
            .collect();
        forces.unusable.extend(others);
        forces.plates.truncate(PLATES_MAX);
        // The groups of the plates are kept, and nothing else of them.
        forces.map.foreign.clear();
        Ok(forces)
    }

    fn add_plates_of_file(&mut self, info: &MotionInfo) -> Result<(), TakeError> {
        let part = self.map.foreign.iter().find(|part| part.kind == ANALOG);
        let Some(part) = part.and_then(|part| part.sampled()) else { return Ok(()) };
        let groups = part.groups().to_vec();
        let Some(first) = groups.first().map(|first| &first.group) else { return Ok(()) };
        let n_channels = first.part_channels as usize;
        let ratio = u64::from(first.samples_per_frame);
        // Damaged parameters are among the problems of the take already.
        let Ok(Some((found, channels))) = ForcePlates::described(info, n_channels) else {
            return Ok(());
        };
        let unusable = found.unusable.iter();
        self.unusable.extend(unusable.map(|plate| format!("{}: {}", plate.number, plate.reason)));
        if ratio == 0 {
            return Ok(());
        }
        let before = i128::from(info.source.first_frame) - i128::from(first.first_frame);
        self.per_frame = Some((ratio, before * i128::from(ratio)));
        for plate in found.plates {
            let column = |index: &usize| column_of(&groups, &channels, *index);
            let Some(columns) = plate.channels.iter().map(column).collect() else { continue };
            let (name, load) = (plate.number.to_string(), LoadOf::File(Box::new(plate)));
            self.plates.push(Plate { name, columns, load });
        }
        self.groups = groups;
        Ok(())
    }

    fn add_plates_of_recording(&mut self) {
        let groups: Vec<GroupSamples> = self.map.recorded_groups().cloned().collect();
        for (group, of) in groups.iter().enumerate() {
            let ticks = of.anchors().iter().map(|anchor| anchor.device_ticks);
            let first = of.anchors().first().map_or(0, |anchor| anchor.device_ticks);
            let is_ascending =
                ticks.is_sorted_by_key(|ticks| ticks.wrapping_sub(first).cast_signed());
            let channels = &of.group.channels;
            if !is_ascending {
                let names = named_plates(channels).into_iter().map(|plate| plate.name);
                self.unusable.extend(
                    names.map(|name| {
                        format!("{name}: the device's clock began again during the take")
                    }),
                );
                continue;
            }
            for PlateColumns { name, columns } in named_plates(channels) {
                let column = |(channel, factor): &(usize, f64)| {
                    let of = channels.get(*channel);
                    let (scale, offset) = of.map_or((0.0, 0.0), |of| (of.scale, of.offset));
                    Column { group, channel: *channel, scale: scale * factor, offset }
                };
                let columns = columns.iter().map(column).collect();
                self.plates.push(Plate { name, columns, load: LoadOf::Recording });
            }
        }
        (self.groups, self.per_frame) = (groups, None);
    }

    /// The plates.
    #[must_use]
    pub fn list(&self) -> PlateList {
        let overview = |plate: &Plate| PlateOverview {
            name: plate.name.clone(),
            corners_mm: match &plate.load {
                LoadOf::File(plate) => Some(plate.geometry.corners_mm()),
                LoadOf::Recording => None,
            },
        };
        PlateList {
            plates: self.plates.iter().map(overview).collect(),
            window_frames_max: self.frames_max(),
            unusable: self.unusable.clone(),
        }
    }

    /// Entries that it holds in memory: key stretches, channels, and blocks of samples.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        let blocks = self.groups.iter().map(|of| of.anchors().len().max(of.n_chunks()));
        self.map.keys.len() + self.map.channels.len() + blocks.sum::<usize>()
    }

    fn frames_max(&self) -> u64 {
        (WINDOW_BYTES_MAX - HEADER_BYTES) / (4 * LOAD_VALUES * self.plates.len().max(1)) as u64
    }

    /// Values of all plates in a frame.
    fn values_per_frame(&self) -> f64 {
        let of_plate = |plate: &Plate| {
            let group = plate.columns.first().and_then(|column| self.groups.get(column.group));
            let samples = match self.per_frame {
                Some((ratio, _)) => ratio as f64,
                None => group.map_or(0.0, |of| of.group.rate_hz) / self.map.header.rate_hz,
            };
            samples.max(1.0) * plate.columns.len() as f64
        };
        self.plates.iter().map(of_plate).sum::<f64>().max(1.0)
    }

    /// The loads in the frames of a window. `every` frames share the least and the largest force of all their samples, so
    /// that no peak is left out.
    ///
    /// # Errors
    /// Those of [`WindowError`].
    pub fn window(
        &self,
        input: &mut (impl Read + Seek),
        request: &WindowRequest,
    ) -> Result<ForceWindow, WindowError> {
        let rows = rows_of(&self.map, request)?;
        let every = u64::from(request.every.clamp(1, EVERY_MAX));
        let per_frame = self.values_per_frame();
        if per_frame * every as f64 > COLUMN_VALUES_MAX {
            return Err(WindowError::TooMuchWork);
        }
        let worked_max = (WINDOW_VALUES_MAX / (per_frame * every as f64)).max(1.0) as u64;
        let rows_max = self.frames_max().min(worked_max).saturating_mul(every);
        let end = rows.end.min(rows.start.saturating_add(rows_max));
        let n_frames = (end - rows.start).div_ceil(every) as usize;
        let mut window = ForceWindow {
            n_plates: self.plates.len() as u32,
            first_row: rows.start,
            every: every as u32,
            flags: if end < rows.end { SHORTENED } else { 0 },
            loads: vec![[f32::NAN; LOAD_VALUES]; n_frames * self.plates.len()],
        };
        let rows = rows.start..end;
        let ticks = match self.per_frame {
            None if !self.plates.is_empty() => row_ticks(input, &self.map, &rows)?,
            _ => Vec::new(),
        };
        for (place, plate) in self.plates.iter().enumerate() {
            let frames = self.sample_ranges(plate, &rows, every, &ticks);
            self.read_plate(input, (place, plate), &frames, &mut window)?;
        }
        Ok(window)
    }

    /// By frame that a window has, the numbers of the samples up to the next one; `None` where it is unknown when they were
    /// taken, or none were.
    fn sample_ranges(
        &self,
        plate: &Plate,
        rows: &Range<u64>,
        every: u64,
        ticks: &[(u64, u64)],
    ) -> Vec<Option<Range<u64>>> {
        let columns = plate.columns.iter();
        let groups = columns.filter_map(|column| self.groups.get(column.group));
        let Some(group) = groups.min_by_key(|group| group.n_samples()) else { return Vec::new() };
        let n_samples = group.n_samples();
        let clock = FrameClock::new(self, group, ticks);
        let starts = (rows.start..rows.end).step_by(every as usize);
        let range = |row: u64| {
            let from = clock.number(row)?;
            let to = clock.number(row.saturating_add(every).min(rows.end))?.min(n_samples);
            (from < to).then_some(from..to)
        };
        starts.map(range).collect()
    }

    /// Reads the samples of a plate in these frames, some at a time, and states its loads.
    fn read_plate(
        &self,
        input: &mut (impl Read + Seek),
        (place, plate): (usize, &Plate),
        frames: &[Option<Range<u64>>],
        window: &mut ForceWindow,
    ) -> Result<(), TakeError> {
        let piece = PIECE_VALUES / plate.columns.len().max(1) as u64;
        let (mut values, mut held, mut sample) = (Vec::new(), 0..0, Vec::new());
        let last = frames.iter().flatten().map(|range| range.end).max().unwrap_or(0);
        for (frame, range) in frames.iter().enumerate() {
            let Some(range) = range else { continue };
            let n_plates = self.plates.len();
            let Some(load) = window.loads.get_mut(frame * n_plates + place) else { continue };
            for number in range.clone() {
                if !held.contains(&number) {
                    held = number..number.saturating_add(piece).min(last);
                    values = self.read_values(input, plate, &held, &mut window.flags)?;
                }
                let n = (held.end - held.start) as usize;
                let at = (number - held.start) as usize;
                sample.clear();
                sample.extend(values.iter().skip(at).step_by(n.max(1)).copied());
                self.add_sample(plate, &sample, number == range.start, load);
            }
        }
        Ok(())
    }

    /// The values of the columns of a plate, column after column; NaN where there is no sample.
    fn read_values(
        &self,
        input: &mut (impl Read + Seek),
        plate: &Plate,
        numbers: &Range<u64>,
        flags: &mut u32,
    ) -> Result<Vec<f64>, TakeError> {
        let n = (numbers.end - numbers.start) as usize;
        let mut values = vec![f64::NAN; n * plate.columns.len()];
        for (index, group) in self.groups.iter().enumerate() {
            let columns = plate.columns.iter().enumerate();
            let of_group: Vec<_> = columns.filter(|(_, column)| column.group == index).collect();
            if of_group.is_empty() {
                continue;
            }
            group.read_range(input, numbers, |first, length, samples| {
                let Some(samples) = samples else {
                    *flags |= DAMAGED;
                    return Ok(());
                };
                let from = first.max(numbers.start);
                let to = (first + length).min(numbers.end);
                for (place, column) in &of_group {
                    let of_channel = column.channel as u64 * length;
                    for number in from..to {
                        let sample = samples.get((of_channel + number - first) as usize);
                        let value = values.get_mut(place * n + (number - numbers.start) as usize);
                        if let (Some(sample), Some(value)) = (sample, value) {
                            *value = (f64::from(*sample) - column.offset) * column.scale;
                        }
                    }
                }
                Ok(())
            })?;
        }
        Ok(values)
    }

    /// Adds a sample of a plate to the load of a frame: the first one is its load, and all are between its ends.
    fn add_sample(
        &self,
        plate: &Plate,
        sample: &[f64],
        is_first: bool,
        load: &mut [f32; LOAD_VALUES],
    ) {
        let nothing = [f64::NAN; 3];
        let (force, cop, free_moment, up) = match &plate.load {
            LoadOf::File(plate) => {
                let load = plate.load(sample);
                let normal = plate.geometry.axes()[2];
                let along = load.free_moment_nm.iter().zip(normal).map(|(m, z)| m * z).sum();
                (load.force_n, load.cop_mm, along, load.force_n[self.up])
            }
            // As the device sent them, in the plate's own axes.
            LoadOf::Recording => match sample {
                &[x, y, z, ..] => ([x, y, z], nothing, f64::NAN, z),
                _ => (nothing, nothing, f64::NAN, f64::NAN),
            },
        };
        if is_first {
            let [fx, fy, fz] = force;
            let [cx, cy, cz] = cop;
            let values = [fx, fy, fz, cx, cy, cz, free_moment, up, up];
            *load = values.map(|value: f64| value as f32);
        }
        let [.., least, largest] = load;
        (*least, *largest) = (least.min(up as f32), largest.max(up as f32));
    }
}

/// When the samples of a group were taken, by the frames of the take.
struct FrameClock<'a> {
    forces: &'a TakeForces,
    group: &'a GroupSamples,
    /// The recorded rows around, with their times.
    ticks: &'a [(u64, u64)],
    tick_hz: f64,
    ticks_each: f64,
}

/// A frame that was not recorded has the time that it was due, if one was recorded within this time of it.
const NEAR_S: f64 = 0.5;

impl<'a> FrameClock<'a> {
    fn new(forces: &'a TakeForces, group: &'a GroupSamples, ticks: &'a [(u64, u64)]) -> Self {
        let header = &forces.map.header;
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz.max(1)) as f64;
        Self { forces, group, ticks, tick_hz, ticks_each: tick_hz / header.rate_hz }
    }

    /// The number of the first sample that was taken with a frame or after it.
    fn number(&self, row: u64) -> Option<u64> {
        if let Some((ratio, first)) = self.forces.per_frame {
            let number = i128::from(row) * i128::from(ratio) + first;
            return u64::try_from(number).ok();
        }
        let after = self.ticks.partition_point(|(known, _)| *known <= row);
        let nearest = self.ticks.get(after.saturating_sub(1))?;
        let by = row as f64 - nearest.0 as f64;
        if by.abs() > NEAR_S * self.forces.map.header.rate_hz + 1.0 {
            return None;
        }
        let ticks = nearest.1.wrapping_add_signed((by * self.ticks_each).round() as i64);
        let since = |from: u64| ticks.wrapping_sub(from).cast_signed();
        // They ascend: those of a clock that began again have no forces.
        let anchors = self.group.anchors();
        let after = anchors.partition_point(|anchor| since(anchor.device_ticks) >= 0);
        let anchor = anchors.get(after.saturating_sub(1))?;
        let by = since(anchor.device_ticks) as f64 / self.tick_hz * self.group.group.rate_hz;
        // The times of samples are stated to a tick.
        let number = (anchor.number as f64 + by - TICK_SAMPLES).ceil();
        let is_in_run = number >= anchor.run_start as f64;
        let next = anchors.get(after).filter(|next| next.run_start != anchor.run_start);
        let is_before = next.is_none_or(|next| number <= next.run_start as f64);
        (is_in_run && is_before).then_some(number as u64)
    }
}

/// Samples by which a time may miss that of a sample.
const TICK_SAMPLES: f64 = 0.05;

/// The channel of a part of an imported file, by its index.
fn column_of(groups: &[GroupSamples], channels: &[AnalogChannel], index: usize) -> Option<Column> {
    let channel = channels.get(index)?;
    let (group, of) = groups.iter().enumerate().find(|(_, of)| {
        let first = of.group.first_channel as usize;
        (first..first + of.group.channels.len()).contains(&index)
    })?;
    let in_group = index - of.group.first_channel as usize;
    Some(Column { group, channel: in_group, scale: channel.scale, offset: channel.offset })
}

/// The times of the recorded rows among these, in ticks of the device's clock.
fn row_ticks(
    input: &mut (impl Read + Seek),
    map: &TakeMap,
    rows: &Range<u64>,
) -> Result<Vec<(u64, u64)>, TakeError> {
    let mut found = Vec::new();
    let mut take = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
    take.read_rows(rows, |take, part, _| {
        let Some(timeline) = take.timeline() else { return Ok(()) };
        let times = timeline.recorded().filter(|(row, _)| part.contains(row));
        found.extend(times.map(|(row, time)| (row, time.device_ticks)));
        Ok(())
    })?;
    Ok(found)
}

impl ForceWindow {
    /// The window as bytes, little endian: the four bytes `MPF1`, u32 number of plates, u64 first row, u32 number of frames,
    /// u32 rows from one frame to the next, u32 flags, u32 zero; then the frames, each nine f32 per plate: the force along
    /// x, y and z in newtons, the centre of pressure in millimetres, the free moment along the plate's z axis in newton metres, and the least and
    /// the largest upward force up to the next frame in newtons. NaN where there is none.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let n_frames = self.loads.len() as u64 / u64::from(self.n_plates.max(1));
        let mut out =
            Vec::with_capacity(HEADER_BYTES as usize + 4 * LOAD_VALUES * self.loads.len());
        let words = [self.n_plates, n_frames as u32, self.every, self.flags];
        put_header(&mut out, MAGIC, self.first_row, words);
        for value in self.loads.iter().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out
    }
}
