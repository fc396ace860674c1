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

mod learned_stages;
mod template;
#[cfg(test)]
mod tests;

use learned_stages::{STEPS, first_stage_features, second_stage_features};

use self::{
    learned_stages::length,
    template::{CELL_PX, Cells, EYES_PX, SIDE, TEMPLATES, TemplateFit, best_fit, eyes_of},
};
use crate::{
    photo::Photo,
    plane::{Plane, Pyramid, distance, middle},
    points::RoughFace,
};
pub use learned_stages::{FEATURE_COUNT, FeatureVector, Frame, SECOND_STAGE_COUNT};

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
            let (frame, features) = second_stage_features(&pyramid, photo, found)?;
            let found = on_photo(&frame, learned_stages::second_stage_score(&features));
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
                frame = step.aligned(&frame, &first_stage_features(pyramid, &frame));
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
    let features = first_stage_features(pyramid, frame);
    Hypothesis { found: on_photo(frame, learned_stages::first_stage_score(&features)), features }
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

/// Rolls of the search: 15 degrees apart, up to 30.
const ROLLS_RAD: [f32; 5] = [0.0, -0.262, 0.262, -0.524, 0.524];
/// Ratio of successive sizes: the template tolerates a tenth.
const STEP: f32 = 1.2;
/// Margin around a level, in pixels: a face may lie at the border.
const MARGIN_PX: usize = 8;
/// Maximum number of candidates: two for each of a class of thirty.
const CANDIDATES_MAX: usize = 64;
/// Candidates closer than this, in eye distances, are the same face.
const APART: f32 = 0.4;
/// Larger ratios of sizes are different faces: an eye with its brow may resemble a small face.
const SAME_SIZE: f32 = 1.5;

/// Minimum log odds of a candidate.
const ODDS_MIN: f32 = -4.0;
/// Cells around the template on each side, for the local contrast.
const AROUND: usize = 4;
const CROP_PX: usize = (SIDE + 2 * AROUND) * CELL_PX;
/// Changes of size, then of roll, between the steps of the search.
const CHANGES: [[(f32, f32); 2]; 2] = [[(1.1, 0.0), (0.91, 0.0)], [(1.0, 0.13), (1.0, -0.13)]];

/// The best candidates of a photograph, best first. `eyes_min` is the least eye distance.
fn candidates(pyramid: &Pyramid, eyes_min: f32) -> Vec<Candidate> {
    let [wide, high] = pyramid.size();
    let side = wide.min(high) as f32;
    let mut shrink = eyes_min / EYES_PX;
    let mut all = Vec::new();
    while side / shrink >= (SIDE * CELL_PX) as f32 * 0.7 {
        if let Some((plane, done)) = pyramid.at(shrink) {
            let px = |side: usize| ((side as f32 * done / shrink).round() as usize).max(1);
            let level =
                plane.resized(px(plane.width()), px(plane.height())).map(|v| v.max(0.0).sqrt());
            let scale = [wide as f32 / level.width() as f32, high as f32 / level.height() as f32];
            for roll_rad in ROLLS_RAD {
                RotatedLevel::new(&level, roll_rad).search(scale, &mut all);
            }
        }
        shrink *= STEP;
    }
    all.sort_by(|a, b| b.fit.odds.total_cmp(&a.fit.odds));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in all {
        let near = |other: &Candidate| {
            let offset = [0, 1].map(|axis| other.origin[axis] - candidate.origin[axis]);
            let (a, b) = (other.eyes_px(), candidate.eyes_px());
            length(offset) < APART * a.min(b) && a.max(b) < SAME_SIZE * a.min(b)
        };
        if !kept.iter().any(near) {
            kept.push(candidate);
            if kept.len() >= CANDIDATES_MAX {
                break;
            }
        }
    }
    kept
}

/// A level of the image pyramid, rotated.
struct RotatedLevel {
    cells: Cells,
    /// Rotation and centres for mapping its pixels to the level's.
    turn: [f32; 2],
    middle: [f32; 2],
    level_middle: [f32; 2],
}

impl RotatedLevel {
    fn new(level: &Plane, roll_rad: f32) -> Self {
        let (sin, cos) = roll_rad.sin_cos();
        let (wide, high) = (level.width() as f32, level.height() as f32);
        let width = (cos.abs() * wide + sin.abs() * high) as usize + 2 * MARGIN_PX;
        let height = (sin.abs() * wide + cos.abs() * high) as usize + 2 * MARGIN_PX;
        let half = |side: usize| (side as f32 - 1.0) / 2.0;
        let middle = [half(width), half(height)];
        let level_middle = [half(level.width()), half(level.height())];
        let mut plane = Plane::filled(width, height, 0.0);
        for (y, row) in plane.values_mut().chunks_exact_mut(width).enumerate() {
            let dy = y as f32 - middle[1];
            for (x, value) in row.iter_mut().enumerate() {
                let dx = x as f32 - middle[0];
                *value = level.sample(
                    cos * dx - sin * dy + level_middle[0],
                    sin * dx + cos * dy + level_middle[1],
                );
            }
        }
        Self { cells: Cells::new(&plane), turn: [cos, sin], middle, level_middle }
    }

