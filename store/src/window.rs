//! A take in a store, of which windows are read.

use std::ops::Range;

use mocapd_take::{TakeError, TakeMap, TakeTail, TakeTraversal, traversal::Decode};

use crate::{ObjectReader, ObjectUrl, Store};

/// A take in a store, of which some rows are wanted.
///
/// A closed take with a summary is opened in one request, and a window of it costs one or two more: one range of key
/// stretches that is likely to hold it, and if it does not, the rest up to the next key stretch. Any other take is read
/// as a file, chunk by chunk.
#[derive(Debug)]
pub struct StoredTake {
    reader: ObjectReader,
    map: TakeMap,
    tail: Option<TakeTail>,
}

impl StoredTake {
    /// Opens a take.
    ///
    /// # Errors
    /// `Io` with a [`StoreError`](crate::StoreError) inside; those of [`TakeMap::open`].
    pub fn open(store: &Store, url: &ObjectUrl) -> Result<Self, TakeError> {
        Self::of(store.open(url).map_err(|error| TakeError::Io(error.into()))?)
    }

    /// A take in an object that was opened.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn of(mut reader: ObjectReader) -> Result<Self, TakeError> {
        let tail = TakeTail::read(&mut reader)?;
        let map = match &tail {
            Some(tail) => tail.map.clone(),
            None => TakeMap::open(&mut reader)?,
        };
        Ok(Self { reader, map, tail })
    }

    /// The take, without its samples. If it [was read from its end](Self::is_from_end), events, subject, clock lines and
    /// foreign parts are missing.
    #[must_use]
    pub fn map(&self) -> &TakeMap {
        &self.map
    }

    /// Whether only the end of the take was read.
    #[must_use]
    pub fn is_from_end(&self) -> bool {
        self.tail.is_some()
    }

    /// The object.
    #[must_use]
    pub fn reader(&self) -> &ObjectReader {
        &self.reader
    }

    /// Decodes the stretches that contain any of the rows `rows`, as [`TakeTraversal::read_rows`] does.
    ///
    /// # Errors
    /// As there.
    pub fn read_rows(
        &mut self,
        rows: &Range<u64>,
        decode: Decode,
        mut each: impl FnMut(
            &TakeTraversal<&mut ObjectReader>,
            Range<u64>,
            usize,
        ) -> Result<(), TakeError>,
    ) -> Result<(), TakeError> {
        if let Some(tail) = &self.tail {
            self.reader.plan(tail.window(rows));
        }
        let mut take = TakeTraversal::from_map(&mut self.reader, &self.map, decode)?;
        take.read_rows(rows, |take, rows, offset| each(take, rows, offset))
    }
}
