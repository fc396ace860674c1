//! The template that is held against cells: how slopes at each place of a face speak for it.

use super::cells::{CELL_PX, Cell, Cells};
use super::frame::Frame;
use super::template_weights::{EYE_ROWS_MIN, FRONTAL, FRONTAL_BIAS, TURNED, TURNED_BIAS};

/// Pixels between the eyes where the template fits.
pub(super) const EYES_PX: f32 = 8.0;
/// Cells along each side of the template: two and a half distances of the eyes.
pub(super) const SIDE: usize = 10;
/// Where the template begins, in distances of the eyes from the middle of the eyes.
pub(super) const LEFT: f32 = -1.25;
pub(super) const TOP: f32 = -0.75;
/// What turning by some 30 degrees makes of a face: eyes nearer together, the mouth aside, one half wider.
const TURNED_FRAME: (f32, f32, f32, f32) = (0.93, 1.07, 0.08, -0.25);

/// Rows of the template that tell most: brows, lids and eyes. What has none is not looked at further.
const EYE_ROWS: [usize; 3] = [1, 2, 3];
const OTHER_ROWS: [usize; 7] = [7, 5, 6, 4, 8, 0, 9];

/// Weights of cells, row by row.
pub(super) type Weights = [[Cell; SIDE]; SIDE];

/// One pose of the head.
#[derive(Debug)]
pub(super) struct Template {
    /// What each cell speaks for a face.
    pub(super) weights: Weights,
    /// What is added to the sum over cells.
    pub(super) bias: f32,
    /// The face, with the middle of the eyes at 0 and the template's distance of the eyes 1.
    pub(super) frame: Frame,
}

impl Template {
    /// Frontal, the nose to the picture's right, and to its left.
    pub(super) fn all() -> [Self; 3] {
        let frontal = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let row = FRONTAL.get(row);
                let at = |column: usize| row.and_then(|row| row.get(column)).copied();
                at(column).or_else(|| at(SIDE - 1 - column).map(swapped)).unwrap_or_default()
            })
        });
        let frame = Frame { origin: [0.0; 2], across: [1.0, 0.0], down: [0.0, 1.0], turn: 0.0 };
        let turned = |weights, aside: f32| {
            let (across, down, shear, turn) = TURNED_FRAME;
            let frame = Frame {
                origin: [0.0; 2],
                across: [across, 0.0],
                down: [shear * aside, down],
                turn: turn * aside,
            };
            Self { weights, bias: TURNED_BIAS, frame }
        };
        [
            Self { weights: frontal, bias: FRONTAL_BIAS, frame },
            turned(TURNED, 1.0),
            turned(mirrored(TURNED), -1.0),
        ]
    }
}

/// Pixels of a turned level from a template's corner to the middle of its eyes.
pub(super) fn eyes_of(column: f32, row: f32) -> [f32; 2] {
    let px = CELL_PX as f32;
    [px * column - LEFT * EYES_PX - 0.5, px * row - TOP * EYES_PX - 0.5]
}

/// The best of three templates at a cell, and how well it fits; none where the eyes do not.
pub(super) fn best_fit(
    cells: &Cells,
    templates: &[Template; 3],
    column: usize,
    row: usize,
) -> Option<(usize, f32)> {
    let [a, b, c] = templates;
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
    let fits = sums.iter().zip(templates).map(|(sum, template)| sum + template.bias);
    fits.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
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

fn mirrored(mut weights: Weights) -> Weights {
    for row in &mut weights {
        row.reverse();
        *row = row.map(swapped);
    }
    weights
}

/// What is brighter to the right is, mirrored, brighter to the left.
fn swapped([right, left, down, up]: Cell) -> Cell {
    [left, right, down, up]
}
