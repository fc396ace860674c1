//! Extremities through the interior of a body whose limbs touch.
//!
//! Where skin touches skin, a scan fuses, and paths along its surface step from an arm to the hip. In the interior
//! limbs stay thick while contacts are thin, so removing a layer of voxels all over separates them. The thickness that
//! this takes is unknown; several are tried.
//! Tests of the interior: filling, depth and separation.
//!
//! Where skin touches skin, a scan fuses, and paths along its surface step from an arm to the hip. In the interior
//! limbs stay thick while contacts are thin, so removing a layer of voxels all over separates them. The thickness that
//! this takes is unknown; several are tried.

use nalgebra::Matrix3;

use super::{
    Ends, Extremities, NamingMode,
    naming::{Naming, misfit, name},
    protrusions,
};
use crate::{
    Mesh,
    geodesic::{Graph, GraphEdge, Workspace, distances, distances_from},
    mesh::{Point, distance, find_root, normal, union},
};

/// Edge of a voxel as a fraction of the square root of the surface area: about 12 mm of an adult.
const STEP: f64 = 1.0 / 110.0;
/// Layers to remove, in voxels: none, one, and two by diagonal steps. A wrist is about five thick.
const LAYERS: [f64; 4] = [0.0, 1.0, 1.8, 2.2];

/// Finds head, hands and feet of a body whose limbs touch; none if no layer leaves a body.
///
/// The extremities are the surface vertices nearest to the ends of the thinned interior.
pub(super) fn find(mesh: &Mesh, graph: &Graph, workspace: &mut Workspace) -> Option<Ends> {
    let positions = in_principal_frame(mesh);
    let step = STEP * mesh.area().sqrt();
    let grid = Grid::new(&positions, &mesh.triangles, step)?;
    let inside = Inside::new(&grid, workspace);
    let mut best: Option<Thinned> = None;
    for layer in LAYERS {
        let thinned = inside.deeper_than(layer);
        let Some(start) = largest_piece(&thinned) else { break };
        let protrusions = protrusions(&thinned, start, workspace);
        let Ok(naming) = name(&protrusions, misfit) else { continue };
        if best.as_ref().is_none_or(|best| naming.misfit.rms < best.naming.misfit.rms) {
            let peaks = naming.ends.map(|end| protrusions.candidates[end].peak);
            let persistence = peaks.map(|peak| peak.persistence / protrusions.longest);
            best = Some(Thinned { cubes: peaks.map(|peak| peak.vertex), persistence, naming });
        }
    }
    let Thinned { cubes, persistence, naming } = best?;
    let ends = cubes.map(|cube| {
        let centre = grid.centre(inside.cells[cube as usize]);
        nearest(&positions, graph, centre)
    });
    let [head, a, b, c, d] = ends;
    Some(Ends {
        extremities: Extremities { head, hands: [a, b], feet: [c, d] },
        fields: ends.map(|end| distances(graph, end, workspace)),
        spread: Vec::new(),
        persistence,
        mode: NamingMode::Interior,
        misfit: naming.misfit,
        margin: naming.margin,
    })
}

/// Result for one thickness.
struct Thinned {
    cubes: [u32; 5],
    persistence: [f64; 5],
    naming: Naming,
}

/// The first vertex of the largest component; none if nothing is linked.
fn largest_piece(graph: &Graph) -> Option<u32> {
    let vertices = 0..graph.vertex_count() as u32;
    let mut parents: Vec<u32> = vertices.clone().collect();
    for vertex in vertices.clone() {
        graph.links(vertex).iter().for_each(|link| union(&mut parents, vertex, link.to));
    }
    let mut counts = vec![0; parents.len()];
    vertices.clone().for_each(|vertex| counts[find_root(&mut parents, vertex) as usize] += 1);
    let largest = vertices.rev().max_by_key(|vertex| counts[*vertex as usize])?;
    (counts[largest as usize] > 1).then_some(largest)
}

/// The surface vertex nearest to a point inside.
fn nearest(positions: &[Point], graph: &Graph, place: Point) -> u32 {
    let mut best = (f64::INFINITY, 0);
    for (vertex, at) in (0_u32..).zip(positions) {
        let far = distance(*at, place);
        if far < best.0 && !graph.links(vertex).is_empty() {
            best = (far, vertex);
        }
    }
    best.1
}

/// The interior voxels as vertices of a graph.
struct Inside {
    /// Grid cells of the voxels.
    cells: Vec<usize>,
    /// Edges from each voxel to the later half of its 26 neighbours.
    edges: Vec<GraphEdge>,
    /// Approximate depth of each voxel below the surface, in grid steps.
    depths: Vec<f64>,
}

