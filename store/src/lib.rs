//! Takes in object storage: S3, Google Cloud Storage, Azure, a folder of files, and for reading also HTTP.
//!
//! Objects are read by ranges and created once: nothing here replaces an object. Calls block; the clients of the stores
//! run on one thread, `mocapd-store`, which starts with the first call. Without the feature `full` no store can be
//! opened, and [`StoreError::NotBuilt`] says what to do.

mod backend;
#[cfg(feature = "full")]
mod cloud;
mod error;
mod location;
mod reader;
mod store;

pub use backend::{Backend, ByteRange, ListedObject, ObjectPiece};
pub use error::StoreError;
pub use location::{ObjectUrl, is_url, without_secrets};
pub use reader::{ObjectReader, StoredTake};
pub use store::{PART_BYTES, Pace, Store, Traffic, TrafficCount};
