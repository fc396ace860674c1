//! Level sets of a function on the surface: closed curves around the limbs (Yu et al. 2008, section 6).
//! Level curves of tubes, and of torn and branching surfaces.

use std::f64::consts::PI;

use crate::{
    Mesh,
    geodesic::{Adjacency, NONE},
    mesh::Point,
};

/// Level-set curves of a function.
#[derive(Debug, Clone)]
pub struct Rings {
    /// The levels, ascending.
    pub values: Vec<f64>,
    /// The curves, those of lower levels first.
    pub rings: Vec<Ring>,
    pub(crate) spans: Spans,
}

/// `count - 1` levels that divide the range of `field` evenly, as in algorithm 2 of (Yu et al. 2008); its ends have no
/// curves.
#[must_use]
pub fn even_levels(field: &[f64], count: u32) -> Vec<f64> {
    let most = field.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
    (1..count).map(|level| most * f64::from(level) / f64::from(count)).collect()
}

/// Cuts the surface where `field`, one value per vertex, crosses `values`, by (3) of (Yu et al. 2008).
///
/// Connectivity comes from the mesh's edges, not from positions. `values` may be in any order. A field of the wrong
/// length gives no curves.
#[must_use]
pub fn cut(mesh: &Mesh, adjacency: &Adjacency, field: &[f64], mut values: Vec<f64>) -> Rings {
    values.retain(|value| value.is_finite());
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    let spans = Spans::new(field, &values);
    let mut rings = Vec::new();
    let fits = field.len() == mesh.positions.len()
        && adjacency.vertex_count() == field.len()
        && adjacency.triangle_edges().len() == mesh.triangles.len();
    if !fits {
        return Rings { values, rings, spans };
    }
    let mut seen = vec![0; mesh.triangles.len()];
    let crossed = spans.crossed(mesh, values.len());
    for ((level, value), triangles) in (0_u32..).zip(&values).zip(&crossed) {
        let ground = Ground { mesh, adjacency, spans: &spans, level };
        for start in triangles {
            if seen[*start as usize] == level + 1 {
                continue;
            }
            let (edges, closed) = ground.walk(*start, &mut seen);
            let points = edges.iter().map(|edge| crossing(mesh, adjacency, field, *edge, *value));
            rings.push(Ring::new(level, points.collect(), *start, closed));
        }
    }
    Rings { values, rings, spans }
}

/// The crossing of a level with an edge (3): the same point from both triangles.
fn crossing(mesh: &Mesh, adjacency: &Adjacency, field: &[f64], edge: u32, value: f64) -> [f64; 3] {
    let [o, p] = adjacency.edges()[edge as usize].vertices.map(|vertex| vertex as usize);
    let part = ((value - field[o]) / (field[p] - field[o])).clamp(0.0, 1.0);
    let (from, to) = (Point::from(mesh.positions[o]), Point::from(mesh.positions[p]));
    (from + (to - from) * part).into()
}

/// The rank of each vertex: the number of levels at or below it.
///
/// A vertex on a level counts as above it, everywhere alike. So no level passes through a vertex, and a level that
/// enters a triangle leaves it through another side.
#[derive(Debug, Clone)]
pub(crate) struct Spans {
    ranks: Vec<u32>,
}

/// Rank of an unreachable vertex: no level is near it.
const UNREACHED: u32 = u32::MAX;

impl Spans {
    /// `values` must ascend.
    pub(crate) fn new(field: &[f64], values: &[f64]) -> Self {
        let rank = |at: &f64| match at.is_finite() {
            true => values.partition_point(|value| value <= at) as u32,
            false => UNREACHED,
        };
        Self { ranks: field.iter().map(rank).collect() }
    }

    /// The rank of a vertex; none if it is unreachable.
    pub(crate) fn rank(&self, vertex: u32) -> Option<u32> {
        self.ranks.get(vertex as usize).copied().filter(|rank| *rank != UNREACHED)
    }

    /// Whether a vertex lies at or above a level.
    pub(crate) fn above(&self, vertex: u32, level: u32) -> bool {
        self.ranks[vertex as usize] > level
    }

    /// The lowest and the highest rank of some vertices; none if one is unreachable.
    pub(crate) fn bands(&self, vertices: &[u32]) -> Option<[u32; 2]> {
        let ranks = || vertices.iter().map(|vertex| self.ranks[*vertex as usize]);
        let highest = ranks().max().filter(|rank| *rank != UNREACHED)?;
        Some([ranks().min()?, highest])
    }

    /// For each level, the triangles that it crosses, ascending.
    pub(crate) fn crossed(&self, mesh: &Mesh, level_count: usize) -> Vec<Vec<u32>> {
        let mut crossed = vec![Vec::new(); level_count];
        for (triangle, corners) in (0_u32..).zip(&mesh.triangles) {
            let Some([lowest, highest]) = self.bands(corners) else { continue };
            for level in lowest..highest {
                crossed[level as usize].push(triangle);
            }
        }
        crossed
    }
}

