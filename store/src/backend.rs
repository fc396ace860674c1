//! The requests that a store answers, and their answers from files as objects, for `file://`: a mounted archive
//! behaves as a bucket does.

use std::{
    collections::hash_map::RandomState,
    fmt,
    fs::{self, File, OpenOptions},
    hash::{BuildHasher, Hasher},
    io::{self, Read, Seek, SeekFrom, Write},
    ops::Range,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::SystemTime,
};

use crate::{ObjectUrl, StoreError};

/// Bytes of an object to read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ByteRange {
    /// From one offset to before another, which the object may not reach.
    Of(Range<u64>),
    /// The last bytes.
    Last(u64),
}

/// A part of an object, as a store returns it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObjectPiece {
    /// Offset of the first byte.
    pub at: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Size of the whole object.
    pub len: u64,
    /// What changes when the object is replaced, if the store states it.
    pub e_tag: Option<String>,
}

/// An object in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedObject {
    /// Its URL.
    pub url: ObjectUrl,
    /// Its size in bytes.
    pub len: u64,
    /// When it was created, if the store says so.
    pub modified: Option<SystemTime>,
}

/// The requests that a store answers. Each method is one request, except where it says otherwise.
pub trait Backend: fmt::Debug + Send + Sync {
    /// Reads a range of an object, if its tag is still `e_tag`.
    ///
    /// # Errors
    /// `NotFound`, `Changed`, and those of any request.
    fn read(
        &self,
        url: &ObjectUrl,
        range: &ByteRange,
        e_tag: Option<&str>,
    ) -> Result<ObjectPiece, StoreError>;

    /// The size of an object.
    ///
    /// # Errors
    /// `NotFound`, and those of any request.
    fn len(&self, url: &ObjectUrl) -> Result<u64, StoreError>;

    /// Creates an object, in up to two requests; the first time, up to five more find out whether the store respects
    /// their conditions.
    ///
    /// # Errors
    /// `Exists`, `Replaces`, and those of any request.
    fn create(&self, url: &ObjectUrl, bytes: Vec<u8>) -> Result<(), StoreError>;

    /// Creates an object of several parts, all but the last of the same size: one request for each part, and some
    /// more, as many as the store takes to copy it.
    ///
    /// # Errors
    /// `Exists`, `Replaces`, those of any request, and those of `next_part`, after which nothing of the object is left.
    fn create_from_parts(
        &self,
        url: &ObjectUrl,
        next_part: &mut dyn FnMut() -> Result<Option<Vec<u8>>, StoreError>,
    ) -> Result<(), StoreError>;

    /// The objects in a folder, in order of their names; a request for each thousand.
    ///
    /// # Errors
    /// Those of any request.
    fn list(&self, folder: &ObjectUrl, recursive: bool) -> Result<Vec<ListedObject>, StoreError>;

    /// Removes an object.
    ///
    /// # Errors
    /// Those of any request.
    fn remove(&self, url: &ObjectUrl) -> Result<(), StoreError>;
}

/// A new name for an object that is not complete yet. It is hidden: no list has it.
pub(crate) fn incomplete_name() -> String {
    // Randomly keyed, so that no two uploads share a name.
    format!(".mocapd-upload-{:016x}", RandomState::new().build_hasher().finish())
}

/// The files of this machine.
#[derive(Debug)]
pub(crate) struct Folders;

fn path_of(url: &ObjectUrl) -> PathBuf {
    url.local_path().unwrap_or_default()
}

fn failed(url: &ObjectUrl, error: &io::Error) -> StoreError {
    let text = url.to_string();
    match error.kind() {
        io::ErrorKind::NotFound => StoreError::NotFound(text),
        io::ErrorKind::AlreadyExists => StoreError::Exists(text),
        io::ErrorKind::PermissionDenied => {
            StoreError::Forbidden { url: text, detail: error.to_string() }
        }
        _ => StoreError::Unavailable { url: text, detail: error.to_string() },
    }
}

/// What changes when another file gets the name.
fn tag(metadata: &fs::Metadata) -> String {
    let (s, ns) = (metadata.mtime(), metadata.mtime_nsec());
    format!("{}-{}-{s}-{ns}-{}", metadata.dev(), metadata.ino(), metadata.len())
}

