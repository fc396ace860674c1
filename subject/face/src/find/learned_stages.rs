//! The learned stages after the template, and the feature vectors of an upright face on which they work: of the
//! template's frame in the first stage, and of the landmark regressor's frame with patches around its landmarks in the
//! second. A frame is the coordinate system of a face, given by two eyes and a mouth.
//!
//! A cascade of linear regressions aligns eyes and mouth, each learned on the residuals of the one before (Xiong and De
//! la Torre 2013); boosted decision trees of depth 3 score feature vectors (Friedman, Hastie and Tibshirani 2000).

use super::DetectedFace;
use crate::{
    oriented_gradients::{DIRECTIONS, FLOOR, Histograms, MIDDLE, byte},
    photo::Photo,
    plane::{Plane, Pyramid},
    points::{
        RoughFace,
        regressor::{LandmarkPoints, LandmarkRegressor, PATCH_FEATURES, mean},
    },
    table::{f32s, i16s, i32s, u8s, u16s},
};

/// Cells per side, each a quarter of the eye distance wide: two and a half distances in all.
const SIDE: usize = 10;
/// Samples per side of a cell.
const CELL: usize = 4;
/// Cells beyond the border, for the local contrast.
const AROUND: usize = 1;
const SAMPLES: usize = (SIDE + 2 * AROUND) * CELL;
/// Left and top of the cells, in eye distances from the midpoint of the eyes.
const LEFT: f32 = -1.25;
const TOP: f32 = -0.75;
/// Distance between samples, in eye distances.
const STEP: f32 = 1.0 / 16.0;
/// Features of a cell: gradients, brightness, contrast.
const FEATURES_PER_CELL: usize = DIRECTIONS + 2;
/// Length of a first-stage feature vector.
pub const FEATURE_COUNT: usize = SIDE * SIDE * FEATURES_PER_CELL;
/// Quantisation: bytes per factor of two in contrast.
const CONTRAST_BYTES: f32 = 40.0;

/// Length of a second-stage feature vector: the cells of the landmarks' frame, the patches around the landmarks, and
/// the first-stage score.
pub const SECOND_STAGE_COUNT: usize = FEATURE_COUNT + PATCH_FEATURES + 1;
/// iBUG-68 number of the nasion, which lies where the middle of the face crosses the line of the eyes.
const NASION: usize = 27;
/// Turn of the frame per offset of the nasion, in eye distances: fitted to 600 random heads of known turn. The nasion
/// lies in front of the cylinder that a [`Frame`] assumes, so this is less than the cylinder's 4.
const TURN_BY_ASIDE: f32 = -2.4;
/// Largest turn, 54 degrees; beyond it one eye is hidden.
const TURN_MAX: f32 = 0.6;

/// [`FEATURE_COUNT`] bytes, followed in the second stage by the patches and the score. Cells in row order, each with
/// eight gradients clockwise from the right, brightness, contrast.
pub type FeatureVector = Vec<u8>;

/// Extracts the first-stage features of a frame on the photograph.
pub(super) fn first_stage_features(pyramid: &Pyramid, frame: &Frame) -> FeatureVector {
    let Some((plane, done)) = pyramid.at(length(frame.down) * STEP) else { return Vec::new() };
    let by = 1.0 / done;
    let mut roots = Plane::filled(SAMPLES, SAMPLES, 0.0);
    for (y, row) in roots.values_mut().chunks_exact_mut(SAMPLES).enumerate() {
        for (x, value) in row.iter_mut().enumerate() {
            let at = |i: usize, from: f32| from + STEP * (i as f32 + 0.5 - (AROUND * CELL) as f32);
            let [px, py] = frame.at(at(x, LEFT), at(y, TOP));
            *value = plane.sample((px + 0.5) * by - 0.5, (py + 0.5) * by - 0.5).max(0.0).sqrt();
        }
    }
    let cells = Histograms::pooled(&roots, CELL);
    let energy = cells.inner(AROUND).map(|(_, _, cell)| cell.energy).sum::<f32>();
    let whole = (energy / (SIDE * SIDE) as f32).sqrt();
    cells.bytes(AROUND, |cell, bytes| {
        let own = cell.energy.sqrt() + FLOOR;
        bytes.push(byte(MIDDLE + CONTRAST_BYTES * (own / (whole + FLOOR)).log2()));
    })
}

/// The feature vector of the mirror image.
pub(super) fn mirrored(features: &FeatureVector) -> FeatureVector {
    let swapped = |cell: &[u8]| -> [u8; FEATURES_PER_CELL] {
        let mut out = [0; FEATURES_PER_CELL];
        for (to, from) in out.iter_mut().zip([4, 3, 2, 1, 0, 7, 6, 5, 8, 9]) {
            *to = cell.get(from).copied().unwrap_or_default();
        }
        out
    };
    let rows = features.chunks(SIDE * FEATURES_PER_CELL);
    rows.flat_map(|row| row.chunks(FEATURES_PER_CELL).rev().flat_map(swapped)).collect()
}

