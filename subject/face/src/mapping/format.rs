//! The mapping's file.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Mapping, Marker, Place};
use crate::fitted::shortened;

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
    markers: Vec<FileMarker>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileMarker {
    label: String,
    at: FilePlace,
    #[serde(default = "one")]
    weight: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum FilePlace {
    Feature(String),
    Vertex(usize),
}

fn one() -> f64 {
    1.0
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
        let markers: Vec<_> =
            file.markers.into_iter().map(Marker::try_from).collect::<Result<_, _>>()?;
        let mut labels: Vec<_> = markers.iter().map(|marker| &marker.label).collect();
        labels.sort_unstable();
        if let Some(pair) = labels.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(MappingError::Value(format!("the label {:?} twice", pair[0])));
        }
        Ok(Self { markers })
    }

    /// Writes a mapping.
    ///
    /// # Errors
    /// None that a mapping which was read can have.
    pub fn to_json(&self) -> Result<String, MappingError> {
        let marker = |marker: &Marker| FileMarker {
            label: marker.label.clone(),
            at: match &marker.place {
                Place::Feature(name) => FilePlace::Feature(name.clone()),
                Place::Vertex(index) => FilePlace::Vertex(*index),
            },
            weight: marker.weight,
        };
        let markers = self.markers.iter().map(marker).collect();
        let file = File { format: FORMAT.into(), version: VERSION, about: None, markers };
        serde_json::to_string_pretty(&file).map_err(|error| MappingError::Shape(error.to_string()))
    }
}

impl TryFrom<FileMarker> for Marker {
    type Error = MappingError;

    fn try_from(marker: FileMarker) -> Result<Self, MappingError> {
        let odd = |name: &str| {
            name.is_empty() || name.len() > MAX_NAME || name.chars().any(char::is_control)
        };
        let name = if let FilePlace::Feature(name) = &marker.at { name } else { "a vertex" };
        if odd(&marker.label) || odd(name) {
            let what = format!(
                "a label or name that is empty, longer than {MAX_NAME} bytes, or has control characters"
            );
            return Err(MappingError::Value(what));
        }
        if !(0.0..=MAX_WEIGHT).contains(&marker.weight) {
            return Err(MappingError::Value(format!(
                "a weight of {}, where 0 to {MAX_WEIGHT} are allowed",
                marker.weight
            )));
        }
        let place = match marker.at {
            FilePlace::Feature(name) => Place::Feature(name),
            FilePlace::Vertex(index) => Place::Vertex(index),
        };
        Ok(Self { label: marker.label, place, weight: marker.weight })
    }
}
