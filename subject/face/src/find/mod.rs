//! Where the faces of a photograph are: two eyes and a mouth each.
//!
//! Slopes of brightness, told in the contrast of around, are pooled over small cells (Dalal and Triggs 2005), and a template
//! of what each cell of a face speaks for it is held against every place, at every size, five rolls, frontal and turned to
//! both sides. The best places are refined between the steps of that search, and give the frame of a face ([`Frame`]: eyes,
//! mouth and turn). How it looks in that frame ([`Look`]) tells where eyes and mouth are, by two linear regressions, one
//! after the other (Xiong and De la Torre 2013); how it looks with those tells whether it may be a face: a few hundred boosted
//! trees of three questions each, about slopes, brightness and contrast of its cells, as in aggregated channel features
//! (Dollar et al. 2014). What may be one is looked at again, where a glance (`points::glance`) has its landmarks: other
//! trees ask how it looks there and around each of them. No colours are asked about: grey photographs are as good as others.
//!
//! The template of (Yang et al. 2004, eq. 4) is what this grew from; it is measured everywhere instead of on blocks of skin,
//! so that neither hair over a cheek nor a wall of skin's colour hides a face.

mod align;
mod align_first;
mod align_second;
mod cells;
mod frame;
mod look;
mod look_trees;
mod octaves;
mod place;
mod rough;
mod scan;
mod search;
mod second;
mod second_trees;
mod template;
mod template_weights;
#[cfg(test)]
mod tests;
mod verdict;

pub use frame::Frame;
pub use look::{LOOK, Look};
pub use search::{
    Hypothesis, IO_MIN_PX, SCORE_MIN, faces, hypotheses, hypotheses_after, hypotheses_again,
};
pub use second::SECOND;

use super::{Photo, Plane};

/// A face: eyes, mouth and how sure they are. Coordinates are the photograph's, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The middles of the eyes: first the one at the picture's left, which is the subject's right eye.
    pub eyes: [[f64; 2]; 2],
    /// The middle of the mouth.
    pub mouth: [f64; 2],
    /// The angle of the line through the eyes from the x axis, clockwise in the picture.
    pub roll_rad: f64,
    /// The distance of the outer eye corners, estimated from the eyes'.
    pub io_px: f64,
    /// 0 to 1: the share of what looks so that is a face, on what the trees learned from, where faces counted two of five.
    pub score: f64,
}
