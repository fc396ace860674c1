//! Face detection: two eyes and a mouth for each face of a photograph.
//!
//! The detector is a cascade on histograms of oriented gradients (Dalal and Triggs 2005), without colour, so grey
//! photographs work as well as others:
//!
//! 1. A linear template over pooled gradients scores every place of an image pyramid, at every size and five rolls,
//!    frontal and turned to both sides. The best candidates are refined between the steps of that search and give the
//!    [`Frame`] of a face: eyes, mouth and turn.
//!
//! 2. Two linear regressions (Xiong and De la Torre 2013) on the [`FeatureVector`] of that frame align eyes and mouth.
//!
//! 3. First-stage classifier: 300 boosted trees of depth 3 on gradients, brightness and contrast of the frame's cells,
//!    as in aggregated channel features (Dollar et al. 2014), dismiss nearly all candidates.
//!
//! 4. Second-stage classifier: for the rest, a landmark regressor ([`points::regressor`](crate::points::regressor))
//!    gives eyes, mouth and turn, and 500 more trees score the frame there, the patches around each landmark, and the
//!    first score.
//!
//! The template of (Yang et al. 2004, eq. 4) was the starting point. It is evaluated everywhere instead of on blocks of
//! skin, so that neither hair over a cheek nor a skin-coloured wall hides a face.

mod candidates;
mod features;
mod stages;
mod template;
#[cfg(test)]
mod tests;

use crate::photo::Photo;
use crate::plane::{Pyramid, distance, middle};
use crate::points::RoughFace;
use candidates::candidates;
pub use features::{FEATURE_COUNT, FeatureVector, Frame, SECOND_STAGE_COUNT};
use features::{extract, second_stage};
use stages::STEPS;

/// A detected face. Coordinates are the photograph's, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedFace {
    /// The centres of the eyes: first the one at the picture's left, the subject's right eye.
    pub eyes: [[f64; 2]; 2],
    /// The centre of the mouth.
    pub mouth: [f64; 2],
    /// Angle of the line through the eyes from the x axis, clockwise in the picture.
    pub roll_rad: f64,
    /// Outer interocular distance, estimated from the eyes.
    pub interocular_px: f64,
    /// Score, 0 to 1: the fraction of such feature vectors that are faces in the training set, where faces were
    /// weighted as two fifths.
    pub score: f64,
}

/// Ratio of the outer interocular distance to that of the eye centres: 90 mm to 63 mm.
const INTEROCULAR_PER_EYES: f64 = 1.43;
/// Minimum outer interocular distance on photographs of up to a megapixel; it grows with the square root of the
/// size beyond that.
pub const INTEROCULAR_MIN_PX: f32 = 32.0;
const FULL_SEARCH_PX: f32 = 1e6;
/// Minimum score of a face: the lowest threshold, in steps of half a unit of log odds, at which at most one in a
/// thousand of 3932 held-out pictures without a face has a detection (pictures of apes excluded).
pub const SCORE_MIN: f64 = 0.73;

/// Minimum first-stage score of a second-stage candidate. It is low, since the second stage is better and takes about
/// 2 ms per candidate; there are never more than the template's candidates.
const FIRST_STAGE_MIN: f64 = 0.03;

/// Minimum log odds of a refined candidate: a hundredth of the training faces and two fifths of all candidates have
/// less.
const REFINED_MIN: f32 = -1.5;

/// A candidate face with its score.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// The face.
    pub found: DetectedFace,
    /// Its features: [`FEATURE_COUNT`] bytes in the first stage, [`SECOND_STAGE_COUNT`] in the second.
    pub features: FeatureVector,
}

/// All candidates of the template after alignment, with their first-stage scores, the template's best first.
#[must_use]
pub fn hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    hypotheses_after_steps(photo, STEPS.len())
}

/// All candidates after fewer alignment steps; with none, eyes and mouth are where the template has them.
#[must_use]
pub fn hypotheses_after_steps(photo: &Photo, steps: usize) -> Vec<Hypothesis> {
    propose(photo, &Pyramid::new(photo.grey()), steps)
}

/// The candidates that the first stage keeps, with the second stage's eyes, mouth and score, best first-stage score
/// first.
#[must_use]
pub fn second_stage_hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    let pyramid = Pyramid::new(photo.grey());
    let all = propose(photo, &pyramid, STEPS.len()).into_iter().map(|first| first.found);
    suppress_overlaps(all.filter(|found| found.score >= FIRST_STAGE_MIN).collect())
        .iter()
        .filter_map(|found| {
            let (frame, features) = second_stage(&pyramid, photo, found)?;
            let found = on_photo(&frame, stages::second_stage_score(&features));
            Some(Hypothesis { found, features })
        })
        .collect()
}

