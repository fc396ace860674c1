//! `TakeFile`: the native object behind `mocapd.Take`.

use std::{ops::Range, path::PathBuf};

use mocapd_take::{TakeMap, damage::Problem, timeline::LossCauses};
use numpy::{IntoPyArray, PyArray1, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict, PyList},
};

use crate::{
    background::run_detached,
    cache::DecodeCache,
    decode::DecodeRequest,
    errors::Failure,
    scan::scan,
    source::Source,
    times::{Times, lost, times},
};

/// An open take, addressed by rows and columns.
#[pyclass(frozen, module = "mocapd._native")]
pub(crate) struct TakeFile {
    source: Source,
    path: Option<PathBuf>,
    map: TakeMap,
    cache: DecodeCache,
}

/// Device ticks, arrival times in nanoseconds, and whether each row was recorded.
type TimesOut<'py> =
    (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<bool>>);

/// For each column: samples, gaps, knots, the largest stated error in millimetres, and the rows of the knots.
type ScanOut<'py> = Vec<(u64, u64, u64, f64, Bound<'py, PyArray1<i64>>)>;

#[pymethods]
impl TakeFile {
    #[new]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let opened = py.detach(|| Source::open(&path));
        let source = opened.map_err(|failure| failure.into_py_err(py, Some(&path)))?;
        Self::open_source(py, source, Some(path))
    }

    /// Opens a take in memory.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &Bound<'_, PyBytes>) -> PyResult<Self> {
        Self::open_source(py, Source::from_bytes(bytes.as_bytes()), None)
    }

    #[getter]
    fn n_rows(&self) -> u64 {
        self.map.n_rows
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.map.channels.iter().map(|channel| channel.label.clone()).collect()
    }

    #[getter]
    fn finished(&self) -> bool {
        self.map.finished
    }

    /// The problems of the take, except that its end is missing: that is [`cut_off`](Self::cut_off).
    #[getter]
    fn problems(&self) -> Vec<String> {
        let problems = self.map.problems.iter().filter(|problem| **problem != Problem::CutOff);
        problems.map(ToString::to_string).collect()
    }

    /// A message if the end of the take is missing; None for a take that was closed in order.
    #[getter]
    fn cut_off(&self) -> Option<String> {
        let cut_off = self.map.problems.iter().find(|problem| **problem == Problem::CutOff);
        cut_off.map(ToString::to_string)
    }

    /// The header as a dict.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let header = &self.map.header;
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

    /// For each channel whether the device or file gave it its name.
    fn labelled(&self) -> Vec<bool> {
        self.map.channels.iter().map(|channel| channel.labelled).collect()
    }

    /// The last ledger as a dict, or None.
    fn ledger<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(ledger) = &self.map.ledger else { return Ok(None) };
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
        Ok(Some(out))
    }

    /// How the recording ended, as (kind, detail); None if the take does not state it.
    fn ending(&self) -> Option<(String, String)> {
        let ending = self.map.ending.as_ref()?;
        Some((ending.kind.name().to_owned(), ending.detail.clone()))
    }

    /// The events, each as a dict.
    fn events<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let out = PyList::empty(py);
        for event in &self.map.events {
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

    /// The clock lines, each as a dict: linear maps from the device's clock to the host's.
    fn clock_lines<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let out = PyList::empty(py);
        for (segment, line) in &self.map.clock_lines {
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

    /// Fills `out`, float32 [rows, columns, 3], with positions in millimetres from row `first` on, NaN for missing
    /// samples. Returns the problems of decoding as text.
    fn read_into(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray3<'_, f32>,
        first: u64,
        columns: Vec<usize>,
        threads: usize,
    ) -> PyResult<Vec<String>> {
        let n_rows = out.shape()[0] as u64;
        if out.shape()[1..] != [columns.len(), 3] {
            return Err(Failure::Value("the array must be [frames, markers, 3]".into()).into());
        }
        let rows = self.rows(first, first.saturating_add(n_rows))?;
        self.check_columns(&columns)?;
        let out = out
            .as_slice_mut()
            .map_err(|_| Failure::Value("the array must be contiguous, in C order".into()))?;
        self.run(py, |source| self.cache.read(self.request(source, &columns, threads), &rows, out))
    }

    /// Counts samples, gaps and knots of the requested columns over the whole take. Returns [`ScanOut`], and the
    /// problems of decoding as text.
    fn scan<'py>(
        &self,
        py: Python<'py>,
        columns: Vec<usize>,
        with_knots: bool,
        threads: usize,
    ) -> PyResult<(ScanOut<'py>, Vec<String>)> {
        self.check_columns(&columns)?;
        let (found, problems) =
            self.run(py, |source| scan(self.request(source, &columns, threads), with_knots))?;
        let out = found.into_iter().map(|column| {
            let knots = column.knots.into_pyarray(py);
            (column.samples, column.gaps, column.n_knots, column.max_error_mm, knots)
        });
        Ok((out.collect(), problems))
    }

    /// The times of the rows from `first` to before `stop`, as [`TimesOut`]; the arrays are empty for an import.
    fn times<'py>(&self, py: Python<'py>, first: u64, stop: u64) -> PyResult<TimesOut<'py>> {
        let rows = self.rows(first, stop)?;
        let Times { device_ticks, arrival_ns, recorded } =
            self.run(py, |source| times(source, &self.map, &rows))?;
        Ok((device_ticks.into_pyarray(py), arrival_ns.into_pyarray(py), recorded.into_pyarray(py)))
    }

    /// Runs of lost rows, each as first row, number of rows and causes.
    fn lost(&self, py: Python<'_>) -> PyResult<Vec<(u64, u64, String)>> {
        let found = self.run(py, |source| lost(source, &self.map))?;
        Ok(found.into_iter().map(|(first, n, causes)| (first, n, cause_text(causes))).collect())
    }
}