const OUTSIDE: u32 = u32::MAX;

impl Inside {
    fn new(grid: &Grid, workspace: &mut Workspace) -> Self {
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
        let mut edges = Vec::with_capacity(13 * cells.len());
        let mut skin = Vec::new();
        for (number, cell) in (0_u32..).zip(&cells) {
            for (offset, length) in half_of_neighbours() {
                if let Some(other) = around(*cell, offset) {
                    edges.push(GraphEdge { ends: [number, other], length });
                }
            }
            let faces = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]];
            if faces.iter().any(|face| around(*cell, *face).is_none()) {
                skin.push((number, 0.5));
            }
        }
        let depths =
            distances_from(&Graph::new(cells.len(), edges.iter().copied()), skin, workspace);
        Self { cells, edges, depths }
    }

    /// The graph of voxels deeper than `layer`, with lengths in grid steps.
    fn deeper_than(&self, layer: f64) -> Graph {
        let deep = |end: &u32| self.depths[*end as usize] > layer;
        let edges = self.edges.iter().filter(|edge| edge.ends.iter().all(deep));
        Graph::new(self.cells.len(), edges.copied())
    }
}

/// Thirteen of the 26 neighbours: of each opposite pair, the later.
fn half_of_neighbours() -> impl Iterator<Item = ([isize; 3], f64)> {
    let all = (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])));
    let later = all.filter(|offset| *offset > [0, 0, 0]);
    later.map(|[x, y, z]| ([x, y, z], ((x * x + y * y + z * z) as f64).sqrt()))
}

/// Maximum number of cells of a grid. A body has one to two million; a cell costs a byte and an index.
const CELL_COUNT_MAX: usize = 1 << 24;

/// A voxel grid, and which voxels have their centre inside.
struct Grid {
    /// Edge of a voxel.
    step: f64,
    /// Centre of the first voxel.
    origin: Point,
    /// Number of voxels along each axis; the outermost are all outside.
    size: [usize; 3],
    /// Order: z fastest, then y.
    inside: Vec<bool>,
}

impl Grid {
    /// Voxelises the interior: along each column in z the surface is crossed inwards and outwards in turn. None if
    /// there would be too many cells.
    fn new(positions: &[Point], triangles: &[[u32; 3]], step: f64) -> Option<Self> {
        let low = positions.iter().fold(Point::repeat(f64::INFINITY), |low, at| low.inf(at));
        let high = positions.iter().fold(Point::repeat(f64::NEG_INFINITY), |high, at| high.sup(at));
        let mut size = [0; 3];
        for axis in 0..3 {
            let cells = (high[axis] - low[axis]) / step;
            // An empty mesh has no finite extent.
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

    /// Adds the crossings of columns with a triangle.
    fn cross(&self, [a, b, c]: [Point; 3], crossings: &mut [Vec<f64>]) {
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

    /// Centre of a cell.
    fn centre(&self, cell: usize) -> Point {
        let [_, columns, layers] = self.size;
        let at = [cell / layers / columns, cell / layers % columns, cell % layers];
        self.origin + Point::from(at.map(|at| self.step * at as f64))
    }
}

/// Whether the side passes `at` on its right in x and y.
///
/// The end points are ordered first, so that both triangles of a side agree and a column that hits the side exactly
/// crosses one of them alone.
fn passes([p, q]: [Point; 2], at: [f64; 2]) -> bool {
    let [p, q] = if [p[1], p[0]] <= [q[1], q[0]] { [p, q] } else { [q, p] };
    if (p[1] > at[1]) == (q[1] > at[1]) {
        return false;
    }
    at[0] < p[0] + (q[0] - p[0]) * (at[1] - p[1]) / (q[1] - p[1])
}

/// Positions in the frame of the surface's principal axes about its centroid, so that the grid does not depend on the
/// orientation of the scan.
fn in_principal_frame(mesh: &Mesh) -> Vec<Point> {
    let centre = mesh.area_centroid();
    let arms: Vec<Point> = mesh.positions.iter().map(|at| Point::from(*at) - centre).collect();
    let mut spread = Matrix3::zeros();
    let mut third = Vec::new();
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|vertex| arms[vertex as usize]);
        let area = normal([a, b, c]).norm() / 2.0;
        let middle = (a + b + c) / 3.0;
        spread += middle * middle.transpose() * area;
        third.push((middle, area));
    }
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axes = order.map(|at| {
        let axis: Point = eigen.eigenvectors.column(at).into_owned();
        // The positive direction of an axis is the one in which the surface reaches farther.
        let skew: f64 = third.iter().map(|(middle, area)| area * middle.dot(&axis).powi(3)).sum();
        if skew < 0.0 { -axis } else { axis }
    });
    arms.iter().map(|arm| axes.map(|axis| axis.dot(arm)).into()).collect()
}

#[cfg(test)]
mod tests {
    use super::{Grid, Inside, in_principal_frame};
    use crate::{
        Mesh,
        geodesic::{Workspace, distances},
        mesh::Point,
        tests::{cubes, sphere},
    };

