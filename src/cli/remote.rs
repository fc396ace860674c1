//! Files in object storage. A command that reads one copies it to a temporary file first, each byte once: readers seek,
//! and read most files more than once. An output is written to a temporary file, and created when it is complete.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, Seek, SeekFrom, Write},
    os::fd::AsRawFd,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::Context;
use mocapd::outcome::UsageError;
use mocapd_acquire::files::{self, Kept, NewFile, SparseFile};
use mocapd_store::{ObjectUrl, Store, StoreError, TrafficCount, is_url, without_secrets};

use super::output::Progress;

/// The copies of objects, by URL. A copy is made once, and other readers of the same object wait for it.
static COPIES: Mutex<Option<HashMap<PathBuf, SharedCopy>>> = Mutex::new(None);

/// A copy, once it is made.
type SharedCopy = Arc<Mutex<Option<ObjectCopy>>>;

/// The copy of an object, in a temporary file without a name.
struct ObjectCopy {
    file: File,
    /// What it took to read it.
    traffic: TrafficCount,
}

/// The URL that a path is; `None` for a file.
///
/// # Errors
/// A usage error for a URL that cannot be understood.
pub(super) fn url_of(path: &Path) -> anyhow::Result<Option<ObjectUrl>> {
    if !is_url(path) {
        return Ok(None);
    }
    let url = ObjectUrl::of_path(path).map_err(|error| UsageError(error.to_string()))?;
    Ok(Some(url))
}

/// Opens a file or an object for reading.
///
/// # Errors
/// A [`FileError`](files::FileError) when a file cannot be opened, a [`StoreError`] for an object.
pub(super) fn open(path: &Path) -> anyhow::Result<SparseFile> {
    SparseFile::open(&local(path)?)
}

/// Size of a file or an object in bytes.
///
/// # Errors
/// As [`open`].
pub(super) fn len_bytes(path: &Path) -> anyhow::Result<u64> {
    Ok(open(path)?.len_bytes()?)
}

/// Where a file or the copy of an object can be opened. A copy stays until it is [released](release).
///
/// # Errors
/// A [`StoreError`] for an object that cannot be read.
pub(super) fn local(path: &Path) -> anyhow::Result<PathBuf> {
    let Some(url) = url_of(path)? else { return Ok(path.to_owned()) };
    copied(path, &url, None)
}

/// Copies the objects among `paths`, with a progress display.
///
/// # Errors
/// As [`local`].
pub(super) fn fetch(paths: &[impl AsRef<Path>]) -> anyhow::Result<()> {
    for path in paths {
        let path = path.as_ref();
        if let Some(url) = url_of(path)? {
            copied(path, &url, Some("downloading"))?;
        }
    }
    Ok(())
}

fn copied(path: &Path, url: &ObjectUrl, shown: Option<&'static str>) -> anyhow::Result<PathBuf> {
    if url.is_folder() {
        let message = format!("{url} is a folder: name an object in it, without a `/` at the end");
        return Err(UsageError(message).into());
    }
    let copy = {
        let mut copies = COPIES.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(copies.get_or_insert_default().entry(path.to_owned()).or_default())
    };
    let mut copy = copy.lock().unwrap_or_else(PoisonError::into_inner);
    let found = match copy.take() {
        Some(found) => found,
        None => download(url, shown)?,
    };
    // Every open of this path begins at the start of the file.
    let local = PathBuf::from(format!("/proc/self/fd/{}", found.file.as_raw_fd()));
    *copy = Some(found);
    Ok(local)
}

/// What it took to copy an object; `None` for a file, and for an object without a copy.
pub(super) fn traffic(path: &Path) -> Option<TrafficCount> {
    let copies = COPIES.lock().unwrap_or_else(PoisonError::into_inner);
    let copy = Arc::clone(copies.as_ref()?.get(path)?);
    drop(copies);
    let copy = copy.lock().unwrap_or_else(PoisonError::into_inner);
    copy.as_ref().map(|copy| copy.traffic)
}

/// Removes the copy of an object that no one reads any more.
pub(super) fn release(path: &Path) {
    let mut copies = COPIES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(copies) = &mut *copies {
        copies.remove(path);
    }
}

