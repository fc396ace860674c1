//! How deep inside cubes lie, and what is left with a layer off.

use super::grid::Grid;
use crate::geodesic::{Graph, Workspace, distances_from};

/// The cubes inside, as vertices of a graph.
pub(super) struct Inside {
    /// Their cells.
    pub(super) cells: Vec<usize>,
    /// From each to those of its 26 neighbours that come after it.
    ways: Vec<([u32; 2], f64)>,
    /// How far each is from outside, about; in steps of the grid.
    depths: Vec<f64>,
}

const OUTSIDE: u32 = u32::MAX;

impl Inside {
    pub(super) fn new(grid: &Grid, workspace: &mut Workspace) -> Self {
        let cells: Vec<usize> = (0..grid.inside.len()).filter(|cell| grid.inside[*cell]).collect();
        let mut numbers = vec![OUTSIDE; grid.inside.len()];
        for (number, cell) in (0_u32..).zip(&cells) {
            numbers[*cell] = number;
        }
        let [_, columns, layers] = grid.size.map(|size| size as isize);
        let around = |cell: usize, [x, y, z]: [isize; 3]| {
            let other = cell as isize + (x * columns + y) * layers + z;
            numbers.get(other as usize).copied().filter(|number| *number != OUTSIDE)
        };
        let mut ways = Vec::with_capacity(13 * cells.len());
        let mut skin = Vec::new();
        for (number, cell) in (0_u32..).zip(&cells) {
            for (offset, length) in half_of_neighbours() {
                if let Some(other) = around(*cell, offset) {
                    ways.push(([number, other], length));
                }
            }
            let faces = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]];
            if faces.iter().any(|face| around(*cell, *face).is_none()) {
                skin.push((number, 0.5));
            }
        }
        let depths = distances_from(&Graph::new(cells.len(), ways.clone()), skin, workspace);
        Self { cells, ways, depths }
    }

    /// The cubes that are deeper than `layer`, in steps, as a graph whose lengths are steps.
    pub(super) fn deeper_than(&self, layer: f64) -> Graph {
        let deep = |end: &u32| self.depths[*end as usize] > layer;
        let ways = self.ways.iter().filter(|(ends, _)| ends.iter().all(deep));
        Graph::new(self.cells.len(), ways.copied().collect())
    }
}

/// Thirteen of the 26 neighbours: of each and its opposite, the later.
fn half_of_neighbours() -> impl Iterator<Item = ([isize; 3], f64)> {
    let all = (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])));
    let later = all.filter(|offset| *offset > [0, 0, 0]);
    later.map(|[x, y, z]| ([x, y, z], ((x * x + y * y + z * z) as f64).sqrt()))
}