impl Backend for Folders {
    fn read(
        &self,
        url: &ObjectUrl,
        range: &ByteRange,
        e_tag: Option<&str>,
    ) -> Result<ObjectPiece, StoreError> {
        let read = || -> io::Result<ObjectPiece> {
            let mut file = File::open(path_of(url))?;
            let metadata = file.metadata()?;
            if metadata.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            let len = metadata.len();
            let range = match range {
                ByteRange::Of(range) => range.start.min(len)..range.end.min(len),
                ByteRange::Last(n) => len.saturating_sub(*n)..len,
            };
            let mut bytes = Vec::new();
            file.seek(SeekFrom::Start(range.start))?;
            file.take(range.end.saturating_sub(range.start)).read_to_end(&mut bytes)?;
            Ok(ObjectPiece { at: range.start, bytes, len, e_tag: Some(tag(&metadata)) })
        };
        let piece = read().map_err(|error| failed(url, &error))?;
        if e_tag.is_some() && e_tag != piece.e_tag.as_deref() {
            return Err(StoreError::Changed(url.to_string()));
        }
        Ok(piece)
    }

    fn len(&self, url: &ObjectUrl) -> Result<u64, StoreError> {
        let metadata = fs::metadata(path_of(url)).map_err(|error| failed(url, &error))?;
        Ok(metadata.len())
    }

    fn create(&self, url: &ObjectUrl, bytes: Vec<u8>) -> Result<(), StoreError> {
        let mut bytes = Some(bytes);
        self.create_from_parts(url, &mut || Ok(bytes.take()))
    }

    fn create_from_parts(
        &self,
        url: &ObjectUrl,
        next_part: &mut dyn FnMut() -> Result<Option<Vec<u8>>, StoreError>,
    ) -> Result<(), StoreError> {
        let path = path_of(url);
        if path.symlink_metadata().is_ok() {
            return Err(StoreError::Exists(url.to_string()));
        }
        let folder = path.parent().unwrap_or(Path::new("/"));
        let hidden = folder.join(incomplete_name());
        let file = || -> io::Result<File> {
            fs::create_dir_all(folder)?;
            OpenOptions::new().write(true).create_new(true).open(&hidden)
        };
        let mut file = file().map_err(|error| failed(url, &error))?;
        let written = (|| {
            while let Some(part) = next_part()? {
                file.write_all(&part).map_err(|error| failed(url, &error))?;
            }
            // A link never replaces a file.
            let named = file.sync_all().and_then(|()| fs::hard_link(&hidden, &path));
            named.map_err(|error| failed(url, &error))
        })();
        fs::remove_file(&hidden).ok();
        if let Ok(folder) = File::open(folder) {
            folder.sync_all().ok();
        }
        written
    }

    fn list(&self, folder: &ObjectUrl, recursive: bool) -> Result<Vec<ListedObject>, StoreError> {
        let mut found = Vec::new();
        let mut folders = vec![folder.clone()];
        while let Some(at) = folders.pop() {
            let entries = fs::read_dir(path_of(&at)).map_err(|error| failed(&at, &error))?;
            for entry in entries {
                let entry = entry.map_err(|error| failed(&at, &error))?;
                let name = entry.file_name();
                let Some(name) = name.to_str().filter(|name| !name.starts_with('.')) else {
                    continue;
                };
                let Ok(metadata) = fs::metadata(entry.path()) else { continue };
                let is_link = entry.file_type().is_ok_and(|kind| kind.is_symlink());
                if metadata.is_file() {
                    let (url, modified) = (at.join(name), metadata.modified().ok());
                    found.push(ListedObject { url, len: metadata.len(), modified });
                } else if metadata.is_dir() && recursive && !is_link {
                    folders.push(at.join(name));
                }
            }
        }
        found.sort_by(|a, b| a.url.key().cmp(b.url.key()));
        Ok(found)
    }

    fn remove(&self, url: &ObjectUrl) -> Result<(), StoreError> {
        fs::remove_file(path_of(url)).map_err(|error| failed(url, &error))
    }
}