/// The landmark regressor's frame and its second-stage features; none if the frame is degenerate.
pub(super) fn second_stage_features(
    pyramid: &Pyramid,
    photo: &Photo,
    found: &DetectedFace,
) -> Option<(Frame, FeatureVector)> {
    let regressor = LandmarkRegressor::new(photo, &RoughFace::from(found));
    let landmarks = regressor.predict();
    let frame = frame(&regressor, &landmarks);
    let mut bytes = first_stage_features(pyramid, &frame);
    bytes.extend(regressor.patch_features(&landmarks));
    bytes.push((255.0 * found.score).round().clamp(0.0, 255.0) as u8);
    (bytes.len() == SECOND_STAGE_COUNT).then_some((frame, bytes))
}

fn frame(regressor: &LandmarkRegressor, landmarks: &LandmarkPoints) -> Frame {
    let at = |range| regressor.to_photo(mean(landmarks, range)).map(|v| v as f32);
    let (left, right, mouth) = (at(36..42), at(42..48), at(48..60));
    let nasion = at(NASION..NASION + 1);
    let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
    let across = [right[0] - left[0], right[1] - left[1]];
    let wide = across[0] * across[0] + across[1] * across[1];
    let aside = (nasion[0] - origin[0]) * across[0] + (nasion[1] - origin[1]) * across[1];
    let turn = TURN_BY_ASIDE * aside / wide.max(f32::MIN_POSITIVE);
    Frame::through([left, right], mouth, turn.clamp(-TURN_MAX, TURN_MAX))
}

/// Maps a face's own coordinates to a picture's: the eyes are at (-1/2, 0) and (1/2, 0), the mouth at (0,
/// [`Frame::MOUTH`]).
///
/// The map is affine except for the turn of the head. A face is modelled as a cylinder of radius R; rotated by an angle
/// a, a point at x appears at x cos a + sqrt(R^2 - x^2) sin a. To second order, and with the eyes kept in place, that
/// is x + turn (x^2 - 1/4): one half is wider, and the nose is nearer to the other eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Midpoint of the eyes.
    pub origin: [f32; 2],
    /// Vector from the left to the right eye.
    pub across: [f32; 2],
    /// Vector of one unit towards the mouth.
    pub down: [f32; 2],
    /// About tan a / 2.3; positive where the nose points to the picture's left.
    pub turn: f32,
}

impl Frame {
    /// Distance of the mouth from the eyes, in eye distances: 70 mm to 63 mm on an adult.
    pub const MOUTH: f32 = 1.1;

    /// The frame through two eyes, the one at the picture's left first, and a mouth.
    pub(super) fn through([left, right]: [[f32; 2]; 2], mouth: [f32; 2], turn: f32) -> Self {
        let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
        let across = [right[0] - left[0], right[1] - left[1]];
        // In a turned face the middle of the mouth is not below the midpoint of the eyes.
        let down = [0, 1].map(|i| (mouth[i] - origin[i] + turn / 4.0 * across[i]) / Self::MOUTH);
        Self { origin, across, down, turn }
    }

    /// Maps a point of the face to the picture.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let x = x + self.turn * (x * x - 0.25);
        [0, 1].map(|i| self.origin[i] + x * self.across[i] + y * self.down[i])
    }

    /// The eyes: first the one at the picture's left.
    #[must_use]
    pub fn eyes(&self) -> [[f32; 2]; 2] {
        [self.at(-0.5, 0.0), self.at(0.5, 0.0)]
    }
}

/// Length of a vector. Squares cannot overflow on a photograph, and this is much faster than `hypot`.
pub(super) fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

/// An ensemble of trees of depth 3. `find_looks.py` and `find_again.py` in `benches/subject` learn the first and the
/// second stage.
struct BoostedTrees<const N: usize> {
    /// Bias, in thousandths.
    bias: i32,
    trees: [Tree; N],
}

#[derive(Clone, Copy)]
struct Tree {
    /// Feature index of each split: the root, its children for below and above, and their four children.
    features: [u16; 7],
    /// Threshold of each split: the largest byte that counts as below.
    thresholds: [u8; 7],
    /// Value of each of the eight leaves, in thousandths.
    leaves: [i16; 8],
}

const FIRST_TABLE: &[u8] = include_bytes!("../../data/face-first-trees.bin");
const SECOND_TABLE: &[u8] = include_bytes!("../../data/face-second-trees.bin");
static FIRST_STAGE: BoostedTrees<{ Tree::count(FIRST_TABLE) }> = BoostedTrees::read(FIRST_TABLE);
static SECOND_STAGE: BoostedTrees<{ Tree::count(SECOND_TABLE) }> = BoostedTrees::read(SECOND_TABLE);

/// First-stage score, 0 to 1: the fraction of such feature vectors that are faces. The mean over the face and its
/// mirror image, which is a face too.
pub(super) fn first_stage_score(features: &FeatureVector) -> f64 {
    let sum = FIRST_STAGE.sum(features) + FIRST_STAGE.sum(&mirrored(features));
    logistic(FIRST_STAGE.bias + sum / 2)
}

