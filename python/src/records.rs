//! The records of a take as Python dicts.

use mocapd_take::{
    foreign::{
        analog::AnalogSamples,
        force_plates::{ForcePlate, ForcePlates, UnusablePlate},
        parameters::{C3dParameter, C3dValues},
    },
    record::{ClockLine, Event, Header, Ledger},
};
use numpy::{IntoPyArray, PyArray2};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict, PyList},
};

use crate::foreign::KeptContent;

pub(crate) fn header<'py>(py: Python<'py>, header: &Header) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("software", &header.software)?;
    out.set_item("take_id", PyBytes::new(py, &header.take_id))?;
    out.set_item("created_unix_ms", header.created_unix_ms)?;
    out.set_item("resampler", &header.resampler)?;
    out.set_item("tolerance_mm", header.tolerance_mm)?;
    out.set_item("rate_hz", header.rate_hz)?;
    out.set_item("up_axis", header.up_axis.name())?;
    out.set_item("settings", header.settings.to_vec())?;
    let device = header.device.as_ref().map(|device| {
        let dict = PyDict::new(py);
        dict.set_item("driver", &device.driver)?;
        dict.set_item("uri", &device.uri)?;
        dict.set_item("model", &device.model)?;
        dict.set_item("serial", &device.serial)?;
        dict.set_item("firmware", &device.firmware)?;
        dict.set_item("tick_hz", device.tick_hz)?;
        dict.set_item("low_latency", device.low_latency)?;
        Ok::<_, PyErr>(dict)
    });
    out.set_item("device", device.transpose()?)?;
    let source = header.source.as_ref().map(|source| {
        let dict = PyDict::new(py);
        dict.set_item("format", &source.format)?;
        dict.set_item("file", &source.file)?;
        dict.set_item("unit", &source.unit)?;
        dict.set_item("factor_to_mm", source.factor)?;
        dict.set_item("first_frame", source.first_frame)?;
        dict.set_item("warnings", &source.warnings)?;
        Ok::<_, PyErr>(dict)
    });
    out.set_item("source", source.transpose()?)?;
    Ok(out)
}

pub(crate) fn ledger<'py>(py: Python<'py>, ledger: &Ledger) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("finished", ledger.finished)?;
    for (name, count) in [
        ("frames_sent", ledger.frames_sent),
        ("recorded", ledger.recorded),
        ("lost_on_link", ledger.lost_on_link),
        ("dropped_by_device", ledger.dropped_by_device),
        ("lost_ring_full", ledger.lost_ring_full),
        ("lost_other", ledger.lost_other),
        ("duplicates", ledger.duplicates),
        ("unknown_after_disconnect", ledger.unknown_after_disconnect),
        ("samples_announced", ledger.samples_announced),
        ("samples_present", ledger.samples_present),
        ("samples_occluded", ledger.samples_occluded),
        ("samples_not_finite", ledger.samples_not_finite),
        ("markers_dropped", ledger.markers_dropped),
        ("link_bytes", ledger.link_bytes),
        ("link_bytes_skipped", ledger.link_bytes_skipped),
        ("link_messages", ledger.link_messages),
        ("link_messages_damaged", ledger.link_messages_damaged),
        ("link_messages_unknown", ledger.link_messages_unknown),
    ] {
        out.set_item(name, count)?;
    }
    out.set_item("contradictions", &ledger.contradictions)?;
    out.set_item("closes", ledger.closes())?;
    Ok(out)
}

pub(crate) fn events<'py>(py: Python<'py>, events: &[Event]) -> PyResult<Bound<'py, PyList>> {
    let out = PyList::empty(py);
    for event in events {
        let dict = PyDict::new(py);
        dict.set_item("kind", event.kind.name())?;
        dict.set_item("frame", event.row)?;
        dict.set_item("device_ticks", event.device_ticks)?;
        dict.set_item("host_ns", event.host_ns)?;
        dict.set_item("input", event.input)?;
        dict.set_item("text", &event.text)?;
        out.append(dict)?;
    }
    Ok(out)
}

