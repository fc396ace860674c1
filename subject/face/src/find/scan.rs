//! Where the template fits: at every place of every size, at five rolls, frontal and turned to both sides.

use super::Plane;
use super::cells::{CELL_PX, Cells};
use super::frame::length;
use super::octaves::Octaves;
use super::place::Place;
use super::template::{EYES_PX, SIDE, Template, best_fit, eyes_of};
use super::template_weights::PLACE_MIN;

/// Rolls that are tried: 15 degrees apart, up to 30.
const ROLLS_RAD: [f32; 5] = [0.0, -0.262, 0.262, -0.524, 0.524];
/// From one size to the next, smaller one: the template forgives a tenth.
const STEP: f32 = 1.2;
/// Pixels of a level that are added around it: a face may lie at the border.
const MARGIN_PX: usize = 8;
/// Places that are kept: two thirds of a class of thirty, all with a false place each.
const PLACES_MAX: usize = 64;
/// Of two places nearer than this to each other, in distances of the eyes, the worse is the same face.
const APART: f32 = 0.4;
/// What differs more in size is another face: an eye with its brow may look like a small one.
const SAME_SIZE: f32 = 1.5;

/// The best places of a photograph, best first. Faces are larger than `eyes_min` between the eyes.
pub(super) fn places(
    octaves: &Octaves,
    templates: &[Template; 3],
    size: (usize, usize),
    eyes_min: f32,
) -> Vec<Place> {
    let side = size.0.min(size.1) as f32;
    let mut shrink = eyes_min / EYES_PX;
    let mut all = Vec::new();
    while side / shrink >= (SIDE * CELL_PX) as f32 * 0.7 {
        if let Some((plane, done)) = octaves.at(shrink) {
            let px = |side: usize| ((side as f32 * done / shrink).round() as usize).max(1);
            let level =
                plane.resized(px(plane.width()), px(plane.height())).map(|v| v.max(0.0).sqrt());
            let scale =
                [size.0 as f32 / level.width() as f32, size.1 as f32 / level.height() as f32];
            for roll_rad in ROLLS_RAD {
                Turned::new(&level, roll_rad).search(templates, scale, &mut all);
            }
        }
        shrink *= STEP;
    }
    all.sort_by(|a, b| b.fit.total_cmp(&a.fit));
    let mut kept: Vec<Place> = Vec::new();
    for place in all {
        let near = |other: &Place| {
            let apart = [other.origin[0] - place.origin[0], other.origin[1] - place.origin[1]];
            let (a, b) = (other.eyes_px(), place.eyes_px());
            length(apart) < APART * a.min(b) && a.max(b) < SAME_SIZE * a.min(b)
        };
        if !kept.iter().any(near) {
            kept.push(place);
            if kept.len() >= PLACES_MAX {
                break;
            }
        }
    }
    kept
}

/// A level turned upright.
struct Turned {
    cells: Cells,
    /// From its pixels to the level's: the columns of the turn, and the middles of both.
    turn: [f32; 2],
    middle: [f32; 2],
    level_middle: [f32; 2],
}

impl Turned {
    fn new(level: &Plane, roll_rad: f32) -> Self {
        let (sin, cos) = roll_rad.sin_cos();
        let (wide, high) = (level.width() as f32, level.height() as f32);
        let width = (cos.abs() * wide + sin.abs() * high) as usize + 2 * MARGIN_PX;
        let height = (sin.abs() * wide + cos.abs() * high) as usize + 2 * MARGIN_PX;
        let half = |side: usize| (side as f32 - 1.0) / 2.0;
        let middle = [half(width), half(height)];
        let level_middle = [half(level.width()), half(level.height())];
        let mut plane = Plane::filled(width, height, 0.0);
        for (y, row) in plane.values_mut().chunks_exact_mut(width).enumerate() {
            let dy = y as f32 - middle[1];
            for (x, value) in row.iter_mut().enumerate() {
                let dx = x as f32 - middle[0];
                *value = level.sample(
                    cos * dx - sin * dy + level_middle[0],
                    sin * dx + cos * dy + level_middle[1],
                );
            }
        }
        Self { cells: Cells::new(&plane), turn: [cos, sin], middle, level_middle }
    }

    /// Adds every place that fits better than its neighbours.
    fn search(&self, templates: &[Template; 3], scale: [f32; 2], out: &mut Vec<Place>) {
        let across = (self.cells.across + 1).saturating_sub(SIDE);
        let down = (self.cells.down + 1).saturating_sub(SIDE);
        let mut fits = Plane::filled(across, down, f32::NEG_INFINITY);
        if across == 0 || down == 0 {
            return;
        }
        let mut which = vec![0_usize; across * down];
        let places = fits.values_mut().iter_mut().zip(&mut which).enumerate();
        // Every other place: what is between two of them is looked at when the better one is refined.
        for (i, (fit, which)) in places.filter(|(i, _)| (i % across + i / across).is_multiple_of(2))
        {
            if let Some((best, best_fit)) = best_fit(&self.cells, templates, i % across, i / across)
            {
                (*fit, *which) = (best_fit, best);
            }
        }
        for (i, (&fit, &which)) in fits.values().iter().zip(&which).enumerate() {
            let (x, y) = ((i % across) as isize, (i / across) as isize);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            if fit < PLACE_MIN || near.into_iter().any(|(dx, dy)| fits.get(x + dx, y + dy) > fit) {
                continue;
            }
            out.push(self.place(x as f32, y as f32, scale, which, fit));
        }
    }

    /// A cell's place on the photograph.
    fn place(&self, column: f32, row: f32, scale: [f32; 2], pose: usize, fit: f32) -> Place {
        let at = eyes_of(column, row);
        let [cos, sin] = self.turn;
        let (dx, dy) = (at[0] - self.middle[0], at[1] - self.middle[1]);
        let x = cos * dx - sin * dy + self.level_middle[0];
        let y = sin * dx + cos * dy + self.level_middle[1];
        Place {
            origin: [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5],
            step: [cos * scale[0], sin * scale[1]],
            pose,
            fit,
        }
    }
}
