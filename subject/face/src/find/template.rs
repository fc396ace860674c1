//! The detection template: a linear classifier over gradients pooled in cells.
//!
//! Gradients are pooled over small cells and normalised by the local contrast: histograms of oriented gradients (Dalal
//! and Triggs 2005) with four directions. An eye is dark below and above in any light, and all skin tones give the same
//! cells, because brightness enters as its square root, divided by the local contrast.

use super::learned_stages::Frame;
use crate::plane::Plane;
use crate::table::f32s;

/// Side of a cell in pixels.
pub(super) const CELL_PX: usize = 2;
/// Standard deviation of the contrast's average, in cells: three quarters of the eye distance.
const AROUND_CELLS: f32 = 3.0;
/// Noise floor of the contrast, in square roots of grey levels: added before the division.
const CONTRAST_FLOOR: f32 = 0.25;
/// Largest gradient in units of the contrast: a single edge is not a face.
const SLOPE_MAX: f32 = 2.0;

/// Eye distance of the template in pixels.
pub(super) const EYES_PX: f32 = 8.0;
/// Cells per side of the template: two and a half eye distances.
pub(super) const SIDE: usize = 10;
/// Left and top of the template, in eye distances from the midpoint of the eyes.
const LEFT: f32 = -1.25;
const TOP: f32 = -0.75;
/// Frame of a face turned by about 30 degrees, the nose to the picture's right: eyes nearer together, the mouth aside,
/// one half wider.
const TURNED_FRAME: Frame =
    Frame { origin: [0.0; 2], across: [0.93, 0.0], down: [0.08, 1.07], turn: -0.25 };

/// The most discriminative rows: brows, lids and eyes. Candidates without them are dropped at once.
const EYE_ROWS: [usize; 3] = [1, 2, 3];
const OTHER_ROWS: [usize; 7] = [7, 5, 6, 4, 8, 0, 9];

/// Learned by `benches/subject/find_template.py` as logistic functions: the least score of the eye rows (a hundredth of
/// the training faces has less), the biases of frontal and turned faces; then four weights per cell, for the left half
/// of a frontal face and for a whole one whose nose points to the picture's right.
const TABLE: &[u8] = include_bytes!("../../data/face-template.bin");
const HEADER: [f32; 3] = f32s(TABLE, 0);
const EYE_ROWS_MIN: f32 = HEADER[0];
const FRONTAL_BIAS: f32 = HEADER[1];
const TURNED_BIAS: f32 = HEADER[2];
/// Size of the header, and of a cell's weights.
const HEADER_BYTES: usize = 3 * size_of::<f32>();
const CELL_BYTES: usize = size_of::<Cell>();

/// Gradients of a cell: brighter to the right, to the left, down, up.
type Cell = [f32; 4];

/// The cells of a plane, row by row.
#[derive(Debug)]
pub(super) struct Cells {
    pub(super) across: usize,
    pub(super) down: usize,
    cells: Vec<Cell>,
}

impl Cells {
    /// Pools square roots of brightness; incomplete cells at the right and at the bottom are dropped.
    pub(super) fn new(roots: &Plane) -> Self {
        let (across, down) = (roots.width() / CELL_PX, roots.height() / CELL_PX);
        let mut cells = vec![Cell::default(); across * down];
        let mut energy = Plane::filled(across, down, 0.0);
        for (y, (row, energies)) in cells
            .chunks_exact_mut(across.max(1))
            .zip(energy.values_mut().chunks_exact_mut(across.max(1)))
            .enumerate()
        {
            for y in [CELL_PX * y, CELL_PX * y + 1] {
                let upper = roots.row(y.saturating_sub(1));
                let lower = roots.row((y + 1).min(roots.height() - 1));
                pool(roots.row(y), upper, lower, row, energies);
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

    /// `count` cells of a row from a column on; empty beyond the border.
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

/// Smooths cells by 1, 2, 1 both ways: a feature on a cell's border belongs to both.
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

/// Weights of the cells, row by row.
type Weights = [[Cell; SIDE]; SIDE];

/// Weights of a face whose nose points to the picture's right.
const TURNED: Weights = weights(HEADER_BYTES + SIDE * SIDE / 2 * CELL_BYTES, SIDE);

/// The template of one head pose.
#[derive(Debug)]
pub(super) struct Template {
    /// Weights of the cells.
    weights: Weights,
    /// Bias of the sum over cells.
    bias: f32,
    /// The face, with the midpoint of the eyes at 0 and the template's eye distance 1.
    pub(super) frame: Frame,
}

/// Frontal; the nose to the picture's right; to its left.
pub(super) static TEMPLATES: [Template; 3] = [
    Template {
        weights: weights(HEADER_BYTES, SIDE / 2),
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

/// Reads `columns` columns from byte `at` on, row by row; the others are their mirror images.
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

/// Mirroring exchanges left and right gradients.
const fn mirrored_cell([right, left, down, up]: Cell) -> Cell {
    [left, right, down, up]
}

/// The midpoint of the eyes for a template at a cell, in pixels of a rotated level.
pub(super) fn eyes_of(column: f32, row: f32) -> [f32; 2] {
    let px = CELL_PX as f32;
    [px * column - LEFT * EYES_PX - 0.5, px * row - TOP * EYES_PX - 0.5]
}

/// The best template at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TemplateFit {
    pub(super) pose: usize,
    /// Log odds.
    pub(super) odds: f32,
}

/// The best of the three templates at a cell; none if the eye rows do not fit.
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

/// Adds the products of a row of cells with each template, by direction, which vectorises.
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
