//! Where the faces of a photograph are: two eyes and a mouth each.
//!
//! A face of sixteen strokes is drawn once. Over a pyramid of sizes it is correlated with the photograph's brightness
//! (less that of around, divided by the contrast of around) at seven rolls and turned aside; from the best places the
//! frame of the face ([`Frame`]: eyes, mouth and turn) climbs to where the drawing fits best. There a handful of scores is
//! taken: likeness to the drawing and to each of its strokes, symmetry, how dark the eyes are, how far the frame is from a
//! frontal one, and with colours how like skin, how even and how different from around it is, and how red the lips. A
//! logistic function weighs them. Without colours, or in coloured light, those that need no colours stand alone.
//!
//! The template of (Yang et al. 2004, eq. 4) is what this grew from; it is measured everywhere instead of on blocks of skin,
//! so that neither hair over a cheek nor a wall of skin's colour hides a face.

mod climb;
mod coarse;
mod eyes;
mod frame;
mod hue;
mod level;
mod schema;
mod scores;
mod search;
#[cfg(test)]
mod tests;
mod weights;

pub use frame::Frame;
pub use scores::{COLOUR_SCORES, ColourScores, GREY_SCORES, GreyScores, Scores};
pub use search::{Hypothesis, IO_MIN_PX, SCORE_MIN, faces, hypotheses};

use super::{Photo, Plane};

/// A face: eyes, mouth and how sure they are. Coordinates are the photograph's, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The middles of the irises: first the one at the picture's left, which is the subject's right eye.
    pub eyes: [[f64; 2]; 2],
    /// The middle of the mouth.
    pub mouth: [f64; 2],
    /// The angle of the line through the eyes from the x axis, clockwise in the picture.
    pub roll_rad: f64,
    /// The distance of the outer eye corners, estimated from the irises'.
    pub io_px: f64,
    /// 0 to 1: the share of what looks so that is a face, on what the scores were weighed with.
    pub score: f64,
}
