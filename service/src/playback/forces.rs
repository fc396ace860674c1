//! The forces of a take for a player: its force plates, and windows of their loads.
//!
//! The plates are those of the parameters of an imported C3D file, or those that a recording states. The samples of a recording
//! have the places among its frames that exports give them.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use mocapd_acquire::files;
use mocapd_take::{
    TakeError, TakeFrames, TakeMap,
    foreign::{
        analog::AnalogChannel,
        force_plates::{ForcePlate, ForcePlates},
    },
    interchange::plates_of_group,
    motion::{FrameSource, MotionInfo},
    sampled::{GroupSamples, PlaceIndex, SampleTimeLine},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::window::{
    DAMAGED, EVERY_MAX, HEADER_BYTES, SHORTENED, WINDOW_BYTES_MAX, WindowError, WindowRequest,
    put_header, rows_of,
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
    /// Its corners in millimetres, in the axes of the markers.
    pub corners_mm: [[f64; 3]; 4],
}

/// A plate, and where the values of its channels come from.
#[derive(Debug, Clone)]
struct Plate {
    /// By quantity, its column: six, or up to eight.
    columns: Vec<Column>,
    plate: ForcePlate,
}

/// A channel of a group of sampled channels.
#[derive(Debug, Clone, Copy)]
struct Column {
    /// The index of the group.
    group: usize,
    /// The channel in the group.
    channel: usize,
    scale: f64,
    offset: f64,
}

/// The samples of the plates.
#[derive(Debug, Clone)]
enum PlateSamples {
    /// Those of an imported file: samples in a frame, and the sample of the first frame.
    File { groups: Vec<GroupSamples>, per_frame: u64, first: i128 },
    /// Those of a recording, with an index by group that has plates.
    Recording { line: Box<SampleTimeLine>, indices: Vec<Option<PlaceIndex>> },
}

/// Samples one after another of a frame of a window.
#[derive(Debug, Clone)]
struct FramePiece {
    /// The frame in the window.
    frame: usize,
    numbers: Range<u64>,
    /// Whether its first sample is the load of the frame.
    begins: bool,
}

/// The force plates of a take, and where their samples are.
#[derive(Debug, Clone)]
pub struct TakeForces {
    map: TakeMap,
    samples: PlateSamples,
    plates: Vec<Plate>,
    unusable: Vec<String>,
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
    /// Reads the take for its plates, without decoding anything but times.
    ///
    /// # Errors
    /// Those of the reader.
    pub fn open(mut input: impl Read + Seek) -> Result<Self, TakeError> {
        let frames = TakeFrames::open_with(&mut input, |kind| kind == PARAMETERS, files::scratch)?;
        let map = frames.map().clone();
        let up = frames.info().up.index().unwrap_or(2);
        let samples = PlateSamples::File { groups: Vec::new(), per_frame: 1, first: 0 };
        let (plates, unusable) = (Vec::new(), Vec::new());
        let mut forces = Self { map, samples, plates, unusable, up };
        forces.add_plates_of_file(frames.info())?;
        drop(frames);
        if forces.plates.is_empty() {
            forces.add_plates_of_recording(input)?;
        }
        let others = forces.plates.iter().skip(PLATES_MAX);
        let others: Vec<String> = others
            .map(|Plate { plate, .. }| {
                format!("{}: a player shows {PLATES_MAX} plates", plate.number)
            })
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
        let first_sample = before * i128::from(ratio);
        for plate in found.plates {
            let column = |index: &usize| column_of(&groups, &channels, *index);
            let Some(columns) = plate.channels.iter().map(column).collect() else { continue };
            self.plates.push(Plate { columns, plate });
        }
        self.samples = PlateSamples::File { groups, per_frame: ratio, first: first_sample };
        Ok(())
    }

    fn add_plates_of_recording(&mut self, input: impl Read + Seek) -> Result<(), TakeError> {
        let (plates, unusable) = self.map.force_plates();
        self.unusable.extend(unusable);
        if plates.is_empty() {
            return Ok(());
        }
        // Residuals, of which there are many, are not looked at.
        let line = SampleTimeLine::read_groups(input, &self.map, |group| !group.has_residuals())?;
        let mut indices = Vec::new();
        for (group, of) in line.groups().iter().enumerate() {
            let found = plates_of_group(&plates, &of.group);
            indices.push(if found.is_empty() { None } else { line.index(group) });
            for plate in found {
                let column = |channel: &usize| {
                    let of = of.group.channels.get(*channel)?;
                    Some(Column { group, channel: *channel, scale: of.scale, offset: of.offset })
                };
                let Some(columns) = plate.channels.iter().map(column).collect() else { continue };
                self.plates.push(Plate { columns, plate });
            }
        }
        self.samples = PlateSamples::Recording { line: Box::new(line), indices };
        Ok(())
    }

    fn groups(&self) -> &[GroupSamples] {
        match &self.samples {
            PlateSamples::File { groups, .. } => groups,
            PlateSamples::Recording { line, .. } => line.groups(),
        }
    }

    /// The plates.
    #[must_use]
    pub fn list(&self) -> PlateList {
        let overview = |Plate { plate, .. }: &Plate| PlateOverview {
            name: plate.number.to_string(),
            corners_mm: plate.geometry.corners_mm(),
        };
        PlateList {
            plates: self.plates.iter().map(overview).collect(),
            window_frames_max: self.frames_max(),
            unusable: self.unusable.clone(),
        }
    }

    /// Entries that it holds in memory: key stretches, channels, blocks of samples, and times.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        let of_samples = match &self.samples {
            PlateSamples::File { groups, .. } => groups.iter().map(GroupSamples::n_chunks).sum(),
            PlateSamples::Recording { line, indices } => {
                let of_indices = indices.iter().flatten().map(PlaceIndex::n_entries);
                line.n_entries() + of_indices.sum::<usize>()
            }
        };
        self.map.keys.len() + self.map.channels.len() + of_samples
    }

    fn frames_max(&self) -> u64 {
        (WINDOW_BYTES_MAX - HEADER_BYTES) / (4 * LOAD_VALUES * self.plates.len().max(1)) as u64
    }

    /// Values of all plates in a frame.
    fn values_per_frame(&self) -> f64 {
        let of_plate = |plate: &Plate| {
            let group = plate.columns.first().and_then(|column| self.groups().get(column.group));
            let samples = match &self.samples {
                PlateSamples::File { per_frame, .. } => *per_frame as f64,
                PlateSamples::Recording { .. } => {
                    group.map_or(0.0, |of| of.group.rate_hz) / self.map.header.rate_hz
                }
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
        let mut work_left = COLUMN_VALUES_MAX as u64;
        // The plates of a recording follow each other by group.
        let (mut of_group, mut pieces) = (None, Vec::new());
        for (place, plate) in self.plates.iter().enumerate() {
            let group = plate.columns.first().map(|column| column.group);
            if of_group.is_none() || of_group != group {
                pieces = self.pieces(plate, &rows, every, (&mut window.flags, &mut work_left))?;
                of_group = group;
            }
            let n: u64 = pieces.iter().map(|piece| piece.numbers.end - piece.numbers.start).sum();
            let values = n.saturating_mul(plate.columns.len() as u64);
            work_left = work_left.checked_sub(values).ok_or(WindowError::TooMuchWork)?;
            self.read_plate(input, (place, plate), &pieces, &mut window)?;
        }
        Ok(window)
    }

    /// The samples of a plate in the frames of a window, in ascending order.
    fn pieces(
        &self,
        plate: &Plate,
        rows: &Range<u64>,
        every: u64,
        (flags, work_left): (&mut u32, &mut u64),
    ) -> Result<Vec<FramePiece>, WindowError> {
        let group = plate.columns.first().map_or(0, |column| column.group);
        let mut pieces: Vec<FramePiece> = Vec::new();
        match &self.samples {
            PlateSamples::File { groups, per_frame, first } => {
                let n_samples = groups.iter().map(GroupSamples::n_samples).min().unwrap_or(0);
                let number = |row: u64| i128::from(row) * i128::from(*per_frame) + first;
                // Before the first sample there is none, and behind the last.
                let stored = |number: i128| number.clamp(0, n_samples.into()) as u64;
                for (frame, row) in (rows.start..rows.end).step_by(every as usize).enumerate() {
                    let end = row.saturating_add(every).min(rows.end);
                    let numbers = stored(number(row))..stored(number(end));
                    let begins = number(row) >= 0;
                    pieces.extend((!numbers.is_empty()).then_some(FramePiece {
                        frame,
                        numbers,
                        begins,
                    }));
                }
            }
            PlateSamples::Recording { line, indices } => {
                let index = indices.get(group).and_then(Option::as_ref);
                let Some((index, clock)) = index.zip(line.clock(group)) else { return Ok(pieces) };
                let mut is_too_much = false;
                let has_lost = index.in_rows(clock, rows, |number, row| {
                    is_too_much = *work_left == 0;
                    *work_left = work_left.saturating_sub(1);
                    if let Some(row) = row {
                        put_sample(&mut pieces, (number, row - rows.start), every);
                    }
                    !is_too_much
                });
                if is_too_much {
                    return Err(WindowError::TooMuchWork);
                }
                *flags |= if has_lost { DAMAGED } else { 0 };
            }
        }
        Ok(pieces)
    }

    /// Reads the samples of a plate, some at a time, and states its loads.
    fn read_plate(
        &self,
        input: &mut (impl Read + Seek),
        (place, plate): (usize, &Plate),
        pieces: &[FramePiece],
        window: &mut ForceWindow,
    ) -> Result<(), TakeError> {
        let n_max = PIECE_VALUES / plate.columns.len().max(1) as u64;
        let (mut values, mut held, mut sample) = (Vec::new(), 0..0, Vec::new());
        for (i, piece) in pieces.iter().enumerate() {
            let at = piece.frame * self.plates.len() + place;
            for number in piece.numbers.clone() {
                if !held.contains(&number) {
                    let end = end_of_run(pieces.get(i..).unwrap_or_default(), number + n_max);
                    held = number..end;
                    values = self.read_values(input, plate, &held, &mut window.flags)?;
                }
                let n = (held.end - held.start) as usize;
                let within = (number - held.start) as usize;
                sample.clear();
                sample.extend(values.iter().skip(within).step_by(n.max(1)).copied());
                let is_first = piece.begins && number == piece.numbers.start;
                if let Some(load) = window.loads.get_mut(at) {
                    self.add_sample(plate, &sample, is_first, load);
                }
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
        for (index, group) in self.groups().iter().enumerate() {
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
        let found = plate.plate.load(sample);
        let normal = plate.plate.geometry.axes()[2];
        let free_moment = found.free_moment_nm.iter().zip(normal).map(|(m, z)| m * z).sum();
        let up = found.force_n[self.up];
        if is_first {
            let [fx, fy, fz] = found.force_n;
            let [cx, cy, cz] = found.cop_mm;
            let values = [fx, fy, fz, cx, cy, cz, free_moment, up, up];
            *load = values.map(|value: f64| value as f32);
        }
        let [.., least, largest] = load;
        (*least, *largest) = (least.min(up as f32), largest.max(up as f32));
    }
}

/// Adds a sample of a row of a window to its frames.
fn put_sample(pieces: &mut Vec<FramePiece>, (number, row): (u64, u64), every: u64) {
    let frame = (row / every) as usize;
    match pieces.last_mut() {
        Some(last) if last.frame == frame && last.numbers.end == number => last.numbers.end += 1,
        last => {
            let begins = row % every == 0 && last.is_none_or(|last| last.frame != frame);
            pieces.push(FramePiece { frame, numbers: number..number + 1, begins });
        }
    }
}

/// The end of the samples that follow each other from the first piece on, at most `end_max`.
fn end_of_run(pieces: &[FramePiece], end_max: u64) -> u64 {
    let mut end = pieces.first().map_or(end_max, |first| first.numbers.end);
    for next in pieces.iter().skip(1) {
        if next.numbers.start != end || end >= end_max {
            break;
        }
        end = next.numbers.end;
    }
    end.min(end_max)
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
