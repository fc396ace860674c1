//! Imports the bytes of motion files as takes, for archives, and describes the motion on the way.

use std::{io, sync::Arc, time::Duration};

use mocapd_codec::{Effort, Settings, Tolerance};
use mocapd_take::{
    TakeFrames,
    import::{self, IMPORTER_VERSION, ImportSettings},
    interchange::{Format, InterchangeError, MotionReader, ReadOptions, ReaderSettings},
    motion::{FrameSource, MotionInfo, Position, is_gap},
    record::{KeyDistance, Subject},
};
use numpy::{IntoPyArray, PyArray1, PyArray2, ndarray::Array2};
use pyo3::{prelude::*, types::PyBytes};

use crate::{
    background::{Cancel, run_detached},
    errors::{Failure, Result},
    foreign::scratch,
};

/// Settings of an import: in Python a dictionary with these keys.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ImportOptions {
    format: String,
    /// None for lossless resamplers.
    tolerance_mm: Option<f64>,
    resampler: String,
    effort: u8,
    /// Longest time between key stretches; infinite for the first stretch only; None for the importer's choice.
    keys_s: Option<f64>,
    unit: Option<String>,
    up: Option<String>,
    analog_tolerance: Vec<String>,
    drop_foreign: bool,
    subject: Option<String>,
}

/// A take, the largest error of its samples in millimetres, and the motion of each marker.
#[pyclass(frozen, get_all, module = "mocapd._native")]
pub(crate) struct Imported {
    take: Py<PyBytes>,
    max_error_mm: f64,
    samples: Py<PyArray1<u64>>,
    gaps: Py<PyArray1<u64>>,
    /// [markers, 3], NaN for a marker without samples.
    low_mm: Py<PyArray2<f32>>,
    high_mm: Py<PyArray2<f32>>,
    /// Fastest movement between two frames that follow each other.
    peak_speed_mm_per_s: Py<PyArray1<f64>>,
}

/// The version of what an import writes.
#[pyfunction]
pub(crate) fn importer_version() -> u32 {
    IMPORTER_VERSION
}

/// Imports the bytes of a motion file. The same bytes and options give the same take; the name of the file is not in it.
#[pyfunction]
pub(crate) fn import_motion(
    py: Python<'_>,
    data: &Bound<'_, PyBytes>,
    options: ImportOptions,
) -> PyResult<Imported> {
    let (format, settings) = settings(options)?;
    let bytes = data.as_bytes();
    let (take, max_error_mm, markers) =
        run_detached(py, None, |cancel| import(bytes, format, &settings, cancel))?;
    Imported::new(py, &PyBytes::new(py, &take), max_error_mm, &markers)
}

/// Describes a take as if it were imported, and lists what is wrong with it.
#[pyfunction]
pub(crate) fn measure_take(
    py: Python<'_>,
    data: &Bound<'_, PyBytes>,
) -> PyResult<(Imported, Vec<String>)> {
    let bytes = data.as_bytes();
    let (max_error_mm, markers, problems) = run_detached(py, None, |cancel| {
        let mut take = TakeFrames::open(io::Cursor::new(bytes))?;
        let mut frames = MeasuredFrames::new(&mut take);
        let mut row = vec![Position::default(); frames.markers.len()];
        let mut max_error_mm = 0.0_f64;
        while frames.next_frame(&mut row)? {
            cancel.check()?;
            let errors = (0..row.len()).filter_map(|column| frames.source.stated_error_mm(column));
            max_error_mm = errors.fold(max_error_mm, f64::max);
        }
        let markers = frames.finish();
        Ok((max_error_mm, markers, take.problems().iter().map(ToString::to_string).collect()))
    })?;
    Ok((Imported::new(py, data, max_error_mm, &markers)?, problems))
}

