//! How much each score counts: learned on the development photographs by `benches/subject/find_weights.py`, as a logistic
//! function of the scores that need no colours, and one of its sum and of the scores that do.

use super::scores::{COLOUR_SCORES, GREY_SCORES, Scores};

/// In the order of [`grey_scores`](super::scores::grey_scores), and what is added.
const GREY: ([f32; GREY_SCORES], f32) = (
    [
        8.880, 2.804, -1.303, 3.426, 0.757, 3.610, 6.406, 9.333, 5.798, 1.213, 3.191, 6.141, 1.713,
        4.787, 3.080, 16.296, 1.657, -1.158, 2.080, 5.714, 2.632, 1.978, -8.576, 8.541, -4.328,
        4.150, -1.774, 1.825, -0.888, -1.572, -3.716, -2.020, 7.921, -1.343, 0.526, 7.635, 0.719,
        -1.397, 11.568, -1.433, 0.408,
    ],
    -19.810,
);
/// What the sum of the others counts beside colours; theirs, in the order of [`Hues::scores`](super::hue::Hues::scores);
/// and what is added.
const COLOUR: (f32, [f32; COLOUR_SCORES], f32) =
    (1.018, [3.387, 1.524, -1.093, 1.894, 5.187, 1.285], -8.259);

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
