//! The template that is held against every place: how slopes of brightness in each of its cells speak for a face.
//!
//! Slopes are pooled over small cells and told in the contrast of around: histograms of oriented gradients (Dalal and
//! Triggs 2005) with four directions. An eye is dark below and above whatever the light, and skin of any tone has the same
//! cells, for brightness enters as its root and is divided by the contrast of what is around it.

use super::frame::Frame;
use crate::plane::Plane;
use crate::table::f32s;

/// Pixels along the side of a cell.
pub(super) const CELL_PX: usize = 2;
/// What contrast is averaged over, in cells: three quarters of the distance of the eyes.
const AROUND_CELLS: f32 = 3.0;
/// Contrast that is noise, in roots of grey levels: added before it is divided by.
const CONTRAST_FLOOR: f32 = 0.25;
/// A slope counts at most as this many contrasts: one edge is no face.
const SLOPE_MAX: f32 = 2.0;

/// Pixels between the eyes where the template fits.
pub(super) const EYES_PX: f32 = 8.0;
/// Cells along each side of the template: two and a half distances of the eyes.
pub(super) const SIDE: usize = 10;
/// Where the template begins, in distances of the eyes from the middle of the eyes.
const LEFT: f32 = -1.25;
const TOP: f32 = -0.75;
/// What turning by some 30 degrees, the nose to the picture's right, makes of a face: eyes nearer together, the mouth aside,
/// one half wider.
const TURNED_FRAME: Frame =
    Frame { origin: [0.0; 2], across: [0.93, 0.0], down: [0.08, 1.07], turn: -0.25 };

/// Rows of the template that tell most: brows, lids and eyes. What has none is not looked at further.
const EYE_ROWS: [usize; 3] = [1, 2, 3];
const OTHER_ROWS: [usize; 7] = [7, 5, 6, 4, 8, 0, 9];

/// Learned by `benches/subject/find_template.py` as logistic functions: what a face has at least by its eyes alone (a
/// hundredth of the faces learned from has less), what is added for a frontal and for a turned face; then, cell by cell, four
/// weights, of the left half of a frontal face and of a whole one whose nose points to the picture's right.
const TABLE: &[u8] = include_bytes!("../../data/face-template.bin");
const HEAD: [f32; 3] = f32s(TABLE, 0);
const EYE_ROWS_MIN: f32 = HEAD[0];
const FRONTAL_BIAS: f32 = HEAD[1];
const TURNED_BIAS: f32 = HEAD[2];
/// Bytes before the weights, and of those of a cell.
const HEAD_BYTES: usize = 3 * size_of::<f32>();
const CELL_BYTES: usize = size_of::<Cell>();

/// How much brighter it gets to the right, to the left, down and up.
type Cell = [f32; 4];

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
    fn row(&self, column: usize, row: usize, count: usize) -> &[Cell] {
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

/// Weights of cells, row by row.
type Weights = [[Cell; SIDE]; SIDE];

/// A face whose nose points to the picture's right.
const TURNED: Weights = weights(HEAD_BYTES + SIDE * SIDE / 2 * CELL_BYTES, SIDE);

/// One pose of the head.
#[derive(Debug)]
pub(super) struct Template {
    /// What each cell speaks for a face.
    weights: Weights,
    /// What is added to the sum over cells.
    bias: f32,
    /// The face, with the middle of the eyes at 0 and the template's distance of the eyes 1.
    pub(super) frame: Frame,
}

/// Frontal, the nose to the picture's right, and to its left.
pub(super) static TEMPLATES: [Template; 3] = [
    Template {
        weights: weights(HEAD_BYTES, SIDE / 2),
        bias: FRONTAL_BIAS,
        frame: Frame { origin: [0.0; 2], across: [1.0, 0.0], down: [0.0, 1.0], turn: 0.0 },
    },
    Template { weights: TURNED, bias: TURNED_BIAS, frame: TURNED_FRAME },
    Template {
        weights: mirrored(TURNED),
        bias: TURNED_BIAS,
        frame: Frame { down: [-0.08, 1.07], turn: 0.25, ..TURNED_FRAME },
    },
];

/// So many columns from a byte of the table on, row by row; the others are their mirror images.
const fn weights(at: usize, columns: usize) -> Weights {
    let mut weights = [[[0.0; 4]; SIDE]; SIDE];
    let mut i = 0;
    while i < SIDE * columns {
        let (row, column) = (i / columns, i % columns);
        let cell = f32s(TABLE, at + i * CELL_BYTES);
        if columns < SIDE {
            weights[row][SIDE - 1 - column] = mirrored_cell(cell);
        }
        weights[row][column] = cell;
        i += 1;
    }
    weights
}

const fn mirrored(weights: Weights) -> Weights {
    let mut mirrored = weights;
    let mut i = 0;
    while i < SIDE * SIDE {
        mirrored[i / SIDE][i % SIDE] = mirrored_cell(weights[i / SIDE][SIDE - 1 - i % SIDE]);
        i += 1;
    }
    mirrored
}

/// What is brighter to the right is, mirrored, brighter to the left.
const fn mirrored_cell([right, left, down, up]: Cell) -> Cell {
    [left, right, down, up]
}

/// Pixels of a turned level from a template's corner to the middle of its eyes.
pub(super) fn eyes_of(column: f32, row: f32) -> [f32; 2] {
    let px = CELL_PX as f32;
    [px * column - LEFT * EYES_PX - 0.5, px * row - TOP * EYES_PX - 0.5]
}

/// Which template fits, and how well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TemplateFit {
    pub(super) pose: usize,
    /// Logarithm of the odds.
    pub(super) odds: f32,
}

/// The best of three templates at a cell, and how well it fits; none where the eyes do not.
pub(super) fn best_fit(cells: &Cells, column: usize, row: usize) -> Option<TemplateFit> {
    let [a, b, c] = &TEMPLATES;
    let add = |sums, rows: &[usize]| {
        rows.iter().fold(sums, |sums, &line| {
            let cells = cells.row(column, row + line, SIDE).first_chunk::<SIDE>();
            match (cells, a.weights.get(line), b.weights.get(line), c.weights.get(line)) {
                (Some(cells), Some(a), Some(b), Some(c)) => products(cells, a, b, c, sums),
                _ => sums,
            }
        })
    };
    let whole = |sums: &[Cell; 3]| sums.map(|sum| sum.iter().sum::<f32>());
    let sums = add([Cell::default(); 3], &EYE_ROWS);
    if whole(&sums).iter().all(|&sum| sum < EYE_ROWS_MIN) {
        return None;
    }
    let sums = whole(&add(sums, &OTHER_ROWS));
    let fits = sums.iter().zip(&TEMPLATES).map(|(sum, template)| sum + template.bias);
    let fits = fits.enumerate().map(|(pose, odds)| TemplateFit { pose, odds });
    fits.max_by(|a, b| a.odds.total_cmp(&b.odds))
}

/// Adds a row of cells times that of each template; by direction, so that four are one instruction.
fn products(
    cells: &[Cell; SIDE],
    a: &[Cell; SIDE],
    b: &[Cell; SIDE],
    c: &[Cell; SIDE],
    sums: [Cell; 3],
) -> [Cell; 3] {
    let [mut sum_a, mut sum_b, mut sum_c] = sums;
    for (((cell, a), b), c) in cells.iter().zip(a).zip(b).zip(c) {
        for (i, slope) in cell.iter().enumerate() {
            sum_a[i] += slope * a[i];
            sum_b[i] += slope * b[i];
            sum_c[i] += slope * c[i];
        }
    }
    [sum_a, sum_b, sum_c]
}