impl Imported {
    fn new(
        py: Python<'_>,
        take: &Bound<'_, PyBytes>,
        max_error_mm: f64,
        markers: &[MarkerMotion],
    ) -> PyResult<Self> {
        let array = |values: fn(&MarkerMotion) -> Position| {
            let flat: Vec<f32> = markers.iter().flat_map(values).collect();
            let shaped = Array2::from_shape_vec((markers.len(), 3), flat);
            shaped.map(|array| array.into_pyarray(py).unbind()).map_err(|_| Failure::Internal)
        };
        let counts = |values: fn(&MarkerMotion) -> u64| {
            markers.iter().map(values).collect::<Vec<_>>().into_pyarray(py).unbind()
        };
        let speeds: Vec<f64> = markers.iter().map(|marker| marker.peak_speed_mm_per_s).collect();
        Ok(Self {
            take: take.clone().unbind(),
            max_error_mm,
            samples: counts(|marker| marker.samples),
            gaps: counts(|marker| marker.gaps),
            low_mm: array(|marker| marker.low_mm)?,
            high_mm: array(|marker| marker.high_mm)?,
            peak_speed_mm_per_s: speeds.into_pyarray(py).unbind(),
        })
    }
}

/// Checks the options of imports. Returns those that are names as the importer writes them, so that equal options have
/// equal texts: the resampler, the unit, the axis that points up, and the tolerances of analog channels.
#[pyfunction]
pub(crate) fn normal_options(options: ImportOptions) -> PyResult<NormalOptions> {
    let (_, settings) = settings(options)?;
    let kind = settings.codec.kind;
    if settings.key_distance.is_some() && !kind.is_live() {
        let message = format!("{kind} encodes a take as one stretch: omit the distance of keys");
        return Err(Failure::Value(message).into());
    }
    if settings.drops_foreign && !settings.analog.0.is_empty() {
        let message = "a tolerance of analog channels that are dropped: omit one of the two";
        return Err(Failure::Value(message.to_owned()).into());
    }
    Ok((
        kind.to_string(),
        settings.options.unit.map(|unit| unit.to_string()),
        settings.options.up.map(|up| up.to_string()),
        settings.analog.0.iter().map(ToString::to_string).collect(),
    ))
}

type NormalOptions = (String, Option<String>, Option<String>, Vec<String>);

fn settings(options: ImportOptions) -> Result<(Format, ImportSettings)> {
    let value = |message: String| Failure::Value(message);
    let format = match options.format.as_str() {
        "c3d" => Format::C3d,
        "trc" => Format::Trc,
        "tsv" => Format::Tsv,
        "csv" => Format::Csv,
        other => return Err(value(format!("format {other:?}: expected c3d, trc, tsv or csv"))),
    };
    let codec = Settings {
        kind: options.resampler.parse().map_err(Failure::from)?,
        tolerance: Tolerance::from_mm(options.tolerance_mm.unwrap_or(Tolerance::MAX_MM))?,
    };
    let key_distance = match options.keys_s {
        None => None,
        Some(f64::INFINITY) => Some(KeyDistance::FirstOnly),
        Some(seconds) => {
            let distance = Duration::try_from_secs_f64(seconds).ok();
            let distance = distance.filter(|distance| *distance >= KEYS_MIN).ok_or_else(|| {
                value(format!("keys of {seconds} s: expected 0.05 s or more, or infinity"))
            })?;
            Some(KeyDistance::Every(distance))
        }
    };
    let unit = options.unit.map(|unit| unit.parse()).transpose().map_err(value)?;
    let up = options.up.map(|up| up.parse()).transpose().map_err(value)?;
    let analog = options.analog_tolerance.iter().map(|text| text.parse());
    let settings = ImportSettings {
        codec,
        effort: Effort::new(options.effort)?,
        key_distance,
        analog: mocapd_take::foreign::tolerance::AnalogTolerance(
            analog.collect::<Result<_, String>>().map_err(value)?,
        ),
        options: ReadOptions { unit, up },
        drops_foreign: options.drop_foreign,
        subject: options.subject.map(|name| Subject { name, ..Subject::default() }),
    };
    Ok((format, settings))
}

/// Smallest distance of key stretches, as for `mocapd import`.
const KEYS_MIN: Duration = Duration::from_millis(50);

