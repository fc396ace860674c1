//! Where a face may be, and the same place between the cells, sizes and rolls of the search.

use super::Plane;
use super::cells::{CELL_PX, Cells};
use super::frame::{Frame, length};
use super::octaves::Octaves;
use super::template::{EYES_PX, SIDE, Template, best_fit, eyes_of};

/// What is around the template on each side, in cells: contrast is told from there too.
const AROUND: usize = 4;
const CROP_PX: usize = (SIDE + 2 * AROUND) * CELL_PX;
/// Sizes, then rolls, between those of the search.
const CHANGES: [[(f32, f32); 2]; 2] = [[(1.1, 0.0), (0.91, 0.0)], [(1.0, 0.13), (1.0, -0.13)]];

/// Where a template fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// The middle of the eyes, on the photograph.
    pub(super) origin: [f32; 2],
    /// One pixel of the template to the right, on the photograph; down is square to it.
    pub(super) step: [f32; 2],
    /// Which template.
    pub(super) pose: usize,
    /// How well it fits.
    pub(super) fit: f32,
}

impl Place {
    /// The template's distance of the eyes, on the photograph.
    pub(super) fn eyes_px(&self) -> f32 {
        EYES_PX * length(self.step)
    }

    /// The face of the template, on the photograph.
    pub(super) fn frame(&self, templates: &[Template; 3]) -> Option<Frame> {
        let Frame { across, down, turn, .. } = templates.get(self.pose)?.frame;
        let way = |[x, y]: [f32; 2]| self.way(EYES_PX * x, EYES_PX * y);
        Some(Frame { origin: self.origin, across: way(across), down: way(down), turn })
    }

    fn way(&self, x: f32, y: f32) -> [f32; 2] {
        [x * self.step[0] - y * self.step[1], x * self.step[1] + y * self.step[0]]
    }

    /// Where near it the template fits best.
    pub(super) fn refined(self, octaves: &Octaves, templates: &[Template; 3]) -> Self {
        let mut best = self;
        for changes in CHANGES {
            let from = best;
            for (scale, roll_rad) in changes {
                let (sin, cos) = roll_rad.sin_cos();
                let moved = Self { step: from.way(scale * cos, scale * sin), ..from };
                if let Some(found) =
                    moved.best_near(octaves, templates).filter(|f| f.fit > best.fit)
                {
                    best = found;
                }
            }
        }
        best
    }

    /// The best fit within a cell each way.
    fn best_near(&self, octaves: &Octaves, templates: &[Template; 3]) -> Option<Self> {
        let (plane, done) = octaves.at(length(self.step))?;
        let [ex, ey] = eyes_of(AROUND as f32, AROUND as f32);
        let mut crop = Plane::filled(CROP_PX, CROP_PX, 0.0);
        for (y, row) in crop.values_mut().chunks_exact_mut(CROP_PX).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let [dx, dy] = self.way(x as f32 - ex, y as f32 - ey);
                let at = |origin: f32, d: f32| (origin + d + 0.5) / done - 0.5;
                *value =
                    plane.sample(at(self.origin[0], dx), at(self.origin[1], dy)).max(0.0).sqrt();
            }
        }
        let cells = Cells::new(&crop);
        let near = AROUND - 1..=AROUND + 1;
        let fits = near.clone().flat_map(|row| near.clone().map(move |column| (column, row)));
        let fits = fits.filter_map(|(column, row)| {
            best_fit(&cells, templates, column, row).map(|(pose, fit)| (column, row, pose, fit))
        });
        let (column, row, pose, fit) = fits.max_by(|a, b| a.3.total_cmp(&b.3))?;
        let [x, y] = eyes_of(column as f32, row as f32);
        let [dx, dy] = self.way(x - ex, y - ey);
        Some(Self { origin: [self.origin[0] + dx, self.origin[1] + dy], pose, fit, ..*self })
    }
}
