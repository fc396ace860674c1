//! A face as one draws it: what the frame of a hypothesis is held against.

/// Points of a patch across: from -1 to 1 eye distances, an eighth apart.
pub(super) const ACROSS: usize = 17;
/// Points of a patch down: from -0.5 (above the brows) to 1.5 (under the lip).
pub(super) const DOWN: usize = 17;
/// Between points, in eye distances.
pub(super) const GRID: f32 = 0.125;

/// The place of a patch's point in the face's frame.
pub(super) fn place(i: usize) -> [f32; 2] {
    [(i % ACROSS) as f32 * GRID - 1.0, (i / ACROSS) as f32 * GRID - 0.5]
}

use super::climb::{Drawing, HALF, WHOLE};

/// Strokes of the drawing.
pub(super) const STROKES: usize = 16;

/// An ellipse with soft borders: x (both sides, unless 0), y, half axes, turn of the right one, and how much brighter it
/// is than the skin around, in shares of the mouth's line.
struct Stroke(f32, f32, f32, f32, f32, f32);

/// What is darker and brighter than what is around it, in eye distances. Where things are is anthropometry (eyes 63 mm
/// apart, mouth 50 mm wide and 70 mm below the eyes, the nose's base at 45 mm, brows at 17 mm); how dark they are was
/// fitted to the faces that the template was learned on (`benches/subject/find_strokes.py`).
const FACE: [Stroke; STROKES] = [
    // Sockets, eyes, brows, forehead.
    Stroke(0.46, -0.04, 0.36, 0.24, 0.0, -0.657),
    Stroke(0.50, 0.00, 0.20, 0.10, 0.0, -0.562),
    Stroke(0.50, -0.27, 0.36, 0.09, 0.10, -0.155),
    Stroke(0.0, -0.50, 0.60, 0.12, 0.0, 0.748),
    // The bridge and the ridge of the nose, its sides, its base.
    Stroke(0.0, 0.05, 0.10, 0.25, 0.0, 0.588),
    Stroke(0.0, 0.45, 0.10, 0.22, 0.0, 0.430),
    Stroke(0.27, 0.58, 0.08, 0.12, 0.0, -0.339),
    Stroke(0.0, 0.72, 0.26, 0.07, 0.0, -0.327),
    // Cheeks, and the folds from the nose to the mouth.
    Stroke(0.58, 0.45, 0.28, 0.22, 0.0, 0.793),
    Stroke(0.45, 0.86, 0.08, 0.16, -0.4, 0.057),
    // The line of the mouth, the shade under it, the chin.
    Stroke(0.0, 1.08, 0.38, 0.07, 0.0, -1.000),
    Stroke(0.0, 1.32, 0.24, 0.08, 0.0, -0.067),
    Stroke(0.0, 1.52, 0.30, 0.14, 0.0, 0.463),
    // What is beside the face: ears, the jaw's edge, temples.
    Stroke(1.10, 0.30, 0.18, 0.60, 0.0, -0.362),
    Stroke(0.95, 1.45, 0.28, 0.40, 0.5, -0.657),
    Stroke(0.90, -0.15, 0.12, 0.20, 0.0, -0.255),
];

/// The drawn face in the measure of [`Level::local`](super::level::Level), all of it, and half of it.
#[derive(Debug)]
pub(super) struct Schema {
    /// For the last passes of a climb.
    pub(super) whole: Drawing<WHOLE>,
    /// For the first ones.
    pub(super) half: Drawing<HALF>,
}

impl Schema {
    /// Drawn once a photograph.
    pub(super) fn new() -> Self {
        let at = |[x, y]: [f32; 2]| FACE.iter().map(|stroke| stroke.brighter(x, y)).sum();
        let bright: Vec<f32> = (0..ACROSS * DOWN).map(|i| at(place(i))).collect();
        let slope = slope(&bright);
        Self { whole: Drawing::new(&bright, &slope, 1), half: Drawing::new(&bright, &slope, 2) }
    }
}

impl Stroke {
    fn brighter(&self, x: f32, y: f32) -> f32 {
        let Self(side, down, wide, high, turn, brighter) = *self;
        let soft = |x: f32| {
            let (dx, dy) = (x - side, y - down);
            let (sin, cos) = turn.sin_cos();
            let (dx, dy) = ((dx * cos + dy * sin) / wide, (dy * cos - dx * sin) / high);
            (-(dx * dx + dy * dy)).exp()
        };
        if side == 0.0 { brighter * soft(x) } else { brighter * (soft(x) + soft(-x)) }
    }
}

/// Differences of each point's lower and upper neighbours; zeros in the first and the last row.
pub(super) fn slope(patch: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; patch.len()];
    let lower = patch.iter().skip(2 * ACROSS);
    for ((out, upper), lower) in out.iter_mut().skip(ACROSS).zip(patch).zip(lower) {
        *out = lower - upper;
    }
    out
}

/// With mean 0 and length 1.
pub(super) fn standard(values: &[f32]) -> Vec<f32> {
    let mean = values.iter().sum::<f32>() / values.len().max(1) as f32;
    let length = values.iter().map(|value| (value - mean).powi(2)).sum::<f32>().sqrt();
    values.iter().map(|value| (value - mean) / length.max(1e-6)).collect()
}