fn import(
    bytes: &[u8],
    format: Format,
    settings: &ImportSettings,
    cancel: &Cancel,
) -> Result<(Vec<u8>, f64, Vec<MarkerMotion>)> {
    let reader_settings = ReaderSettings {
        options: settings.options,
        keeps_foreign: !settings.drops_foreign,
        new_scratch: &scratch,
        bytes_read: Arc::default(),
    };
    let reader = MotionReader::open(format, io::Cursor::new(bytes), &reader_settings);
    let mut reader = reader.map_err(of_file)?;
    import::check(reader.info(), "the file")?;
    check_unit(reader.info(), settings)?;
    settings.apply(reader.info_mut(), scratch)?;
    let software = format!("mocapd importer {IMPORTER_VERSION}");
    let mut header = settings.header(reader.info(), &software, String::new());
    header.set_source_bytes(bytes.len() as u64);
    header.set_import_id(bytes, settings.subject.as_ref())?;
    header.check()?;
    let mut frames = MeasuredFrames::new(&mut reader);
    let (take, max_error_mm) = import::write(&mut frames, &header, Vec::new(), || cancel.check())?;
    Ok((take, max_error_mm, frames.finish()))
}

fn of_file(error: InterchangeError) -> Failure {
    match error {
        InterchangeError::Io(error) => error.into(),
        other => Failure::Value(other.to_string()),
    }
}

/// Refuses a tolerance that would destroy the motion if the unit is not the one assumed, as `mocapd import` does.
fn check_unit(info: &MotionInfo, settings: &ImportSettings) -> Result<()> {
    if settings.codec.kind.is_lossless() {
        return Ok(());
    }
    let tolerance_mm = settings.codec.tolerance.mm();
    let found = info.source.ambiguities.iter().find(|found| found.is_destroyed_by(tolerance_mm));
    let Some(found) = found else { return Ok(()) };
    Err(Failure::Value(format!(
        "{found} A tolerance of {tolerance_mm} mm would destroy the motion: state the unit of the file (mm, cm, m, in...)"
    )))
}

/// What a marker did.
#[derive(Debug, Clone, Copy)]
struct MarkerMotion {
    samples: u64,
    gaps: u64,
    low_mm: Position,
    high_mm: Position,
    peak_speed_mm_per_s: f64,
    /// The sample of the last frame.
    last_mm: Option<Position>,
}

impl MarkerMotion {
    fn add(&mut self, position: Position, rate_hz: f64, is_first: bool) {
        if is_gap(position) {
            self.gaps += u64::from(is_first || self.last_mm.is_some());
            self.last_mm = None;
            return;
        }
        self.samples += 1;
        // `min` and `max` ignore the NaN of a marker without samples.
        self.low_mm = std::array::from_fn(|axis| self.low_mm[axis].min(position[axis]));
        self.high_mm = std::array::from_fn(|axis| self.high_mm[axis].max(position[axis]));
        if let Some(last_mm) = self.last_mm {
            let step =
                (0..3).map(|axis| (f64::from(position[axis]) - f64::from(last_mm[axis])).powi(2));
            let speed = step.sum::<f64>().sqrt() * rate_hz;
            self.peak_speed_mm_per_s = self.peak_speed_mm_per_s.max(speed);
        }
        self.last_mm = Some(position);
    }
}

/// The frames of a source, measured as they are read.
struct MeasuredFrames<'a> {
    source: &'a mut dyn FrameSource,
    markers: Vec<MarkerMotion>,
    is_first: bool,
}

impl<'a> MeasuredFrames<'a> {
    fn new(source: &'a mut dyn FrameSource) -> Self {
        let unseen = MarkerMotion {
            samples: 0,
            gaps: 0,
            low_mm: [f32::NAN; 3],
            high_mm: [f32::NAN; 3],
            peak_speed_mm_per_s: 0.0,
            last_mm: None,
        };
        let markers = vec![unseen; source.info().markers.len()];
        Self { source, markers, is_first: true }
    }

    fn finish(self) -> Vec<MarkerMotion> {
        self.markers
    }
}

impl FrameSource for MeasuredFrames<'_> {
    fn info(&self) -> &MotionInfo {
        self.source.info()
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        let found = self.source.next_frame(row)?;
        if found {
            let (rate_hz, is_first) = (self.source.info().rate_hz, self.is_first);
            for (marker, position) in self.markers.iter_mut().zip(row.iter()) {
                marker.add(*position, rate_hz, is_first);
            }
            self.is_first = false;
        }
        Ok(found)
    }
}
