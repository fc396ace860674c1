//! `TakeFile`: the native part of `mocapd.Take`.

use std::{
    ops::Range,
    path::PathBuf,
    sync::{Arc, PoisonError, RwLock},
};

use mocapd_take::{TakeMap, damage::Problem, sampled::Recording, timeline::LossCauses};
use numpy::{IntoPyArray, PyArray1, PyReadwriteArray2, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict, PyList},
};

use crate::{
    background::run_detached,
    cache::DecodeCache,
    decode::DecodeRequest,
    errors::Failure,
    foreign::{self, KeptContent, KeptParts, LOAD_VALUES},
    recording::{self, POSE_VALUES},
    records,
    scan::scan,
    source::Source,
    times::{Times, lost, times},
};

/// An open take, addressed by rows and columns.
#[pyclass(frozen, module = "mocapd._native")]
pub(crate) struct TakeFile {
    /// `None` once closed. Threads that read hold the file open until they are done.
    open: RwLock<Option<OpenTake>>,
    path: Option<PathBuf>,
    map: TakeMap,
    cache: DecodeCache,
}

/// What closing a take frees.
#[derive(Clone)]
struct OpenTake {
    source: Source,
    /// The parts of an import that were read, and which they are.
    kept: Option<(KeptParts, Arc<KeptContent>)>,
    /// The sampled channels, once they were found; `None` in it if there are none.
    recording: Option<Arc<Option<Recording>>>,
}

/// Device ticks, arrival times in nanoseconds, and whether each row was recorded.
type TimesOut<'py> =
    (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<bool>>);

/// For each column: samples, gaps, knots, the largest stated error in millimetres, and the rows of the knots.
type ScanOut<'py> = Vec<(u64, u64, u64, f64, Bound<'py, PyArray1<i64>>)>;

