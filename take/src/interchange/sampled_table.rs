//! The sampled channels of a take as tables for export: the analog channels of a C3D file, or the groups of a recording,
//! the loads of force plates, and the poses of rigid bodies. A table has a row for each sample, with a time of its own. The
//! rows of an imported file
//! start at the first frame and follow at the analog rate; [`Recording`] says when those of a recording were taken.

use std::io::{self, Write};

use super::{
    Result, c3d,
    csv::quote,
    recorded_rows::{
        ABOUT_STATE, FramePoses, RecordedRows, STATE, as_analog, body_names, recorded_plates,
    },
    text::{unique_names, without_tabs},
};
use crate::{
    TakeError,
    foreign::{
        analog::{AnalogChannel, AnalogSamples},
        force_plates::{Baseline, ForcePlate, PlateLoad, PlateLoads},
    },
    motion::{FrameSource, MotionInfo},
    poses::{CHANNEL_NAMES, CHANNEL_UNITS},
    sampled::Recording,
};

/// The quantities of a force plate's load, each along x, y and z, with their units.
const QUANTITIES: [(&str, &str); 4] =
    [("force", "N"), ("moment", "N m"), ("cop", "mm"), ("free_moment", "N m")];

/// The name of the column of times.
pub(super) const TIME_COLUMN: &str = "time_s";

/// Values of a recording that are held at once, at least: a take may have any number of samples before its first frame.
const VALUES_AT_ONCE: usize = 1 << 14;

/// Bytes of a text table that are written at once.
const BUFFER_BYTES: usize = 1 << 16;

/// What a table holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampledKind {
    /// The analog channels, in the units that the file states.
    Analog,
    /// The channels of a recording's group with this number, in their units.
    Group(u32),
    /// The loads of the force plates that can be used: force, moment about the centre of the surface, centre of pressure
    /// and free moment, in laboratory axes. With a number they are the plates whose channels are in this group of a
    /// recording, if several groups have such channels.
    ForcePlates(Option<u32>),
    /// The poses of the rigid bodies of a recording, a row for each frame.
    Poses,
}

impl SampledKind {
    /// Its content, as text for the user.
    #[must_use]
    pub fn description(self) -> String {
        match self {
            Self::Analog => "the analog channels".to_owned(),
            Self::Group(number) => format!("group {number} of sampled channels"),
            Self::ForcePlates(None) => "the loads of the force plates".to_owned(),
            Self::ForcePlates(Some(number)) => {
                format!("the loads of the force plates of group {number}")
            }
            Self::Poses => "the poses of rigid bodies".to_owned(),
        }
    }

    /// Its name in files: `analog`, `sampled_0`, `force_plates` or `poses`.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Analog => "analog".to_owned(),
            Self::Group(number) => format!("sampled_{number}"),
            Self::ForcePlates(None) => "force_plates".to_owned(),
            Self::ForcePlates(Some(number)) => format!("force_plates_{number}"),
            Self::Poses => "poses".to_owned(),
        }
    }

    /// The name of the message type of a row in MCAP and in live streams.
    #[must_use]
    pub fn message_name(self) -> String {
        match self {
            Self::Analog => "mocapd.Analog".to_owned(),
            Self::Group(number) => format!("mocapd.Sampled{number}"),
            Self::ForcePlates(None) => "mocapd.ForcePlates".to_owned(),
            Self::ForcePlates(Some(number)) => format!("mocapd.ForcePlates{number}"),
            Self::Poses => "mocapd.Poses".to_owned(),
        }
    }

    /// The kind with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let number = |text: &str| text.parse().ok();
        let kind = match name {
            "analog" => Self::Analog,
            "force_plates" => Self::ForcePlates(None),
            "poses" => Self::Poses,
            _ => match (name.strip_prefix("sampled_"), name.strip_prefix("force_plates_")) {
                (Some(text), _) => Self::Group(number(text)?),
                (_, Some(text)) => Self::ForcePlates(Some(number(text)?)),
                _ => return None,
            },
        };
        // Not `sampled_07`.
        Some(kind).filter(|kind| kind.name() == name)
    }

    /// Whether the rows are loads of force plates.
    #[must_use]
    pub fn is_of_plates(self) -> bool {
        matches!(self, Self::ForcePlates(_))
    }
}

