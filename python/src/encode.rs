//! Encodes arrays as takes.

use std::thread;

use mocapd_codec::{Settings, Tolerance};
use mocapd_take::{
    motion::{Marker, Motion, MotionFrames, MotionInfo, Position, UpAxis},
    motion_encoder::{EncodePart, EncodePlan, EncodedPart, MotionWriter, channels, stretch_rows},
    record::{CODEC_VERSION, Header, ImportSource},
};
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{prelude::*, types::PyBytes};

use crate::{
    background::{Cancel, run_abandonable, run_detached},
    errors::{Failure, Result},
};

/// The writer's name in a take's header.
const SOFTWARE: &str = concat!("mocapd-python ", env!("CARGO_PKG_VERSION"));

/// Positions to check and copy between two checks for cancellation: about a millisecond of work.
const POSITIONS_PER_CHECK: usize = 1 << 16;

/// Maximum number of markers of a take: marker ids have 16 bits.
const MARKERS_MAX: usize = 1 << 16;

/// Options of the encoder: in Python a dictionary with these keys.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct EncodeOptions {
    rate_hz: f64,
    /// None for `lossless`.
    tolerance_mm: Option<f64>,
    resampler: String,
    /// The code of the up axis in HEADER.
    up_axis: u8,
}

/// Encodes `positions`, float32 [frames, markers, 3] in millimetres with NaN for missing samples. Returns the bytes of
/// the take.
#[pyfunction]
pub(crate) fn encode<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray3<'py, f32>,
    labels: Vec<(String, bool)>,
    options: EncodeOptions,
    threads: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let EncodeOptions { rate_hz, tolerance_mm, resampler, up_axis } = options;
    let [n_rows, n_markers, axes] = *positions.shape() else {
        return Err(Failure::Value("the array must be [frames, markers, 3]".into()).into());
    };
    if axes != 3 || labels.len() != n_markers || n_markers > MARKERS_MAX {
        let message = format!(
            "expected an array [frames, markers, 3] of at most {MARKERS_MAX} markers with a label for each, found [{n_rows}, {n_markers}, {axes}] with {} labels",
            labels.len()
        );
        return Err(Failure::Value(message).into());
    }
    let values = positions
        .as_slice()
        .map_err(|_| Failure::Value("the array must be contiguous, in C order".into()))?;
    let settings = Settings {
        kind: resampler.parse().map_err(Failure::from)?,
        tolerance: Tolerance::from_mm(tolerance_mm.unwrap_or(Tolerance::MAX_MM))
            .map_err(Failure::from)?,
    };
    let motion = run_detached(py, None, |cancel| motion(values, n_rows, labels, rate_hz, cancel))?;
    let take = run_abandonable(py, move |cancel| {
        let mut header = header(&settings, rate_hz, UpAxis::from_code(up_axis));
        header.channels = channels(&motion.info.markers);
        let codec = header.codec()?;
        header.stretch_rows = stretch_rows(&codec, rate_hz, n_rows, n_markers) as u32;
        header.check()?;
        let values = motion.positions_mm.as_flattened().iter();
        let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
        header.set_import_id(&bytes[..], None)?;
        drop(bytes);
        write(&motion, &header, threads, cancel)
    })?;
    Ok(PyBytes::new(py, &take))
}

fn header(codec: &Settings, rate_hz: f64, up_axis: UpAxis) -> Header {
    let mut header = Header {
        software: SOFTWARE.to_owned(),
        codec_version: CODEC_VERSION,
        rate_hz,
        up_axis,
        source: Some(ImportSource {
            format: "array".to_owned(),
            unit: "mm".to_owned(),
            factor: 1.0,
            first_frame: 1,
            ..ImportSource::default()
        }),
        ..Header::default()
    };
    header.set_codec(codec);
    header
}

fn motion(
    values: &[f32],
    n_rows: usize,
    labels: Vec<(String, bool)>,
    rate_hz: f64,
    cancel: &Cancel,
) -> Result<Motion> {
    let (positions, _) = values.as_chunks::<3>();
    let is_invalid = |position: &Position| {
        let missing = position.iter().filter(|value| value.is_nan()).count();
        (missing != 0 && missing != 3) || position.iter().any(|value| value.is_infinite())
    };
    let mut positions_mm = Vec::with_capacity(positions.len());
    for part in positions.chunks(POSITIONS_PER_CHECK) {
        cancel.check()?;
        if let Some(at) = part.iter().position(is_invalid) {
            let place = positions_mm.len() + at;
            let (row, column) = (place / labels.len(), place % labels.len());
            return Err(Failure::Value(format!(
                "frame {row}, marker {column} is {:?}: expected three finite numbers, or three NaN for a gap",
                part[at]
            )));
        }
        positions_mm.extend_from_slice(part);
    }
    let marker = |(label, labelled): (String, bool)| Marker { label, labelled };
    Ok(Motion {
        info: MotionInfo {
            rate_hz,
            n_frames: n_rows as u64,
            markers: labels.into_iter().map(marker).collect(),
            ..MotionInfo::default()
        },
        positions_mm,
    })
}

/// Encodes as many parts at a time as there are threads. The bytes do not depend on the number of threads.
fn write(motion: &Motion, header: &Header, threads: usize, cancel: &Cancel) -> Result<Vec<u8>> {
    let mut frames = MotionFrames::new(motion);
    let (plan, mut parts) = EncodePlan::new(&mut frames, header)?;
    let mut take = MotionWriter::new(&plan, parts.info(), header, Vec::new())?;
    let mut encoders: Vec<_> = (0..threads.max(1)).map(|_| plan.encoder()).collect();
    loop {
        let parts: Vec<EncodePart> =
            parts.by_ref().take(encoders.len()).collect::<std::result::Result<_, _>>()?;
        if parts.is_empty() {
            return Ok(take.finish()?.1);
        }
        cancel.check()?;
        let coded: Vec<EncodedPart> = thread::scope(|scope| {
            let work = encoders.iter_mut().zip(&parts);
            let threads: Vec<_> = work
                .map(|(encoder, part)| {
                    thread::Builder::new().spawn_scoped(scope, move || encoder.encode(part))
                })
                .collect::<Result<_, _>>()?;
            let done = threads.into_iter().map(|thread| thread.join());
            done.map(|coded| Ok(coded.map_err(|_| Failure::Internal)??)).collect::<Result<_>>()
        })?;
        for (part, coded) in parts.iter().zip(&coded) {
            take.push(part, coded)?;
        }
    }
}
