//! How much each score counts: learned on the development photographs by `benches/subject/find_weights.py`, as a logistic
//! function of the scores that need no colours, and one of its sum and of the scores that do.

use super::scores::{COLOUR_SCORES, GREY_SCORES, Scores};

/// In the order of [`grey_scores`](super::scores::grey_scores), and what is added.
const GREY: ([f32; GREY_SCORES], f32) = (
    [
        8.566, 2.875, -1.436, 3.612, 0.317, 4.134, 7.452, 9.490, 5.196, 1.051, 2.993, 6.451, 1.678,
        4.831, 3.504, 17.220, 1.858, -1.456, 1.541, 6.138, 2.996, 2.949, -7.870, 8.355, -4.395,
        4.175, -1.453, 2.283, -0.895, -1.754, -3.940, -2.294, 8.140, -1.280, 0.879, 8.085, 1.549,
        -2.288, 11.883, -1.666, 0.827,
    ],
    -20.007,
);
/// What the sum of the others counts beside colours; theirs, in the order of [`Hues::scores`](super::hue::Hues::scores);
/// and what is added.
const COLOUR: (f32, [f32; COLOUR_SCORES], f32) =
    (0.974, [3.316, 1.531, -0.004, 2.474, 5.384, 1.466], -8.504);

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
