//! Slopes of brightness by direction, pooled over small cells and told in the contrast of around.
//!
//! Histograms of oriented gradients (Dalal and Triggs 2005) with four directions: an eye is dark below and above whatever
//! the light, and skin of any tone has the same cells, for brightness enters as its root and is divided by the contrast
//! of what is around it.

use super::Plane;

/// Pixels along the side of a cell.
pub(super) const CELL_PX: usize = 2;
/// What contrast is averaged over, in cells: three quarters of the distance of the eyes.
const AROUND_CELLS: f32 = 3.0;
/// Contrast that is noise, in roots of grey levels: added before it is divided by.
const CONTRAST_FLOOR: f32 = 0.25;
/// A slope counts at most as this many contrasts: one edge is no face.
const SLOPE_MAX: f32 = 2.0;

/// How much brighter it gets to the right, to the left, down and up.
pub(super) type Cell = [f32; 4];

/// The cells of a plane, row by row.
#[derive(Debug)]
pub(super) struct Cells {
    pub(super) across: usize,
    pub(super) down: usize,
    cells: Vec<Cell>,
}

impl Cells {
    /// Of roots of brightness; what does not fill a cell at the right and at the bottom is left out.
    pub(super) fn new(root: &Plane) -> Self {
        let (across, down) = (root.width() / CELL_PX, root.height() / CELL_PX);
        let mut cells = vec![Cell::default(); across * down];
        let mut energy = Plane::filled(across, down, 0.0);
        for (y, (row, energies)) in cells
            .chunks_exact_mut(across.max(1))
            .zip(energy.values_mut().chunks_exact_mut(across.max(1)))
            .enumerate()
        {
            for y in [CELL_PX * y, CELL_PX * y + 1] {
                let upper = root.row(y.saturating_sub(1));
                let lower = root.row((y + 1).min(root.height() - 1));
                pool(root.row(y), upper, lower, row, energies);
            }
        }
        let around = energy.blurred(AROUND_CELLS);
        for (cell, square) in cells.iter_mut().zip(around.values()) {
            let by = 1.0 / (square.max(0.0).sqrt() + CONTRAST_FLOOR);
            *cell = cell.map(|slope| (slope * by).min(SLOPE_MAX));
        }
        smooth(&mut cells, across);
        Self { across, down, cells }
    }

    /// `count` cells of a row from a column on; none beyond the border.
    pub(super) fn row(&self, column: usize, row: usize, count: usize) -> &[Cell] {
        let from = row * self.across + column;
        self.cells.get(from..from + count).unwrap_or_default()
    }
}

/// Adds one row of pixels to a row of cells.
fn pool(row: &[f32], upper: &[f32], lower: &[f32], cells: &mut [Cell], energies: &mut [f32]) {
    let share = 1.0 / (CELL_PX * CELL_PX) as f32;
    let before = |x: usize| x.saturating_sub(1);
    let last = row.len().saturating_sub(1);
    for (column, (cell, energy)) in cells.iter_mut().zip(energies).enumerate() {
        for x in [CELL_PX * column, CELL_PX * column + 1] {
            let (Some(left), Some(right)) = (row.get(before(x)), row.get((x + 1).min(last))) else {
                continue;
            };
            let (Some(above), Some(below)) = (upper.get(x), lower.get(x)) else { continue };
            let (across, down) = (share * (right - left), share * (below - above));
            cell[0] += across.max(0.0);
            cell[1] += (-across).max(0.0);
            cell[2] += down.max(0.0);
            cell[3] += (-down).max(0.0);
            *energy += (across * across + down * down) / share;
        }
    }
}

/// Each cell with its neighbours, by 1, 2, 1 both ways: a feature at a cell's border is in both.
fn smooth(cells: &mut [Cell], across: usize) {
    let mix = |a: Cell, b: Cell, c: Cell| -> Cell {
        std::array::from_fn(|i| {
            let of = |cell: &Cell| cell.get(i).copied().unwrap_or_default();
            (of(&a) + 2.0 * of(&b) + of(&c)) / 4.0
        })
    };
    for row in cells.chunks_exact_mut(across.max(1)) {
        let mut before = row.first().copied().unwrap_or_default();
        for x in 0..row.len() {
            let Some(&here) = row.get(x) else { continue };
            let after = row.get(x + 1).copied().unwrap_or(here);
            if let Some(cell) = row.get_mut(x) {
                *cell = mix(before, here, after);
            }
            before = here;
        }
    }
    let mut above: Vec<Cell> = cells.get(..across).unwrap_or_default().to_vec();
    let mut rest = cells;
    while rest.len() >= across.max(1) {
        let (row, below) = rest.split_at_mut(across);
        for (x, cell) in row.iter_mut().enumerate() {
            let here = *cell;
            let after = below.get(x).copied().unwrap_or(here);
            if let Some(before) = above.get_mut(x) {
                *cell = mix(*before, here, after);
                *before = here;
            }
        }
        rest = below;
    }
}
