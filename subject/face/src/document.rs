//! JSON of anybody as a document of this crate: which one it is, what it has to be, and errors that say where it is not.

use std::fmt::Debug;

use serde::{Deserialize, de::DeserializeOwned};
use serde_json::error::Category;
use thiserror::Error;

use crate::shortened;

/// Why bytes are no face, or no mapping of markers to one.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DocumentError {
    /// No JSON, another document, or one of a later version.
    #[error("{0}")]
    Kind(String),
    /// A key that is missing, or unknown, or a value of another type.
    #[error("a damaged {0}")]
    Shape(String),
    /// A number, a name or an index that cannot be.
    #[error("a damaged {0}")]
    Value(String),
}

/// A kind of document.
pub(crate) struct Format {
    /// What `format` says.
    pub(crate) name: &'static str,
    pub(crate) version: u64,
    /// Where one is to be had, as a clause.
    pub(crate) made_by: &'static str,
    pub(crate) bytes_max: usize,
}

/// Which document it is.
#[derive(Deserialize)]
#[serde(expecting = "an object")]
struct DocumentHeader {
    #[serde(default)]
    format: Option<String>,
    #[serde(default)]
    version: Option<u64>,
}

impl Format {
    /// No room is made for more than the bytes have in them.
    pub(crate) fn read<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, DocumentError> {
        self.check_len(bytes.len())?;
        self.check_kind(bytes).map_err(DocumentError::Kind)?;
        let mut json = serde_json::Deserializer::from_slice(bytes);
        serde_path_to_error::deserialize(&mut json).map_err(|error| {
            let (name, reason) = (self.name, shortened(&error.to_string()));
            let page = "docs/subject-face-format.md has the format";
            DocumentError::Shape(format!("{name} ({page}): {reason}"))
        })
    }

    pub(crate) fn check_len(&self, bytes: usize) -> Result<(), DocumentError> {
        let (name, most) = (self.name, self.bytes_max);
        if bytes > most {
            let what = format!("{name}: it has {bytes} bytes, where {most} is the most");
            return Err(DocumentError::Value(what));
        }
        Ok(())
    }

    /// Refuses the first of these values that does not hold, with its place among them: `points[3].confidence`.
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
        Err(DocumentError::Value(format!("{name}: `{place}` is {found}: expected {expected}")))
    }

    /// Refuses what is no JSON, JSON that is another document, and one of a later version.
    fn check_kind(&self, bytes: &[u8]) -> Result<(), String> {
        let Self { name, version, made_by, .. } = self;
        let header: DocumentHeader = serde_json::from_slice(bytes).map_err(|error| {
            let is = match error.classify() {
                Category::Data => "it is no",
                Category::Eof => "it is cut off, or no",
                Category::Syntax | Category::Io => "it is no JSON, and so no",
            };
            format!("{is} {name}, {made_by}: {}", shortened(&error.to_string()))
        })?;
        if header.format.as_deref() != Some(name) {
            let found = header
                .format
                .map_or("no format".to_owned(), |format| format.escape_debug().take(40).collect());
            return Err(format!("it says {found} where {name} is expected, {made_by}"));
        }
        match header.version {
            Some(found) if found == *version => Ok(()),
            Some(found) if found > *version => Err(format!(
                "it is version {found} of {name}, this build reads {version}: use a newer mocapd"
            )),
            Some(found) => {
                Err(format!("there is no version {found} of {name}: write \"version\": {version}"))
            }
            None => Err(format!("it says {name} and no version: write \"version\": {version}")),
        }
    }
}
