//! The 53 points of a face (Yang et al. 2004, section 3): outline 12, brows 2 x 5, nose 5, eyes 2 x 6, mouth 14, each
//! with a confidence, numbered as in [`FeatureId`].
//!
//! [`find`] is the default. A landmark regressor gives initial positions; each feature is then an active shape, moved
//! and bent until brightness and redness agree with it; the generic face in its pose ties the features together, and
//! both steps alternate. [`paper::find`] is the published method, feature by feature. Both start from a [`RoughFace`]
//! and work in an upright crop of fixed size, so that no length depends on the photograph's resolution.

mod chain;
mod crop;
mod evidence;
mod features;
mod outline;
pub mod paper;
pub mod regressor;
mod search;
mod shape;
#[cfg(test)]
mod tests;

use crate::model::{self, FeatureId};
use crate::vector::Point;
pub use chain::find;
use crop::Crop;
pub use evidence::{Evidence, FAINT};

/// Approximate position of a face (pixels of the photograph); an error of a tenth of the eye distance is harmless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoughFace {
    /// Centre of the eye at the picture's left, the subject's right eye.
    pub left_eye: [f64; 2],
    /// Centre of the eye at the picture's right.
    pub right_eye: [f64; 2],
    /// Centre of the mouth.
    pub mouth: [f64; 2],
}

/// One of the 53 points.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FacePoint {
    /// Position in pixels of the photograph.
    pub at: [f64; 2],
    /// 0 (inferred from the rest of the face) to 1 (clearly visible).
    pub confidence: f64,
}

/// The points of one face.
#[derive(Debug, Clone, PartialEq)]
pub struct FacePoints {
    /// By [`FeatureId::index`].
    pub points: [FacePoint; FeatureId::COUNT],
    /// The outline of the face, a closed polygon (pixels of the photograph).
    pub outline: Vec<[f64; 2]>,
    /// Yaw, positive when the face turns to the right of the picture; none if the method finds no pose.
    pub yaw_deg: Option<f64>,
    /// Evidence for the confidence; none from [`paper::find`].
    pub evidence: Option<Evidence>,
}

impl Default for FacePoints {
    fn default() -> Self {
        FacePoints {
            points: [FacePoint::default(); FeatureId::COUNT],
            outline: Vec::new(),
            yaw_deg: None,
            evidence: None,
        }
    }
}

impl FacePoints {
    /// Confidence of the face, 0 to 1: the probability that the mean error of its points is below a tenth of the outer
    /// interocular distance. None from [`paper::find`], which has no evidence for it.
    #[must_use]
    pub fn confidence(&self) -> Option<f64> {
        self.evidence.map(|evidence| evidence.confidence())
    }

    /// The points that were located, as [`Model::fit_shape`](model::Model::fit_shape) takes them.
    #[must_use]
    pub fn found(&self) -> Vec<model::Landmark> {
        FeatureId::all()
            .zip(&self.points)
            .filter(|(_, p)| p.confidence > 0.0)
            .map(|(id, p)| model::Landmark { id, xy_px: p.at, confidence: p.confidence })
            .collect()
    }

    fn set(&mut self, index: usize, at: [f64; 2], confidence: f64) {
        if let Some(point) = self.points.get_mut(index) {
            *point = FacePoint { at, confidence };
        }
    }

    /// Sets points given in the crop, by iBUG-68 numbers.
    fn put(&mut self, which: &[usize], at: &[Point], confidence: f64, crop: &Crop) {
        for (i, p) in which.iter().zip(at) {
            if let Some(id) = FeatureId::from_ibug(*i) {
                self.set(id.index(), crop.to_photo(*p), confidence);
            }
        }
    }
}

// iBUG-68 numbers of the features' points, from the left of the picture.
const BROWS: [[usize; 5]; 2] = [[17, 18, 19, 20, 21], [22, 23, 24, 25, 26]];
const NOSE: [usize; 5] = [31, 32, 33, 34, 35];
const EYES: [[usize; 6]; 2] = [[36, 37, 38, 39, 40, 41], [42, 43, 44, 45, 46, 47]];
const MOUTH: [usize; 14] = [48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 62, 66];
