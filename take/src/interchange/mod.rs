//! The field's formats: C3D, TRC, QTM TSV and CSV, in and out; `NumPy` archives, XDF and BIDS out, and with the feature
//! `full` Parquet and MCAP.
//!
//! Every importer turns the bytes of a whole file into a [`Motion`] in millimetres: each coordinate is the number
//! as stored or printed, multiplied in f64 by one factor and rounded once to f32. What was found wrong and could
//! be read all the same stands in [`crate::motion::Source::warnings`]. What a file holds beside marker
//! trajectories is kept in [`crate::motion::Foreign`] (`docs/foreign.md`).
//! Every exporter writes frames as they come.

use std::io::{self, Write};

use crate::{
    ambiguity::Notes,
    motion::{FrameSource, GAP, Motion, MotionInfo, Position, UpAxis, is_gap},
};

#[cfg(feature = "full")]
mod about;
pub mod bids;
mod c3d;
mod csv;
mod line_frames;
#[cfg(feature = "full")]
mod mcap;
pub mod npz;
mod origin;
#[cfg(feature = "full")]
mod parquet;
mod table;
mod text;
mod trc;
mod tsv;
mod turn;
mod turned;
mod units;
mod xdf;
mod zip;

pub use text::column_labels;
pub use turn::Direction;
pub use turned::Turned;
pub use units::LengthUnit;

use turn::Turn;

/// A format by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// C3D, binary.
    C3d,
    /// Track Row Column, text.
    Trc,
    /// Qualisys Track Manager's text export.
    Tsv,
    /// Ours; of others, the `time,head_x,...` dialect and Motive's export are read, and so is the long layout.
    Csv,
    /// Apache Parquet, a row a sample; written only, with the feature `full`.
    Parquet,
    /// The same, a row a frame.
    ParquetWide,
    /// MCAP with Foxglove's schemas; written only, with the feature `full`.
    Mcap,
    /// CSV with one row a sample.
    CsvLong,
    /// An archive of `NumPy` arrays; written only, by [`npz::write`].
    Npz,
    /// Lab Streaming Layer's recordings; written only.
    Xdf,
    /// A folder after the Brain Imaging Data Structure; written only, by [`bids::write`].
    Bids,
}

/// What a file holds beside trajectories.
struct Holds {
    /// What the kinds of its foreign parts begin with.
    foreign: Option<&'static str>,
    /// Which axis is up.
    up_axis: bool,
    /// Most events.
    events_max: usize,
}

type Result<T, E = InterchangeError> = std::result::Result<T, E>;

/// Why bytes could not be read as a format, or trajectories not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterchangeError {
    /// Not that format, or nothing usable in it.
    #[error("{format} {place}: {message}")]
    Malformed {
        /// `c3d`, `trc`, `tsv` or `csv`.
        format: &'static str,
        /// Where: `line 4`, `byte 512`...
        place: String,
        /// What was expected, what was found, and what to do.
        message: String,
    },
    /// The trajectories cannot be said in that format.
    #[error("{0}")]
    Unsupported(String),
    /// Reading the source or writing the output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl InterchangeError {
    fn malformed(
        format: &'static str,
        place: impl Into<String>,
        message: impl Into<String>,
    ) -> Self {
        Self::Malformed { format, place: place.into(), message: message.into() }
    }
}

impl Format {
    /// By a file name's ending, case-insensitive.
    #[must_use]
    pub fn from_extension(path: &std::path::Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        Some(match extension.as_str() {
            "c3d" => Self::C3d,
            "trc" => Self::Trc,
            "tsv" => Self::Tsv,
            "csv" => Self::Csv,
            "parquet" => Self::Parquet,
            "mcap" => Self::Mcap,
            "npz" => Self::Npz,
            "xdf" => Self::Xdf,
            _ => return None,
        })
    }

    /// Whether this build writes it, where it writes it at all.
    ///
    /// # Errors
    /// `Unsupported`, with what to do.
    pub fn check_built(self) -> Result<()> {
        let is_heavy = matches!(self, Self::Parquet | Self::ParquetWide | Self::Mcap);
        if !is_heavy || cfg!(feature = "full") {
            return Ok(());
        }
        Err(InterchangeError::Unsupported(
            "this build has no Parquet and no MCAP: the Debian package has, and so has what `cargo build --release --features full` makes; or export to c3d, trc, csv or npz"
                .to_owned(),
        ))
    }