impl TakeFile {
    fn open_source(py: Python<'_>, source: Source, path: Option<PathBuf>) -> PyResult<Self> {
        let map = run_detached(py, path.as_deref(), |cancel| {
            Ok(TakeMap::open(&mut source.with_cancel(cancel).reader())?)
        })?;
        Ok(Self { source, path, map, cache: DecodeCache::default() })
    }

    fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Source) -> Result<T, Failure> + Send,
    ) -> PyResult<T> {
        run_detached(py, self.path.as_deref(), |cancel| work(&self.source.with_cancel(cancel)))
    }

    fn request<'a>(
        &'a self,
        source: &'a Source,
        columns: &'a [usize],
        threads: usize,
    ) -> DecodeRequest<'a> {
        DecodeRequest { source, map: &self.map, columns, threads }
    }

    fn rows(&self, first: u64, stop: u64) -> Result<Range<u64>, Failure> {
        if first <= stop && stop <= self.map.n_rows {
            return Ok(first..stop);
        }
        let n_rows = self.map.n_rows;
        Err(Failure::Value(format!("frames {first} to {stop} are outside of the take's {n_rows}")))
    }

    fn check_columns(&self, columns: &[usize]) -> Result<(), Failure> {
        let n = self.map.channels.len();
        match columns.iter().find(|&&column| column >= n) {
            Some(column) => Err(Failure::Value(format!("no column {column}: the take has {n}"))),
            None => Ok(()),
        }
    }
}

/// The causes of lost rows as text.
fn cause_text(causes: LossCauses) -> String {
    let all = [
        (LossCauses::NOT_RECEIVED, "not received"),
        (LossCauses::RING_FULL, "ring full"),
        (LossCauses::DISCONNECTED, "disconnected"),
        (LossCauses::DAMAGED, "damaged"),
    ];
    let texts = all.iter().filter(|(cause, _)| causes.contains(*cause)).map(|(_, text)| *text);
    let texts: Vec<_> = texts.collect();
    if texts.is_empty() { "unknown".to_owned() } else { texts.join(", ") }
}
