//! A bucket, whose requests and bytes are counted, and uploads of files to it: whole or not at all, created once, at a
//! pace that the caller sets, and read back.

use std::{
    collections::HashMap,
    io::{self, Read, Seek, SeekFrom},
    mem::ManuallyDrop,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{
    ObjectUrl, StoreError,
    backend::{Backend, ByteRange, Folders, ListedObject, ObjectPiece},
    location::Scheme,
};

/// Requests sent, and bytes received and sent as content.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TrafficCount {
    /// Requests. Those that a client repeats after a failure count once.
    pub requests: u64,
    /// Bytes of objects received.
    pub received_bytes: u64,
    /// Bytes of objects sent.
    pub sent_bytes: u64,
}

/// Counts the traffic with a store.
#[derive(Debug, Default)]
pub struct Traffic {
    requests: AtomicU64,
    received_bytes: AtomicU64,
    sent_bytes: AtomicU64,
}

impl Traffic {
    /// The traffic so far.
    #[must_use]
    pub fn count(&self) -> TrafficCount {
        TrafficCount {
            requests: self.requests.load(Ordering::Relaxed),
            received_bytes: self.received_bytes.load(Ordering::Relaxed),
            sent_bytes: self.sent_bytes.load(Ordering::Relaxed),
        }
    }

    fn request(&self) {
        self.requests.fetch_add(1, Ordering::Relaxed);
    }
}

/// A bucket, container, web server, or the files of this machine.
#[derive(Debug, Clone)]
pub struct Store {
    backend: Arc<dyn Backend>,
    traffic: Arc<Traffic>,
}

/// The stores of a process, by scheme and bucket, so that many files share a connection. As many as the user names.
static STORES: Mutex<Option<(u32, HashMap<String, Store>)>> = Mutex::new(None);

impl Store {
    /// The store of a URL; its credentials are those of the environment. A process that was forked off must get its
    /// stores anew: the connections of those that it inherited are served by a thread that it does not have.
    ///
    /// # Errors
    /// `NotBuilt`; `NoCredentials` or `Unavailable` if the environment has an invalid configuration.
    pub fn of(url: &ObjectUrl) -> Result<Self, StoreError> {
        let mut stores = STORES.lock().unwrap_or_else(PoisonError::into_inner);
        let process = std::process::id();
        if stores.as_ref().is_some_and(|(of, _)| *of != process) {
            // Not dropped: connections would be closed, which are the parent's, too.
            let _inherited = ManuallyDrop::new(stores.take());
        }
        let (_, stores) = stores.get_or_insert_with(|| (process, HashMap::new()));
        if let Some(store) = stores.get(url.root()) {
            return Ok(store.clone());
        }
        let store = Self::with_backend(match url.scheme() {
            Scheme::File => Arc::new(Folders),
            _ => cloud(url)?,
        });
        stores.insert(url.root().to_owned(), store.clone());
        Ok(store)
    }

    /// A store that asks `backend`.
    #[must_use]
    pub fn with_backend(backend: Arc<dyn Backend>) -> Self {
        Self { backend, traffic: Arc::default() }
    }

    /// The traffic of all uses of this store.
    #[must_use]
    pub fn traffic(&self) -> TrafficCount {
        self.traffic.count()
    }

    /// The same store, whose traffic is counted anew.
    #[must_use]
    pub fn counted_anew(&self) -> Self {
        Self::with_backend(Arc::clone(&self.backend))
    }

    /// Reads a range of an object, if its tag is still `e_tag`.
    ///
    /// # Errors
    /// `NotFound`, `Changed`, and those of any request.
    pub fn read(
        &self,
        url: &ObjectUrl,
        range: &ByteRange,
        e_tag: Option<&str>,
    ) -> Result<ObjectPiece, StoreError> {
        self.traffic.request();
        let piece = self.backend.read(url, range, e_tag)?;
        self.traffic.received_bytes.fetch_add(piece.bytes.len() as u64, Ordering::Relaxed);
        Ok(piece)
    }

    /// The size of an object in bytes.
    ///
    /// # Errors
    /// `NotFound`, and those of any request.
    pub fn len_bytes(&self, url: &ObjectUrl) -> Result<u64, StoreError> {
        self.traffic.request();
        self.backend.len(url)
    }

    /// Creates an object of one part.
    ///
    /// # Errors
    /// `Exists`, `Replaces`, and those of any request.
    pub fn create(&self, url: &ObjectUrl, bytes: Vec<u8>) -> Result<(), StoreError> {
        writable(url)?;
        self.traffic.request();
        let len = bytes.len() as u64;
        self.backend.create(url, bytes)?;
        self.traffic.sent_bytes.fetch_add(len, Ordering::Relaxed);
        Ok(())
    }

