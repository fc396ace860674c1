//! Where the drawn face fits roughly: a correlation at every place and roll, on half of a level's pixels.

use super::Plane;
use super::frame::Frame;
use super::level::EYE_DISTANCE;
use super::schema::Schema;

/// Poses that are tried: roll in radians (13 degrees apart, up to 40), and which way the head is turned aside.
const POSES: [(f32, f32); 13] = [
    (-0.69, 0.0),
    (-0.46, 0.0),
    (-0.23, 0.0),
    (0.0, 0.0),
    (0.23, 0.0),
    (0.46, 0.0),
    (0.69, 0.0),
    (-0.23, -1.0),
    (0.0, -1.0),
    (0.23, -1.0),
    (-0.23, 1.0),
    (0.0, 1.0),
    (0.23, 1.0),
];
/// What turning by some 30 degrees makes of a frame: eyes nearer together, the mouth aside.
const TURNED_WIDTH: f32 = 0.87;
const TURNED_SHEAR: f32 = 0.1;
const TURN: f32 = 0.25;
/// Distance of the eyes on half a level, in the middle of what is looked for on it.
const EYES_PX: f32 = EYE_DISTANCE / 2.0 * 1.19;
/// Places of a level that are looked at closer, best first.
const PLACES_MAX: usize = 60;
/// The middle of a face is about this far below its eyes, upright or not.
const MIDDLE_PX: usize = (EYES_PX * 0.4) as usize;
/// What contrast is averaged over, in distances of the eyes, and what is added to it: noise, in deviations of around.
const ENERGY_WIDTH: f32 = 0.6;
const ENERGY_FLOOR: f32 = 0.3;
/// Taps below this share of the strongest are left out.
const TAP_MIN: f32 = 0.3;

/// A place where the drawn face fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// On the level.
    pub(super) frame: Frame,
    /// How well it fits.
    pub(super) fit: f32,
}

/// The drawn face as weights of pixels, at each roll.
#[derive(Debug)]
pub(super) struct Stencils(Vec<Stencil>);

#[derive(Debug)]
struct Stencil {
    /// Around the middle of the eyes, on half a level.
    frame: Frame,
    /// Steps from the middle of the eyes, and the weight there.
    taps: Vec<(isize, isize, f32)>,
}

impl Stencils {
    /// Of the drawn face.
    pub(super) fn new(schema: &Schema) -> Self {
        Self(POSES.map(|(roll_rad, turn)| Stencil::new(schema, roll_rad, turn)).into())
    }

    /// The best places of a level, whose brightness (less that of around) is `local`.
    pub(super) fn places(&self, local: &Plane) -> Vec<Place> {
        let half = local.resized(local.width() / 2, local.height() / 2);
        let (width, height) = (half.width(), half.height());
        // What is around a place by the size of a face: edges of signs and walls are steeper than any face's.
        let contrast = half.map(|value| value * value).blurred(ENERGY_WIDTH * EYES_PX);
        let weight = contrast.map(|square| 1.0 / (square.max(0.0).sqrt() + ENERGY_FLOOR));
        let mut best = vec![(f32::NEG_INFINITY, 0_usize); width * height];
        let mut sums = vec![0.0_f32; width];
        for (which, stencil) in self.0.iter().enumerate() {
            for (y, row) in best.chunks_exact_mut(width).enumerate() {
                stencil.correlate(&half, y, &mut sums);
                let weights = weight.row((y + MIDDLE_PX).min(height - 1));
                for ((best, sum), weight) in row.iter_mut().zip(&sums).zip(weights) {
                    let sum = sum * weight;
                    if sum > best.0 {
                        *best = (sum, which);
                    }
                }
            }
        }
        let (kx, ky) = (local.width() as f32 / width as f32, local.height() as f32 / height as f32);
        let mut places = Vec::new();
        for (y, row) in best.chunks_exact(width).enumerate() {
            for (x, &(fit, which)) in row.iter().enumerate() {
                let higher = |dx: isize, dy: isize| {
                    let (Some(x), Some(y)) = (x.checked_add_signed(dx), y.checked_add_signed(dy))
                    else {
                        return false;
                    };
                    let other = best.get(y * width + x).filter(|_| x < width);
                    other.is_some_and(|other| other.0 > fit)
                };
                let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
                if fit <= 0.0 || near.into_iter().any(|(dx, dy)| higher(dx, dy)) {
                    continue;
                }
                if let Some(stencil) = self.0.get(which) {
                    let Frame { across, down, turn, .. } = stencil.frame;
                    let frame = Frame {
                        origin: [(x as f32 + 0.5) * kx - 0.5, (y as f32 + 0.5) * ky - 0.5],
                        across: [across[0] * kx, across[1] * ky],
                        down: [down[0] * kx, down[1] * ky],
                        turn,
                    };
                    places.push(Place { frame, fit });
                }
            }
        }
        places.sort_by(|a, b| b.fit.total_cmp(&a.fit));
        places.truncate(PLACES_MAX);
        places
    }
}

impl Stencil {
    fn new(schema: &Schema, roll_rad: f32, turn: f32) -> Self {
        let (sin, cos) = roll_rad.sin_cos();
        let width = EYES_PX * if turn == 0.0 { 1.0 } else { TURNED_WIDTH };
        let aside = EYES_PX * TURNED_SHEAR * turn;
        let frame = Frame {
            origin: [0.0, 0.0],
            across: [cos * width, sin * width],
            down: [aside * cos - EYES_PX * sin, aside * sin + EYES_PX * cos],
            turn: -TURN * turn,
        };
        let reach = (2.0 * EYES_PX) as isize + 1;
        let mut taps = Vec::new();
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let [x, y] = frame.inside([dx as f32, dy as f32]);
                if let Some(weight) = schema.at(x, y) {
                    taps.push((dx, dy, weight));
                }
            }
        }
        let strongest = taps.iter().fold(0.0_f32, |most, tap| most.max(tap.2.abs()));
        taps.retain(|tap| tap.2.abs() >= TAP_MIN * strongest);
        let mean = taps.iter().map(|tap| tap.2).sum::<f32>() / taps.len().max(1) as f32;
        for tap in &mut taps {
            tap.2 -= mean;
        }
        let length = taps.iter().map(|tap| tap.2 * tap.2).sum::<f32>().sqrt().max(1e-6);
        for tap in &mut taps {
            tap.2 /= length;
        }
        Self { frame, taps }
    }

    /// One row of the correlation. What lies outside counts as even, 0.
    fn correlate(&self, plane: &Plane, y: usize, sums: &mut [f32]) {
        sums.fill(0.0);
        for &(dx, dy, weight) in &self.taps {
            let Some(row) = y.checked_add_signed(dy).filter(|&row| row < plane.height()) else {
                continue;
            };
            let from = plane.row(row).get(dx.max(0) as usize..).unwrap_or_default();
            let to = sums.get_mut(dx.min(0).unsigned_abs()..).unwrap_or_default();
            for (sum, value) in to.iter_mut().zip(from) {
                *sum += weight * value;
            }
        }
    }
}
