//! Mapping of a take's markers to places on the wireframe, so that a fitted face can be drawn under its markers.
//!
//! `docs/subject-face-format.md` describes the format.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashSet};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::document::{DocumentError, Format};

/// Minimum number of markers for an alignment: three fix a rigid body, a fourth shows whether they fit.
pub const MARKERS_MIN: usize = 4;
/// Markers are collinear if their spread across is below this fraction of that along; the rotation about the line is
/// then undetermined.
const FLAT: f64 = 1e-3;
/// A thousand kilometres: products of four coordinates stay far within the range of a double.
const MAX_COORDINATE_MM: f64 = 1e9;

/// Places of markers on a face.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mapping {
    /// One entry per placed marker.
    pub markers: Vec<Marker>,
}

/// A marker and its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Label in the take.
    pub label: String,
    /// Place on the wireframe.
    #[serde(rename = "at")]
    pub place: Place,
    /// Weight in the alignment: 0 for a marker that moves much, such as on the lips.
    #[serde(default = "one")]
    pub weight: f64,
}

/// A place on the wireframe.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Place {
    /// A vertex by its feature name.
    Feature(String),
    /// A vertex by its index, from 0.
    Vertex(usize),
}

fn one() -> f64 {
    1.0
}

impl Place {
    /// The vertex, if the wireframe has it.
    pub fn vertex(&self, features: &BTreeMap<String, usize>, vertices: usize) -> Option<usize> {
        let index = match self {
            Self::Feature(name) => *features.get(name)?,
            Self::Vertex(index) => *index,
        };
        (index < vertices).then_some(index)
    }
}

/// Whether the alignment may scale the face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scaling {
    /// Free: a photograph has no scale, so the markers give it.
    Free,
    /// Fixed: the size is known from an earlier frame.
    Fixed,
}

/// Why a face cannot be aligned.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum AlignError {
    /// Too few markers of the mapping are in the frame and on the wireframe.
    #[error(
        "{0} markers of the mapping are in this frame and on this face, at least {MARKERS_MIN} are needed"
    )]
    TooFew(usize),
    /// The markers do not determine the rotation.
    #[error("the mapped markers of this frame lie on one line")]
    Flat,
    /// A coordinate that is not finite, or beyond a thousand kilometres.
    #[error("marker {0:?} has no finite position, or is beyond 1e9 mm: check the unit")]
    NotFinite(String),
}

/// Position of a face among markers: x ↦ scale · rotation · x + translation.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// The take's millimetres per millimetre of the face.
    pub scale: f64,
    /// Rotation from the face's frame to the take's, by rows.
    pub rotation: [[f64; 3]; 3],
    /// Translation in the take's millimetres.
    pub translation_mm: [f64; 3],
    /// Weighted root mean square distance of the markers from their places, in the take's millimetres.
    pub rms_mm: f64,
    /// Number of markers used.
    pub markers: usize,
}

impl Mapping {
    /// Aligns a face with the markers of one frame by weighted least squares (Umeyama 1991).
    ///
    /// `marker` returns the position of the marker with a label, in the take's millimetres, if present. Markers of
    /// weight 0 are ignored.
    ///
    /// # Errors
    /// [`AlignError`]: too few markers, all on one line, or not finite.
    pub fn align(
        &self,
        vertices_mm: &[[f64; 3]],
        features: &BTreeMap<String, usize>,
        marker: impl Fn(&str) -> Option<[f64; 3]>,
        scaling: Scaling,
    ) -> Result<Alignment, AlignError> {
        let mut pairs = Vec::new();
        for entry in self.markers.iter().filter(|entry| entry.weight > 0.0) {
            let vertex = entry.place.vertex(features, vertices_mm.len());
            if let (Some(vertex), Some(at)) = (vertex, marker(&entry.label)) {
                if !at.iter().chain(&vertices_mm[vertex]).all(|v| v.abs() < MAX_COORDINATE_MM) {
                    return Err(AlignError::NotFinite(entry.label.clone()));
                }
                let (from, to) = (vertices_mm[vertex].into(), at.into());
                pairs.push(Pair { weight: entry.weight, from, to });
            }
        }
        if pairs.len() < MARKERS_MIN {
            return Err(AlignError::TooFew(pairs.len()));
        }
        solve(&pairs, scaling)
    }
}

/// A place on the face and the position of its marker.
struct Pair {
    weight: f64,
    from: Vector3<f64>,
    to: Vector3<f64>,
}

fn solve(pairs: &[Pair], scaling: Scaling) -> Result<Alignment, AlignError> {
    let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
    let from = pairs.iter().map(|pair| pair.from * pair.weight).sum::<Vector3<f64>>() / total;
    let to = pairs.iter().map(|pair| pair.to * pair.weight).sum::<Vector3<f64>>() / total;
    let mut covariance = Matrix3::zeros();
    let mut spread = 0.0;
    for pair in pairs {
        covariance += (pair.to - to) * (pair.from - from).transpose() * pair.weight;
        spread += pair.weight * (pair.from - from).norm_squared();
    }
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(AlignError::Flat) };
    let mut widths = svd.singular_values;
    let [largest, middle] = [0, 1].map(|i| widths[i]);
    if !(middle > FLAT * largest && spread > 0.0) {
        return Err(AlignError::Flat);
    }
    // A reflection would fit better: invert the least certain direction.
    let mut mirror = Matrix3::identity();
    if u.determinant() * v_t.determinant() < 0.0 {
        mirror[(2, 2)] = -1.0;
        widths[2] = -widths[2];
    }
    let rotation = u * mirror * v_t;
    let scale = match scaling {
        Scaling::Free => widths.sum() / spread,
        Scaling::Fixed => 1.0,
    };
    let translation = to - rotation * from * scale;
    let off = |pair: &Pair| {
        pair.weight * (rotation * pair.from * scale + translation - pair.to).norm_squared()
    };
    let rms_mm = (pairs.iter().map(off).sum::<f64>() / total).sqrt();
    Ok(Alignment {
        scale,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        translation_mm: translation.into(),
        rms_mm,
        markers: pairs.len(),
    })
}

impl Alignment {
    /// Transforms the face to the markers.
    pub fn apply(&self, vertices_mm: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let turn = |v: &[f64; 3]| {
            std::array::from_fn(|i| {
                let turned: f64 = (0..3).map(|j| self.rotation[i][j] * v[j]).sum();
                self.scale * turned + self.translation_mm[i]
            })
        };
        vertices_mm.iter().map(turn).collect()
    }
}

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
