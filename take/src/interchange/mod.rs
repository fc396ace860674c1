//! Import and export of the field's file formats: C3D, TRC, QTM TSV and CSV in both directions; `NumPy` archives, XDF
//! and BIDS for export, and with the feature `full` also Parquet and MCAP; `OpenSim`'s `.mot` for the export of force
//! plates. Analog channels and force plates of a C3D file are part of exports to C3D, NPZ, XDF, BIDS and MCAP, and files
//! beside those to CSV and Parquet ([`Format::write_sampled`]), and so are the sampled channels and poses of a recording.
//!
//! An importer turns a file into frames in millimetres, one after another ([`MotionReader`]) or all of them as a
//! [`Motion`]: it multiplies each coordinate as stored or printed by one factor in f64 and rounds once to f32. It reads
//! a faulty file where that is possible and lists the faults in [`crate::motion::Source::warnings`]. Analog samples,
//! residuals, parameters and everything else that is not a trajectory goes into [`crate::motion::Foreign`]
//! (`docs/foreign.md`).
//! An exporter streams: it writes each frame as the source delivers it.

pub mod bids;
pub(crate) mod c3d;
mod csv;
#[cfg(feature = "full")]
pub mod foxglove;
#[cfg(feature = "full")]
mod mcap;
pub mod mot;
mod motion_reader;
pub mod npz;
mod origin;
pub mod page_motion;
#[cfg(feature = "full")]
mod parquet;
mod recorded_rows;
mod sampled_table;
mod source_file;
mod table;
mod text;
mod trc;
mod tsv;
mod units;
mod xdf;

use std::{
    io::{self, Cursor, Write},
    sync::Arc,
};

pub use crate::up_axis::Direction;
pub(crate) use crate::up_axis::Rotation;
use crate::{
    foreign::{self, content::MemoryScratch, force_plates::Baseline},
    map::TakeMap,
    motion::{FrameSource, GAP, Motion, MotionInfo, Notes, Position, UpAxis, is_gap},
};
pub use c3d::residuals_10um;
pub use csv::quote as csv_cell;
pub use motion_reader::{MotionReader, ReaderSettings};
pub use recorded_rows::{output_names, plates_of_group, recorded_plates};
pub use sampled_table::{SampledColumn, SampledKind, SampledTable, TableRowTime, plate_columns};
pub use text::column_labels;
pub use units::LengthUnit;

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// C3D, the binary format of biomechanics.
    C3d,
    /// Track Row Column, the text format of `OpenSim` and Cortex.
    Trc,
    /// Qualisys Track Manager's text export.
    Tsv,
    /// CSV with one row per frame. Reading also accepts the `time,head_x,...` dialect, Motive's export and the long
    /// layout.
    Csv,
    /// Apache Parquet with one row per sample; export only, with the feature `full`.
    Parquet,
    /// Apache Parquet with one row per frame; export only, with the feature `full`.
    ParquetWide,
    /// MCAP with Foxglove's schemas; export only, with the feature `full`.
    Mcap,
    /// CSV with one row per sample.
    CsvLong,
    /// An archive of `NumPy` arrays; export only, by [`npz::write`].
    Npz,
    /// XDF, the recording format of Lab Streaming Layer; export only.
    Xdf,
    /// A folder in the Brain Imaging Data Structure; export only, by [`bids::write`].
    Bids,
    /// `OpenSim`'s motion file, with the loads of force plates; export only, with remarks by [`mot::write`].
    Mot,
    /// A page that plays the motion in a browser; export only. Its motion is that of [`page_motion::write`].
    Html,
}

/// What files of a format can hold besides trajectories.
struct Capabilities {
    /// Prefix of the foreign parts that an export restores, such as `c3d/`.
    foreign: Option<&'static str>,
    /// Whether the format states which axis is up.
    up_axis: bool,
    /// Maximum number of events that fit.
    events_max: usize,
    /// Where analog channels and force plates of an imported C3D file are.
    sampled: SampledPlace,
}

/// Where an export has analog channels and force plates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SampledPlace {
    /// Among the foreign parts that it restores, or nowhere.
    Restored,
    /// In the file.
    Inside,
    /// In separate files.
    SeparateFiles,
}

