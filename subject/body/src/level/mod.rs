//! Level sets of a function on the surface: rings about the limbs (Yu et al. 2008, section 6).

use std::f64::consts::PI;

use crate::Mesh;
use crate::geodesic::{Adjacency, NONE};
use crate::mesh::Point;

#[cfg(test)]
mod tests;

/// The rings of a function at some levels.
#[derive(Debug, Clone)]
pub struct Rings {
    /// The levels, ascending.
    pub values: Vec<f64>,
    /// The rings, those of lower levels first.
    pub rings: Vec<Ring>,
    pub(crate) spans: Spans,
}

/// `count - 1` levels that part the range of `field` evenly, algorithm 2 of (Yu et al. 2008): its ends have no rings.
#[must_use]
pub fn even_levels(field: &[f64], count: u32) -> Vec<f64> {
    let most = field.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
    (1..count).map(|level| most * f64::from(level) / f64::from(count)).collect()
}

/// Cuts the surface where `field`, one value a vertex, passes `values`, by (3) of (Yu et al. 2008).
///
/// What is connected is known from the mesh's edges, not from where points lie. `values` need not be in order. A field
/// that is shorter than the mesh has vertices gives no rings.
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

/// Where a level crosses an edge, (3): the same point from both of its triangles.
fn crossing(mesh: &Mesh, adjacency: &Adjacency, field: &[f64], edge: u32, value: f64) -> [f64; 3] {
    let [o, p] = adjacency.edges()[edge as usize].vertices.map(|vertex| vertex as usize);
    let part = ((value - field[o]) / (field[p] - field[o])).clamp(0.0, 1.0);
    let (from, to) = (Point::from(mesh.positions[o]), Point::from(mesh.positions[p]));
    (from + (to - from) * part).into()
}

/// How many levels are at or below each vertex.
///
/// A vertex that lies on a level counts as above it, everywhere alike: so no level ever passes through a vertex, and every
/// triangle that it enters it leaves through another side.
#[derive(Debug, Clone)]
pub(crate) struct Spans {
    ranks: Vec<u32>,
}

/// The rank of a vertex that cannot be reached: no level is near it.
const UNREACHED: u32 = u32::MAX;

impl Spans {
    /// `values` in ascending order.
    pub(crate) fn new(field: &[f64], values: &[f64]) -> Self {
        let rank = |at: &f64| match at.is_finite() {
            true => values.partition_point(|value| value <= at) as u32,
            false => UNREACHED,
        };
        Self { ranks: field.iter().map(rank).collect() }
    }

    /// The band of a vertex: how many levels are at or below it.
    pub(crate) fn rank(&self, vertex: u32) -> Option<u32> {
        self.ranks.get(vertex as usize).copied().filter(|rank| *rank != UNREACHED)
    }

    /// Whether a vertex is at or above a level.
    pub(crate) fn above(&self, vertex: u32, level: u32) -> bool {
        self.ranks[vertex as usize] > level
    }

    /// The lowest and the highest band that vertices reach into; none if one of them cannot be reached.
    pub(crate) fn bands(&self, vertices: &[u32]) -> Option<[u32; 2]> {
        let ranks = || vertices.iter().map(|vertex| self.ranks[*vertex as usize]);
        let highest = ranks().max().filter(|rank| *rank != UNREACHED)?;
        Some([ranks().min()?, highest])
    }

    /// For each level the triangles that it crosses, in ascending order.
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

/// What a walk goes over.
struct Ground<'a> {
    mesh: &'a Mesh,
    adjacency: &'a Adjacency,
    spans: &'a Spans,
    level: u32,
}

impl Ground<'_> {
    /// The edges that the level crosses on its way about the vertices above, from `start`; and whether it came back.
    ///
    /// `seen` holds for each triangle the level, plus one, that last passed it.
    fn walk(&self, start: u32, seen: &mut [u32]) -> (Vec<u32>, bool) {
        let Some([entry, exit]) = self.sides(start) else { return (Vec::new(), false) };
        let mut crossed = vec![entry];
        seen[start as usize] = self.level + 1;
        if self.follow(start, exit, seen, &mut crossed) {
            return (crossed, true);
        }
        // It ran into a hole: what lies before the start comes before it.
        let mut before = Vec::new();
        self.follow(start, entry, seen, &mut before);
        before.reverse();
        // The entry stands in both.
        before.pop();
        before.append(&mut crossed);
        (before, false)
    }

    /// Goes on from `triangle` over `edge`, until a hole or a triangle that was passed; whether that is where it began.
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

    /// The two sides of a triangle that the level crosses: first the one that climbs, going round the triangle.
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

/// One curve of a level set: points on edges of the mesh, in order, with the higher part of the surface on one side.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    /// Which level it is of.
    pub level: u32,
    /// Where it crosses edges. The last is joined to the first, through the hole if it runs into one.
    pub points: Vec<[f64; 3]>,
    /// A triangle that it crosses.
    pub triangle: u32,
    /// Whether it comes back to where it began, without a hole in between.
    pub closed: bool,
    /// The mean of the curve, each piece weighted by its length: what (4) is without its bias to where edges are dense.
    pub centroid: [f64; 3],
    /// Its length, in the mesh's unit.
    pub perimeter: f64,
    /// Half the sum of `(p[k] - c) x (p[k + 1] - c)`: its length is the area of a flat ring, its direction the normal.
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

    /// 4 pi s / c^2, (5) of (Yu et al. 2008), with the length of the vector area for s: 1 for a circle, less for all else.
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
