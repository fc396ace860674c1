//! A bucket, whose requests and bytes are counted.

use std::{
    collections::HashMap,
    mem::ManuallyDrop,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{
    ObjectUrl, StoreError,
    backend::{Backend, ByteRange, ListedObject, ObjectPiece},
    local::Folders,
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