type Result<T, E = InterchangeError> = std::result::Result<T, E>;

/// Why a file could not be read, or trajectories could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterchangeError {
    /// The bytes are not of that format, or hold nothing usable.
    #[error("{format} {place}: {message}")]
    Malformed {
        /// `c3d`, `trc`, `tsv` or `csv`.
        format: &'static str,
        /// Where the error is: `line 4`, `byte 512`...
        place: String,
        /// What was expected, what was found, and what to do.
        message: String,
    },
    /// The format cannot hold these trajectories, or this build cannot write it.
    #[error("{0}")]
    Unsupported(String),
    /// Another program changed the file between two passes over it.
    #[error("another program changed it while it was being read")]
    Changed,
    /// Reading the source or writing the output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl InterchangeError {
    fn malformed(format: &'static str, place: &str, message: impl Into<String>) -> Self {
        Self::Malformed { format, place: place.to_owned(), message: message.into() }
    }
}

fn unsupported<T>(message: &str) -> Result<T> {
    Err(InterchangeError::Unsupported(message.to_owned()))
}

/// What a page that plays a take does not show of a part of a C3D file, as text for the user.
fn left_out_of_a_page(kind: &str) -> Option<String> {
    let text = match kind {
        c3d::ANALOG => "analog channels and force plates",
        c3d::RESIDUALS => "residuals and camera masks",
        c3d::MODEL_OUTPUTS => "model outputs",
        _ => return None,
    };
    Some(text.to_owned())
}

