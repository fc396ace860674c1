//! How much each score counts: learned on the development photographs by `benches/subject/find_weights.py`, as a logistic
//! function of the scores that need no colours, and one of its sum and of the scores that do.

use super::scores::{COLOUR_SCORES, GREY_SCORES, Scores};

/// In the order of [`grey_scores`](super::scores::grey_scores), and what is added.
const GREY: ([f32; GREY_SCORES], f32) = (
    [
        8.817, 3.044, -1.365, 3.484, 0.042, 3.000, 11.764, 13.986, 4.088, 2.266, 3.322, 5.164,
        1.060, 6.502, 1.835, 13.967, 1.345, -1.093, 3.489, 4.730, 3.112, 1.327, -8.667, 6.082,
        -5.648, 5.031, -4.369, -0.189, -1.016, -2.696, -4.046, -0.323, 6.705, -1.239, -0.896,
        7.453, 1.334, -1.676, 11.483, 0.485, 1.364,
    ],
    -17.974,
);
/// What the sum of the others counts beside colours; theirs, in the order of [`Hues::scores`](super::hue::Hues::scores);
/// and what is added.
const COLOUR: (f32, [f32; COLOUR_SCORES], f32) =
    (0.727, [4.082, 1.210, 0.773, 2.301, 3.202, -0.396], -6.794);

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
