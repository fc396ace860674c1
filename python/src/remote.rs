//! Objects in stores, and takes in them, for archives.

use std::{
    io::{Cursor, Read, Seek, SeekFrom},
    sync::{Mutex, PoisonError},
    time::UNIX_EPOCH,
};

use mocapd_store::{ByteRange, ObjectReader, ObjectUrl, Store, StoreError};
use mocapd_take::{TakeMap, TakeTail, TakeTraversal, traversal::Decode};
use numpy::{PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{prelude::*, types::PyBytes};

use crate::{
    background::{run_abandonable, run_detached},
    decode::groups,
    errors::{Failure, Result},
    read::PositionFiller,
};

/// Name, size, and time of creation in seconds since 1970, where the store states one.
type ListedOut = (String, u64, Option<f64>);

/// Bytes that are read between two checks for cancellation: the longest range of a reader.
const READ_BYTES: u64 = 8 << 20;

/// A folder of objects in a store: `s3://bucket/folder`.
#[pyclass(frozen, module = "mocapd._native")]
pub(crate) struct ObjectStore {
    folder: ObjectUrl,
    /// With the process that connected it.
    store: Mutex<(u32, Store)>,
}

impl ObjectStore {
    /// The store: another one in a process that was forked off, whose parent has the connections.
    fn store(&self) -> Result<Store> {
        let process = std::process::id();
        let mut known = self.store.lock().unwrap_or_else(PoisonError::into_inner);
        if known.0 != process {
            let parents = std::mem::replace(&mut *known, (process, connect(&self.folder)?));
            std::mem::forget(parents);
        }
        Ok(known.1.clone())
    }
}

/// Counted for itself, so that the traffic is that of one object.
fn connect(folder: &ObjectUrl) -> Result<Store> {
    Ok(Store::of(folder)?.counted_anew())
}

#[pymethods]
impl ObjectStore {
    #[new]
    fn new(url: &str) -> PyResult<Self> {
        let folder = ObjectUrl::parse(url).map_err(Failure::from)?;
        let store = Mutex::new((std::process::id(), connect(&folder)?));
        Ok(Self { folder, store })
    }

    /// Creates an object, in parts if it is large. False if it exists with the same content.
    fn create(&self, py: Python<'_>, name: &str, data: &Bound<'_, PyBytes>) -> PyResult<bool> {
        let (store, url) = (self.store()?, self.folder.join(name));
        let bytes = data.as_bytes().to_vec();
        run_abandonable(py, move |cancel| {
            let mut pace = |_| match cancel.check() {
                Ok(()) => Ok(()),
                Err(_) => Err(StoreError::Stopped(url.to_string())),
            };
            Ok(store.upload(&url, &mut Cursor::new(&bytes), &mut pace)?)
        })
    }

    /// The bytes from `start` to before `stop`, or all, which are read in ranges of one version of the object.
    #[pyo3(signature = (name, start=0, stop=None))]
    fn read<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        start: u64,
        stop: Option<u64>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let (store, url) = (self.store()?, self.folder.join(name));
        let bytes = run_abandonable(py, move |cancel| {
            if let Some(stop) = stop {
                return Ok(store.read(&url, &ByteRange::Of(start..stop), None)?.bytes);
            }
            let mut reader = store.open(&url)?;
            reader.seek(SeekFrom::Start(start))?;
            let mut bytes = Vec::new();
            while reader.by_ref().take(READ_BYTES).read_to_end(&mut bytes)? > 0 {
                cancel.check()?;
            }
            Ok(bytes)
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The size of an object; None if it does not exist.
    fn size(&self, py: Python<'_>, name: &str) -> PyResult<Option<u64>> {
        let (store, url) = (self.store()?, self.folder.join(name));
        run_abandonable(py, move |_| match store.len_bytes(&url) {
            Err(StoreError::NotFound(_)) => Ok(None),
            other => Ok(other.map(Some)?),
        })
    }

    /// The objects in a folder, with those in its folders.
    fn list(&self, py: Python<'_>, folder: &str) -> PyResult<Vec<ListedOut>> {
        let at = if folder.is_empty() { self.folder.clone() } else { self.folder.join(folder) };
        let store = self.store()?;
        let found = run_abandonable(py, move |_| Ok(store.list(&at, true)?))?;
        let prefix = match self.folder.key().trim_end_matches('/') {
            "" => String::new(),
            key => format!("{key}/"),
        };
        let listed = found.into_iter().map(|object| {
            let name = object.url.key().strip_prefix(&prefix).unwrap_or(object.url.key());
            let since = object.modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            (name.to_owned(), object.len, since.map(|since| since.as_secs_f64()))
        });
        Ok(listed.collect())
    }

    /// Removes an object, if it exists.
    fn remove(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        let (store, url) = (self.store()?, self.folder.join(name));
        run_abandonable(py, move |_| Ok(store.remove(&url)?))
    }

    /// Opens a take, to read windows of it.
    fn open_take(&self, py: Python<'_>, name: &str) -> PyResult<RemoteTake> {
        let (store, url) = (self.store()?, self.folder.join(name));
        run_abandonable(py, move |_| {
            let mut reader = store.open(&url)?;
            let tail = TakeTail::read(&mut reader)?;
            let map = match &tail {
                Some(tail) => tail.map.clone(),
                None => TakeMap::open(&mut reader)?,
            };
            Ok(RemoteTake { reader: Mutex::new(reader), map, tail })
        })
    }

    /// Requests, bytes received and bytes sent by this object and the takes that it opened.
    fn traffic(&self) -> PyResult<(u64, u64, u64)> {
        let count = self.store()?.traffic();
        Ok((count.requests, count.received_bytes, count.sent_bytes))
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
