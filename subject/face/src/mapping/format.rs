//! The mapping's file.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Mapping, Marker, Place};
use crate::shortened;

const FORMAT: &str = "mocapd-face-mapping";
const VERSION: u32 = 1;
const MAX_BYTES: usize = 256 * 1024;
/// More than any face was ever captured with.
const MAX_MARKERS: usize = 1000;
const MAX_NAME: usize = 255;
const MAX_WEIGHT: f64 = 1000.0;

/// Why a text is no mapping.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MappingError {
    /// Of another kind, or of a version that is newer.
    #[error("not a mapping of markers to a face, version {VERSION}: {0}")]
    Kind(String),
    /// JSON, but not this.
    #[error("not a mapping of markers to a face: {0}")]
    Shape(String),
    /// A label, name or weight that cannot be.
    #[error("a mapping of markers to a face with {0}")]
    Value(String),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    about: Option<String>,
    markers: Vec<Marker>,
}

impl Mapping {
    /// Reads a mapping.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn from_json(text: &str) -> Result<Self, MappingError> {
        if text.len() > MAX_BYTES {
            let what = format!("{} bytes, where {MAX_BYTES} is the most", text.len());
            return Err(MappingError::Value(what));
        }
        let shape = |error: serde_json::Error| MappingError::Shape(shortened(&error.to_string()));
        let file: File = serde_json::from_str(text).map_err(shape)?;
        if file.format != FORMAT || file.version != VERSION {
            let found = file.format.escape_debug().take(40).collect::<String>();
            return Err(MappingError::Kind(format!("{found:?}, version {}", file.version)));
        }
        if file.markers.len() > MAX_MARKERS {
            let what = format!("{} markers, where {MAX_MARKERS} is the most", file.markers.len());
            return Err(MappingError::Value(what));
        }
        file.markers.iter().try_for_each(Marker::check)?;
        let mut labels: Vec<_> = file.markers.iter().map(|marker| &marker.label).collect();
        labels.sort_unstable();
        if let Some(pair) = labels.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(MappingError::Value(format!("the label {:?} twice", pair[0])));
        }
        Ok(Self { markers: file.markers })
    }

    /// Writes a mapping.
    ///
    /// # Errors
    /// None that a mapping which was read can have.
    pub fn to_json(&self) -> Result<String, MappingError> {
        let markers = self.markers.clone();
        let file = File { format: FORMAT.into(), version: VERSION, about: None, markers };
        serde_json::to_string_pretty(&file).map_err(|error| MappingError::Shape(error.to_string()))
    }
}

impl Marker {
    fn check(&self) -> Result<(), MappingError> {
        let odd = |name: &str| {
            name.is_empty() || name.len() > MAX_NAME || name.chars().any(char::is_control)
        };
        let name = if let Place::Feature(name) = &self.place { name } else { "a vertex" };
        if odd(&self.label) || odd(name) {
            return Err(MappingError::Value(format!(
                "a label or name that is empty, longer than {MAX_NAME} bytes, or has control characters"
            )));
        }
        if !(0.0..=MAX_WEIGHT).contains(&self.weight) {
            return Err(MappingError::Value(format!(
                "a weight of {}, where 0 to {MAX_WEIGHT} are allowed",
                self.weight
            )));
        }
        Ok(())
    }
}
