//! The learned stages after the template. A cascade of linear regressions aligns eyes and mouth, each learned on the
//! residuals of the one before (Xiong and De la Torre 2013); boosted decision trees of depth 3 score feature vectors
//! (Friedman, Hastie and Tibshirani 2000).

use super::features::{FEATURE_COUNT, FeatureVector, Frame, mirrored};
use crate::table::{f32s, i16s, i32s, u8s, u16s};

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
pub(super) fn score(features: &FeatureVector) -> f64 {
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