/// When a row was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableRowTime {
    /// In frames from the first one.
    pub frames: f64,
    /// In seconds from the first frame.
    pub time_s: f64,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampledColumn {
    /// A name that no other column of the table has: the channel's, or such as `force_plate_1.force_x_n`.
    pub name: String,
    /// The unit of the values; may be empty.
    pub unit: String,
    /// A description; may be empty.
    pub description: String,
}

/// The rows of a table, read in blocks of frames, in bounded memory.
#[derive(Debug)]
pub struct SampledTable<'a> {
    kind: SampledKind,
    columns: Vec<SampledColumn>,
    rate_hz: f64,
    samples_per_frame: usize,
    n_frames: u64,
    source: TableSource<'a>,
    /// The rows of the current block, and the index of the next value in them.
    block: Vec<f32>,
    next: usize,
    /// Frames whose rows were read, and the times of the rows of the last one.
    n_read: u64,
    times: Vec<TableRowTime>,
    warnings: Vec<String>,
}

/// Where the rows of a table come from, with a buffer for a block of them.
#[derive(Debug)]
enum TableSource<'a> {
    Analog(Box<AnalogSamples<'a>>, Vec<f64>),
    ForcePlates(Box<PlateLoads<'a>>, Vec<PlateLoad>),
    Recorded(Box<RecordedRows<'a>>),
    Poses(Box<FramePoses<'a>>),
}

impl<'a> SampledTable<'a> {
    /// The tables of a take, or of a part of one: none, the analog channels, these and the force plates, and poses. What
    /// cannot be read, because the take is damaged, has no table.
    ///
    /// # Errors
    /// Those of the scratch file that the samples may be in.
    pub fn all(info: &'a MotionInfo) -> io::Result<Vec<Self>> {
        let analog = readable(AnalogSamples::open(info))?.map(|samples| {
            let columns = analog_columns(samples.channels());
            let (rate_hz, ratio) = (samples.rate_hz(), samples.samples_per_frame());
            let source = TableSource::Analog(Box::new(samples), Vec::new());
            Self::new(SampledKind::Analog, columns, (rate_hz, ratio), info.n_frames, source)
        });
        let loads = readable(PlateLoads::open(info, Baseline::AsStored))?;
        let plates = loads.filter(|loads| !loads.plates().plates.is_empty()).map(|loads| {
            let columns = plate_columns(&loads.plates().plates);
            let (rate_hz, ratio) = (loads.rate_hz(), loads.samples_per_frame());
            let source = TableSource::ForcePlates(Box::new(loads), Vec::new());
            Self::new(
                SampledKind::ForcePlates(None),
                columns,
                (rate_hz, ratio),
                info.n_frames,
                source,
            )
        });
        let mut all: Vec<Self> = analog.into_iter().chain(plates).collect();
        if let Some(recording) = &info.recording {
            all.extend(Self::all_recorded(info, recording)?);
        }
        all.extend(FramePoses::open(info).map(|poses| {
            let (columns, source) = (pose_columns(info), TableSource::Poses(Box::new(poses)));
            Self::new(SampledKind::Poses, columns, (info.rate_hz, 1), info.n_frames, source)
        }));
        Ok(all)
    }

    /// The tables of a recording's groups, then those of its force plates.
    fn all_recorded(info: &'a MotionInfo, recording: &'a Recording) -> io::Result<Vec<Self>> {
        let groups = recording.groups().iter().enumerate();
        let n_with_plates = groups
            .clone()
            .filter(|(index, _)| !recorded_plates(recording, *index).is_empty())
            .count();
        let (mut of_channels, mut of_plates) = (Vec::new(), Vec::new());
        for (index, found) in groups {
            let number = found.group.number;
            let table = |kind, columns, plates| {
                let rows =
                    RecordedRows::new(info, recording, index, plates).map_err(io::Error::other)?;
                let shape = (found.group.rate_hz, 0);
                let source = TableSource::Recorded(Box::new(rows));
                Ok::<_, io::Error>(Self::new(kind, columns, shape, info.n_frames, source))
            };
            let channels: Vec<AnalogChannel> = found.group.channels.iter().map(as_analog).collect();
            let channels =
                table(SampledKind::Group(number), analog_columns(&channels), Vec::new())?;
            of_channels.push(channels);
            let plates = recorded_plates(recording, index);
            if !plates.is_empty() {
                let kind = SampledKind::ForcePlates(Some(number).filter(|_| n_with_plates > 1));
                of_plates.push(table(kind, plate_columns(&plates), plates)?);
            }
        }
        if let Some(first) = of_channels.first_mut() {
            first.warnings.extend(c3d::warnings_of(recording));
        }
        Ok(of_channels.into_iter().chain(of_plates).collect())
    }

    fn new(
        kind: SampledKind,
        columns: Vec<SampledColumn>,
        (rate_hz, samples_per_frame): (f64, usize),
        n_frames: u64,
        source: TableSource<'a>,
    ) -> Self {
        let (block, times, next, n_read) = (Vec::new(), Vec::new(), 0, 0);
        let warnings = match &source {
            TableSource::Analog(samples, _) => samples.warnings().to_vec(),
            TableSource::ForcePlates(loads, _) => loads.plates().warnings.clone(),
            TableSource::Recorded(_) | TableSource::Poses(_) => Vec::new(),
        };
        Self {
            kind,
            columns,
            rate_hz,
            samples_per_frame,
            n_frames,
            source,
            block,
            next,
            n_read,
            times,
            warnings,
        }
    }

    /// What the table holds.
    #[must_use]
    pub fn kind(&self) -> SampledKind {
        self.kind
    }

    /// The columns, in order.
    #[must_use]
    pub fn columns(&self) -> &[SampledColumn] {
        &self.columns
    }

    /// Changes the names of the columns.
    pub fn rename(&mut self, change: impl FnMut(&mut String)) {
        self.columns.iter_mut().map(|column| &mut column.name).for_each(change);
    }

    /// Rows in a second; of a recording, as the device states it.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Number of rows.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        match &self.source {
            TableSource::Recorded(rows) => rows.n_rows(),
            _ => self.n_frames.saturating_mul(self.samples_per_frame as u64),
        }
    }

    /// Whether the rows are those of a recording, which have times of their own.
    #[must_use]
    pub fn is_recorded(&self) -> bool {
        matches!(self.source, TableSource::Recorded(_))
    }

    /// The times of all rows in order, in seconds from the first frame.
    #[must_use]
    pub fn times_s(&self) -> Box<dyn Iterator<Item = f64> + '_> {
        match &self.source {
            TableSource::Recorded(rows) => Box::new(rows.times_s()),
            _ => Box::new((0..self.n_rows()).map(|index| index as f64 / self.rate_hz)),
        }
    }

    /// Rows in a second by their times: of a recording from the first to the last one.
    #[must_use]
    pub fn measured_rate_hz(&self) -> f64 {
        let (mut times, n) = (self.times_s(), self.n_rows());
        let ends = times.next().zip(times.last());
        let span_s = ends.map_or(0.0, |(first, last)| last - first);
        if !self.is_recorded() || span_s <= 0.0 { self.rate_hz } else { (n - 1) as f64 / span_s }
    }

    /// The force plates; none in other tables.
    #[must_use]
    pub fn plates(&self) -> &[ForcePlate] {
        match &self.source {
            TableSource::Analog(..) | TableSource::Poses(_) => &[],
            TableSource::ForcePlates(loads, _) => &loads.plates().plates,
            TableSource::Recorded(rows) => rows.plates(),
        }
    }

    /// What the file leaves open, and how it was read, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The next rows of the frames up to number `frame`, from 0, one after another, rounded once to f32, and their times;
    /// NaN where there is no sample, or a plate has no centre of pressure. `None` if there are no more of these frames: call
    /// it again until then. The rows of a recording before the first frame and after the last one are with these.
    ///
    /// # Errors
    /// Those of reading the take, or the scratch file that the samples may be in.
    pub fn next_rows(&mut self, frame: u64) -> io::Result<Option<(&[f32], &[TableRowTime])>> {
        self.times.clear();
        if let TableSource::Recorded(rows) = &mut self.source {
            self.block.clear();
            let is_last = frame.saturating_add(1) >= self.n_frames;
            let end = if is_last { f64::INFINITY } else { frame as f64 + 1.0 };
            while self.block.len() < VALUES_AT_ONCE
                && let Some(frames) = rows.peek()?.filter(|frames| *frames < end)
            {
                let time_s = rows.take(&mut self.block);
                self.times.push(TableRowTime { frames, time_s });
            }
            let found = Some((&self.block[..], &self.times[..]));
            return Ok(found.filter(|(_, times)| !times.is_empty()));
        }
        if self.n_read > frame || self.n_read >= self.n_frames {
            return Ok(None);
        }
        let frame = self.n_read;
        self.n_read += 1;
        if self.next >= self.block.len() {
            self.read_block()?;
        }
        let n = (self.samples_per_frame * self.columns.len()).min(self.block.len() - self.next);
        let from = self.next;
        self.next += n;
        let ratio = self.samples_per_frame as u64;
        let (n_rows, rate_hz) = (n / self.columns.len().max(1), self.rate_hz);
        self.times.extend((0..n_rows as u64).map(|sample| TableRowTime {
            frames: frame as f64 + sample as f64 / ratio as f64,
            time_s: (frame * ratio + sample) as f64 / rate_hz,
        }));
        Ok(Some((self.block.get(from..from + n).unwrap_or(&[]), &self.times)))
    }

    /// The next rows of any frame, as [`next_rows`](Self::next_rows); `None` at the end.
    ///
    /// # Errors
    /// Those of [`next_rows`](Self::next_rows).
    pub fn next_any(&mut self) -> io::Result<Option<(&[f32], &[TableRowTime])>> {
        self.next_rows(self.n_frames.saturating_sub(1))
    }

    fn read_block(&mut self) -> io::Result<()> {
        self.block.clear();
        self.next = 0;
        match &mut self.source {
            TableSource::Analog(samples, values) => {
                samples.next_block(values)?;
                self.block.extend(values.iter().map(|&value| value as f32));
            }
            TableSource::ForcePlates(loads, block) => {
                loads.next_block(block)?;
                let values = block.iter().flat_map(PlateLoad::values);
                self.block.extend(values.map(|value| value as f32));
            }
            TableSource::Poses(poses) => poses.next_row(&mut self.block)?,
            TableSource::Recorded(_) => {}
        }
        Ok(())
    }

    /// Calls `put` for every row that is left, with its time; `frames` counts the frames for a display of progress.
    ///
    /// # Errors
    /// Those of reading, and of `put`.
    pub fn for_each_row(
        &mut self,
        frames: &dyn FrameSource,
        mut put: impl FnMut(TableRowTime, &[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let width = self.columns.len().max(1);
        for frame in 0..self.n_frames {
            while let Some((rows, times)) = self.next_rows(frame)? {
                for (row, time) in rows.chunks_exact(width).zip(times) {
                    put(*time, row)?;
                }
            }
            frames.count_sampled(1);
        }
        Ok(())
    }

    /// Writes the table as CSV: the column names with their units, then a line for each row, with its time from the first
    /// frame in seconds; a missing value is an empty cell.
    pub(super) fn write_csv(
        &mut self,
        frames: &dyn FrameSource,
        out: &mut dyn Write,
    ) -> Result<()> {
        let mut header = TIME_COLUMN.to_owned();
        for SampledColumn { name, unit, .. } in &self.columns {
            // The names of loads end in their units.
            let unit = Some(unit).filter(|unit| !self.kind.is_of_plates() && !unit.is_empty());
            let unit = unit.map_or_else(String::new, |unit| format!(" ({unit})"));
            header = format!("{header},{}", quote(&format!("{name}{unit}")));
        }
        writeln!(out, "{header}")?;
        self.write_text(frames, out, ("", b','), |line, time_s| {
            write!(line, "{time_s}")?;
            line.push(b',');
            Ok(())
        })
    }

    /// Writes a line of text for each row: what `begin` appends for its time in seconds, and the values. A value that is missing is
    /// `cells.0`, and `cells.1` separates values.
    pub(super) fn write_text(
        &mut self,
        frames: &dyn FrameSource,
        out: &mut dyn Write,
        (missing, separator): (&str, u8),
        begin: impl Fn(&mut Vec<u8>, f64) -> io::Result<()>,
    ) -> Result<()> {
        let mut lines = Vec::new();
        self.for_each_row(frames, |time, row| {
            begin(&mut lines, time.time_s)?;
            for (column, value) in row.iter().enumerate() {
                lines.extend((column > 0).then_some(separator));
                if value.is_finite() {
                    write!(lines, "{value}")?;
                } else {
                    lines.extend(missing.bytes());
                }
            }
            lines.push(b'\n');
            if lines.len() >= BUFFER_BYTES {
                out.write_all(&lines)?;
                lines.clear();
            }
            Ok(())
        })?;
        out.write_all(&lines)?;
        Ok(out.flush()?)
    }
}

/// What could be opened; `None` if its part of the take is damaged or was not read.
fn readable<T>(opened: std::result::Result<Option<T>, TakeError>) -> io::Result<Option<T>> {
    match opened {
        Ok(found) => Ok(found),
        Err(TakeError::Io(error)) => Err(error),
        Err(_) => Ok(None),
    }
}

fn analog_columns(channels: &[AnalogChannel]) -> Vec<SampledColumn> {
    let text = |text: &str| without_tabs(text).trim().to_owned();
    // Tables have the times of rows in a column before these.
    let names = channels.iter().map(|channel| text(&channel.name));
    let names = unique_names(std::iter::once(TIME_COLUMN.to_owned()).chain(names));
    let columns = names.into_iter().skip(1).zip(channels).map(|(name, channel)| SampledColumn {
        name,
        unit: text(&channel.unit),
        description: text(&channel.description),
    });
    columns.collect()
}

/// The columns of the bodies of a recording.
fn pose_columns(info: &MotionInfo) -> Vec<SampledColumn> {
    let channels = CHANNEL_NAMES.into_iter().zip(CHANNEL_UNITS).chain([(STATE, "")]);
    let of_body = |name: &String| {
        let column = |(channel, unit): (&str, &str)| SampledColumn {
            name: format!("{name}.{channel}"),
            unit: unit.to_owned(),
            description: if channel == STATE { ABOUT_STATE } else { "" }.to_owned(),
        };
        channels.clone().map(column).collect::<Vec<_>>()
    };
    body_names(info).iter().flat_map(of_body).collect()
}

/// The columns of the loads of force plates: for each, its [values](PlateLoad::values).
#[must_use]
pub fn plate_columns(plates: &[ForcePlate]) -> Vec<SampledColumn> {
    let mut columns = Vec::new();
    for plate in plates {
        for (quantity, unit) in QUANTITIES {
            let ending = unit.replace(' ', "").to_lowercase();
            for axis in ["x", "y", "z"] {
                columns.push(SampledColumn {
                    name: format!("force_plate_{}.{quantity}_{axis}_{ending}", plate.number),
                    unit: unit.to_owned(),
                    description: String::new(),
                });
            }
        }
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_channel_has_the_name_of_the_column_of_times() {
        let channel = |name: &str| AnalogChannel {
            name: name.to_owned(),
            unit: "V".to_owned(),
            description: String::new(),
            scale: 1.0,
            offset: 0.0,
        };
        let columns = analog_columns(&["Fz1", "time_s", "Fz1"].map(channel));
        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(names, ["Fz1", "time_s#2", "Fz1#2"]);
    }
}
