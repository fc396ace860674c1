//! A reader of one object that asks for few ranges, and a take in a store, of which it reads windows.

use std::{
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
};

use mocapd_take::{TakeError, TakeMap, TakeTail, TakeTraversal, traversal::Decode};

use crate::{ObjectUrl, Store, StoreError, backend::ByteRange};

/// Bytes at the end of an object that are read when it is opened. They hold footer, index, summary and the last ledger
/// of most takes: the index of an hour needs 2 KiB, the summary 12 bytes for each marker.
pub(crate) const TAIL_BYTES: u64 = 64 << 10;

/// First range of a sequential read: small, because a reader may need only the header.
const RANGE_BYTES_MIN: u64 = 256 << 10;

/// Longest range, which is held in memory: at 100 MB/s it takes as long as the answers of two requests.
const RANGE_BYTES_MAX: u64 = 8 << 20;

impl Store {
    /// Opens an object by reading its last 64 KiB.
    ///
    /// # Errors
    /// `NotFound`, and those of any request.
    pub fn open(&self, url: &ObjectUrl) -> Result<ObjectReader, StoreError> {
        ObjectReader::open(self.clone(), url)
    }
}

/// Consecutive bytes of the object in memory.
#[derive(Debug, Default)]
struct Block {
    at: u64,
    bytes: Vec<u8>,
}

impl Block {
    fn end(&self) -> u64 {
        self.at + self.bytes.len() as u64
    }

    fn copy(&self, at: u64, into: &mut [u8]) -> usize {
        let Some(offset) = at.checked_sub(self.at) else { return 0 };
        let here = usize::try_from(offset).ok().and_then(|offset| self.bytes.get(offset..));
        let here = here.unwrap_or_default();
        let n = here.len().min(into.len());
        into[..n].copy_from_slice(&here[..n]);
        n
    }
}

/// Reads an object by ranges. Its end, read when it was opened, and the last range stay in memory; ranges grow while
/// they follow each other. All ranges are of the same object: if it is replaced meanwhile, reading fails.
#[derive(Debug)]
pub struct ObjectReader {
    store: Store,
    url: ObjectUrl,
    len: u64,
    e_tag: Option<String>,
    at: u64,
    tail: Block,
    block: Block,
    range_bytes: u64,
    planned: Vec<Range<u64>>,
}

impl ObjectReader {
    fn open(store: Store, url: &ObjectUrl) -> Result<Self, StoreError> {
        let last = ByteRange::Last(TAIL_BYTES);
        let tail = match store.read(url, &last, None) {
            // Azure has no ranges from the end, and no store has a range of an empty object.
            Err(StoreError::Unsupported { .. }) => {
                let len = store.len_bytes(url)?;
                let range = ByteRange::Of(len.saturating_sub(TAIL_BYTES)..len);
                if len > 0 { Some(store.read(url, &range, None)?) } else { None }
            }
            other => Some(other?),
        };
        let (len, e_tag) = tail.as_ref().map_or((0, None), |tail| (tail.len, tail.e_tag.clone()));
        let tail =
            tail.map_or_else(Block::default, |tail| Block { at: tail.at, bytes: tail.bytes });
        Ok(Self {
            store,
            url: url.clone(),
            len,
            e_tag,
            at: 0,
            tail,
            block: Block::default(),
            range_bytes: RANGE_BYTES_MIN,
            planned: Vec::new(),
        })
    }

    /// Size of the object in bytes.
    #[must_use]
    pub fn len_bytes(&self) -> u64 {
        self.len
    }

    /// The URL of the object.
    #[must_use]
    pub fn url(&self) -> &ObjectUrl {
        &self.url
    }

    /// The store, whose [traffic](Store::traffic) includes that of this reader.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// States which ranges will be read: each becomes one request, up to its end, or one for each 8 MiB of it. Ranges
    /// outside are read as before.
    pub fn plan(&mut self, ranges: impl Into<Vec<Range<u64>>>) {
        self.planned = ranges.into();
    }

    /// Reads the range that begins at the current position.
    fn fetch(&mut self) -> Result<(), StoreError> {
        let at = self.at;
        let end = match self.planned.iter().find(|range| range.contains(&at)) {
            Some(range) => range.end.min(at.saturating_add(RANGE_BYTES_MAX)),
            None => {
                let follows = at == self.block.end();
                let grown = (2 * self.range_bytes).min(RANGE_BYTES_MAX);
                self.range_bytes = if follows && at > 0 { grown } else { RANGE_BYTES_MIN };
                at.saturating_add(self.range_bytes)
            }
        };
        // What is in memory already is not read again.
        let end = if at < self.tail.at { end.min(self.tail.at) } else { end.min(self.len) };
        let piece = self.store.read(&self.url, &ByteRange::Of(at..end), self.e_tag.as_deref())?;
        if piece.at != at || piece.bytes.len() as u64 != end - at || piece.len != self.len {
            return Err(StoreError::Changed(self.url.to_string()));
        }
        self.block = Block { at, bytes: piece.bytes };
        Ok(())
    }
}

