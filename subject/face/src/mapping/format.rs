//! The mapping file.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

use super::{Mapping, Marker, Place};
use crate::document::{DocumentError, Format};

const MAPPING: Format = Format {
    name: "mocapd-face-mapping",
    version: 1,
    made_by: "such as subject/face/data/singing-face-mapping.json",
    bytes_max: 256 * 1024,
};
/// More markers than any face was captured with.
const MARKERS_MAX: usize = 1000;
const NAME_MAX: usize = 255;
const WEIGHT_MAX: f64 = 1000.0;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingFile {
    format: String,
    version: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    about: Option<String>,
    markers: Vec<Marker>,
}

impl Mapping {
    /// Reads a mapping. Unknown keys are rejected.
    ///
    /// # Errors
    /// [`DocumentError`] with the reason.
    pub fn from_json(bytes: &[u8]) -> Result<Self, DocumentError> {
        let MappingFile { markers, .. } = MAPPING.read(bytes)?;
        let (count, expected) = ([markers.len()], format!("0 to {MARKERS_MAX}"));
        let place = |_| "markers.length".to_owned();
        MAPPING.expect(count, place, &expected, |count| *count <= MARKERS_MAX)?;
        let expected = format!("1 to {NAME_MAX} bytes without control characters");
        let is_name = |name: &&String| {
            (1..=NAME_MAX).contains(&name.len()) && !name.contains(char::is_control)
        };
        let labels = || markers.iter().map(|marker| &marker.label);
        MAPPING.expect(labels(), |i| format!("markers[{i}].label"), &expected, is_name)?;
        let named = markers.iter().enumerate().filter_map(|(i, marker)| match &marker.place {
            Place::Feature(name) => Some((i, name)),
            Place::Vertex(_) => None,
        });
        let (at, names): (Vec<_>, Vec<_>) = named.unzip();
        MAPPING.expect(names, |i| format!("markers[{}].at", at[i]), &expected, is_name)?;
        let expected = format!("0 to {WEIGHT_MAX}");
        let weights = markers.iter().map(|marker| marker.weight);
        let is_weight = |weight: &f64| (0.0..=WEIGHT_MAX).contains(weight);
        MAPPING.expect(weights, |i| format!("markers[{i}].weight"), &expected, is_weight)?;
        let mut known = HashSet::new();
        let place = |i| format!("markers[{i}].label");
        MAPPING.expect(labels(), place, "each label once", |label| known.insert(*label))?;
        Ok(Self { markers })
    }

    /// Serialises a mapping.
    ///
    /// # Errors
    /// None for a mapping that was read.
    pub fn to_json(&self) -> Result<String, DocumentError> {
        let (format, version, markers) =
            (MAPPING.name.to_owned(), MAPPING.version, self.markers.clone());
        let file = MappingFile { format, version, about: None, markers };
        serde_json::to_string_pretty(&file).map_err(|error| DocumentError::Shape(error.to_string()))
    }
}
