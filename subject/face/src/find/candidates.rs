//! Searches for the template at every position and size, at five rolls, frontal and turned to both sides, and refines
//! the results between the cells, sizes and rolls of that search.

use super::features::{Frame, length};
use super::template::{CELL_PX, Cells, EYES_PX, SIDE, TEMPLATES, TemplateFit, best_fit, eyes_of};
use crate::plane::{Plane, Pyramid};

/// Rolls of the search: 15 degrees apart, up to 30.
const ROLLS_RAD: [f32; 5] = [0.0, -0.262, 0.262, -0.524, 0.524];
/// Ratio of successive sizes: the template tolerates a tenth.
const STEP: f32 = 1.2;
/// Margin around a level, in pixels: a face may lie at the border.
const MARGIN_PX: usize = 8;
/// Maximum number of candidates: two for each of a class of thirty.
const CANDIDATES_MAX: usize = 64;
/// Candidates closer than this, in eye distances, are the same face.
const APART: f32 = 0.4;
/// Larger ratios of sizes are different faces: an eye with its brow may resemble a small face.
const SAME_SIZE: f32 = 1.5;

/// Minimum log odds of a candidate.
const ODDS_MIN: f32 = -4.0;
/// Cells around the template on each side, for the local contrast.
const AROUND: usize = 4;
const CROP_PX: usize = (SIDE + 2 * AROUND) * CELL_PX;
/// Changes of size, then of roll, between the steps of the search.
const CHANGES: [[(f32, f32); 2]; 2] = [[(1.1, 0.0), (0.91, 0.0)], [(1.0, 0.13), (1.0, -0.13)]];

/// The best candidates of a photograph, best first. `eyes_min` is the least eye distance.
pub(super) fn candidates(pyramid: &Pyramid, eyes_min: f32) -> Vec<Candidate> {
    let [wide, high] = pyramid.size();
    let side = wide.min(high) as f32;
    let mut shrink = eyes_min / EYES_PX;
    let mut all = Vec::new();
    while side / shrink >= (SIDE * CELL_PX) as f32 * 0.7 {
        if let Some((plane, done)) = pyramid.at(shrink) {
            let px = |side: usize| ((side as f32 * done / shrink).round() as usize).max(1);
            let level =
                plane.resized(px(plane.width()), px(plane.height())).map(|v| v.max(0.0).sqrt());
            let scale = [wide as f32 / level.width() as f32, high as f32 / level.height() as f32];
            for roll_rad in ROLLS_RAD {
                RotatedLevel::new(&level, roll_rad).search(scale, &mut all);
            }
        }
        shrink *= STEP;
    }
    all.sort_by(|a, b| b.fit.odds.total_cmp(&a.fit.odds));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in all {
        let near = |other: &Candidate| {
            let offset = [0, 1].map(|axis| other.origin[axis] - candidate.origin[axis]);
            let (a, b) = (other.eyes_px(), candidate.eyes_px());
            length(offset) < APART * a.min(b) && a.max(b) < SAME_SIZE * a.min(b)
        };
        if !kept.iter().any(near) {
            kept.push(candidate);
            if kept.len() >= CANDIDATES_MAX {
                break;
            }
        }
    }
    kept
}

/// A level of the image pyramid, rotated.
struct RotatedLevel {
    cells: Cells,
    /// Rotation and centres for mapping its pixels to the level's.
    turn: [f32; 2],
    middle: [f32; 2],
    level_middle: [f32; 2],
}

impl RotatedLevel {
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

    /// Adds the local maxima of the template's score.
    fn search(&self, scale: [f32; 2], out: &mut Vec<Candidate>) {
        let across = (self.cells.across + 1).saturating_sub(SIDE);
        let down = (self.cells.down + 1).saturating_sub(SIDE);
        if across == 0 || down == 0 {
            return;
        }
        let mut fits = Plane::filled(across, down, f32::NEG_INFINITY);
        let mut poses = vec![0_usize; across * down];
        let cells = fits.values_mut().iter_mut().zip(&mut poses).enumerate();
        // Every other place only: refinement covers those between.
        for (i, (fit, pose)) in cells.filter(|(i, _)| (i % across + i / across).is_multiple_of(2)) {
            if let Some(best) = best_fit(&self.cells, i % across, i / across) {
                (*fit, *pose) = (best.odds, best.pose);
            }
        }
        for (i, (&fit, &pose)) in fits.values().iter().zip(&poses).enumerate() {
            let (x, y) = ((i % across) as isize, (i / across) as isize);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
            if fit < ODDS_MIN || near.into_iter().any(|(dx, dy)| fits.get(x + dx, y + dy) > fit) {
                continue;
            }
            out.push(self.candidate_at(x as f32, y as f32, scale, TemplateFit { pose, odds: fit }));
        }
    }