    /// Whether files of it are read.
    #[must_use]
    pub fn is_read(self) -> bool {
        matches!(self, Self::C3d | Self::Trc | Self::Tsv | Self::Csv | Self::CsvLong)
    }

    /// Reads a whole file's bytes.
    ///
    /// # Errors
    /// `Malformed` when there is nothing usable; `Unsupported` for a format that is written only.
    pub fn read(self, bytes: &[u8]) -> Result<Motion> {
        self.read_with(bytes, &ReadOptions::default())
    }

    /// Reads a whole file's bytes, with what is known beside them.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_with(self, bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
        match self {
            Self::C3d => c3d::read(bytes, options),
            Self::Trc => trc::read(bytes, options),
            Self::Tsv => tsv::read(bytes, options),
            Self::Csv | Self::CsvLong => csv::read(bytes, options),
            Self::Npz | Self::Xdf | Self::Bids | Self::Parquet | Self::ParquetWide | Self::Mcap => {
                Err(InterchangeError::Unsupported(
                    "this format is written only: import c3d, trc, tsv or csv".to_owned(),
                ))
            }
        }
    }

    /// What a file of it holds beside trajectories. Without a default: a new format says so itself.
    fn holds(self) -> Holds {
        let (foreign, up_axis, events_max) = match self {
            Self::C3d => (Some("c3d/"), true, c3d::EVENTS_MAX),
            Self::Trc => (Some("trc/"), false, 0),
            Self::Tsv => (Some("tsv/"), false, usize::MAX),
            Self::Csv | Self::CsvLong => (None, false, 0),
            Self::Xdf => (None, false, usize::MAX),
            Self::Parquet | Self::ParquetWide | Self::Mcap | Self::Npz | Self::Bids => {
                (None, true, usize::MAX)
            }
        };
        Holds { foreign, up_axis, events_max }
    }

    /// Whether a file of this format holds foreign parts of a kind: those that it was imported with.
    #[must_use]
    pub fn gives_back(self, kind: &str) -> bool {
        self.holds().foreign.is_some_and(|format| kind.starts_with(format))
    }

    /// What of `info` a file of this format will not hold, in words; `up_is_chosen` says that its reader knows what is up.
    #[must_use]
    pub fn leaves_out(self, info: &MotionInfo, up_is_chosen: bool) -> Vec<String> {
        let others = info.foreign.iter().filter(|part| !self.gives_back(&part.kind));
        let mut left_out: Vec<String> = others.map(|part| part.kind.clone()).collect();
        let documents = info.subject.iter().flat_map(|subject| &subject.documents);
        left_out.extend(documents.map(|document| format!("the subject's {}", document.kind)));
        if let (false, Some(axis)) = (self.holds().up_axis || up_is_chosen, info.up.name()) {
            left_out.push(format!("the up axis ({axis})"));
        }
        let events = info.events.len().saturating_sub(self.holds().events_max);
        if events > 0 {
            left_out.push(format!("{events} event{}", if events == 1 { "" } else { "s" }));
        }
        left_out
    }

    /// Writes frames as they come, in bounded memory. The number of the first frame is
    /// `frames.info().source.first_frame`; a source over a part of a take states the part's own, so that what
    /// an importer kept frame by frame (analog samples, residuals) is given back for the right frames.
    ///
    /// # Errors
    /// `Unsupported` for what the format cannot hold, for BIDS, which is a folder, and for `NumPy` archives, whose writer must
    /// go back ([`npz::write`]); `Io`.
    pub fn write(self, frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
        match self {
            Self::C3d => c3d::write(frames, out),
            Self::Trc => trc::write(frames, out),
            Self::Tsv => tsv::write(frames, out),
            Self::Csv => csv::wide::write(frames, out),
            Self::CsvLong => csv::long::write(frames, out),
            #[cfg(feature = "full")]
            Self::Parquet => parquet::write_long(frames, out),
            #[cfg(feature = "full")]
            Self::ParquetWide => parquet::write_wide(frames, out),
            #[cfg(feature = "full")]
            Self::Mcap => mcap::write(frames, out),
            #[cfg(not(feature = "full"))]
            Self::Parquet | Self::ParquetWide | Self::Mcap => self.check_built(),
            Self::Xdf => xdf::write(frames, out),
            Self::Npz => Err(InterchangeError::Unsupported(
                "npz is not written from front to back: use npz::write".to_owned(),
            )),
            Self::Bids => Err(InterchangeError::Unsupported(
                "bids is a folder, not a file: use bids::write".to_owned(),
            )),
        }
    }
}

