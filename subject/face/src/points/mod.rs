//! The 53 points of a face (Yang et al. 2004, section 3): outline 12, brows 2 x 5, nose 5, eyes 2 x 6, mouth 14, each
//! with a confidence, numbered as in [`FeatureId`].
//!
//! [`find`] is the default. A landmark regressor gives initial positions; each feature is then an active shape, moved
//! and bent until brightness and redness agree with it; the generic face in its pose ties the features together, and
//! both steps alternate. [`paper::find`] is the published method, feature by feature. Both start from a [`RoughFace`]
//! and work in an upright crop of fixed size, so that no length depends on the photograph's resolution.

mod crop;
mod evidence;
mod features;
pub mod paper;
pub mod regressor;
#[cfg(test)]
mod tests;

use crate::model;
use crate::model::{FeatureId, Model, ModelError};
use crate::photo::Photo;
use crate::plane::{Point, middle};
use crop::{Crop, Maps};
pub use evidence::{Evidence, FAINT};
use evidence::{LocatedFeatures, clearness};
use features::{Heights, Ray};
use regressor::{LandmarkPoints, LandmarkRegressor, REGRESSED, mean};
use regressor::{Landmarks, PosedModel, Target};

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

/// Search range of a feature and of the outline (pixels of the crop), and number of rounds. These and the following
/// constants were chosen on the development photographs and on random heads that nothing was learned from.
const REACH: f64 = 2.5;
const OUTLINE_REACH: f64 = 7.0;
const ROUNDS: usize = 2;
/// Standard deviation of the regressor's landmarks, before and during the comparison with the picture (pixels of the
/// crop).
const REGRESSOR_FIRST_SD: f64 = 3.0;
const REGRESSOR_SD: f64 = 4.0;
/// Confidence at which a face is accepted; below it other starting positions are tried, and the most confident result
/// counts.
const CONFIDENT: f64 = 0.5;
/// Alternative mouth positions, in eye distances: lower, as where a nose was taken for it, or higher.
const LOWER: [f64; 2] = [0.17, -0.13];

/// Locates the 53 points of the face at `rough`.
///
/// # Errors
/// None, unless the built-in model is damaged ([`Model::generic`]).
pub fn find(photo: &Photo, rough: &RoughFace) -> Result<FacePoints, ModelError> {
    let landmarks = Landmarks::of(Model::generic()?);
    let frontal = PosedModel::frontal(&landmarks, crop::INTEROCULAR, crop::EYES);
    let mut best = Attempt::from(photo, rough, &frontal);
    for rough in alternative_starts(rough, &best.regressor, &best.predicted) {
        if best.evidence.confidence() >= CONFIDENT {
            break;
        }
        let other = Attempt::from(photo, &rough, &frontal);
        if other.evidence.confidence() > best.evidence.confidence() {
            best = other;
        }
    }
    Ok(collect(best))
}

/// The result from one starting position.
struct Attempt<'a> {
    regressor: LandmarkRegressor,
    predicted: LandmarkPoints,
    pose: PosedModel<'a>,
    located: LocatedFeatures,
    line: Vec<Ray>,
    evidence: Evidence,
}

impl<'a> Attempt<'a> {
    fn from(photo: &Photo, rough: &RoughFace, frontal: &PosedModel<'a>) -> Self {
        let regressor = LandmarkRegressor::new(photo, rough);
        let predicted = regressor.predict();
        let targets = |sd: f64| {
            let places = REGRESSED.iter().zip(&predicted);
            places.map(move |(&landmark, &at)| Target { landmark, at, sd })
        };
        let mut pose = frontal.clone();
        pose.fit(&targets(REGRESSOR_FIRST_SD).collect::<Vec<_>>(), 8);
        let maps = Maps::of(regressor.crop());
        let (mut located, mut line) = (LocatedFeatures::default(), Vec::new());
        for _ in 0..ROUNDS {
            let unlike = evidence::unlike(&maps, &pose);
            let (around, outlined) = evidence::locate_outline(&maps, &unlike, &pose, OUTLINE_REACH);
            located = evidence::locate_features(&maps, &pose, REACH);
            let located = located.targets.iter().chain(&around).copied();
            pose.fit(&located.chain(targets(REGRESSOR_SD)).collect::<Vec<_>>(), 4);
            line = outlined;
        }
        let evidence = Evidence::of(&pose, &located, &line, &predicted);
        Self { regressor, predicted, pose, located, line, evidence }
    }
}