    /// Creates an object of several parts; see [`Backend::create_from_parts`].
    ///
    /// # Errors
    /// As there.
    pub(crate) fn create_from_parts(
        &self,
        url: &ObjectUrl,
        mut next_part: impl FnMut() -> Result<Option<Vec<u8>>, StoreError>,
    ) -> Result<(), StoreError> {
        writable(url)?;
        let mut counted = || {
            let part = next_part()?;
            if let Some(part) = &part {
                self.traffic.request();
                self.traffic.sent_bytes.fetch_add(part.len() as u64, Ordering::Relaxed);
            }
            Ok(part)
        };
        self.backend.create_from_parts(url, &mut counted)
    }

    /// The objects in a folder, in order of their names, and with `recursive` those in its subfolders.
    ///
    /// # Errors
    /// `Unsupported` for a web server, and those of any request.
    pub fn list(
        &self,
        folder: &ObjectUrl,
        recursive: bool,
    ) -> Result<Vec<ListedObject>, StoreError> {
        if folder.scheme() == Scheme::Http {
            let reason = "a web server does not list its files: give their URLs".to_owned();
            return Err(StoreError::Unsupported { url: folder.to_string(), reason });
        }
        self.traffic.request();
        self.backend.list(folder, recursive)
    }

    /// Removes an object; one that does not exist is not an error.
    ///
    /// # Errors
    /// Those of any request.
    pub fn remove(&self, url: &ObjectUrl) -> Result<(), StoreError> {
        writable(url)?;
        self.traffic.request();
        match self.backend.remove(url) {
            Err(StoreError::NotFound(_)) => Ok(()),
            other => other,
        }
    }
}

fn writable(url: &ObjectUrl) -> Result<(), StoreError> {
    if url.is_writable() {
        return Ok(());
    }
    let reason = "a web server is read only: write to s3://, gs://, az:// or file://".to_owned();
    Err(StoreError::Unsupported { url: url.to_string(), reason })
}

#[cfg(feature = "full")]
fn cloud(url: &ObjectUrl) -> Result<Arc<dyn Backend>, StoreError> {
    Ok(Arc::new(crate::cloud::Cloud::connect(url)?))
}

#[cfg(not(feature = "full"))]
fn cloud(url: &ObjectUrl) -> Result<Arc<dyn Backend>, StoreError> {
    Err(StoreError::NotBuilt(url.to_string()))
}

/// Size of a part, which is held in memory. S3 needs at least 5 MiB, and accepts 10 000 parts: 78 GiB.
pub const PART_BYTES: usize = 8 << 20;

/// Longest object: a copy on the server, which gives an object of several parts its name once, takes at most 5 GiB.
const OBJECT_BYTES_MAX: u64 = 5 << 30;

/// Called with the number of bytes that were sent or received, after each part: it may wait, so that the line is not
/// filled, or end the upload with [`StoreError::Stopped`].
pub type Pace<'a> = &'a mut dyn FnMut(usize) -> Result<(), StoreError>;

impl Store {
    /// Creates an object with the content of `source`: in one request if it fits into a part, else in parts, under a
    /// temporary name until it is complete.
    ///
    /// An object of this name and content is left there, and is no error, so that an upload can be repeated after a
    /// failure that left it unknown whether it had succeeded. Returns whether the object is new.
    ///
    /// # Errors
    /// `Exists` if an object of this name has other content; `Source`; those of any request and of `pace`.
    pub fn upload(
        &self,
        url: &ObjectUrl,
        source: &mut (impl Read + Seek),
        pace: Pace<'_>,
    ) -> Result<bool, StoreError> {
        let read_error = |error: io::Error| StoreError::Source(error.to_string());
        let len = source.seek(SeekFrom::End(0)).map_err(read_error)?;
        if len > OBJECT_BYTES_MAX {
            let reason = "larger than 5 GiB, the limit of an object: divide it with `mocapd cut`";
            return Err(StoreError::Unsupported {
                url: url.to_string(),
                reason: reason.to_owned(),
            });
        }
        source.rewind().map_err(read_error)?;
        let mut next_part = || -> Result<Option<Vec<u8>>, StoreError> {
            let mut part = Vec::new();
            source.take(PART_BYTES as u64).read_to_end(&mut part).map_err(read_error)?;
            if part.is_empty() {
                return Ok(None);
            }
            pace(part.len())?;
            Ok(Some(part))
        };
        let created = if len <= PART_BYTES as u64 {
            next_part().and_then(|part| self.create(url, part.unwrap_or_default()))
        } else {
            self.create_from_parts(url, &mut next_part)
        };
        match created {
            Ok(()) => Ok(true),
            Err(StoreError::Exists(name)) => match self.has_content(url, source, pace)? {
                true => Ok(false),
                false => Err(StoreError::Exists(name)),
            },
            Err(error) => Err(error),
        }
    }