impl Format {
    /// The format of a file by its extension, in any case.
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
            "mot" => Self::Mot,
            "html" | "htm" => Self::Html,
            _ => return None,
        })
    }

    /// Checks that this build includes the writer of the format.
    ///
    /// # Errors
    /// `Unsupported` for Parquet and MCAP without the feature `full`.
    pub fn check_built(self) -> Result<()> {
        let is_heavy = matches!(self, Self::Parquet | Self::ParquetWide | Self::Mcap);
        if !is_heavy || cfg!(feature = "full") {
            return Ok(());
        }
        unsupported(
            "this build writes neither Parquet nor MCAP: use the Debian package, build with `cargo build --release --features full`, or export to c3d, trc, csv or npz",
        )
    }

    /// Whether files of this format can be imported.
    #[must_use]
    pub fn is_read(self) -> bool {
        matches!(self, Self::C3d | Self::Trc | Self::Tsv | Self::Csv | Self::CsvLong)
    }

    /// Reads the bytes of a whole file.
    ///
    /// # Errors
    /// `Malformed` if the file holds nothing usable; `Unsupported` for a format that is export only.
    pub fn read(self, bytes: &[u8]) -> Result<Motion> {
        self.read_with(bytes, &ReadOptions::default())
    }

    /// Reads the bytes of a whole file with a unit or an up axis that overrides the file's own. [`MotionReader`] reads
    /// a file without holding it.
    ///
    /// # Errors
    /// `Malformed` if the file holds nothing usable; `Unsupported` for a format that is export only.
    pub fn read_with(self, bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
        let settings = ReaderSettings {
            options: *options,
            keeps_foreign: true,
            new_scratch: &|| Ok(Arc::new(MemoryScratch::default())),
            bytes_read: Arc::default(),
        };
        MotionReader::open(self, Cursor::new(bytes), &settings)?.into_motion()
    }

    /// What files of this format can hold. The match has no default arm, so that a new format must be added to it.
    fn capabilities(self) -> Capabilities {
        let sampled = match self {
            Self::C3d | Self::Trc | Self::Tsv | Self::Mot | Self::Html => SampledPlace::Restored,
            Self::Mcap | Self::Npz | Self::Xdf | Self::Bids => SampledPlace::Inside,
            Self::Csv | Self::CsvLong | Self::Parquet | Self::ParquetWide => {
                SampledPlace::SeparateFiles
            }
        };
        let (foreign, up_axis, events_max) = match self {
            Self::C3d => (Some("c3d/"), true, c3d::EVENTS_MAX),
            Self::Trc => (Some("trc/"), false, 0),
            Self::Tsv => (Some("tsv/"), false, usize::MAX),
            Self::Csv | Self::CsvLong | Self::Mot => (None, false, 0),
            Self::Xdf => (None, false, usize::MAX),
            Self::Parquet
            | Self::ParquetWide
            | Self::Mcap
            | Self::Npz
            | Self::Bids
            | Self::Html => (None, true, usize::MAX),
        };
        Capabilities { foreign, up_axis, events_max, sampled }
    }

    /// Whether an export to this format needs foreign parts of a kind: those that an import of it kept, or the analog
    /// samples.
    #[must_use]
    pub fn restores(self, kind: &str) -> bool {
        let holds_sampled =
            self == Self::Mot || self.capabilities().sampled != SampledPlace::Restored;
        (holds_sampled && foreign::analog::is_needed(kind)) || self.is_restored(kind)
    }

    fn is_restored(self, kind: &str) -> bool {
        self.capabilities().foreign.is_some_and(|format| kind.starts_with(format))
    }

    /// Whether sampled channels, force plates and poses are files beside the export, by [`write_sampled`](Self::write_sampled).
    #[must_use]
    pub fn has_sampled_files(self) -> bool {
        self.capabilities().sampled == SampledPlace::SeparateFiles
    }

    /// The tables of analog channels and force plates in an export of `info`, or beside it. C3D and `.mot` have them in
    /// forms of their own.
    ///
    /// # Errors
    /// Those of the scratch file that the samples may be in.
    pub fn sampled_tables(self, info: &MotionInfo) -> io::Result<Vec<SampledTable<'_>>> {
        match self.capabilities().sampled {
            SampledPlace::Restored => Ok(Vec::new()),
            SampledPlace::Inside | SampledPlace::SeparateFiles => SampledTable::all(info),
        }
    }

    /// Whether an export has the analog samples of a foreign part of this kind, or what it needs of their parameters.
    fn holds(self, kind: &str, info: &MotionInfo) -> bool {
        match self.capabilities().sampled {
            SampledPlace::Restored if self == Self::Mot => foreign::analog::is_needed(kind),
            SampledPlace::Restored => self.is_restored(kind),
            SampledPlace::Inside | SampledPlace::SeparateFiles => {
                let has_table = || SampledTable::all(info).is_ok_and(|tables| !tables.is_empty());
                self.is_restored(kind) || (kind == c3d::ANALOG && has_table())
            }
        }
    }

    /// What an export of `info` to this format leaves out, as text for the user. The up axis is not listed if
    /// `up_is_chosen`: the caller chose it for this export and knows it.
    #[must_use]
    pub fn leaves_out(self, info: &MotionInfo, up_is_chosen: bool) -> Vec<String> {
        let others = info.foreign.iter().filter(|part| !self.holds(&part.kind, info));
        let mut left_out: Vec<String> = match self {
            // A page shows motion: the header and its parameters are not missed there.
            Self::Html => others.filter_map(|part| left_out_of_a_page(&part.kind)).collect(),
            _ => others.map(|part| part.kind.clone()).collect(),
        };
        left_out.extend(self.recorded_left_out(info));
        let documents = info.subject.iter().flat_map(|subject| &subject.documents);
        left_out.extend(documents.map(|document| format!("the subject's {}", document.kind)));
        if let (false, Some(axis)) = (self.capabilities().up_axis || up_is_chosen, info.up.name()) {
            left_out.push(format!("the up axis ({axis})"));
        }
        if self == Self::Mot {
            left_out.extend(mot::left_out(info));
        } else if self.capabilities().sampled != SampledPlace::Restored {
            left_out.extend(mot::unusable_plates(info));
        }
        let events = info.events.len().saturating_sub(self.capabilities().events_max);
        left_out.extend((events > 0).then(|| counted(events as u64, "event")));
        left_out
    }

    /// The groups of a recording that an export leaves out.
    fn recorded_left_out(self, info: &MotionInfo) -> Vec<String> {
        let Some(recording) = &info.recording else { return Vec::new() };
        let n_bodies = recording.bodies().len() as u64;
        let poses = match n_bodies {
            0 => None,
            1 => Some("the poses of a rigid body".to_owned()),
            n => Some(format!("the poses of {n} rigid bodies")),
        };
        match self.capabilities().sampled {
            SampledPlace::Inside | SampledPlace::SeparateFiles => Vec::new(),
            SampledPlace::Restored if self == Self::C3d => c3d::RecordedPlan::of(info).left_out,
            // It counts the channels of its own.
            SampledPlace::Restored if self == Self::Mot => poses.into_iter().collect(),
            SampledPlace::Restored => {
                let groups = recording.groups().iter();
                let groups = groups.map(|found| c3d::name_of(&found.group));
                // A page has the poses.
                groups.chain(poses.filter(|_| self != Self::Html)).collect()
            }
        }
    }

    /// Writes a table of analog channels or force plates as a file of its own, beside an export of `frames`.
    ///
    /// # Errors
    /// `Unsupported` for a format without such files ([`has_sampled_files`](Self::has_sampled_files)); `Io` if reading or
    /// writing fails.
    pub fn write_sampled(
        self,
        table: &mut SampledTable<'_>,
        frames: &dyn FrameSource,
        out: &mut dyn Write,
    ) -> Result<()> {
        match self {
            Self::Csv | Self::CsvLong => table.write_csv(frames, out),
            #[cfg(feature = "full")]
            Self::Parquet | Self::ParquetWide => parquet::write_sampled(table, frames, out),
            _ => unsupported(
                "only csv and parquet have separate files for sampled channels, force plates and poses",
            ),
        }
    }

    /// Writes all frames of a source in bounded memory. `frames.info().source.first_frame` is the number of the first
    /// frame; a source over a part of a take gives the part's own number there, so that data kept frame by frame
    /// (analog samples, residuals) goes to the right frames.
    ///
    /// # Errors
    /// `Unsupported` for content that the format cannot hold, for BIDS, which is a folder ([`bids::write`]), and for
    /// `NumPy` archives, which need to seek ([`npz::write`]); `Io` if reading or writing fails.
    pub fn write(self, frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
        match self {
            Self::C3d => write_c3d(frames, out).map(drop),
            Self::Trc => trc::write(frames, out),
            Self::Tsv => tsv::write(frames, out),
            Self::Csv => csv::write(frames, out),
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
            Self::Mot => mot::write(frames, out, Baseline::default()).map(drop),
            Self::Npz => unsupported("npz needs an output that can seek: use npz::write"),
            Self::Html => unsupported("a page needs more than frames: use page_motion::write"),
            Self::Bids => unsupported("bids is a folder, not a file: use bids::write"),
        }
    }
}