/// The name of a subject, and the documents by their kinds.
type SubjectOut<'py> = (String, Vec<(String, Bound<'py, PyBytes>)>);

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
        records::header(py, &self.map.header)
    }

    /// The last ledger as a dict, or None.
    fn ledger<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.map.ledger.as_ref().map(|ledger| records::ledger(py, ledger)).transpose()
    }

    /// The events, each as a dict.
    fn events<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        records::events(py, &self.map.events)
    }

    /// The clock lines, each as a dict: linear maps from the device's clock to the host's.
    fn clock_lines<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        records::clock_lines(py, &self.map.clock_lines)
    }

    /// For each channel whether the device or file gave it its name.
    fn labelled(&self) -> Vec<bool> {
        self.map.channels.iter().map(|channel| channel.labelled).collect()
    }

    /// How the recording ended, as (kind, detail); None if the take does not state it.
    fn ending(&self) -> Option<(String, String)> {
        let ending = self.map.ending.as_ref()?;
        Some((ending.kind.name().to_owned(), ending.detail.clone()))
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
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
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

    #[getter]
    fn closed(&self) -> bool {
        self.source().is_err()
    }

    /// Closes the file, and frees what is cached of it.
    fn close(&self) {
        *self.open.write().unwrap_or_else(PoisonError::into_inner) = None;
        self.cache.clear();
    }

    /// Fails if the file is closed.
    fn check_open(&self, py: Python<'_>) -> PyResult<()> {
        let open = self.source();
        open.map(drop).map_err(|closed| closed.into_py_err(py, self.path.as_deref()))
    }

    /// The subject, if the take states it.
    fn subject<'py>(&self, py: Python<'py>) -> Option<SubjectOut<'py>> {
        let subject = self.map.subject.as_ref()?;
        let documents = subject.documents.iter();
        let documents = documents.map(|found| (found.kind.clone(), PyBytes::new(py, &found.data)));
        Some((subject.name.clone(), documents.collect()))
    }

    /// The parameters of an imported C3D file, each as a dict.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let kept = self.kept(py, KeptParts::Parameters)?;
        records::parameters(py, self.run(py, |_| foreign::parameters(&kept.info))?)
    }

    /// The analog channels, as a dict.
    fn analog<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let kept = self.kept(py, KeptParts::All)?;
        let found = self.run(py, |_| foreign::analog(&kept.info))?;
        records::analog(py, found.as_ref(), &kept)
    }

    /// The force plates that can be used, each as a dict, and what was wrong with them and the others.
    fn force_plates<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyList>, Vec<String>)> {
        let kept = self.kept(py, KeptParts::All)?;
        records::force_plates(py, &self.run(py, |_| foreign::force_plates(&kept.info))?)
    }

    /// The groups of sampled channels of a recording, each as a dict, and what is wrong with them.
    fn sampled<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyList>, Vec<String>)> {
        recording::describe(py, (*self.recording(py)?).as_ref())
    }

    /// The times of all samples of the group with this index, in seconds from the first frame.
    fn sampled_times<'py>(
        &self,
        py: Python<'py>,
        group: usize,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let found = self.recording(py)?;
        let times_s = self.run(py, |_| recording::times(of_recording(&found)?, group))?;
        Ok(times_s.into_pyarray(py))
    }

    /// Fills `out`, float32 [samples, channels], with values of a group from its sample `first` on.
    fn read_sampled(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray2<'_, f32>,
        group: usize,
        first: u64,
        channels: Vec<usize>,
    ) -> PyResult<()> {
        let samples = first..first.saturating_add(out.shape()[0] as u64);
        if out.shape()[1] != channels.len() {
            return Err(Failure::Value("the array must be [samples, channels]".into()).into());
        }
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
        let found = self.recording(py)?;
        self.run(py, |source| {
            recording::read(of_recording(&found)?, source, (group, &samples), &channels, out)
        })
    }

    /// Fills `out`, float64 [samples, 12 for each plate], with loads of the plates of a group from its sample `first` on.
    fn read_sampled_loads(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray2<'_, f64>,
        group: usize,
        first: u64,
        plates: Vec<usize>,
    ) -> PyResult<()> {
        let samples = first..first.saturating_add(out.shape()[0] as u64);
        if out.shape()[1] != plates.len() * LOAD_VALUES {
            return Err(
                Failure::Value("the array must be [samples, 12 for each plate]".into()).into()
            );
        }
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
        let found = self.recording(py)?;
        self.run(py, |source| {
            recording::read_loads(of_recording(&found)?, source, (group, &samples), &plates, out)
        })
    }

    /// The numbers and the names of the rigid bodies of a recording.
    fn bodies(&self, py: Python<'_>) -> PyResult<Vec<(u32, String)>> {
        let found = self.recording(py)?;
        let bodies = found.iter().flat_map(|recording| recording.bodies());
        Ok(bodies.map(|body| (body.number, body.name.clone())).collect())
    }

    /// Fills `out`, float32 [frames, bodies, 8], with positions, quaternions and residuals of rigid bodies from row `first`
    /// on, and `states`, uint8 [frames, bodies], with the numbers of their states.
    fn read_poses(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray3<'_, f32>,
        mut states: PyReadwriteArray2<'_, u8>,
        first: u64,
        bodies: Vec<usize>,
    ) -> PyResult<()> {
        let n_rows = out.shape()[0] as u64;
        let is_shaped =
            out.shape()[1..] == [bodies.len(), POSE_VALUES] && states.shape() == &out.shape()[..2];
        if !is_shaped {
            let message = "the arrays must be [frames, bodies, 8] and [frames, bodies]";
            return Err(Failure::Value(message.into()).into());
        }
        let rows = self.rows(first, first.saturating_add(n_rows))?;
        let found = self.recording(py)?;
        let n_bodies = found.as_ref().as_ref().map_or(0, |recording| recording.bodies().len());
        if let Some(body) = bodies.iter().find(|&&body| body >= n_bodies) {
            let message = format!("no rigid body {body}: the take has {n_bodies}");
            return Err(Failure::Value(message).into());
        }
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
        let states = states.as_slice_mut().map_err(|_| not_contiguous())?;
        self.run(py, |source| match &*found {
            Some(found) => recording::read_poses(found, source, &rows, &bodies, (out, states)),
            None => Ok(()),
        })
    }

    /// Fills `out`, float64 [samples, channels], with physical values from sample `first` on.
    fn read_analog(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray2<'_, f64>,
        first: u64,
        channels: Vec<usize>,
    ) -> PyResult<()> {
        let samples = first..first.saturating_add(out.shape()[0] as u64);
        if out.shape()[1] != channels.len() {
            return Err(Failure::Value("the array must be [samples, channels]".into()).into());
        }
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
        let kept = self.kept(py, KeptParts::All)?;
        self.run(py, |source| foreign::read_analog(&kept.info, source, &samples, &channels, out))
    }

    /// Fills `out`, float64 [samples, 12 for each plate], with loads from sample `first` on.
    fn read_loads(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray2<'_, f64>,
        first: u64,
        plates: Vec<usize>,
    ) -> PyResult<()> {
        let samples = first..first.saturating_add(out.shape()[0] as u64);
        if out.shape()[1] != plates.len() * LOAD_VALUES {
            return Err(
                Failure::Value("the array must be [samples, 12 for each plate]".into()).into()
            );
        }
        let out = out.as_slice_mut().map_err(|_| not_contiguous())?;
        let kept = self.kept(py, KeptParts::All)?;
        self.run(py, |source| foreign::read_loads(&kept.info, source, &samples, &plates, out))
    }
}

