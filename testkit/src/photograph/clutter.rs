//! A cluttered background: wood, walls and cloth, much of it in the colours of skin.

use super::random::PictureRng;
use super::raster::{Canvas, Colour};

const SHAPES: usize = 22;
/// Linear colours of wood, plaster, brick, cloth, leaves, shade.
const COLOURS: [Colour; 8] = [
    [0.42, 0.23, 0.11],
    [0.62, 0.52, 0.41],
    [0.40, 0.16, 0.10],
    [0.68, 0.42, 0.28],
    [0.10, 0.16, 0.30],
    [0.12, 0.22, 0.08],
    [0.05, 0.05, 0.06],
    [0.55, 0.56, 0.55],
];

/// Fills the canvas with clutter.
pub(super) fn fill(canvas: &mut Canvas, random: &mut PictureRng) {
    let size = canvas.size_px();
    let base: Colour = random.one_of(&COLOURS);
    let tilt = [random.between(-0.3, 0.3), random.between(-0.3, 0.3)];
    canvas.paint(|at, _| {
        let light = 1.0 + tilt[0] * (at[0] / size[0] - 0.5) + tilt[1] * (at[1] / size[1] - 0.5);
        base.map(|c| c * light)
    });
    for _ in 0..SHAPES {
        shape(canvas, random, size);
    }
}

/// Draws a slanted box or ellipse with a grain.
fn shape(canvas: &mut Canvas, random: &mut PictureRng, size: [f64; 2]) {
    let colour: Colour = random.one_of(&COLOURS);
    let light = random.between(0.5, 1.3);
    let middle = size.map(|s| random.between(-0.1, 1.1) * s);
    let half = size.map(|s| random.between(0.03, 0.25) * s);
    let (sin, cos) = random.between(-1.0, 1.0).sin_cos();
    let round = random.uniform() < 0.5;
    let (grain, pitch) = (random.between(0.0, 0.25), random.between(0.2, 1.5));
    canvas.paint(|at, under| {
        let d = [at[0] - middle[0], at[1] - middle[1]];
        let local = [(cos * d[0] + sin * d[1]) / half[0], (cos * d[1] - sin * d[0]) / half[1]];
        let reach =
            if round { local[0].hypot(local[1]) } else { local[0].abs().max(local[1].abs()) };
        if reach > 1.0 {
            return under;
        }
        let shade = light
            * (1.0 - 0.25 * reach * reach)
            * (1.0 + grain * (pitch * d[1] + 0.05 * d[0]).sin());
        colour.map(|c| (c * shade).max(0.0))
    });
}