    /// Adds the local maxima of the template's score.
    fn search(&self, scale: [f32; 2], out: &mut Vec<Candidate>) {
        let across = (self.cells.across + 1).saturating_sub(SIDE);
        let down = (self.cells.down + 1).saturating_sub(SIDE);
        if across == 0 || down == 0 {
            return;
        }
        let mut fits = Plane::filled(across, down, f32::NEG_INFINITY);
        let mut poses = vec![0_usize; across * down];
        let cells = fits.values_mut().iter_mut().zip(&mut poses).enumerate();
        // Every other place only: refinement covers those between.
        for (i, (fit, pose)) in cells.filter(|(i, _)| (i % across + i / across).is_multiple_of(2)) {
            if let Some(best) = best_fit(&self.cells, i % across, i / across) {
                (*fit, *pose) = (best.odds, best.pose);
            }
        }
        for (i, (&fit, &pose)) in fits.values().iter().zip(&poses).enumerate() {
            let (x, y) = ((i % across) as isize, (i / across) as isize);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            if fit < ODDS_MIN || near.into_iter().any(|(dx, dy)| fits.get(x + dx, y + dy) > fit) {
                continue;
            }
            out.push(self.candidate_at(x as f32, y as f32, scale, TemplateFit { pose, odds: fit }));
        }
    }

    /// The candidate at a cell, on the photograph.
    fn candidate_at(&self, column: f32, row: f32, scale: [f32; 2], fit: TemplateFit) -> Candidate {
        let at = eyes_of(column, row);
        let [cos, sin] = self.turn;
        let (dx, dy) = (at[0] - self.middle[0], at[1] - self.middle[1]);
        let x = cos * dx - sin * dy + self.level_middle[0];
        let y = sin * dx + cos * dy + self.level_middle[1];
        Candidate {
            origin: [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5],
            step: [cos * scale[0], sin * scale[1]],
            fit,
        }
    }
}

/// A candidate: a place where a template fits.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    /// Midpoint of the eyes, on the photograph.
    origin: [f32; 2],
    /// Vector of one template pixel to the right, on the photograph; down is perpendicular to it.
    step: [f32; 2],
    fit: TemplateFit,
}

impl Candidate {
    /// The template's eye distance, on the photograph.
    fn eyes_px(&self) -> f32 {
        EYES_PX * length(self.step)
    }

    /// The frame of the template's face, on the photograph.
    fn frame(&self) -> Option<Frame> {
        let Frame { across, down, turn, .. } = TEMPLATES.get(self.fit.pose)?.frame;
        let offset = |[x, y]: [f32; 2]| self.offset(EYES_PX * x, EYES_PX * y);
        Some(Frame { origin: self.origin, across: offset(across), down: offset(down), turn })
    }

    fn offset(&self, x: f32, y: f32) -> [f32; 2] {
        [x * self.step[0] - y * self.step[1], x * self.step[1] + y * self.step[0]]
    }

    /// The best fit nearby in size and roll.
    fn refined(self, pyramid: &Pyramid) -> Self {
        let mut best = self;
        for changes in CHANGES {
            let from = best;
            for (scale, roll_rad) in changes {
                let (sin, cos) = roll_rad.sin_cos();
                let moved = Self { step: from.offset(scale * cos, scale * sin), ..from };
                if let Some(found) = moved.best_near(pyramid).filter(|f| f.fit.odds > best.fit.odds)
                {
                    best = found;
                }
            }
        }
        best
    }

    /// The best fit within a cell each way.
    fn best_near(&self, pyramid: &Pyramid) -> Option<Self> {
        let (plane, done) = pyramid.at(length(self.step))?;
        let [ex, ey] = eyes_of(AROUND as f32, AROUND as f32);
        let mut crop = Plane::filled(CROP_PX, CROP_PX, 0.0);
        for (y, row) in crop.values_mut().chunks_exact_mut(CROP_PX).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let [dx, dy] = self.offset(x as f32 - ex, y as f32 - ey);
                let at = |origin: f32, d: f32| (origin + d + 0.5) / done - 0.5;
                *value =
                    plane.sample(at(self.origin[0], dx), at(self.origin[1], dy)).max(0.0).sqrt();
            }
        }
        let cells = Cells::new(&crop);
        let near = AROUND - 1..=AROUND + 1;
        let fits = near.clone().flat_map(|row| near.clone().map(move |column| (column, row)));
        let fits = fits.filter_map(|(column, row)| {
            best_fit(&cells, column, row).map(|best| (column, row, best))
        });
        let (column, row, fit) = fits.max_by(|a, b| a.2.odds.total_cmp(&b.2.odds))?;
        let [x, y] = eyes_of(column as f32, row as f32);
        let [dx, dy] = self.offset(x - ex, y - ey);
        Some(Self { origin: [self.origin[0] + dx, self.origin[1] + dy], fit, ..*self })
    }
}