/// Names of the settings that a take's header keeps of them.
const UNIT: &str = "unit";
const UP: &str = "up";

/// What is known of a file beside what stands in it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// The unit of length, instead of the file's own.
    pub unit: Option<LengthUnit>,
    /// What points up, instead of what the file says. Where that is the way down an axis, positions are given half a
    /// turn, so that the axis points up.
    pub up: Option<Direction>,
}

impl ReadOptions {
    /// As a header keeps them.
    #[must_use]
    pub fn settings(&self) -> Vec<(String, String)> {
        let unit = self.unit.map(|unit| (UNIT.to_owned(), unit.to_string()));
        let up = self.up.map(|up| (UP.to_owned(), up.to_string()));
        unit.into_iter().chain(up).collect()
    }

    /// Those that a take was imported with.
    #[must_use]
    pub fn from_settings(settings: &[(String, String)]) -> Self {
        let value = |name: &str| {
            settings.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
        };
        Self {
            unit: value(UNIT).and_then(|unit| unit.parse().ok()),
            up: value(UP).and_then(|up| up.parse().ok()),
        }
    }

    /// How positions are turned.
    fn turn(&self) -> Turn {
        match self.up {
            Some(up) if up.is_negative() => Turn::upside_down(up.axis()),
            _ => Turn::NONE,
        }
    }

    /// Which axis is up after that; what the file says is noted where it is another.
    fn up(&self, of_file: UpAxis, notes: &mut Notes) -> UpAxis {
        let Some(up) = self.up else { return of_file };
        if let Some(name) = of_file.name().filter(|_| of_file != up.axis() || up.is_negative()) {
            notes
                .warnings
                .push(format!("The file says that {name} is up; {up} was taken, as asked."));
        }
        if up.is_negative() {
            notes.warnings.push(format!(
                "Positions were given half a turn, as asked, so that {} is up.",
                up.axis().name().unwrap_or("it")
            ));
        }
        up.axis()
    }
}

/// Fails when not as many frames came as were announced: a file that states their number would not be true.
fn expect_frames(announced: u64, came: u64) -> io::Result<()> {
    if came == announced {
        return Ok(());
    }
    Err(io::Error::other(format!(
        "{announced} frames were announced, {came} or more came: the file is not usable, export again"
    )))
}

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;

/// Writes `buffer`, then frame after frame: `put` appends each to the buffer, by its index from 0. Returns how many came.
fn write_frames(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
    mut buffer: Vec<u8>,
    mut put: impl FnMut(&mut Vec<u8>, u64, &[Position]) -> io::Result<()>,
) -> io::Result<u64> {
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut n_written = 0;
    while frames.next_frame(&mut row)? {
        put(&mut buffer, n_written, &row)?;
        if buffer.len() >= BUFFER_BYTES {
            out.write_all(&buffer)?;
            buffer.clear();
        }
        n_written += 1;
    }
    out.write_all(&buffer)?;
    out.flush()?;
    Ok(n_written)
}

/// Appends the three cells of a position, each of them `missing` for a gap. Numbers have the fewest digits that bring back
/// the value, and no exponent.
fn put_position(
    out: &mut Vec<u8>,
    position: Position,
    separator: u8,
    missing: &str,
) -> io::Result<()> {
    let is_missing = is_gap(position);
    for (axis, value) in position.into_iter().enumerate() {
        out.extend((axis > 0).then_some(separator));
        if is_missing {
            out.extend(missing.bytes());
        } else {
            write!(out, "{value}")?;
        }
    }
    Ok(())
}
