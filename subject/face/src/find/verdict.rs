//! How sure a look is: trees of three questions, boosted (Friedman, Hastie and Tibshirani 2000).

use super::look::{Look, mirrored};
use super::{look_trees, second_trees};

/// A tree: which byte of a look is asked (the first question; the second ones after no and yes; four third ones), the
/// largest byte that is a no, and what each of the eight ways through adds, in thousandths.
pub(super) type Tree = ([u16; 7], [u8; 7], [i16; 8]);

/// 0 to 1: the share of what looks so that is a face. A face's mirror image is one, too: both are asked about.
pub(super) fn score(look: &Look) -> f64 {
    let both = sum(&look_trees::TREES, look) + sum(&look_trees::TREES, &mirrored(look));
    share(look_trees::BIAS + both / 2)
}

/// The same of a second look, which is asked about as it is: its trees learned from mirror images as well.
pub(super) fn second_score(look: &[u8]) -> f64 {
    share(second_trees::BIAS + sum(&second_trees::TREES, look))
}

/// Of thousandths of the logarithm of the odds.
fn share(sum: i32) -> f64 {
    1.0 / (1.0 + (-f64::from(sum) / 1000.0).exp())
}

fn sum(trees: &[Tree], look: &[u8]) -> i32 {
    trees.iter().map(|tree| told(tree, look)).sum()
}

/// What one tree adds, in thousandths.
fn told((asked, limits, leaves): &Tree, look: &[u8]) -> i32 {
    let mut node = 0;
    for _ in 0..3 {
        let (Some(&ask), Some(&limit)) = (asked.get(node), limits.get(node)) else { return 0 };
        let yes = look.get(usize::from(ask)).is_some_and(|&byte| byte > limit);
        node = 2 * node + 1 + usize::from(yes);
    }
    leaves.get(node - asked.len()).copied().map_or(0, i32::from)
}