    /// The candidate at a cell, on the photograph.
    fn candidate_at(&self, column: f32, row: f32, scale: [f32; 2], fit: TemplateFit) -> Candidate {
        let at = eyes_of(column, row);
        let [cos, sin] = self.turn;
        let (dx, dy) = (at[0] - self.middle[0], at[1] - self.middle[1]);
        let x = cos * dx - sin * dy + self.level_middle[0];
        let y = sin * dx + cos * dy + self.level_middle[1];
        Candidate {
            origin: [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5],
            step: [cos * scale[0], sin * scale[1]],
            fit,
        }
    }
}

/// A candidate: a place where a template fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Midpoint of the eyes, on the photograph.
    pub(super) origin: [f32; 2],
    /// Vector of one template pixel to the right, on the photograph; down is perpendicular to it.
    pub(super) step: [f32; 2],
    pub(super) fit: TemplateFit,
}

impl Candidate {
    /// The template's eye distance, on the photograph.
    pub(super) fn eyes_px(&self) -> f32 {
        EYES_PX * length(self.step)
    }

    /// The frame of the template's face, on the photograph.
    pub(super) fn frame(&self) -> Option<Frame> {
        let Frame { across, down, turn, .. } = TEMPLATES.get(self.fit.pose)?.frame;
        let offset = |[x, y]: [f32; 2]| self.offset(EYES_PX * x, EYES_PX * y);
        Some(Frame { origin: self.origin, across: offset(across), down: offset(down), turn })
    }

    fn offset(&self, x: f32, y: f32) -> [f32; 2] {
        [x * self.step[0] - y * self.step[1], x * self.step[1] + y * self.step[0]]
    }

    /// The best fit nearby in size and roll.
    pub(super) fn refined(self, pyramid: &Pyramid) -> Self {
        let mut best = self;
        for changes in CHANGES {
            let from = best;
            for (scale, roll_rad) in changes {
                let (sin, cos) = roll_rad.sin_cos();
                let moved = Self { step: from.offset(scale * cos, scale * sin), ..from };
                if let Some(found) = moved.best_near(pyramid).filter(|f| f.fit.odds > best.fit.odds)
                {
                    best = found;
                }
            }
        }
        best
    }

    /// The best fit within a cell each way.
    fn best_near(&self, pyramid: &Pyramid) -> Option<Self> {
        let (plane, done) = pyramid.at(length(self.step))?;
        let [ex, ey] = eyes_of(AROUND as f32, AROUND as f32);
        let mut crop = Plane::filled(CROP_PX, CROP_PX, 0.0);
        for (y, row) in crop.values_mut().chunks_exact_mut(CROP_PX).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let [dx, dy] = self.offset(x as f32 - ex, y as f32 - ey);
                let at = |origin: f32, d: f32| (origin + d + 0.5) / done - 0.5;
                *value =
                    plane.sample(at(self.origin[0], dx), at(self.origin[1], dy)).max(0.0).sqrt();
            }
        }
        let cells = Cells::new(&crop);
        let near = AROUND - 1..=AROUND + 1;
        let fits = near.clone().flat_map(|row| near.clone().map(move |column| (column, row)));
        let fits = fits.filter_map(|(column, row)| {
            best_fit(&cells, column, row).map(|best| (column, row, best))
        });
        let (column, row, fit) = fits.max_by(|a, b| a.2.odds.total_cmp(&b.2.odds))?;
        let [x, y] = eyes_of(column as f32, row as f32);
        let [dx, dy] = self.offset(x - ex, y - ey);
        Some(Self { origin: [self.origin[0] + dx, self.origin[1] + dy], fit, ..*self })
    }
}
