//! The handful of scores that a hypothesis is weighed by.

use super::Plane;
use super::climb::Patch;
use super::eyes::Spot;
use super::frame::Frame;
use super::schema::{ACROSS, STROKES, Schema, likeness};

/// How many scores need no colours.
pub const GREY_SCORES: usize = 10 + 2 * STROKES;

/// Scores of one hypothesis that need no colours: how well the zones' template fits, likeness to the whole drawn face (brightness, slope), symmetry (the
/// same), how dark the eyes are (the lighter one, both), how little the frame is stretched, sheared and turned, and likeness
/// to each stroke of the drawing (brightness, then slope).
pub type GreyScores = [f32; GREY_SCORES];

/// How many scores need colours.
pub const COLOUR_SCORES: usize = 6;

/// Scores of one hypothesis that need colours: how like skin forehead, cheeks, nose and chin are, how even, how much
/// redder the mouth is and how much less red the eyes are, how different it is around the face, and how like skin the mean
/// is.
pub type ColourScores = [f32; COLOUR_SCORES];

/// All of one hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scores {
    /// Those that need no colours.
    pub grey: GreyScores,
    /// The others, where there are colours.
    pub colour: Option<ColourScores>,
}

/// Of a frame on a level.
pub(super) fn grey_scores(
    local: &Plane,
    frame: &Frame,
    eyes: &[Spot; 2],
    fit: f32,
    schema: &Schema,
) -> GreyScores {
    let Patch { bright, slope: steep } = Patch::new(local, frame);
    let [stretch, shear] = frame.stretch_and_shear();
    let darker = eyes.iter().map(|spot| spot.darker);
    let mut scores = [0.0; GREY_SCORES];
    let whole = [
        fit,
        likeness(&bright, &schema.bright),
        likeness(&steep, &schema.slope),
        likeness(&bright, &mirrored(&bright)),
        likeness(&steep, &mirrored(&steep)),
        darker.clone().fold(f32::INFINITY, f32::min),
        darker.sum::<f32>() / 2.0,
        -stretch.ln().powi(2),
        -shear * shear,
        -frame.turn * frame.turn,
    ];
    let brights = schema.strokes.iter().map(|stroke| likeness(&bright, &stroke.bright));
    let steeps = schema.strokes.iter().map(|stroke| likeness(&steep, &stroke.slope));
    for (score, value) in scores.iter_mut().zip(whole.into_iter().chain(brights).chain(steeps)) {
        *score = value;
    }
    scores
}

fn mirrored(patch: &[f32]) -> Vec<f32> {
    patch.chunks(ACROSS).flat_map(|row| row.iter().rev().copied()).collect()
}