impl Read for ObjectReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.at >= self.len || bytes.is_empty() {
            return Ok(0);
        }
        let mut n = self.tail.copy(self.at, bytes);
        if n == 0 {
            n = self.block.copy(self.at, bytes);
        }
        if n == 0 {
            self.fetch()?;
            n = self.block.copy(self.at, bytes);
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for ObjectReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let beyond = || io::Error::from(io::ErrorKind::InvalidInput);
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) => self.at.checked_add_signed(by).ok_or_else(beyond)?,
            SeekFrom::End(by) => self.len.checked_add_signed(by).ok_or_else(beyond)?,
        };
        Ok(self.at)
    }
}

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

#[cfg(test)]
mod tests {
    use std::fs;

    use mocapd_testkit::random::Random;

    use super::*;

    fn stored(len: usize) -> (tempfile::TempDir, Vec<u8>, ObjectReader) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let mut random = Random::new(len as u64);
        let bytes: Vec<u8> = (0..len).map(|_| random.byte()).collect();
        fs::write(&path, &bytes).unwrap();
        let url = ObjectUrl::parse(&format!("file://{}", path.display())).unwrap();
        let reader = Store::of(&url).unwrap().counted_anew().open(&url).unwrap();
        (folder, bytes, reader)
    }

    #[test]
    fn the_bytes_are_those_of_the_object_at_every_place() {
        for len in [0, 1, 1000, TAIL_BYTES as usize, 2_000_000] {
            let (_folder, bytes, mut reader) = stored(len);
            let mut read = Vec::new();
            reader.read_to_end(&mut read).unwrap();
            assert!(read == bytes, "{len}");
            let mut random = Random::new(7);
            for _ in 0..50 {
                let at = random.below(len + 1);
                let n = random.below(100_000).min(len - at);
                reader.seek(SeekFrom::Start(at as u64)).unwrap();
                let mut piece = vec![0; n];
                reader.read_exact(&mut piece).unwrap();
                assert!(piece == bytes[at..at + n], "{at} {n}");
            }
            assert_eq!(reader.seek(SeekFrom::End(0)).unwrap(), len as u64);
            assert_eq!(reader.read(&mut [0; 9]).unwrap(), 0);
        }
    }

    #[test]
    fn reading_all_takes_few_requests_and_no_byte_twice() {
        let (_folder, bytes, mut reader) = stored(20_000_000);
        let mut read = Vec::new();
        reader.read_to_end(&mut read).unwrap();
        assert!(read == bytes);
        let traffic = reader.store().traffic();
        // The tail, 0.25, 0.5, 1, 2, 4 and 8 MiB, and the rest.
        assert_eq!((traffic.requests, traffic.received_bytes), (8, 20_000_000));
    }

    #[test]
    fn a_plan_is_one_request_for_each_of_its_ranges() {
        let (_folder, bytes, mut reader) = stored(5_000_000);
        reader.plan([1_000_000..1_010_000, 1_010_000..1_200_000]);
        let mut piece = vec![0; 10_000];
        reader.seek(SeekFrom::Start(1_000_000)).unwrap();
        reader.read_exact(&mut piece).unwrap();
        assert!(piece == bytes[1_000_000..1_010_000]);
        assert_eq!(reader.store().traffic().received_bytes, TAIL_BYTES + 10_000);
        reader.read_exact(&mut piece).unwrap();
        assert_eq!(reader.store().traffic().received_bytes, TAIL_BYTES + 200_000);
        assert_eq!(reader.store().traffic().requests, 3);
    }

    #[test]
    fn a_planned_range_is_as_long_as_any_other() {
        let (_folder, bytes, mut reader) = stored(20_000_000);
        reader.plan([1000..10_000_000, 10_000_000..19_000_000]);
        let mut piece = vec![0; 18_000_000];
        reader.seek(SeekFrom::Start(1000)).unwrap();
        reader.read_exact(&mut piece[..10]).unwrap();
        assert_eq!(reader.store().traffic().received_bytes, TAIL_BYTES + RANGE_BYTES_MAX);
        reader.read_exact(&mut piece[10..]).unwrap();
        assert!(piece == bytes[1000..18_001_000]);
        // The tail, 8 MiB and the rest of the first range, 8 MiB of the second.
        let traffic = reader.store().traffic();
        let received = TAIL_BYTES + 9_999_000 + RANGE_BYTES_MAX;
        assert_eq!((traffic.requests, traffic.received_bytes), (4, received));
    }

    #[test]
    fn an_object_that_was_replaced_is_not_mixed() {
        let (folder, bytes, mut reader) = stored(3_000_000);
        let path = folder.path().join("x");
        fs::remove_file(&path).unwrap();
        fs::write(&path, &bytes[1..]).unwrap();
        let error = reader.read(&mut [0; 10]).unwrap_err();
        assert!(error.to_string().contains("was replaced"), "{error}");
    }
}
