//! How much each score counts: learned on the development photographs by `benches/subject/find_weights.py`, as a logistic
//! function of the scores that need no colours, and one of its sum and of the scores that do.

use super::scores::{COLOUR_SCORES, GREY_SCORES, Scores};

/// In the order of [`grey_scores`](super::scores::grey_scores), and what is added.
const GREY: ([f32; GREY_SCORES], f32) = (
    [
        0.923, 11.508, 1.506, -3.259, 2.178, 2.392, -2.21, 1.617, 7.556, -1.566, 0.638, 3.836,
        2.849, 1.551, 5.228, 4.183, 17.73, 3.139, 1.319, -3.238, 2.778, 2.049, 1.045, 5.615, 5.109,
        -3.255, 0.474, -1.94, -1.274, -1.201, -5.67, -4.071, -0.288, 5.511, 0.279, 1.896, 8.549,
        4.343, -4.817, -9.324, -0.936, 1.69,
    ],
    -13.253,
);
/// What the sum of the others counts beside colours; theirs, in the order of [`Hues::scores`](super::hue::Hues::scores);
/// and what is added.
const COLOUR: (f32, [f32; COLOUR_SCORES], f32) =
    (1.103, [5.599, 0.946, 5.664, 5.723, 2.624, 1.485], -7.888);

/// 0 to 1.
pub(super) fn score(scores: &Scores) -> f64 {
    let sum = |weights: &[f32], scores: &[f32]| {
        weights.iter().zip(scores).map(|(weight, score)| weight * score).sum::<f32>()
    };
    let mut logit = sum(&GREY.0, &scores.grey) + GREY.1;
    if let Some(colour) = &scores.colour {
        logit = COLOUR.0 * logit + sum(&COLOUR.1, colour) + COLOUR.2;
    }
    1.0 / (1.0 + f64::from(-logit).exp())
}