/// Writes a whole C3D file. Returns remarks on the sampled channels of a recording, one sentence each.
///
/// # Errors
/// Those of [`Format::write`].
pub fn write_c3d(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<Vec<String>> {
    c3d::write(frames, out)
}

/// Names of the read options among the settings in a take's header.
const UNIT: &str = "unit";
const UP: &str = "up";

/// A unit and an up axis given by the user; they override what the file states.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// The unit of length.
    pub unit: Option<LengthUnit>,
    /// The direction that points up. For a negative direction the importer rotates all positions by 180°, so that the
    /// axis points up in the take.
    pub up: Option<Direction>,
}

impl ReadOptions {
    /// The options as settings of a take's header.
    #[must_use]
    pub fn settings(&self) -> Vec<(String, String)> {
        let unit = self.unit.map(|unit| (UNIT.to_owned(), unit.to_string()));
        let up = self.up.map(|up| (UP.to_owned(), up.to_string()));
        unit.into_iter().chain(up).collect()
    }

    /// The options that a take was imported with, from the settings in its header.
    #[must_use]
    pub fn from_settings(settings: &[(String, String)]) -> Self {
        let value = |name: &str| Some(&settings.iter().find(|(key, _)| key == name)?.1);
        Self {
            unit: value(UNIT).and_then(|unit| unit.parse().ok()),
            up: value(UP).and_then(|up| up.parse().ok()),
        }
    }

