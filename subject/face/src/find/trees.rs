//! How sure a look is: trees of three questions, boosted (Friedman, Hastie and Tibshirani 2000).

use super::look::{Look, mirrored};
use crate::table::{i16s, i32s, u8s, u16s};

/// Trees of three questions each. Learned by `benches/subject`: those of a first look by `find_looks.py`, those of a second
/// one by `find_again.py`.
struct Trees<const N: usize> {
    /// In thousandths: what is added to the trees.
    bias: i32,
    trees: [Tree; N],
}

#[derive(Clone, Copy)]
struct Tree {
    /// Which byte of a look is asked: the first question; the second ones after no and yes; four third ones.
    asked: [u16; 7],
    /// The largest byte that is a no.
    limits: [u8; 7],
    /// What each of the eight ways through adds, in thousandths.
    leaves: [i16; 8],
}

const FIRST_TABLE: &[u8] = include_bytes!("../../data/face-first-trees.bin");
const SECOND_TABLE: &[u8] = include_bytes!("../../data/face-second-trees.bin");
static FIRST: Trees<{ Tree::count(FIRST_TABLE) }> = Trees::read(FIRST_TABLE);
static SECOND: Trees<{ Tree::count(SECOND_TABLE) }> = Trees::read(SECOND_TABLE);

/// 0 to 1: the share of what looks so that is a face. A face's mirror image is one, too: both are asked about.
pub(super) fn score(look: &Look) -> f64 {
    share(FIRST.bias + (FIRST.sum(look) + FIRST.sum(&mirrored(look))) / 2)
}

/// The same of a second look, which is asked about as it is: its trees learned from mirror images as well.
pub(super) fn second_score(look: &[u8]) -> f64 {
    share(SECOND.bias + SECOND.sum(look))
}

/// Of thousandths of the logarithm of the odds.
fn share(sum: i32) -> f64 {
    1.0 / (1.0 + (-f64::from(sum) / 1000.0).exp())
}

impl<const N: usize> Trees<N> {
    /// The bias (32 bits), then each tree: bytes asked (16 bits), limits (8), leaves (16).
    const fn read(table: &[u8]) -> Self {
        let [bias] = i32s(table, 0);
        let mut trees = [Tree { asked: [0; 7], limits: [0; 7], leaves: [0; 8] }; N];
        let mut i = 0;
        while i < N {
            let at = size_of::<i32>() + i * Tree::BYTES;
            trees[i] = Tree {
                asked: u16s(table, at),
                limits: u8s(table, at + 14),
                leaves: i16s(table, at + 21),
            };
            i += 1;
        }
        Self { bias, trees }
    }

    fn sum(&self, look: &[u8]) -> i32 {
        self.trees.iter().map(|tree| tree.leaf(look)).sum()
    }
}

impl Tree {
    const BYTES: usize = 7 * 2 + 7 + 8 * 2;

    const fn count(table: &[u8]) -> usize {
        assert!((table.len() - size_of::<i32>()).is_multiple_of(Self::BYTES));
        (table.len() - size_of::<i32>()) / Self::BYTES
    }

    /// What it adds, in thousandths.
    fn leaf(&self, look: &[u8]) -> i32 {
        let mut node = 0;
        for _ in 0..3 {
            let (Some(&ask), Some(&limit)) = (self.asked.get(node), self.limits.get(node)) else {
                return 0;
            };
            let yes = look.get(usize::from(ask)).is_some_and(|&byte| byte > limit);
            node = 2 * node + 1 + usize::from(yes);
        }
        self.leaves.get(node - self.asked.len()).copied().map_or(0, i32::from)
    }
}