/// The sampled channels of a recording that has some.
fn of_recording(found: &Option<Recording>) -> Result<&Recording, Failure> {
    found.as_ref().ok_or_else(|| Failure::Value("the take has no sampled channels".into()))
}

fn not_contiguous() -> Failure {
    Failure::Value("the array must be contiguous, in C order".into())
}

impl TakeFile {
    fn open_source(py: Python<'_>, source: Source, path: Option<PathBuf>) -> PyResult<Self> {
        let map = run_detached(py, path.as_deref(), |cancel| {
            Ok(TakeMap::open(&mut source.with_cancel(cancel).reader())?)
        })?;
        let open = RwLock::new(Some(OpenTake { source, kept: None, recording: None }));
        Ok(Self { open, path, map, cache: DecodeCache::default() })
    }

    fn state(&self) -> Result<OpenTake, Failure> {
        let open = self.open.read().unwrap_or_else(PoisonError::into_inner);
        open.clone().ok_or(Failure::Closed)
    }

    /// The file, which stays open while it is used.
    fn source(&self) -> Result<Source, Failure> {
        self.state().map(|open| open.source)
    }

    /// The parts of an import, read at the first request.
    fn kept(&self, py: Python<'_>, parts: KeptParts) -> PyResult<Arc<KeptContent>> {
        let open = self.state();
        let open = open.map_err(|closed| closed.into_py_err(py, self.path.as_deref()))?;
        if let Some((_, kept)) = open.kept.filter(|(found, _)| *found >= parts) {
            return Ok(kept);
        }
        let kept = Arc::new(self.run(py, |source| foreign::read_kept(source, parts))?);
        if let Some(open) = &mut *self.open.write().unwrap_or_else(PoisonError::into_inner) {
            open.kept = Some((parts, Arc::clone(&kept)));
        }
        Ok(kept)
    }

    /// The sampled channels of a recording, found at the first request.
    fn recording(&self, py: Python<'_>) -> PyResult<Arc<Option<Recording>>> {
        let open = self.state();
        let open = open.map_err(|closed| closed.into_py_err(py, self.path.as_deref()))?;
        if let Some(found) = open.recording {
            return Ok(found);
        }
        // It stays open for later calls, so it is not read through the source of this one, which may be cancelled.
        let found = Arc::new(self.run(py, |_| recording::open(&open.source))?);
        if let Some(open) = &mut *self.open.write().unwrap_or_else(PoisonError::into_inner) {
            open.recording = Some(Arc::clone(&found));
        }
        Ok(found)
    }

    fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Source) -> Result<T, Failure> + Send,
    ) -> PyResult<T> {
        let source = self.source();
        run_detached(py, self.path.as_deref(), |cancel| work(&source?.with_cancel(cancel)))
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
