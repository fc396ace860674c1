//! Takes in object storage: S3, Google Cloud Storage, Azure, a folder of files, and for reading also HTTP.
//!
//! Objects are read by ranges and created once: nothing here replaces an object. Calls block; the clients of the stores
//! run on one thread, `mocapd-store`, which starts with the first call. Without the feature `full` no store can be
//! opened, and [`StoreError::NotBuilt`] says what to do.

mod backend;
#[cfg(feature = "full")]
mod cloud;
mod location;
mod reader;
mod store;

use std::io;

pub use backend::{Backend, ByteRange, ListedObject, ObjectPiece};
pub use location::{ObjectUrl, is_url, without_secrets};
pub use reader::{ObjectReader, StoredTake};
pub use store::{PART_BYTES, Pace, Store, Traffic, TrafficCount};

/// An error of a store. The message is one line that says what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// This build has no clients of object storage.
    #[error(
        "this build cannot use object storage ({0}): use the Debian package, or build with `cargo build --release --features full`"
    )]
    NotBuilt(String),
    /// The URL cannot be understood.
    #[error("{url}: {reason}; expected {expected}", expected = location::EXPECTED)]
    InvalidUrl {
        /// The URL.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No object has this name.
    #[error("{0} does not exist")]
    NotFound(String),
    /// The bucket does not exist.
    #[error("the bucket of {0} does not exist: check its name and region, or create it first")]
    NoBucket(String),
    /// An object of this name exists.
    #[error("{0} exists already, and objects are never replaced: choose another name")]
    Exists(String),
    /// The store does not respect the condition under which objects are created.
    #[error(
        "{0}: the store ignores If-None-Match, and would replace objects: use a store, or a version of it, with conditional writes"
    )]
    Replaces(String),
    /// No credentials were found.
    #[error("no credentials for {url}: {remedy}")]
    NoCredentials {
        /// The URL.
        url: String,
        /// Where credentials are looked for.
        remedy: &'static str,
    },
    /// The store refused the credentials, or they lack a permission.
    #[error(
        "the store refused access to {url}: check the credentials and their permissions ({detail})"
    )]
    Forbidden {
        /// The URL.
        url: String,
        /// The store's words.
        detail: String,
    },
    /// The store did not answer in time.
    #[error("{0}: the store did not answer in time: check the network, and try again")]
    TimedOut(String),
    /// The store cannot be reached, or reported a failure of its own.
    #[error(
        "{url}: the store is unavailable: {detail}; check the endpoint and the network, and try again"
    )]
    Unavailable {
        /// The URL.
        url: String,
        /// What happened.
        detail: String,
    },
    /// The object is not the one that was opened.
    #[error("{0} was replaced while it was read: read it again")]
    Changed(String),
    /// The store or scheme has no such operation.
    #[error("{url}: {reason}")]
    Unsupported {
        /// The URL.
        url: String,
        /// What it cannot do, and what to do.
        reason: String,
    },
    /// The local file could not be read.
    #[error("cannot read the file to upload: {0}")]
    Source(String),
    /// The caller ended the upload.
    #[error("the upload of {0} was stopped")]
    Stopped(String),
}

impl StoreError {
    /// The error of a store in an error of a reader.
    #[must_use]
    pub fn of(error: &io::Error) -> Option<Self> {
        error.get_ref()?.downcast_ref().cloned()
    }

    /// Whether the same call may succeed later, with nothing changed by the user.
    #[must_use]
    pub fn is_temporary(&self) -> bool {
        matches!(self, Self::TimedOut(_) | Self::Unavailable { .. } | Self::Changed(_))
    }
}

impl From<StoreError> for io::Error {
    fn from(error: StoreError) -> Self {
        let kind = match &error {
            StoreError::NotFound(_) | StoreError::NoBucket(_) => io::ErrorKind::NotFound,
            StoreError::Exists(_) => io::ErrorKind::AlreadyExists,
            StoreError::NoCredentials { .. } | StoreError::Forbidden { .. } => {
                io::ErrorKind::PermissionDenied
            }
            StoreError::TimedOut(_) => io::ErrorKind::TimedOut,
            StoreError::NotBuilt(_) | StoreError::Replaces(_) | StoreError::Unsupported { .. } => {
                io::ErrorKind::Unsupported
            }
            StoreError::InvalidUrl { .. } => io::ErrorKind::InvalidInput,
            _ => io::ErrorKind::Other,
        };
        Self::new(kind, error)
    }
}
