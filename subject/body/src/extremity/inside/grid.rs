//! Cubes inside a closed surface.

/// No grid has more cells: a body has one to two million, and a cell costs a byte and an index.
const CELL_COUNT_MAX: usize = 1 << 24;

/// A grid of cubes, and which of them have their centre inside.
pub(super) struct Grid {
    /// The edge of a cube.
    pub(super) step: f64,
    /// The centre of the first cube.
    origin: [f64; 3],
    /// How many there are along each axis; the outermost are all outside.
    pub(super) size: [usize; 3],
    /// z fastest, then y.
    pub(super) inside: Vec<bool>,
}

impl Grid {
    /// Fills a grid of such a step: along each column in z the surface is crossed in and out by turns. None if there would
    /// be too many cells.
    pub(super) fn new(positions: &[[f64; 3]], triangles: &[[u32; 3]], step: f64) -> Option<Self> {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for at in positions {
            for axis in 0..3 {
                low[axis] = low[axis].min(at[axis]);
                high[axis] = high[axis].max(at[axis]);
            }
        }
        let mut size = [0; 3];
        for axis in 0..3 {
            let cells = (high[axis] - low[axis]) / step;
            // An empty mesh has no extent, and gives what is not finite.
            if !cells.is_finite() || cells > CELL_COUNT_MAX as f64 {
                return None;
            }
            size[axis] = cells as usize + 4;
        }
        let count = size[0].checked_mul(size[1])?.checked_mul(size[2])?;
        if count > CELL_COUNT_MAX {
            return None;
        }
        let origin = low.map(|low| low - step);
        let mut grid = Self { step, origin, size, inside: vec![false; count] };
        let mut crossings = vec![Vec::new(); size[0] * size[1]];
        for corners in triangles {
            grid.cross(corners.map(|vertex| positions[vertex as usize]), &mut crossings);
        }
        for (column, heights) in crossings.iter_mut().enumerate() {
            heights.sort_unstable_by(f64::total_cmp);
            for pair in heights.chunks_exact(2) {
                let first = ((pair[0] - origin[2]) / step).ceil().max(0.0) as usize;
                let last = ((pair[1] - origin[2]) / step).floor().max(0.0) as usize;
                for layer in first..=last.min(size[2] - 2) {
                    grid.inside[column * size[2] + layer] = true;
                }
            }
        }
        Some(grid)
    }

    /// Where the columns cross a triangle.
    fn cross(&self, [a, b, c]: [[f64; 3]; 3], crossings: &mut [Vec<f64>]) {
        let cell = |axis: usize, value: f64| ((value - self.origin[axis]) / self.step).max(0.0);
        let least = |axis: usize| a[axis].min(b[axis]).min(c[axis]);
        let most = |axis: usize| a[axis].max(b[axis]).max(c[axis]);
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let twice = u[0] * v[1] - u[1] * v[0];
        if twice == 0.0 {
            return;
        }
        for i in cell(0, least(0)).ceil() as usize..=cell(0, most(0)).floor() as usize {
            for j in cell(1, least(1)).ceil() as usize..=cell(1, most(1)).floor() as usize {
                let at = [0, 1].map(|axis| self.origin[axis] + self.step * [i, j][axis] as f64);
                let sides = [[a, b], [b, c], [c, a]];
                let left = sides.iter().filter(|side| passes(**side, at)).count();
                if left % 2 == 0 || i >= self.size[0] || j >= self.size[1] {
                    continue;
                }
                let arm = [at[0] - a[0], at[1] - a[1]];
                let s = (arm[0] * v[1] - arm[1] * v[0]) / twice;
                let t = (u[0] * arm[1] - u[1] * arm[0]) / twice;
                let height = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2]);
                crossings[i * self.size[1] + j].push(height);
            }
        }
    }

    /// The centre of a cell.
    pub(super) fn centre(&self, cell: usize) -> [f64; 3] {
        let [_, columns, layers] = self.size;
        let at = [cell / layers / columns, cell / layers % columns, cell % layers];
        [0, 1, 2].map(|axis| self.origin[axis] + self.step * at[axis] as f64)
    }
}

/// Whether the side runs past `at`, to its right, in x and y.
///
/// The ends are put in order first, so that both triangles of a side come to the same answer, and a column that hits the
/// side exactly still goes through one of them alone.
fn passes([p, q]: [[f64; 3]; 2], at: [f64; 2]) -> bool {
    let [p, q] = if [p[1], p[0]] <= [q[1], q[0]] { [p, q] } else { [q, p] };
    if (p[1] > at[1]) == (q[1] > at[1]) {
        return false;
    }
    at[0] < p[0] + (q[0] - p[0]) * (at[1] - p[1]) / (q[1] - p[1])
}
