//! Paths in JSON, which has no bytes that are not text: those become U+FFFD. A take whose name is not UTF-8 is a take.

use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};

/// For `serialize_with`.
///
/// # Errors
/// The serializer's.
pub fn path_as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// The same of one that may be missing.
///
/// # Errors
/// The serializer's.
pub fn path_as_text_or_null<S: Serializer>(
    path: &Option<PathBuf>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    path.as_deref().map(Path::to_string_lossy).serialize(serializer)
}