/// The surface and the level of a traversal.
struct Ground<'a> {
    mesh: &'a Mesh,
    adjacency: &'a Adjacency,
    spans: &'a Spans,
    level: u32,
}

impl Ground<'_> {
    /// The edges that the level crosses from triangle `start` on, around the vertices above, and whether it closed.
    ///
    /// `seen` stores for each triangle the last level that passed it, plus one.
    fn walk(&self, start: u32, seen: &mut [u32]) -> (Vec<u32>, bool) {
        let Some([entry, exit]) = self.sides(start) else { return (Vec::new(), false) };
        let mut crossed = vec![entry];
        seen[start as usize] = self.level + 1;
        if self.follow(start, exit, seen, &mut crossed) {
            return (crossed, true);
        }
        // The curve ran into a hole: prepend what lies on the other side of the start.
        let mut before = Vec::new();
        self.follow(start, entry, seen, &mut before);
        before.reverse();
        // The entry is in both halves.
        before.pop();
        before.append(&mut crossed);
        (before, false)
    }

    /// Continues from `triangle` over `edge` until a hole or a visited triangle; whether that is the start.
    fn follow(&self, start: u32, first: u32, seen: &mut [u32], crossed: &mut Vec<u32>) -> bool {
        let (mut triangle, mut edge) = (start, first);
        loop {
            let [one, other] = self.adjacency.edges()[edge as usize].triangles;
            let next = if one == triangle { other } else { one };
            if next == start {
                return true;
            }
            crossed.push(edge);
            if next == NONE || next == triangle || seen[next as usize] == self.level + 1 {
                return false;
            }
            seen[next as usize] = self.level + 1;
            let Some([a, b]) = self.sides(next) else { return false };
            (triangle, edge) = (next, if a == edge { b } else { a });
        }
    }

    /// The two sides of a triangle that the level crosses, the ascending one first.
    fn sides(&self, triangle: u32) -> Option<[u32; 2]> {
        let corners = self.mesh.triangles.get(triangle as usize)?;
        let edges = self.adjacency.triangle_edges().get(triangle as usize)?;
        let above = corners.map(|corner| self.spans.above(corner, self.level));
        let side = |from: bool, to: bool| {
            (0..3).find(|at| above[*at] == from && above[(at + 1) % 3] == to).map(|at| edges[at])
        };
        Some([side(false, true)?, side(true, false)?])
    }
}

/// One curve of a level set: ordered points on mesh edges, with the higher part of the surface on one side.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    /// Index of its level.
    pub level: u32,
    /// Crossings with edges. The last connects to the first, through the hole if the curve is open.
    pub points: Vec<[f64; 3]>,
    /// A triangle that it crosses.
    pub triangle: u32,
    /// Whether the curve is closed, without a hole in between.
    pub closed: bool,
    /// Centroid of the curve, weighted by length: (4) without its bias towards dense edges.
    pub centroid: [f64; 3],
    /// Perimeter, in the mesh's unit.
    pub perimeter: f64,
    /// Half the sum of `(p[k] - c) x (p[k + 1] - c)`. For a flat curve its length is the area and its direction the
    /// normal.
    pub vector_area: [f64; 3],
}

impl Ring {
    fn new(level: u32, points: Vec<[f64; 3]>, triangle: u32, closed: bool) -> Self {
        let ends = || points.iter().map(|point| Point::from(*point));
        let pieces = || ends().zip(ends().cycle().skip(1));
        let (mut perimeter, mut sum) = (0.0, Point::zeros());
        for (from, to) in pieces() {
            let length = (to - from).norm();
            perimeter += length;
            sum += (from + to) * length / 2.0;
        }
        let centroid = if perimeter > 0.0 { sum / perimeter } else { mean_of(&points) };
        let vector_area = pieces()
            .map(|(from, to)| (from - centroid).cross(&(to - centroid)) / 2.0)
            .sum::<Point>()
            .into();
        Self { level, points, triangle, closed, centroid: centroid.into(), perimeter, vector_area }
    }

    /// The mean of its points, (4) and (7) of (Yu et al. 2008).
    #[must_use]
    pub fn mean_point(&self) -> [f64; 3] {
        mean_of(&self.points).into()
    }

    /// Circularity 4 pi s / c^2, (5) of (Yu et al. 2008), with the length of the vector area for s: 1 for a circle,
    /// less for anything else.
    #[must_use]
    pub fn circularity(&self) -> f64 {
        if self.perimeter > 0.0 {
            4.0 * PI * Point::from(self.vector_area).norm() / (self.perimeter * self.perimeter)
        } else {
            0.0
        }
    }
}

