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

/// Values of channels that are decoded at once, in 4 MiB.
const PIECE_VALUES: u64 = 1 << 19;

/// Maximum number of values of channels that a window is made of: about a tenth of a second of work.
const WINDOW_VALUES_MAX: u64 = 1 << 22;

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
            let channels = &of.group.channels;
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

    /// Samples of a frame.
    fn samples_per_frame(&self) -> f64 {
        let of_groups = || self.groups.iter().map(|of| of.group.rate_hz).fold(1.0, f64::max);
        match self.per_frame {
            Some((ratio, _)) => ratio as f64,
            None => of_groups() / self.map.header.rate_hz,
        }
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
        let every = request.every.clamp(1, EVERY_MAX);
        let n_values = self.samples_per_frame() * self.n_columns().max(1) as f64;
        let worked_max = (WINDOW_VALUES_MAX as f64 / n_values) as u64;
        let rows_max = self.frames_max().saturating_mul(every.into());
        let rows_max = rows_max.min(worked_max.next_multiple_of(every.into())).max(1);
        let end = rows.end.min(rows.start.saturating_add(rows_max));
        let mut window = ForceWindow {
            n_plates: self.plates.len() as u32,
            first_row: rows.start,
            every,
            flags: if end < rows.end { SHORTENED } else { 0 },
            loads: Vec::new(),
        };
        if self.plates.is_empty() {
            return Ok(window);
        }
        let piece = (PIECE_VALUES as f64 / n_values) as u64;
        let piece = piece.next_multiple_of(every.into()).max(every.into());
        let mut at = rows.start;
        while at < end {
            let next = at.saturating_add(piece).min(end);
            self.read_piece(input, at..next, &mut window)?;
            at = next;
        }
        Ok(window)
    }

    fn n_columns(&self) -> usize {
        self.plates.iter().map(|plate| plate.columns.len()).sum()
    }

    fn read_piece(
        &self,
        input: &mut (impl Read + Seek),
        rows: Range<u64>,
        window: &mut ForceWindow,
    ) -> Result<(), TakeError> {
        let numbers = self.sample_numbers(input, &rows, window.every)?;
        let (Some(first), Some(last)) = (numbers.first(), numbers.last()) else {
            let n_frames = (rows.end - rows.start).div_ceil(window.every.into()) as usize;
            let unknown =
                std::iter::repeat_n([f32::NAN; LOAD_VALUES], n_frames * self.plates.len());
            window.loads.extend(unknown);
            window.flags |= DAMAGED;
            return Ok(());
        };
        let (first, end) = (*first, (*last).max(first + 1));
        let values = self.read_values(input, first..end, &mut window.flags)?;
        let n_samples = (end - first) as usize;
        for pair in numbers.windows(2) {
            let &[from, to] = pair else { continue };
            // The samples may end before the frames.
            let from_sample = ((from - first) as usize).min(n_samples);
            let to_sample = ((to - first) as usize).max(from_sample + 1).min(n_samples);
            let samples = from_sample..to_sample;
            let mut column = 0;
            for plate in &self.plates {
                let of_plate = values.get(column * n_samples..).unwrap_or_default();
                window.loads.push(self.load(plate, of_plate, n_samples, samples.clone()));
                column += plate.columns.len();
            }
        }
        Ok(())
    }

    /// By frame that a window has, the number of its first sample; and one more for the end. Nothing if no frame among these was
    /// recorded: then it is unknown when they were due.
    fn sample_numbers(
        &self,
        input: &mut (impl Read + Seek),
        rows: &Range<u64>,
        every: u32,
    ) -> Result<Vec<u64>, TakeError> {
        let n_frames = (rows.end - rows.start).div_ceil(every.into());
        let frames = (0..n_frames).map(|i| rows.start + i * u64::from(every)).chain([rows.end]);
        if let Some((ratio, first)) = self.per_frame {
            let number = |row: u64| i128::from(row) * i128::from(ratio) + first;
            return Ok(frames.map(|row| u64::try_from(number(row)).unwrap_or_default()).collect());
        }
        let tick_hz = self.map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1));
        let ticks_each = tick_hz as f64 / self.map.header.rate_hz;
        let known = row_ticks(input, &self.map, rows)?;
        if known.is_empty() {
            return Ok(Vec::new());
        }
        // Of a lost frame, by the nearest recorded one.
        let ticks = |row: u64| {
            let after = known.partition_point(|(known, _)| *known <= row);
            let nearest = known.get(after.saturating_sub(1)).or(known.first())?;
            let by = (row as f64 - nearest.0 as f64) * ticks_each;
            Some(nearest.1.wrapping_add_signed(by.round() as i64))
        };
        let group = self.plates.first().and_then(|plate| plate.columns.first());
        let Some(group) = group.and_then(|column| self.groups.get(column.group)) else {
            return Ok(Vec::new());
        };
        let mut numbers: Vec<u64> = frames
            .map(|row| ticks(row).map_or(0, |ticks| number_at(group, ticks, tick_hz)))
            .collect();
        // Clocks that jump must not make them run back.
        for i in 1..numbers.len() {
            numbers[i] = numbers[i].max(numbers[i - 1]);
        }
        // A piece of many samples for few frames would need more memory than its bound: the clock jumped.
        let most = (self.samples_per_frame() * (rows.end - rows.start + 2) as f64) as u64 + 2;
        let end = numbers.first().map_or(0, |first| first.saturating_add(most));
        numbers.iter_mut().for_each(|number| *number = (*number).min(end));
        Ok(numbers)
    }

    /// The values of the columns of all plates, column after column; NaN where there is no sample.
    fn read_values(
        &self,
        input: &mut (impl Read + Seek),
        numbers: Range<u64>,
        flags: &mut u32,
    ) -> Result<Vec<f64>, TakeError> {
        let n = (numbers.end - numbers.start) as usize;
        let columns: Vec<Column> =
            self.plates.iter().flat_map(|plate| plate.columns.iter().copied()).collect();
        let mut values = vec![f64::NAN; n * columns.len()];
        for (index, group) in self.groups.iter().enumerate() {
            let of_group: Vec<(usize, Column)> = columns.iter().copied().enumerate().collect();
            let of_group: Vec<_> =
                of_group.into_iter().filter(|(_, column)| column.group == index).collect();
            if of_group.is_empty() {
                continue;
            }
            group.read_range(input, &numbers, |first, length, samples| {
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

    /// The load in the first of the samples, with the least and the largest upward force of all of them. `values` are the
    /// columns of the plate, of `n` samples each.
    fn load(
        &self,
        plate: &Plate,
        values: &[f64],
        n: usize,
        samples: Range<usize>,
    ) -> [f32; LOAD_VALUES] {
        let at = |sample: usize| -> [[f64; 3]; 3] {
            let value =
                |column: usize| values.get(column * n + sample).copied().unwrap_or(f64::NAN);
            let of_sample: Vec<f64> = (0..plate.columns.len()).map(value).collect();
            match &plate.load {
                LoadOf::File(plate) => {
                    let load = plate.load(&of_sample);
                    [load.force_n, load.cop_mm, load.free_moment_nm]
                }
                LoadOf::Recording => {
                    let force = std::array::from_fn(|axis| of_sample[axis]);
                    [force, [f64::NAN; 3], [f64::NAN; 3]]
                }
            }
        };
        let [force, cop, free_moment] =
            if samples.is_empty() { [[f64::NAN; 3]; 3] } else { at(samples.start) };
        let mut ends = [f64::NAN; 2];
        for sample in samples {
            let up = at(sample)[0][self.up];
            ends = [ends[0].min(up), ends[1].max(up)];
        }
        let [fx, fy, fz] = force;
        let [cx, cy, cz] = cop;
        [fx, fy, fz, cx, cy, cz, free_moment[self.up], ends[0], ends[1]].map(|value| value as f32)
    }
}

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

/// The number of the sample of a group at a time of the device's clock, by the nearest stated time before it.
fn number_at(group: &GroupSamples, ticks: u64, tick_hz: u64) -> u64 {
    let since = |from: u64| ticks.wrapping_sub(from).cast_signed();
    let anchors = group.anchors();
    let after = anchors.partition_point(|anchor| since(anchor.device_ticks) >= 0);
    let Some(anchor) = anchors.get(after.saturating_sub(1)) else { return 0 };
    let by = since(anchor.device_ticks) as f64 / tick_hz as f64 * group.group.rate_hz;
    let number = anchor.number as f64 + by.round();
    (number.max(0.0) as u64).min(group.n_samples())
}

impl ForceWindow {
    /// The window as bytes, little endian: the four bytes `MPF1`, u32 number of plates, u64 first row, u32 number of frames,
    /// u32 rows from one frame to the next, u32 flags, u32 zero; then the frames, each nine f32 per plate: the force along
    /// x, y and z in newtons, the centre of pressure in millimetres, the free moment in newton metres, and the least and
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
