//! Where the faces of a photograph are: two eyes and a mouth each.
//!
//! Slopes of brightness, told in the contrast of around, are pooled over small cells (Dalal and Triggs 2005), and a template
//! of what each cell of a face speaks for it is held against every place, at every size, five rolls, frontal and turned to
//! both sides. The best places are refined between the steps of that search, and give the frame of a face ([`Frame`]: eyes,
//! mouth and turn). How it looks in that frame ([`FeatureVector`]) tells where eyes and mouth are, by two linear regressions, one
//! after the other (Xiong and De la Torre 2013); how it looks with those tells whether it may be a face: a few hundred boosted
//! trees of three questions each, about slopes, brightness and contrast of its cells, as in aggregated channel features
//! (Dollar et al. 2014). What may be one is looked at again, where a glance (`points::regressor`) has its landmarks: other
//! trees ask how it looks there and around each of them. No colours are asked about: grey photographs are as good as others.
//!
//! The template of (Yang et al. 2004, eq. 4) is what this grew from; it is measured everywhere instead of on blocks of skin,
//! so that neither hair over a cheek nor a wall of skin's colour hides a face.

mod align;
mod candidates;
mod features;
mod frame;
mod template;
#[cfg(test)]
mod tests;
mod trees;

use crate::photo::Photo;
use crate::plane::Pyramid;
use crate::points::RoughFace;
use crate::vector::{distance, middle};
use align::STEPS;
use candidates::candidates;
pub use features::{FEATURE_COUNT, FeatureVector, SECOND_STAGE_COUNT};
use features::{extract, second_stage};
pub use frame::Frame;

/// A face: eyes, mouth and how sure they are. Coordinates are the photograph's, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedFace {
    /// The middles of the eyes: first the one at the picture's left, which is the subject's right eye.
    pub eyes: [[f64; 2]; 2],
    /// The middle of the mouth.
    pub mouth: [f64; 2],
    /// The angle of the line through the eyes from the x axis, clockwise in the picture.
    pub roll_rad: f64,
    /// The distance of the outer eye corners, estimated from the eyes'.
    pub interocular_px: f64,
    /// 0 to 1: the share of what looks so that is a face, on what the trees learned from, where faces counted two of five.
    pub score: f64,
}

/// Distance of the outer eye corners, in those of the eyes' middles: 90 mm and 63 mm.
const INTEROCULAR_PER_EYES: f64 = 1.43;
/// The smallest face that is looked for, as the distance of the outer corners, on photographs of up to a megapixel; it
/// grows with the root of what is beyond that.
pub const INTEROCULAR_MIN_PX: f32 = 32.0;
const FULL_SEARCH_PX: f32 = 1e6;
/// How sure a face must be: the lowest limit, in steps of half a unit of the logarithm of the odds, at which of 3932 pictures
/// without a face that were held out while the trees were learned (apes are left aside) no more than one in a thousand has one.
pub const SCORE_MIN: f64 = 0.73;

/// How sure the first look must be of what is looked at again, which takes about 2 ms: low, for the second look is better at it.
/// There are no more of these than places.
const FIRST_STAGE_MIN: f64 = 0.03;

/// What fits less once it is refined is not looked at closer: of the faces learned from a hundredth, of all places two fifths.
const REFINED_MIN: f32 = -1.5;

/// Two eyes and a mouth, and what they score.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// What would be found.
    pub found: DetectedFace,
    /// How it looks upright: [`FEATURE_COUNT`] bytes, of a second look [`SECOND_STAGE_COUNT`].
    pub features: FeatureVector,
}

/// Every place that may be a face, with its eyes and its mouth where they look to be; the likeliest of the template first.
#[must_use]
pub fn hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    hypotheses_after_steps(photo, STEPS.len())
}

/// The same after fewer steps of the regression that moves eyes and mouth: after none, they are where the template has them.
#[must_use]
pub fn hypotheses_after_steps(photo: &Photo, steps: usize) -> Vec<Hypothesis> {
    propose(photo, &Pyramid::new(photo.grey()), steps)
}

/// What the first look does not dismiss, surest first, as a second look has it: its eyes and mouth, its score, and what
/// lies there.
#[must_use]
pub fn second_stage_hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    let pyramid = Pyramid::new(photo.grey());
    let all = propose(photo, &pyramid, STEPS.len()).into_iter().map(|first| first.found);
    suppress_overlaps(all.filter(|found| found.score >= FIRST_STAGE_MIN).collect())
        .iter()
        .filter_map(|found| {
            let (frame, features) = second_stage(&pyramid, photo, found)?;
            let found = on_photo(&frame, trees::second_stage_score(&features));
            Some(Hypothesis { found, features })
        })
        .collect()
}

/// The faces of a photograph, surest first: what a second look is at least `score_min` sure of, and overlaps nothing surer.
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

/// The surest first, without those that overlap a surer one.
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

/// Whether two faces are at the same place: the middle of one's eyes and mouth is within the other's.
fn overlap(a: &DetectedFace, b: &DetectedFace) -> bool {
    let of = |found: &DetectedFace| middle(middle(found.eyes[0], found.eyes[1]), found.mouth);
    distance(of(a), of(b)) < 0.9 * a.interocular_px.max(b.interocular_px)
}

fn hypothesis(pyramid: &Pyramid, frame: &Frame) -> Hypothesis {
    let features = extract(pyramid, frame);
    Hypothesis { found: on_photo(frame, trees::score(&features)), features }
}

fn on_photo(frame: &Frame, score: f64) -> DetectedFace {
    let eyes = frame.eyes().map(|eye| eye.map(f64::from));
    let [left, right] = eyes;
    let (dx, dy) = (right[0] - left[0], right[1] - left[1]);
    // Turned aside, eyes are nearer than they are on the head; the mouth's distance stays.
    let mouth = frame.at(0.0, Frame::MOUTH).map(f64::from);
    let height = distance(mouth, middle(left, right));
    let eyes_px = dx.hypot(dy).max(0.5 * height / f64::from(Frame::MOUTH));
    let interocular_px = INTEROCULAR_PER_EYES * eyes_px;
    DetectedFace { eyes, mouth, roll_rad: dy.atan2(dx), interocular_px, score }
}

/// A detected mouth may be the base of the nose, which is 0.8 of the eyes' distance below them, often so by the paper's way;
/// no mouth is nearer than this (in their distance), nor this far aside in a face that is not turned too far.
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
