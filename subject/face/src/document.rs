//! Reading of JSON documents: identification, deserialisation and range checks, with errors that name the place.

use std::fmt::Debug;

use serde::{Deserialize, de::DeserializeOwned};
use serde_json::error::Category;
use thiserror::Error;

use crate::shortened;

/// Why bytes are not a face, or not a mapping of markers.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DocumentError {
    /// Not JSON, another kind of document, or a later version.
    #[error("{0}")]
    Kind(String),
    /// A missing or unknown key, or a value of the wrong type.
    #[error("invalid {0}")]
    Shape(String),
    /// A number, name or index out of range.
    #[error("invalid {0}")]
    Value(String),
}

/// A document format.
pub(crate) struct Format {
    /// The value of its `format` key.
    pub(crate) name: &'static str,
    pub(crate) version: u64,
    /// Where to get one, as a clause.
    pub(crate) made_by: &'static str,
    pub(crate) bytes_max: usize,
}

/// The keys that identify a document.
#[derive(Deserialize)]
#[serde(expecting = "an object")]
struct DocumentHeader {
    #[serde(default)]
    format: Option<String>,
    #[serde(default)]
    version: Option<u64>,
}

impl Format {
    /// Deserialises without allocating for more than the bytes contain.
    pub(crate) fn read<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, DocumentError> {
        self.check_len(bytes.len())?;
        self.check_kind(bytes).map_err(DocumentError::Kind)?;
        let mut json = serde_json::Deserializer::from_slice(bytes);
        serde_path_to_error::deserialize(&mut json).map_err(|error| {
            let (name, reason) = (self.name, shortened(&error.to_string()));
            let page = "see docs/subject-face-format.md";
            DocumentError::Shape(format!("{name} ({page}): {reason}"))
        })
    }

    pub(crate) fn check_len(&self, bytes: usize) -> Result<(), DocumentError> {
        let (name, most) = (self.name, self.bytes_max);
        if bytes > most {
            let what = format!("{name}: {bytes} bytes, the limit is {most}");
            return Err(DocumentError::Value(what));
        }
        Ok(())
    }

    /// Rejects the first value that violates `holds`, with its place, such as `points[3].confidence`.
    pub(crate) fn expect<T: Debug>(
        &self,
        values: impl IntoIterator<Item = T>,
        place: impl Fn(usize) -> String,
        expected: &str,
        mut holds: impl FnMut(&T) -> bool,
    ) -> Result<(), DocumentError> {
        let Some((i, found)) = values.into_iter().enumerate().find(|(_, value)| !holds(value))
        else {
            return Ok(());
        };
        let (name, place, found) = (self.name, place(i), shortened(&format!("{found:?}")));
        Err(DocumentError::Value(format!("{name}: `{place}` is {found}, expected {expected}")))
    }

    /// Rejects what is not JSON, another kind of document, or a later version.
    fn check_kind(&self, bytes: &[u8]) -> Result<(), String> {
        let Self { name, version, made_by, .. } = self;
        let header: DocumentHeader = serde_json::from_slice(bytes).map_err(|error| {
            let is = match error.classify() {
                Category::Data => "not a",
                Category::Eof => "cut off, or not a",
                Category::Syntax | Category::Io => "not JSON, and so not a",
            };
            format!("{is} {name}, {made_by}: {}", shortened(&error.to_string()))
        })?;
        if header.format.as_deref() != Some(name) {
            let found = header
                .format
                .map_or("no format".to_owned(), |format| format.escape_debug().take(40).collect());
            return Err(format!("expected format {name}, {made_by}; found {found}"));
        }
        match header.version {
            Some(found) if found == *version => Ok(()),
            Some(found) if found > *version => Err(format!(
                "version {found} of {name}, but this build reads {version}: use a newer mocapd"
            )),
            Some(found) => {
                Err(format!("no version {found} of {name}: write \"version\": {version}"))
            }
            None => Err(format!("{name} with no version: write \"version\": {version}")),
        }
    }
}
