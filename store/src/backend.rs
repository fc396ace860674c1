//! The requests that a store answers.

use std::{
    collections::hash_map::RandomState,
    fmt,
    hash::{BuildHasher, Hasher},
    ops::Range,
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