/// Collects the points of the fitted pose, in the photograph.
fn collect(attempt: Attempt<'_>) -> FacePoints {
    let Attempt { regressor, pose, located, line, evidence, .. } = attempt;
    let crop = regressor.crop();
    let p = pose.project();
    let (yaw_deg, evidence) = (Some(pose.yaw_deg()), Some(evidence));
    let mut points = FacePoints { yaw_deg, evidence, ..FacePoints::default() };
    let features: [&[usize]; 6] = [&EYES[0], &EYES[1], &BROWS[0], &BROWS[1], &NOSE, &MOUTH];
    let at_annotators = |i: usize| {
        let [x, y] = offset_interocular(i);
        let size = pose.scale;
        let narrow = pose.yaw_deg().to_radians().cos();
        p.get(i).map(|p| [p[0] + size * narrow * x, p[1] + size * y])
    };
    for (which, clear) in features.into_iter().zip(&located.clear) {
        let at: Vec<Point> = which.iter().filter_map(|i| at_annotators(*i)).collect();
        points.put(which, &at, *clear, crop);
    }
    let mean = |a: usize, b: usize| (p[a][1] + p[b][1]) / 2.0;
    let heights =
        Heights { brows: mean(19, 24), eyes: mean(36, 45), nose: p[33][1], mouth: mean(48, 54) };
    let polygon: Vec<Point> = line.iter().map(|ray| ray.at).collect();
    let centre = middle(p[27], p[33]);
    for (index, at) in features::twelve(&polygon, centre[0], &heights) {
        let clear = features::towards(&line, centre, at).map_or(FAINT, |(ray, _)| clearness(&ray));
        points.set(index, crop.to_photo(at), clear);
    }
    points.outline = polygon.into_iter().map(|p| crop.to_photo(p)).collect();
    points
}

/// Alternative starting positions: eyes and mouth of the first regression, so that a second one has them centred, and
/// other positions of the mouth.
fn alternative_starts(
    rough: &RoughFace,
    regressor: &LandmarkRegressor,
    predicted: &LandmarkPoints,
) -> [RoughFace; 3] {
    let at = |range| regressor.to_photo(mean(predicted, range));
    let again = RoughFace { left_eye: at(36..42), right_eye: at(42..48), mouth: at(48..60) };
    let ([ax, ay], [bx, by]) = (rough.left_eye, rough.right_eye);
    let [lower, higher] = LOWER.map(|by_eyes| {
        let [x, y] = rough.mouth;
        let mouth = [x - by_eyes * (by - ay), y + by_eyes * (bx - ax)];
        RoughFace { mouth, ..*rough }
    });
    [again, lower, higher]
}

/// Offsets from this chain's points to those of iBUG-68 annotators, as fractions of the outer interocular distance, x
/// to the right of the picture, y down. Keyed by the number of the point on the subject's right; learned on the
/// development photographs by `--example faces_points offsets`.
const OFFSETS_INTEROCULAR: [(usize, [f64; 2]); 23] = [
    (17, [0.044, 0.033]),
    (18, [0.027, 0.031]),
    (19, [-0.034, 0.007]),
    (20, [-0.014, 0.021]),
    (21, [-0.068, -0.009]),
    (31, [0.012, 0.027]),
    (32, [-0.006, 0.007]),
    (33, [0.000, 0.009]),
    (36, [0.019, 0.038]),
    (37, [-0.015, 0.008]),
    (38, [0.000, 0.010]),
    (39, [-0.016, 0.025]),
    (40, [0.001, 0.025]),
    (41, [-0.007, 0.020]),
    (48, [-0.013, -0.016]),
    (49, [-0.030, 0.015]),
    (50, [-0.014, 0.008]),
    (51, [0.000, 0.024]),
    (57, [0.000, -0.022]),
    (58, [-0.022, -0.010]),
    (59, [-0.045, -0.052]),
    (62, [0.000, 0.021]),
    (66, [0.000, -0.004]),
];

/// [`OFFSETS_INTEROCULAR`] for either half of the face, x to the right of the picture.
fn offset_interocular(landmark: usize) -> Point {
    let (right, sign) = match landmark {
        22..=26 => (43 - landmark, -1.0),
        34 | 35 => (66 - landmark, -1.0),
        42..=45 => (81 - landmark, -1.0),
        46 | 47 => (87 - landmark, -1.0),
        52..=54 => (102 - landmark, -1.0),
        55 | 56 => (114 - landmark, -1.0),
        _ => (landmark, 1.0),
    };
    let found = OFFSETS_INTEROCULAR.iter().find(|(i, _)| *i == right);
    found.map_or([0.0; 2], |(_, [x, y])| [sign * x, *y])
}