    /// Reads an object back and compares it with `source`, byte by byte: a part of one, then the same part of the other,
    /// so that the pace is that of both.
    ///
    /// # Errors
    /// `NotFound`; `Changed` if the object was replaced meanwhile; `Source`; those of any request and of `pace`.
    pub fn has_content(
        &self,
        url: &ObjectUrl,
        source: &mut (impl Read + Seek),
        pace: Pace<'_>,
    ) -> Result<bool, StoreError> {
        let read_error = |error: io::Error| StoreError::Source(error.to_string());
        let len = source.seek(SeekFrom::End(0)).map_err(read_error)?;
        if self.len_bytes(url)? != len {
            return Ok(false);
        }
        source.rewind().map_err(read_error)?;
        let (mut at, mut e_tag) = (0, None);
        let mut expected = Vec::new();
        while at < len {
            let range = at..len.min(at + PART_BYTES as u64);
            let part_len = range.end - range.start;
            let piece = self.read(url, &ByteRange::Of(range), e_tag.as_deref())?;
            if piece.at != at || piece.bytes.len() as u64 != part_len || piece.len != len {
                return Err(StoreError::Changed(url.to_string()));
            }
            expected.clear();
            source.take(part_len).read_to_end(&mut expected).map_err(read_error)?;
            pace(piece.bytes.len())?;
            if piece.bytes != expected {
                return Ok(false);
            }
            at += part_len;
            e_tag = piece.e_tag;
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, fs, io::Cursor};

    use super::*;

    fn folder() -> (tempfile::TempDir, ObjectUrl, Store) {
        let folder = tempfile::tempdir().unwrap();
        let url = ObjectUrl::parse(&format!("file://{}/", folder.path().display())).unwrap();
        let store = Store::of(&url).unwrap().counted_anew();
        (folder, url, store)
    }

    #[test]
    fn an_object_is_created_once_and_the_same_content_is_no_error() {
        let (folder, url, store) = folder();
        for len in [0, 5, PART_BYTES, PART_BYTES + 1, 3 * PART_BYTES] {
            let object = url.join(&format!("sub/{len}"));
            let mut content = vec![7; len];
            let upload =
                |content: &[u8]| store.upload(&object, &mut Cursor::new(content), &mut |_| Ok(()));
            assert_eq!(upload(&content), Ok(true), "{len}");
            assert_eq!(upload(&content), Ok(false), "{len}");
            content.push(8);
            assert_eq!(upload(&content), Err(StoreError::Exists(object.to_string())), "{len}");
            content.pop();
            if let Some(last) = content.last_mut() {
                *last = 8;
                assert_eq!(upload(&content), Err(StoreError::Exists(object.to_string())), "{len}");
            }
            let read = fs::read(folder.path().join(format!("sub/{len}"))).unwrap();
            assert!(read == vec![7; len]);
        }
        let names = store.list(&url, true).unwrap();
        assert_eq!(names.len(), 5, "nothing incomplete is left: {names:?}");
        assert_eq!(store.list(&url, false).unwrap(), []);
        for listed in names {
            store.remove(&listed.url).unwrap();
            store.remove(&listed.url).unwrap();
        }
        assert_eq!(store.list(&url, true).unwrap(), []);
    }

    /// Counts what is read of a file.
    struct Counted<'a>(Cursor<Vec<u8>>, &'a Cell<usize>);

    impl Read for Counted<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let n = self.0.read(bytes)?;
            self.1.set(self.1.get() + n);
            Ok(n)
        }
    }

    impl Seek for Counted<'_> {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    #[test]
    fn a_comparison_reads_the_file_at_the_pace_and_ends_at_the_first_difference() {
        let (_folder, url, store) = folder();
        let object = url.join("x");
        let content: Vec<u8> = (0..3 * PART_BYTES).map(|i| (i % 251) as u8).collect();
        let create = store.upload(&object, &mut Cursor::new(&content), &mut |_| Ok(()));
        assert_eq!(create, Ok(true));
        let read = Cell::new(0);
        let mut paced = 0;
        let mut file = Counted(Cursor::new(content.clone()), &read);
        let same = store.has_content(&object, &mut file, &mut |n| {
            paced += n;
            assert_eq!(read.get(), paced, "no byte of the file is read ahead of the pace");
            Ok(())
        });
        assert_eq!((same, paced), (Ok(true), content.len()));
        read.set(0);
        let stopped = store
            .has_content(&object, &mut file, &mut |_| Err(StoreError::Stopped(object.to_string())));
        assert_eq!(stopped, Err(StoreError::Stopped(object.to_string())));
        assert_eq!(read.get(), PART_BYTES, "nothing is read once it is stopped");
        read.set(0);
        let mut other = content;
        other[7] ^= 1;
        let mut file = Counted(Cursor::new(other), &read);
        assert_eq!(store.has_content(&object, &mut file, &mut |_| Ok(())), Ok(false));
        assert_eq!(read.get(), PART_BYTES);
    }

    #[test]
    fn a_stopped_upload_leaves_nothing() {
        let (folder, url, store) = folder();
        let object = url.join("x");
        let mut parts = 0;
        let stopped = store.upload(&object, &mut Cursor::new(vec![1; 3 * PART_BYTES]), &mut |_| {
            parts += 1;
            if parts < 3 { Ok(()) } else { Err(StoreError::Stopped(object.to_string())) }
        });
        assert_eq!(stopped, Err(StoreError::Stopped(object.to_string())));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
