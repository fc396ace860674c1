//! How sure a look is: trees of three questions, boosted (Friedman, Hastie and Tibshirani 2000).

use super::look::{Look, mirrored};
use super::look_trees::{BIAS, TREES, Tree};

/// 0 to 1: the share of what looks so that is a face. A face's mirror image is one, too: both are asked about.
pub(super) fn score(look: &Look) -> f64 {
    let other = mirrored(look);
    let both: i32 = TREES.iter().map(|tree| told(tree, look) + told(tree, &other)).sum();
    let sum = f64::from(2 * BIAS + both) / 2000.0;
    1.0 / (1.0 + (-sum).exp())
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
