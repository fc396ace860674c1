//! A face laid under the markers of one frame.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use super::Mapping;

/// Three points hold a body; a fourth tells whether they do.
const LEAST: usize = 4;
/// Markers nearer to one line than this share of their spread along it do not hold the turn around it.
const FLAT: f64 = 1e-3;
/// A thousand kilometres: products of four coordinates stay far within what a double holds.
const MAX_COORDINATE_MM: f64 = 1e9;

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
        "{0} markers of the mapping are in this frame and on this face, where {LEAST} are needed"
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
                pairs.push((entry.weight, Vector3::from(vertices_mm[vertex]), Vector3::from(at)));
            }
        }
        if pairs.len() < LEAST {
            return Err(AlignError::TooFew(pairs.len()));
        }
        solve(&pairs, scaling)
    }
}

fn solve(
    pairs: &[(f64, Vector3<f64>, Vector3<f64>)],
    scaling: Scaling,
) -> Result<Alignment, AlignError> {
    let total: f64 = pairs.iter().map(|(weight, ..)| weight).sum();
    let from = pairs.iter().map(|(weight, a, _)| a * *weight).sum::<Vector3<f64>>() / total;
    let to = pairs.iter().map(|(weight, _, b)| b * *weight).sum::<Vector3<f64>>() / total;
    let mut covariance = Matrix3::zeros();
    let mut spread = 0.0;
    for (weight, a, b) in pairs {
        covariance += (b - to) * (a - from).transpose() * *weight;
        spread += weight * (a - from).norm_squared();
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
    let off = |(weight, a, b): &(f64, Vector3<f64>, Vector3<f64>)| {
        weight * (rotation * a * scale + translation - b).norm_squared()
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
