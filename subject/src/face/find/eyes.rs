//! Dark spots near where eyes are expected.

use super::level::Level;

/// How far from where it is expected an eye may be, in distances of the eyes: a brow is 0.34 above it.
const REACH: f32 = 0.16;

/// A dark spot on a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    /// Of its darkest place, between pixels.
    pub(super) at: [f32; 2],
    /// How much darker than around it, in standard deviations of around.
    pub(super) darker: f32,
}

/// The darkest spots near two places; what is farther off must be darker.
pub(super) fn darkest(level: &Level, eyes: [[f32; 2]; 2]) -> [Spot; 2] {
    let [[x0, y0], [x1, y1]] = eyes;
    let apart = (x1 - x0).hypot(y1 - y0);
    eyes.map(|[ex, ey]| {
        let reach = (REACH * apart).ceil() as isize;
        let (cx, cy) = (ex.round() as isize, ey.round() as isize);
        let mut best = (f32::NEG_INFINITY, cx, cy);
        for y in cy - reach..=cy + reach {
            for x in cx - reach..=cx + reach {
                let far = (x as f32 - ex).hypot(y as f32 - ey) / (REACH * apart);
                let value = level.spots.get(x, y) - 0.3 * far * far;
                if far <= 1.0 && value > best.0 {
                    best = (value, x, y);
                }
            }
        }
        let (_, x, y) = best;
        let darker = level.spots.get(x, y);
        let at = [
            x as f32 + vertex(level.spots.get(x - 1, y), darker, level.spots.get(x + 1, y)),
            y as f32 + vertex(level.spots.get(x, y - 1), darker, level.spots.get(x, y + 1)),
        ];
        Spot { at, darker }
    })
}

/// Where the parabola through three neighbours is highest, from the middle one.
fn vertex(before: f32, centre: f32, after: f32) -> f32 {
    let bend = before + after - 2.0 * centre;
    if bend < 0.0 { ((before - after) / (2.0 * bend)).clamp(-0.5, 0.5) } else { 0.0 }
}