fn mean_of(points: &[[f64; 3]]) -> Point {
    points.iter().map(|point| Point::from(*point) / points.len() as f64).sum()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::{Mesh, geodesic::Adjacency};

    /// A tube about z of elliptic section, 1 by `flat`, 2 long, open at both ends.
    fn tube(around: u32, rows: u32, flat: f64) -> Mesh {
        let point = |row: u32, column: u32| {
            let angle = 2.0 * PI * f64::from(column) / f64::from(around);
            [angle.cos(), flat * angle.sin(), 2.0 * f64::from(row) / f64::from(rows - 1)]
        };
        let positions = (0..rows).flat_map(|row| (0..around).map(move |column| point(row, column)));
        let at = |row: u32, column: u32| row * around + column % around;
        let cells = (0..rows - 1).flat_map(|row| (0..around).map(move |column| (row, column)));
        let triangles = cells.flat_map(|(row, column)| {
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
            [[a, b, d], [a, d, c]]
        });
        Mesh { positions: positions.collect(), triangles: triangles.collect() }
    }

    fn heights(mesh: &Mesh) -> Vec<f64> {
        mesh.positions.iter().map(|at| at[2]).collect()
    }

    fn rings(mesh: &Mesh, values: Vec<f64>) -> Rings {
        cut(mesh, &Adjacency::new(mesh).unwrap(), &heights(mesh), values)
    }

    #[test]
    fn a_round_tube_gives_circles_and_a_flat_one_less() {
        // At 0.5 rows and at 1.0 alike, though 1.0 is where vertices lie.
        for value in [0.35, 1.0] {
            let found = rings(&tube(64, 11, 1.0), vec![value]);
            assert_eq!(found.rings.len(), 1);
            let ring = &found.rings[0];
            assert!(
                ring.closed && (ring.circularity() - 1.0).abs() < 0.005,
                "{}",
                ring.circularity()
            );
            assert!((ring.perimeter - 2.0 * PI).abs() < 0.01);
            assert!((ring.vector_area[2].abs() - PI).abs() < 0.01);
            assert!((ring.centroid[2] - value).abs() < 1e-12 && ring.centroid[0].abs() < 1e-9);
            assert!((ring.mean_point()[2] - value).abs() < 1e-12);
        }
        // Ramanujan's perimeter of an ellipse of 1 by 0.4 is 4.6026.
        let flat = rings(&tube(64, 11, 0.4), vec![0.35]).rings[0].circularity();
        let expected = 4.0 * PI * 0.4 * PI / 4.6026_f64.powi(2);
        assert!((flat - expected).abs() < 0.005, "{flat} of {expected}");
    }

    #[test]
    fn rings_have_the_same_orientation() {
        let found = rings(&tube(24, 11, 1.0), even_levels(&heights(&tube(24, 11, 1.0)), 20));
        assert_eq!((found.values.len(), found.rings.len()), (19, 19));
        assert!(
            found
                .rings
                .iter()
                .all(|ring| ring.vector_area[2].signum() == found.rings[0].vector_area[2].signum())
        );
    }

    #[test]
    fn a_ring_that_meets_a_hole_is_one_open_curve() {
        let mut mesh = tube(24, 11, 1.0);
        let whole = rings(&mesh, vec![0.9]).rings[0].clone();
        // Three cells' triangles at that height, so that the level is cut once.
        let torn = |corners: &[u32; 3]| {
            corners.iter().all(|at| {
                (4 * 24 + 5..4 * 24 + 9).contains(at) || (5 * 24 + 5..5 * 24 + 9).contains(at)
            })
        };
        mesh.triangles.retain(|corners| !torn(corners));
        let found = rings(&mesh, vec![0.9]);
        assert_eq!(found.rings.len(), 1);
        let ring = &found.rings[0];
        assert!(!ring.closed && ring.points.len() < whole.points.len());
        assert!((ring.perimeter - whole.perimeter).abs() < 0.05 * whole.perimeter);
        let apart = ring.points.windows(2).map(|pair| {
            (0..3).map(|axis| (pair[0][axis] - pair[1][axis]).powi(2)).sum::<f64>().sqrt()
        });
        assert!(apart.fold(0.0, f64::max) < 0.3, "points in order");
    }

    #[test]
    fn two_tubes_give_two_rings_a_level() {
        let mut mesh = tube(16, 6, 1.0);
        let count = mesh.positions.len() as u32;
        let more: Vec<_> = mesh.positions.iter().map(|[x, y, z]| [x + 3.0, *y, *z]).collect();
        mesh.positions.extend(more);
        let more: Vec<_> =
            mesh.triangles.iter().map(|corners| corners.map(|at| at + count)).collect();
        mesh.triangles.extend(more);
        let levels: Vec<u32> =
            rings(&mesh, vec![1.5, 0.5]).rings.iter().map(|ring| ring.level).collect();
        assert_eq!(levels, [0, 0, 1, 1]);
    }

    #[test]
    fn an_unusable_field_gives_no_rings() {
        let mesh = tube(16, 6, 1.0);
        let adjacency = Adjacency::new(&mesh).unwrap();
        assert!(cut(&mesh, &adjacency, &[0.0, 1.0], vec![0.5]).rings.is_empty());
        let unreached = vec![f64::INFINITY; mesh.positions.len()];
        assert!(cut(&mesh, &adjacency, &unreached, vec![0.5]).rings.is_empty());
    }
}
