//! The template that a block is held against (Yang et al. 2004, eq. 4, after Seo et al. 2002).

use super::Turned;
use crate::plane::Plane;

/// Points across and down: the paper's M x N.
const ACROSS: usize = 24;
const DOWN: usize = 30;
/// What edges and brightness count: the paper's alpha and beta. Lips are darker than skin, so beta is negative.
const ALPHA: f32 = 1.0;
const BETA: f32 = -1.0;

/// A zone of the template: left, top, right, bottom, in shares of the face's rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Zone(pub(super) f32, pub(super) f32, pub(super) f32, pub(super) f32);

/// Where eye and brow, nose and mouth are looked for: first the ones at the picture's left.
pub(super) const EYE_LEFT: Zone = Zone(0.10, 0.18, 0.47, 0.48);
pub(super) const EYE_RIGHT: Zone = Zone(0.53, 0.18, 0.90, 0.48);
pub(super) const NOSE: Zone = Zone(0.30, 0.40, 0.70, 0.70);
pub(super) const MOUTH: Zone = Zone(0.22, 0.66, 0.78, 0.90);

/// Black: brows, eyes, the nose's base and the mouth's outline have edges. Our drawing, for the paper's is a small figure.
const BLACK: [Zone; 7] = [
    Zone(0.15, 0.22, 0.43, 0.29),
    Zone(0.57, 0.22, 0.85, 0.29),
    Zone(0.17, 0.33, 0.41, 0.42),
    Zone(0.59, 0.33, 0.83, 0.42),
    Zone(0.37, 0.58, 0.63, 0.65),
    Zone(0.29, 0.71, 0.71, 0.76),
    Zone(0.31, 0.81, 0.69, 0.85),
];
/// Grey: the lips.
const GREY: Zone = Zone(0.31, 0.74, 0.69, 0.82);

/// E = alpha sum of edges in the black zones + beta sum of brightness in the grey one (eq. 4). Both are means, in shares
/// of the mean over the whole rectangle, so that neither the size nor the light of a photograph changes E.
pub(super) fn energy(grey: &Plane, edges: &Plane, face: &Turned) -> f32 {
    let (mut all_edges, mut all_grey, mut black, mut lips) = (0.0, 0.0, (0.0, 0.0), (0.0, 0.0));
    for i in 0..ACROSS * DOWN {
        let x = ((i % ACROSS) as f32 + 0.5) / ACROSS as f32;
        let y = ((i / ACROSS) as f32 + 0.5) / DOWN as f32;
        let [px, py] = face.at(x, y);
        let (edge, bright) = (edges.sample(px, py), grey.sample(px, py));
        all_edges += edge;
        all_grey += bright;
        if BLACK.iter().any(|zone| zone.holds(x, y)) {
            black = (black.0 + edge, black.1 + 1.0);
        }
        if GREY.holds(x, y) {
            lips = (lips.0 + bright, lips.1 + 1.0);
        }
    }
    let count = (ACROSS * DOWN) as f32;
    let share = |(sum, n): (f32, f32), all: f32| sum / n.max(1.0) / (all / count).max(1e-3);
    ALPHA * share(black, all_edges) + BETA * share(lips, all_grey)
}

impl Zone {
    fn holds(&self, x: f32, y: f32) -> bool {
        let Self(left, top, right, bottom) = *self;
        (left..right).contains(&x) && (top..bottom).contains(&y)
    }
}
