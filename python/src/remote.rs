//! Objects in stores, and takes in them, for archives.

use std::{
    io::{Seek, SeekFrom},
    sync::{Mutex, PoisonError},
    time::UNIX_EPOCH,
};

use mocapd_store::{ByteRange, ObjectReader, ObjectUrl, Store, StoreError};
use mocapd_take::{TakeMap, TakeTail, TakeTraversal, traversal::Decode};
use numpy::{PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{prelude::*, types::PyBytes};

use crate::{
    background::run_detached,
    decode::groups,
    errors::{Failure, Result},
    read::PositionFiller,
};

/// Name, size, and time of creation in seconds since 1970.
type ListedOut = (String, u64, f64);

/// A folder of objects in a store: `s3://bucket/folder`.
#[pyclass(frozen, module = "mocapd._native")]
pub(crate) struct ObjectStore {
    store: Store,
    folder: ObjectUrl,
}

#[pymethods]
impl ObjectStore {
    #[new]
    fn new(url: &str) -> PyResult<Self> {
        let folder = ObjectUrl::parse(url).map_err(Failure::from)?;
        // Counted for itself, so that the traffic is that of this object.
        let store = Store::of(&folder).map_err(Failure::from)?.counted_anew();
        Ok(Self { store, folder })
    }

    /// Creates an object. False if it exists.
    fn create(&self, py: Python<'_>, name: &str, data: &Bound<'_, PyBytes>) -> PyResult<bool> {
        let (url, bytes) = (self.folder.join(name), data.as_bytes().to_vec());
        run_detached(py, None, |_| match self.store.create(&url, bytes) {
            Err(StoreError::Exists(_)) => Ok(false),
            other => Ok(other.map(|()| true)?),
        })
    }

    /// The bytes from `start` to before `stop`, or all.
    #[pyo3(signature = (name, start=0, stop=None))]
    fn read<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        start: u64,
        stop: Option<u64>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let url = self.folder.join(name);
        let range = ByteRange::Of(start..stop.unwrap_or(u64::MAX));
        let piece = run_detached(py, None, |_| Ok(self.store.read(&url, &range, None)?))?;
        Ok(PyBytes::new(py, &piece.bytes))
    }

    /// The size of an object; None if it does not exist.
    fn size(&self, py: Python<'_>, name: &str) -> PyResult<Option<u64>> {
        let url = self.folder.join(name);
        run_detached(py, None, |_| match self.store.len_bytes(&url) {
            Err(StoreError::NotFound(_)) => Ok(None),
            other => Ok(other.map(Some)?),
        })
    }

    /// The objects in a folder, with those in its folders.
    fn list(&self, py: Python<'_>, folder: &str) -> PyResult<Vec<ListedOut>> {
        let at = if folder.is_empty() { self.folder.clone() } else { self.folder.join(folder) };
        let found = run_detached(py, None, |_| Ok(self.store.list(&at, true)?))?;
        let prefix = match self.folder.key().trim_end_matches('/') {
            "" => String::new(),
            key => format!("{key}/"),
        };
        let listed = found.into_iter().map(|object| {
            let name = object.url.key().strip_prefix(&prefix).unwrap_or(object.url.key());
            let since = object.modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            (name.to_owned(), object.len, since.unwrap_or_default().as_secs_f64())
        });
        Ok(listed.collect())
    }

    /// Removes an object, if it exists.
    fn remove(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        let url = self.folder.join(name);
        run_detached(py, None, |_| Ok(self.store.remove(&url)?))
    }

    /// Opens a take, to read windows of it.
    fn open_take(&self, py: Python<'_>, name: &str) -> PyResult<RemoteTake> {
        let url = self.folder.join(name);
        run_detached(py, None, |_| {
            let mut reader = self.store.open(&url)?;
            let tail = TakeTail::read(&mut reader)?;
            let map = match &tail {
                Some(tail) => tail.map.clone(),
                None => TakeMap::open(&mut reader)?,
            };
            Ok(RemoteTake { reader: Mutex::new(reader), map, tail })
        })
    }

    /// Requests, bytes received and bytes sent by this object and the takes that it opened.
    fn traffic(&self) -> (u64, u64, u64) {
        let count = self.store.traffic();
        (count.requests, count.received_bytes, count.sent_bytes)
    }
}

/// A take in a store, of which windows are read: the end once, then a range or two for each window.
#[pyclass(frozen, module = "mocapd._native")]
pub(crate) struct RemoteTake {
    reader: Mutex<ObjectReader>,
    map: TakeMap,
    /// The ends of a closed take, from which the ranges of a window follow.
    tail: Option<TakeTail>,
}

#[pymethods]
impl RemoteTake {
    #[getter]
    fn n_rows(&self) -> u64 {
        self.map.n_rows
    }

    #[getter]
    fn rate_hz(&self) -> f64 {
        self.map.header.rate_hz
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.map.channels.iter().map(|channel| channel.label.clone()).collect()
    }

    /// Fills `out`, float32 [rows, columns, 3], with positions from row `first` on. Returns the problems of decoding.
    fn read_into(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArray3<'_, f32>,
        first: u64,
        columns: Vec<usize>,
    ) -> PyResult<Vec<String>> {
        let stop = first.saturating_add(out.shape()[0] as u64);
        let is_inside = columns.iter().all(|column| *column < self.map.channels.len());
        if out.shape()[1..] != [columns.len(), 3] || stop > self.map.n_rows || !is_inside {
            let message = format!("frames {first} to {stop} are not all in the take");
            return Err(Failure::Value(message).into());
        }
        let out = out
            .as_slice_mut()
            .map_err(|_| Failure::Value("the array must be contiguous, in C order".to_owned()))?;
        run_detached(py, None, |_| self.read_rows(first..stop, &columns, out))
    }
}

impl RemoteTake {
    fn read_rows(
        &self,
        rows: std::ops::Range<u64>,
        columns: &[usize],
        out: &mut [f32],
    ) -> Result<Vec<String>> {
        let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tail) = &self.tail {
            reader.plan(tail.window(&rows));
        }
        reader.seek(SeekFrom::Start(0))?;
        let decode = Decode::Groups(groups(columns));
        let mut take = TakeTraversal::from_map(&mut *reader, &self.map, decode)?;
        let mut filler = PositionFiller::new(rows.start, columns, out);
        take.read_rows(&rows, |take, held, offset| {
            filler.fill(take, held, offset);
            Ok(())
        })?;
        filler.finish();
        Ok(take.take_problems().iter().map(ToString::to_string).collect())
    }
}
