//! Which marker of a take sits where on the wireframe, so that a fitted face can be drawn under its markers.
//!
//! The format is described in `docs/subject-face-format.md`.

mod format;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::DocumentError;

/// Markers that hold a face, at least: three hold a body, a fourth tells whether they do.
pub const MARKERS_MIN: usize = 4;
/// Markers nearer to one line than this share of their spread along it do not hold the turn around it.
const FLAT: f64 = 1e-3;
/// A thousand kilometres: products of four coordinates stay far within what a double holds.
const MAX_COORDINATE_MM: f64 = 1e9;

/// Where markers sit on a face.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mapping {
    /// One for each marker that has a place.
    pub markers: Vec<Marker>,
}

/// One marker's place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// As the take has it.
    pub label: String,
    /// Where on the wireframe.
    #[serde(rename = "at")]
    pub place: Place,
    /// How much it counts when the face is laid under the markers: 0 for one that moves much, such as on the lips.
    #[serde(default = "one")]
    pub weight: f64,
}

/// A place on the wireframe.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Place {
    /// A vertex by its name.
    Feature(String),
    /// A vertex by its number, from 0.
    Vertex(usize),
}

fn one() -> f64 {
    1.0
}

impl Place {
    /// The vertex, where the wireframe has it.
    pub fn vertex(&self, features: &BTreeMap<String, usize>, vertices: usize) -> Option<usize> {
        let index = match self {
            Self::Feature(name) => *features.get(name)?,
            Self::Vertex(index) => *index,
        };
        (index < vertices).then_some(index)
    }
}

/// Whether the face may change its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scaling {
    /// A photograph has no scale: the markers give it.
    Free,
    /// The size is known, from an earlier frame.
    Fixed,
}

/// Why a face cannot be laid under markers.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum AlignError {
    /// Too many of the mapping's markers are missing from the frame, or their places from the wireframe.
    #[error(
        "{0} markers of the mapping are in this frame and on this face, where {MARKERS_MIN} are needed"
    )]
    TooFew(usize),
    /// The markers that are there do not tell how the face is turned.
    #[error("the markers of this frame that the mapping has lie on one line")]
    Flat,
    /// A coordinate that is no number, or beyond a thousand kilometres.
    #[error("marker {0:?} is at no place, or further away than 1e9 mm: check the unit")]
    NotFinite(String),
}

/// Where a face is among markers: x ↦ scale · rotation · x + translation.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// The take's millimetres for each of the face's.
    pub scale: f64,
    /// From the face's frame to the take's, by rows.
    pub rotation: [[f64; 3]; 3],
    /// In the take's millimetres.
    pub translation_mm: [f64; 3],
    /// Root mean square distance of the markers to their places, weighted, in the take's millimetres.
    pub rms_mm: f64,
    /// How many markers it is from.
    pub markers: usize,
}

impl Mapping {
    /// That of the public recording of a singing face with 37 markers (c3d.org, sample 19), whose labels run from
    /// `root-1` to `section14-3`.
    ///
    /// # Errors
    /// None, unless the program was built with a damaged file.
    pub fn singing_face() -> Result<Self, DocumentError> {
        Self::from_json(include_bytes!("../../data/singing-face-mapping.json"))
    }

    /// Lays a face under the markers of one frame, by weighted least squares (Umeyama 1991).
    ///
    /// `marker` gives where the marker with a label is, in the take's millimetres, if it is there. Markers of weight 0
    /// do not count.
    ///
    /// # Errors
    /// Too few markers, on one line, or not finite.
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
                pairs.push(Pair {
                    weight: entry.weight,
                    from: vertices_mm[vertex].into(),
                    to: at.into(),
                });
            }
        }
        if pairs.len() < MARKERS_MIN {
            return Err(AlignError::TooFew(pairs.len()));
        }
        solve(&pairs, scaling)
    }
}

/// A place on the face, and where its marker is.
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
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(AlignError::Flat);
    };
    let mut widths = svd.singular_values;
    let [largest, middle] = [0, 1].map(|i| widths[i]);
    if !(middle > FLAT * largest && spread > 0.0) {
        return Err(AlignError::Flat);
    }
    // A reflection would fit better: the least certain direction is turned over.
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
    /// The face among the markers.
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