/// Lines with their segments of the device's clock.
pub(crate) fn clock_lines<'py>(
    py: Python<'py>,
    lines: &[(u32, ClockLine)],
) -> PyResult<Bound<'py, PyList>> {
    let out = PyList::empty(py);
    for (segment, line) in lines {
        let dict = PyDict::new(py);
        dict.set_item("segment", segment)?;
        dict.set_item("device_ticks", line.device_ticks)?;
        dict.set_item("host_ns", line.host_ns)?;
        dict.set_item("drift_ppm", line.drift_ppb as f64 / 1e3)?;
        dict.set_item("bound_us", line.bound.map(|bound| bound.offset_us))?;
        out.append(dict)?;
    }
    Ok(out)
}

/// Texts are a list, numbers an array of one axis: the first of the dimensions is the fastest.
pub(crate) fn parameters(py: Python<'_>, all: Vec<C3dParameter>) -> PyResult<Bound<'_, PyList>> {
    let out = PyList::empty(py);
    for parameter in all {
        let dict = PyDict::new(py);
        dict.set_item("group", &parameter.group)?;
        dict.set_item("name", &parameter.name)?;
        let dimensions = parameter.dimensions.iter().map(|&n| usize::from(n));
        dict.set_item("dimensions", dimensions.collect::<Vec<_>>())?;
        match parameter.values {
            C3dValues::Texts(texts) => dict.set_item("values", texts)?,
            C3dValues::Bytes(bytes) => dict.set_item("values", bytes.into_pyarray(py))?,
            C3dValues::Integers(words) => dict.set_item("values", words.into_pyarray(py))?,
            C3dValues::Floats(floats) => dict.set_item("values", floats.into_pyarray(py))?,
        }
        out.append(dict)?;
    }
    Ok(out)
}

/// The channels of a take.
pub(crate) fn analog<'py>(
    py: Python<'py>,
    analog: Option<&AnalogSamples<'_>>,
    kept: &KeptContent,
) -> PyResult<Bound<'py, PyDict>> {
    let channels = PyList::empty(py);
    for channel in analog.map_or(&[][..], AnalogSamples::channels) {
        let dict = PyDict::new(py);
        dict.set_item("name", &channel.name)?;
        dict.set_item("unit", &channel.unit)?;
        dict.set_item("description", &channel.description)?;
        dict.set_item("scale", channel.scale)?;
        dict.set_item("offset", channel.offset)?;
        channels.append(dict)?;
    }
    let ratio = analog.map_or(0, AnalogSamples::samples_per_frame);
    let out = PyDict::new(py);
    out.set_item("channels", channels)?;
    out.set_item("samples_per_frame", ratio)?;
    out.set_item("n_samples", kept.info.n_frames.saturating_mul(ratio as u64))?;
    out.set_item("rate_hz", analog.map_or(0.0, AnalogSamples::rate_hz))?;
    let warnings = analog.map_or(&[][..], AnalogSamples::warnings);
    out.set_item("warnings", [warnings, &kept.lost].concat())?;
    Ok(out)
}

/// A plate that can be used.
pub(crate) fn force_plate<'py>(
    py: Python<'py>,
    plate: &ForcePlate,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("number", plate.number)?;
    dict.set_item("type", plate.kind.code())?;
    dict.set_item("corners_mm", matrix(py, &plate.geometry.corners_mm())?)?;
    dict.set_item("origin_mm", plate.geometry.origin_mm().to_vec().into_pyarray(py))?;
    dict.set_item("channels", &plate.channels)?;
    let calibration = plate.calibration.as_ref().map(|rows| matrix(py, rows));
    dict.set_item("calibration", calibration.transpose()?)?;
    Ok(dict)
}

/// The plates, and what was wrong with them and with those that are left out.
pub(crate) fn force_plates<'py>(
    py: Python<'py>,
    found: &ForcePlates,
) -> PyResult<(Bound<'py, PyList>, Vec<String>)> {
    let out = PyList::empty(py);
    for plate in &found.plates {
        out.append(force_plate(py, plate)?)?;
    }
    let left_out = |plate: &UnusablePlate| {
        format!("force plate {} is left out: {}", plate.number, plate.reason)
    };
    let wrong = found.unusable.iter().map(left_out).chain(found.warnings.iter().cloned());
    Ok((out, wrong.collect()))
}

fn matrix<'py, const N: usize>(
    py: Python<'py>,
    rows: &[[f64; N]],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows: Vec<Vec<f64>> = rows.iter().map(|row| row.to_vec()).collect();
    Ok(PyArray2::from_vec2(py, &rows)?)
}