/// Second-stage score, without the mirror image: these trees were trained on both.
pub(super) fn second_stage_score(features: &[u8]) -> f64 {
    logistic(SECOND_STAGE.bias + SECOND_STAGE.sum(features))
}

/// The logistic function of log odds in thousandths.
fn logistic(sum: i32) -> f64 {
    1.0 / (1.0 + (-f64::from(sum) / 1000.0).exp())
}

impl<const N: usize> BoostedTrees<N> {
    /// Layout: the bias (32 bits), then for each tree features (16 bits each), thresholds (8), leaves (16).
    const fn read(table: &[u8]) -> Self {
        let [bias] = i32s(table, 0);
        let mut trees = [Tree { features: [0; 7], thresholds: [0; 7], leaves: [0; 8] }; N];
        let mut i = 0;
        while i < N {
            let at = size_of::<i32>() + i * Tree::BYTES;
            trees[i] = Tree {
                features: u16s(table, at),
                thresholds: u8s(table, at + 14),
                leaves: i16s(table, at + 21),
            };
            i += 1;
        }
        Self { bias, trees }
    }

    fn sum(&self, features: &[u8]) -> i32 {
        self.trees.iter().map(|tree| tree.leaf(features)).sum()
    }
}

impl Tree {
    const BYTES: usize = 7 * 2 + 7 + 8 * 2;

    const fn count(table: &[u8]) -> usize {
        assert!((table.len() - size_of::<i32>()).is_multiple_of(Self::BYTES));
        (table.len() - size_of::<i32>()) / Self::BYTES
    }

    /// Value of the leaf for a feature vector, in thousandths.
    fn leaf(&self, features: &[u8]) -> i32 {
        let mut node = 0;
        for _ in 0..3 {
            let split = self.features.get(node).zip(self.thresholds.get(node));
            let Some((&feature, &threshold)) = split else { return 0 };
            let above = features.get(usize::from(feature)).is_some_and(|&byte| byte > threshold);
            node = 2 * node + 1 + usize::from(above);
        }
        self.leaves.get(node - self.features.len()).copied().map_or(0, i32::from)
    }
}

/// One stage: regression of x and y of left eye, right eye and mouth, as fractions of the frame's eye distance.
pub(super) struct AlignmentStep {
    /// Intercepts.
    intercept: [f32; 6],
    /// Weights of each feature byte for the same six numbers, in units of [`WEIGHT_UNIT`].
    weights: [[i16; 6]; FEATURE_COUNT],
}

/// The first stage uses the template's frame, the second the first one's result: ridge regressions, learned by
/// `benches/subject/find_align.py`.
pub(super) static STEPS: [AlignmentStep; 2] = [
    AlignmentStep::read(include_bytes!("../../data/face-align-first.bin")),
    AlignmentStep::read(include_bytes!("../../data/face-align-second.bin")),
];

/// Unit of the weights: fractions of the eye distance per byte.
const WEIGHT_UNIT: f32 = 1e-6;
/// Largest displacement, in eye distances: a candidate that is farther off is not a face.
const FAR: f32 = 0.6;

impl AlignmentStep {
    const fn read(table: &[u8; 6 * (size_of::<f32>() + FEATURE_COUNT * size_of::<i16>())]) -> Self {
        let mut weights = [[0; 6]; FEATURE_COUNT];
        let mut i = 0;
        while i < FEATURE_COUNT {
            weights[i] = i16s(table, 6 * (size_of::<f32>() + i * size_of::<i16>()));
            i += 1;
        }
        Self { intercept: f32s(table, 0), weights }
    }

    /// The frame with aligned eyes and mouth; its turn is kept.
    pub(super) fn aligned(&self, frame: &Frame, features: &FeatureVector) -> Frame {
        let own = self.offsets(features);
        let [ax, ay, bx, by, mx, my] = self.offsets(&mirrored(features));
        // In the mirror image the eyes change sides.
        let other = [-bx, by, -ax, ay, -mx, my];
        let [ax, ay, bx, by, mx, my] =
            std::array::from_fn(|i| ((own[i] + other[i]) / 2.0).clamp(-FAR, FAR));
        // In a turned face the middle of the mouth is not below the midpoint of the eyes.
        let aside = frame.turn / (4.0 * Frame::MOUTH);
        let at = |x: f32, y: f32| {
            let x = x - aside * y;
            [0, 1].map(|i| frame.origin[i] + x * frame.across[i] + y * frame.down[i])
        };
        let eyes = [at(ax - 0.5, ay), at(bx + 0.5, by)];
        Frame::through(eyes, at(mx, my + Frame::MOUTH), frame.turn)
    }

    /// Offsets of eyes and mouth from the frame's, in its own coordinates.
    fn offsets(&self, features: &FeatureVector) -> [f32; 6] {
        let mut sums = [0_i32; 6];
        for (&byte, weights) in features.iter().zip(&self.weights) {
            for (sum, &weight) in sums.iter_mut().zip(weights) {
                *sum += i32::from(byte) * i32::from(weight);
            }
        }
        let mut out = self.intercept;
        for (out, sum) in out.iter_mut().zip(sums) {
            *out += WEIGHT_UNIT * sum as f32;
        }
        out
    }
}