/// Detects faces, best first: second-stage candidates with a score of at least `score_min` that overlap no better one.
#[must_use]
pub fn faces(photo: &Photo, score_min: f64) -> Vec<DetectedFace> {
    let all = second_stage_hypotheses(photo).into_iter().map(|hypothesis| hypothesis.found);
    suppress_overlaps(all.filter(|found| found.score >= score_min).collect())
}

fn propose(photo: &Photo, pyramid: &Pyramid, steps: usize) -> Vec<Hypothesis> {
    let pixels = photo.width() * photo.height();
    let interocular_min = INTEROCULAR_MIN_PX * (pixels as f32 / FULL_SEARCH_PX).sqrt().max(1.0);
    candidates(pyramid, interocular_min / INTEROCULAR_PER_EYES as f32)
        .iter()
        .map(|candidate| candidate.refined(pyramid))
        .filter(|candidate| candidate.fit.odds > REFINED_MIN)
        .filter_map(|candidate| {
            let mut frame = candidate.frame()?;
            for step in STEPS.iter().take(steps) {
                frame = step.aligned(&frame, &extract(pyramid, &frame));
            }
            Some(hypothesis(pyramid, &frame))
        })
        .collect()
}

/// Non-maximum suppression: best first, without faces that overlap a better one.
fn suppress_overlaps(mut all: Vec<DetectedFace>) -> Vec<DetectedFace> {
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<DetectedFace> = Vec::new();
    for found in all {
        if !kept.iter().any(|other| overlap(other, &found)) {
            kept.push(found);
        }
    }
    kept
}

/// Whether two faces overlap: their centres, between eyes and mouth, are close.
fn overlap(a: &DetectedFace, b: &DetectedFace) -> bool {
    let of = |found: &DetectedFace| middle(middle(found.eyes[0], found.eyes[1]), found.mouth);
    distance(of(a), of(b)) < 0.9 * a.interocular_px.max(b.interocular_px)
}

fn hypothesis(pyramid: &Pyramid, frame: &Frame) -> Hypothesis {
    let features = extract(pyramid, frame);
    Hypothesis { found: on_photo(frame, stages::score(&features)), features }
}

fn on_photo(frame: &Frame, score: f64) -> DetectedFace {
    let eyes = frame.eyes().map(|eye| eye.map(f64::from));
    let [left, right] = eyes;
    let (dx, dy) = (right[0] - left[0], right[1] - left[1]);
    // Yaw shortens the distance of the eyes; that of the mouth stays.
    let mouth = frame.at(0.0, Frame::MOUTH).map(f64::from);
    let height = distance(mouth, middle(left, right));
    let eyes_px = dx.hypot(dy).max(0.5 * height / f64::from(Frame::MOUTH));
    let interocular_px = INTEROCULAR_PER_EYES * eyes_px;
    DetectedFace { eyes, mouth, roll_rad: dy.atan2(dx), interocular_px, score }
}

/// Minimum distance of a mouth below the eyes and its largest lateral offset, in eye distances. A detected mouth may
/// be the base of the nose, 0.8 eye distances below the eyes, often so by the published method.
const MOUTH_BELOW_MIN: f64 = 1.05;
const MOUTH_ASIDE: f64 = 0.3;

impl From<&DetectedFace> for RoughFace {
    fn from(found: &DetectedFace) -> Self {
        let [left_eye, right_eye] = found.eyes;
        let across = [right_eye[0] - left_eye[0], right_eye[1] - left_eye[1]];
        let squared = (across[0] * across[0] + across[1] * across[1]).max(f64::MIN_POSITIVE);
        let middle = middle(left_eye, right_eye);
        let to = [found.mouth[0] - middle[0], found.mouth[1] - middle[1]];
        let aside = (to[0] * across[0] + to[1] * across[1]) / squared;
        let below = (to[1] * across[0] - to[0] * across[1]) / squared;
        let (aside, below) = (aside.clamp(-MOUTH_ASIDE, MOUTH_ASIDE), below.max(MOUTH_BELOW_MIN));
        let mouth = [
            middle[0] + aside * across[0] - below * across[1],
            middle[1] + aside * across[1] + below * across[0],
        ];
        RoughFace { left_eye, right_eye, mouth }
    }
}
