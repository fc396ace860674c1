//! Boosted decision trees of depth 3 that score feature vectors (Friedman, Hastie and Tibshirani 2000).

use super::features::{FeatureVector, mirrored};
use crate::table::{i16s, i32s, u8s, u16s};

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