    /// Number of pieces after the outer layer of this thickness is removed.
    fn pieces(inside: &Inside, layer: f64) -> usize {
        let graph = inside.deeper_than(layer);
        let mut seen = vec![false; graph.vertex_count()];
        let mut count = 0;
        for start in 0..graph.vertex_count() as u32 {
            if !seen[start as usize] && !graph.links(start).is_empty() {
                count += 1;
                let field = distances(&graph, start, &mut Workspace::default());
                seen.iter_mut().zip(&field).for_each(|(seen, far)| *seen |= far.is_finite());
            }
        }
        count
    }

    fn grid(mesh: &Mesh, step: f64) -> Option<Grid> {
        let positions: Vec<Point> = mesh.positions.iter().map(|at| Point::from(*at)).collect();
        Grid::new(&positions, &mesh.triangles, step)
    }

    fn filled(mesh: &Mesh, step: f64) -> Grid {
        grid(mesh, step).unwrap()
    }

    #[test]
    fn a_sphere_is_filled_to_its_volume() {
        let grid = filled(&sphere(40), 0.05);
        let volume = grid.inside.iter().filter(|inside| **inside).count() as f64 * 0.05_f64.powi(3);
        let ball = 4.0 / 3.0 * std::f64::consts::PI;
        assert!((volume / ball - 1.0).abs() < 0.02, "{volume} of {ball}");
        for cell in (0..grid.inside.len()).filter(|cell| grid.inside[*cell]) {
            assert!(grid.centre(cell).iter().map(|part| part * part).sum::<f64>() < 1.0);
        }
    }

    #[test]
    fn a_torn_surface_does_not_leak() {
        let mut mesh = sphere(20);
        mesh.triangles.truncate(mesh.triangles.len() - 30);
        let grid = filled(&mesh, 0.1);
        let outside =
            |cell: &usize| grid.centre(*cell).iter().map(|part| part * part).sum::<f64>() > 1.01;
        assert_eq!(
            (0..grid.inside.len()).filter(|cell| grid.inside[*cell]).filter(outside).count(),
            0
        );
    }

    #[test]
    fn thick_parts_separate_where_they_touch() {
        // Two pillars, 4 wide and 12 high, fused over a strip of 2 by 1.
        let mut places = Vec::new();
        for z in 0..12 {
            for x in (0..4).chain(5..9) {
                places.extend((0..4).map(|y| [x, y, z]));
            }
        }
        places.extend([[4, 1, 6], [4, 2, 6]]);
        let mesh = cubes(&places);
        let inside = Inside::new(&filled(&mesh, 0.37), &mut Workspace::default());
        assert_eq!((pieces(&inside, 0.0), pieces(&inside, 2.0)), (1, 2));
    }

    #[test]
    fn a_needle_is_refused_without_a_large_allocation() {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1e9, 0.0, 0.0], [0.0, 1.0, 1.0]],
            triangles: vec![[0, 1, 2]],
        };
        assert!(grid(&mesh, 1e-3).is_none());
    }

    #[test]
    fn the_frame_rotates_with_the_body() {
        let mesh = cubes(&[
            [0, 0, 0],
            [1, 0, 0],
            [2, 0, 0],
            [3, 0, 0],
            [0, 1, 0],
            [1, 1, 0],
            [0, 0, 1],
            [0, 0, 2],
        ]);
        let (sin, cos) = 0.7_f64.sin_cos();
        let mut turned = mesh.clone();
        for at in &mut turned.positions {
            let [x, y, z] = *at;
            *at = [cos * x - sin * z + 5.0, y - 7.0, sin * x + cos * z];
        }
        assert!((mesh.area() - turned.area()).abs() < 1e-9);
        let apart = in_principal_frame(&mesh).into_iter().zip(in_principal_frame(&turned));
        let apart =
            apart.flat_map(|(one, other)| [0, 1, 2].map(|axis| (one[axis] - other[axis]).abs()));
        // Mirrored axes would differ by a whole unit; the frame is right-handed or left-handed for both alike.
        assert!(apart.fold(0.0, f64::max) < 1e-9);
    }
}