fn download(url: &ObjectUrl, shown: Option<&'static str>) -> anyhow::Result<ObjectCopy> {
    let store = Store::of(url)?.counted_anew();
    let mut object = store.open(url)?;
    let read = Arc::new(AtomicU64::new(0));
    let _progress = shown.map(|what| Progress::follow(what, &read, object.len_bytes()));
    let file = files::temporary_for(object.len_bytes())
        .with_context(|| format!("cannot copy {url} to a temporary file"))?;
    let mut copy = CountingCopy { file, written: &read };
    io::copy(&mut object, &mut copy).map_err(|error| match StoreError::of(&error) {
        // Its message names the object.
        Some(found) => found.into(),
        None => {
            anyhow::Error::from(error).context(format!("cannot copy {url} to a temporary file"))
        }
    })?;
    Ok(ObjectCopy { file: copy.file, traffic: store.traffic() })
}

struct CountingCopy<'a> {
    file: File,
    written: &'a AtomicU64,
}

impl Write for CountingCopy<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.file.write(bytes)?;
        self.written.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Checks that an object can be created, before any work is done for it.
///
/// # Errors
/// If it exists, or the store cannot be asked.
pub(super) fn check_output(url: &ObjectUrl) -> anyhow::Result<()> {
    if url.is_folder() {
        return Err(UsageError(format!("{url} is a folder: give the name of a file in it")).into());
    }
    if !url.is_writable() {
        let message = "a web server is read only: write to s3://, gs://, az:// or file://";
        return Err(UsageError(format!("{url}: {message}")).into());
    }
    match Store::of(url)?.len_bytes(url) {
        Ok(_) => Err(StoreError::Exists(url.to_string()).into()),
        Err(StoreError::NotFound(_)) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Removes a file or an object that belongs to a failed output.
///
/// # Errors
/// If it cannot be removed.
pub(super) fn remove(path: &Path) -> anyhow::Result<()> {
    match url_of(path)? {
        Some(url) => Ok(Store::of(&url)?.remove(&url)?),
        None => Ok(fs::remove_file(path)?),
    }
}

/// A file or an object that exists only when it is complete, and replaces none.
#[derive(Debug)]
pub(super) enum OutputFile {
    /// A file.
    File(NewFile),
    /// An object, and the temporary file with its content.
    Object(ObjectUrl, File),
}

impl OutputFile {
    /// Begins a file or an object that must not exist yet.
    ///
    /// # Errors
    /// If it exists, or cannot be created.
    pub(super) fn create(path: &Path) -> anyhow::Result<Self> {
        let Some(url) = url_of(path)? else { return NewFile::create(path).map(Self::File) };
        check_output(&url)?;
        Ok(Self::Object(url, files::temporary()?))
    }

    /// Begins a file or an object that may exist with the same content.
    ///
    /// # Errors
    /// If it cannot be created.
    pub(super) fn create_or_compare(path: &Path) -> anyhow::Result<Self> {
        match url_of(path)? {
            Some(url) => Ok(Self::Object(url, files::temporary()?)),
            None => NewFile::create_or_compare(path).map(Self::File),
        }
    }

    /// Syncs what was written, so that giving it a name takes little time.
    ///
    /// # Errors
    /// When the disk fails.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.sync(),
            Self::Object(..) => Ok(()),
        }
    }

    /// Gives it its name.
    ///
    /// # Errors
    /// If a file or an object of that name appeared, or the disk or the store fails.
    pub(super) fn keep(self) -> anyhow::Result<()> {
        match self {
            Self::File(file) => file.keep(),
            object @ Self::Object(..) => object.keep_or_compare().map(drop),
        }
    }

    /// Gives it its name, unless one of that name has the same content.
    ///
    /// # Errors
    /// If one of that name has other content, or the disk or the store fails.
    pub(super) fn keep_or_compare(self) -> anyhow::Result<Kept> {
        match self {
            Self::File(file) => file.keep_or_compare(),
            Self::Object(url, mut content) => {
                let is_new = Store::of(&url)?.upload(&url, &mut content, &mut |_| Ok(()))?;
                Ok(if is_new { Kept::New } else { Kept::Unchanged })
            }
        }
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Object(_, file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Object(_, file) => file.flush(),
        }
    }
}

impl Seek for OutputFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Self::File(file) => file.seek(to),
            Self::Object(_, file) => file.seek(to),
        }
    }
}

/// Refuses a URL as the output of a recording, whose disk must not be a network.
///
/// # Errors
/// A usage error.
pub(super) fn refuse_recording(output: &Path) -> anyhow::Result<()> {
    if !is_url(output) {
        return Ok(());
    }
    let message = "a recording is written to a local disk, because a network may stall: record to a file, and have the service upload finished takes with [archive] in its configuration";
    let output = output.to_string_lossy();
    Err(UsageError(format!("{}: {message}", without_secrets(&output))).into())
}
