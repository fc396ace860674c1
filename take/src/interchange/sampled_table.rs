//! The sampled channels of a take as tables for export: the analog channels of a C3D file, and the loads of its force
//! plates. A table has a row for each analog sample, at a rate of its own, and its rows start at the first frame.

use std::io::{self, Write};

use super::{
    Result,
    csv::quote,
    text::{unique_names, without_tabs},
};
use crate::{
    TakeError,
    foreign::{
        analog::{AnalogChannel, AnalogSamples},
        force_plates::{Baseline, ForcePlate, PlateLoad, PlateLoads},
    },
    motion::{FrameSource, MotionInfo},
};

/// The quantities of a force plate's load, each along x, y and z, with their units.
const QUANTITIES: [(&str, &str); 4] =
    [("force", "N"), ("moment", "N m"), ("cop", "mm"), ("free_moment", "N m")];

/// The name of the column of times.
pub(super) const TIME_COLUMN: &str = "time_s";

/// Bytes of a text table that are written at once.
const BUFFER_BYTES: usize = 1 << 16;

/// What a table holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampledKind {
    /// The analog channels, in the units that the file states.
    Analog,
    /// The loads of the force plates that can be used: force, moment about the centre of the surface, centre of pressure
    /// and free moment, in laboratory axes.
    ForcePlates,
}

impl SampledKind {
    /// Both kinds.
    pub const ALL: [Self; 2] = [Self::Analog, Self::ForcePlates];

    /// Its content, as text for the user.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Analog => "the analog channels",
            Self::ForcePlates => "the loads of the force plates",
        }
    }

    /// Its name in files: `analog` or `force_plates`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Analog => "analog",
            Self::ForcePlates => "force_plates",
        }
    }
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
}

/// Where the rows of a table come from, with a buffer for a block of them.
#[derive(Debug)]
enum TableSource<'a> {
    Analog(Box<AnalogSamples<'a>>, Vec<f64>),
    ForcePlates(Box<PlateLoads<'a>>, Vec<PlateLoad>),
}

impl<'a> SampledTable<'a> {
    /// The tables of a take, or of a part of one: none, the analog channels, or these and the force plates. What cannot be
    /// read, because the take is damaged, has no table.
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
            Self::new(SampledKind::ForcePlates, columns, (rate_hz, ratio), info.n_frames, source)
        });
        Ok(analog.into_iter().chain(plates).collect())
    }

    fn new(
        kind: SampledKind,
        columns: Vec<SampledColumn>,
        (rate_hz, samples_per_frame): (f64, usize),
        n_frames: u64,
        source: TableSource<'a>,
    ) -> Self {
        let (block, next) = (Vec::new(), 0);
        Self { kind, columns, rate_hz, samples_per_frame, n_frames, source, block, next }
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

    /// Rows in a second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Rows in a frame.
    #[must_use]
    pub fn samples_per_frame(&self) -> usize {
        self.samples_per_frame
    }

    /// Number of rows.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.n_frames.saturating_mul(self.samples_per_frame as u64)
    }

    /// The force plates; none in the table of the analog channels.
    #[must_use]
    pub fn plates(&self) -> &[ForcePlate] {
        match &self.source {
            TableSource::Analog(..) => &[],
            TableSource::ForcePlates(loads, _) => &loads.plates().plates,
        }
    }

    /// What the file leaves open, and how it was read, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        match &self.source {
            TableSource::Analog(samples, _) => samples.warnings(),
            TableSource::ForcePlates(loads, _) => &loads.plates().warnings,
        }
    }

    /// The rows of the next frame, one after another, rounded once to f32; empty at the end. NaN where the file has no
    /// sample, or a plate no centre of pressure.
    ///
    /// # Errors
    /// Those of the scratch file that the samples may be in.
    pub fn next_frame(&mut self) -> io::Result<&[f32]> {
        if self.next >= self.block.len() {
            self.read_block()?;
        }
        let n = (self.samples_per_frame * self.columns.len()).min(self.block.len() - self.next);
        let from = self.next;
        self.next += n;
        Ok(self.block.get(from..from + n).unwrap_or(&[]))
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
                let values = block.iter().flat_map(|load| {
                    [load.force_n, load.moment_nm, load.cop_mm, load.free_moment_nm]
                });
                self.block.extend(values.flatten().map(|value| value as f32));
            }
        }
        Ok(())
    }

    /// Calls `put` for every row that is left, with its index from 0; `frames` counts the frames for a display of progress.
    ///
    /// # Errors
    /// Those of reading, and of `put`.
    pub fn for_each_row(
        &mut self,
        frames: &dyn FrameSource,
        mut put: impl FnMut(u64, &[f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let width = self.columns.len().max(1);
        let mut index = 0;
        loop {
            let rows = self.next_frame()?;
            if rows.is_empty() {
                return Ok(());
            }
            for row in rows.chunks_exact(width) {
                put(index, row)?;
                index += 1;
            }
            frames.count_sampled(1);
        }
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
            let unit =
                Some(unit).filter(|unit| self.kind == SampledKind::Analog && !unit.is_empty());
            let unit = unit.map_or_else(String::new, |unit| format!(" ({unit})"));
            header = format!("{header},{}", quote(&format!("{name}{unit}")));
        }
        writeln!(out, "{header}")?;
        let rate_hz = self.rate_hz;
        self.write_text(frames, out, ("", b','), |line, index| {
            write!(line, "{}", index as f64 / rate_hz)?;
            line.push(b',');
            Ok(())
        })
    }

    /// Writes a line of text for each row: what `begin` appends for its index, and the values. A value that is missing is
    /// `cells.0`, and `cells.1` separates values.
    pub(super) fn write_text(
        &mut self,
        frames: &dyn FrameSource,
        out: &mut dyn Write,
        (missing, separator): (&str, u8),
        begin: impl Fn(&mut Vec<u8>, u64) -> io::Result<()>,
    ) -> Result<()> {
        let mut lines = Vec::new();
        self.for_each_row(frames, |index, row| {
            begin(&mut lines, index)?;
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

fn plate_columns(plates: &[ForcePlate]) -> Vec<SampledColumn> {
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