    /// The rotation of all positions on import.
    fn rotation(&self) -> Rotation {
        match self.up {
            Some(up) if up.is_negative() => Rotation::upside_down(up.axis()),
            _ => Rotation::IDENTITY,
        }
    }

    /// The up axis after the rotation. Warns if the file states another one, and of the rotation.
    fn up(&self, of_file: UpAxis, notes: &mut Notes) -> UpAxis {
        let Some(up) = self.up else { return of_file };
        if let Some(name) = of_file.name().filter(|_| of_file != up.axis() || up.is_negative()) {
            let text = format!("The file states that {name} is up; {up} was used, as requested.");
            notes.warnings.push(text);
        }
        if up.is_negative() {
            notes.warnings.push(format!(
                "Positions were rotated by 180°, as requested, so that {} is up.",
                up.axis().name().unwrap_or("it")
            ));
        }
        up.axis()
    }
}

/// Fails if the source delivered another number of frames than it announced: the file's header states that number.
fn check_frame_count(announced: u64, written: u64) -> io::Result<()> {
    if written == announced {
        return Ok(());
    }
    Err(io::Error::other(format!(
        "expected {announced} frames, got {written}: the file is unusable, export it again"
    )))
}

/// Bytes that are buffered before each write.
const BUFFER_BYTES: usize = 1 << 16;

/// `1 frame`, `2 frames`.
fn counted(n: u64, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Writes `buffer`, then every frame, which `put` appends to the buffer by its index from 0. Returns the number of
/// frames.
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

/// Appends the three cells of a position; each is `missing` for a gap. Numbers have no exponent and the fewest digits
/// that restore the f32 exactly.
fn put_position(out: &mut Vec<u8>, at: Position, separator: u8, missing: &str) -> io::Result<()> {
    let is_missing = is_gap(at);
    for (axis, value) in at.into_iter().enumerate() {
        out.extend((axis > 0).then_some(separator));
        if is_missing {
            out.extend(missing.bytes());
        } else {
            write!(out, "{value}")?;
        }
    }
    Ok(())
}

/// A frame source rotated by a quarter turn: its positions, and of the data kept from a C3D file the force plate
/// corners and the coordinates under gaps.
pub struct RotatedFrames<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    rotation: Rotation,
}

impl std::fmt::Debug for RotatedFrames<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RotatedFrames").field("rotation", &self.rotation).finish_non_exhaustive()
    }
}

impl<'a> RotatedFrames<'a> {
    /// Rotates `frames` so that the axis `up` points up; `None` if the source does not state its up axis.
    ///
    /// # Errors
    /// Those of reading and rewriting the data kept from a C3D file.
    pub fn new(frames: &'a mut dyn FrameSource, up: UpAxis) -> io::Result<Option<Self>> {
        let mut info = frames.info().clone();
        let Some(rotation) = Rotation::between(info.up, up) else { return Ok(None) };
        info.up = up;
        if !rotation.is_identity() {
            c3d::rotate(&mut info.foreign, info.markers.len(), rotation)?;
            info.recording = info
                .recording
                .map(|recording| recording.turned(|vector| rotation.apply_f64(vector)));
        }
        Ok(Some(Self { frames, info, rotation }))
    }

    /// Kinds of the foreign parts that keep their old axes although they may hold vectors in space: model outputs.
    #[must_use]
    pub fn not_rotated(&self) -> Vec<String> {
        let kept = self.info.foreign.iter().filter(|part| part.kind == c3d::MODEL_OUTPUTS);
        let kept = kept.filter(|_| !self.rotation.is_identity());
        kept.map(|part| part.kind.clone()).collect()
    }
}

impl FrameSource for RotatedFrames<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        let is_there = self.frames.next_frame(row)?;
        row.iter_mut().for_each(|at| *at = self.rotation.apply(*at));
        Ok(is_there)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        self.frames.stated_error_mm(column)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }

    fn is_lost(&self) -> bool {
        self.frames.is_lost()
    }

    fn count_sampled(&self, n_frames: u64) {
        self.frames.count_sampled(n_frames);
    }
}
