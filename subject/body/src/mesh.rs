//! Triangle meshes: their measures, their connectivity by half-edges, compressed sparse rows and disjoint sets, and
//! the unit of their lengths, which none of the mesh formats stores: it is read from comments or inferred from the
//! size.

use std::fmt;

use nalgebra::Vector3;

use super::Note;

/// A position or a direction.
pub(crate) type Point = Vector3<f64>;

/// A triangle mesh.
///
/// Positions are in the file's unit; the geometry does not depend on it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// One position per vertex.
    pub positions: Vec<[f64; 3]>,
    /// Three indices into `positions` per triangle, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The position of a vertex; the origin if there is no such vertex.
    pub(crate) fn point(&self, vertex: u32) -> Point {
        self.positions.get(vertex as usize).copied().unwrap_or_default().into()
    }

    pub(crate) fn corners(&self, triangle: [u32; 3]) -> [Point; 3] {
        triangle.map(|vertex| self.point(vertex))
    }

    pub(crate) fn area_of(&self, triangle: [u32; 3]) -> f64 {
        normal(self.corners(triangle)).norm() / 2.0
    }

    /// Surface area.
    pub(crate) fn area(&self) -> f64 {
        self.triangles.iter().map(|triangle| self.area_of(*triangle)).sum()
    }

    /// Centroid of the surface, weighted by area.
    pub(crate) fn area_centroid(&self) -> Point {
        let (mut sum, mut total) = (Point::zeros(), 0.0);
        for triangle in &self.triangles {
            let [a, b, c] = self.corners(*triangle);
            let area = self.area_of(*triangle);
            sum += (a + b + c) * area / 3.0;
            total += area;
        }
        if total > 0.0 { sum / total } else { Point::zeros() }
    }

    /// Keeps the triangles whose index satisfies `kept`; vertices stay.
    pub(crate) fn keep_triangles(&mut self, kept: impl Fn(usize) -> bool) {
        let mut index = 0..;
        self.triangles.retain(|_| index.next().is_some_and(&kept));
    }

    /// Enclosed volume of a closed surface; negative if it faces inwards.
    pub(crate) fn volume(&self) -> f64 {
        let origin = self.point(0);
        let of = |triangle: &[u32; 3]| {
            let [a, b, c] = self.corners(*triangle).map(|corner| corner - origin);
            a.dot(&b.cross(&c)) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }

    /// Distance from the vertex farthest from the mean to the vertex farthest from that one: invariant under rotation,
    /// and at least half the largest distance.
    pub(crate) fn extent(&self) -> f64 {
        let points = || self.positions.iter().map(|at| Point::from(*at));
        let farthest = |from: Point| {
            points().fold((from, 0.0), |best, point| {
                let far = distance(from, point);
                if far > best.1 { (point, far) } else { best }
            })
        };
        let Some(middle) = mean(points()) else { return 0.0 };
        farthest(farthest(middle).0).1
    }
}

/// The outward normal; its length is twice the area.
pub(crate) fn normal([a, b, c]: [Point; 3]) -> Point {
    (b - a).cross(&(c - a))
}

pub(crate) fn distance(a: impl Into<Point>, b: impl Into<Point>) -> f64 {
    (a.into() - b.into()).norm()
}

/// The unit vector; zero if `direction` is zero.
pub(crate) fn unit(direction: Point) -> Point {
    let length = direction.norm();
    if length > 0.0 { direction * (1.0 / length) } else { Point::zeros() }
}

/// Orthonormal axes (left, up, forward): `up` is kept, left is `across` made perpendicular to it. None if the two
/// vectors do not span a plane.
pub(crate) fn axes(up: Point, across: Point) -> Option<[Point; 3]> {
    let up = unit(up);
    let left = unit(across - up * across.dot(&up));
    (up.norm() > 0.5 && left.norm() > 0.5).then(|| [left, up, left.cross(&up)])
}

/// Mean of the points; none if there are none.
pub(crate) fn mean(points: impl IntoIterator<Item = Point>) -> Option<Point> {
    let (sum, n) = points.into_iter().fold((Point::zeros(), 0.0), |(sum, n), p| (sum + p, n + 1.0));
    (n > 0.0).then(|| sum * (1.0 / n))
}

/// A directed side of a triangle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct HalfEdge {
    /// Its two vertices, the lower index first.
    pub(crate) ends: [u32; 2],
    /// Three times the triangle's index, plus the side: 0 from the first corner to the second.
    pub(crate) index: u32,
}

/// All half-edges, sorted by their vertices: those of one edge are adjacent. The order is deterministic.
pub(crate) fn half_edges(triangles: &[[u32; 3]]) -> Vec<HalfEdge> {
    let vertex_count = triangles.as_flattened().iter().max().map_or(0, |most| *most as usize + 1);
    let all = (0..3 * triangles.len() as u32).map(|index| {
        let [from, to] = ends(triangles, index);
        let ends = [from.min(to), from.max(to)];
        (ends[0], HalfEdge { ends, index })
    });
    // Bucketed by the lower vertex, then sorted within each small bucket: far quicker than one sort.
    let SparseRows { starts, mut values } = SparseRows::new(vertex_count, all);
    for range in starts.windows(2) {
        values[range[0] as usize..range[1] as usize].sort_unstable();
    }
    values
}

/// Groups sorted half-edges by edge.
pub(crate) fn edges(half_edges: &[HalfEdge]) -> impl Iterator<Item = &[HalfEdge]> + Clone {
    half_edges.chunk_by(|a, b| a.ends == b.ends)
}

/// The start and end vertices of half-edge `side`.
pub(crate) fn ends(triangles: &[[u32; 3]], side: u32) -> [u32; 2] {
    let triangle = triangles[side as usize / 3];
    let k = side as usize % 3;
    [triangle[k], triangle[(k + 1) % 3]]
}

/// Several values per row in compressed sparse row format.
#[derive(Debug, Clone)]
pub(crate) struct SparseRows<T> {
    starts: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy + Default> SparseRows<T> {
    /// Distributes `(row, value)` pairs over `count` rows, keeping their order.
    pub(crate) fn new(count: usize, values: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut starts = vec![0_u32; count + 1];
        values.clone().for_each(|(row, _)| starts[row as usize + 1] += 1);
        for row in 0..count {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut placed = vec![T::default(); starts[count] as usize];
        values.for_each(|(row, value)| {
            let at = &mut next[row as usize];
            placed[*at as usize] = value;
            *at += 1;
        });
        Self { starts, values: placed }
    }

    pub(crate) fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// The values of a row; empty if there is no such row.
    pub(crate) fn row(&self, index: u32) -> &[T] {
        let range = self.starts.get(index as usize..=index as usize + 1);
        let Some(&[start, end]) = range else { return &[] };
        &self.values[start as usize..end as usize]
    }
}

/// The representative of the set of `at` in a disjoint-set forest, with path halving.
pub(crate) fn find_root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let next = parents[parents[at as usize] as usize];
        parents[at as usize] = next;
        at = next;
    }
    at
}

/// Merges two sets. The lower index becomes the representative, so the result does not depend on the order of merging.
pub(crate) fn union(parents: &mut [u32], one: u32, other: u32) {
    let (one, other) = (find_root(parents, one), find_root(parents, other));
    parents[one.max(other) as usize] = one.min(other);
}

/// A unit of length used in scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Metre.
    Metre,
    /// Centimetre.
    Centimetre,
    /// Millimetre.
    Millimetre,
    /// Inch, never inferred: no body size distinguishes it from the centimetre.
    Inch,
}

/// Plausible extents of a body, in millimetres: from a crouching child of 0.7 m to a man of 2.2 m with raised arms. The
/// range spans less than a factor of ten, so no size fits two of the inferred units.
const EXTENT_MM: std::ops::RangeInclusive<f64> = 400.0..=3000.0;

impl Unit {
    const INFERRED: [Self; 3] = [Self::Metre, Self::Centimetre, Self::Millimetre];

    /// Millimetres per unit.
    #[must_use]
    pub fn mm(self) -> f64 {
        match self {
            Self::Metre => 1000.0,
            Self::Centimetre => 10.0,
            Self::Millimetre => 1.0,
            Self::Inch => 25.4,
        }
    }

    /// Parses a symbol or a name in any case, such as `mm` or `Millimeters`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().as_str() {
            "m" | "meter" | "meters" | "metre" | "metres" => Some(Self::Metre),
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => {
                Some(Self::Centimetre)
            }
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => {
                Some(Self::Millimetre)
            }
            "in" | "inch" | "inches" => Some(Self::Inch),
            _ => None,
        }
    }

    /// Parses a comment such as `File units = meters` or `units: mm`. The unit must be the last word.
    #[must_use]
    pub(crate) fn from_comment(comment: &[u8]) -> Option<Self> {
        let comment = std::str::from_utf8(comment.get(..80.min(comment.len()))?).ok()?;
        let (_, rest) = comment
            .to_ascii_lowercase()
            .split_once("unit")
            .map(|(a, b)| (a.len(), b.to_owned()))?;
        let rest = rest.strip_prefix('s').unwrap_or(&rest);
        Self::from_name(rest.trim_matches(|c: char| c.is_whitespace() || ":=.".contains(c)))
    }

    /// The unit that gives the mesh the size of a body.
    ///
    /// # Errors
    /// [`UnitError`] if the size fits no unit.
    pub fn infer(mesh: &Mesh) -> Result<Self, UnitError> {
        let extent = mesh.extent();
        let fits = |unit: &Self| EXTENT_MM.contains(&(extent * unit.mm()));
        Self::INFERRED.into_iter().find(fits).ok_or(UnitError { extent })
    }

    /// Whether the mesh has the size of a body in this unit.
    #[must_use]
    pub fn fits(self, mesh: &Mesh) -> bool {
        EXTENT_MM.contains(&(mesh.extent() * self.mm()))
    }
}

/// Statures, from a child of 1.2 m to a man of 2.2 m.
const STATURE_MM: std::ops::RangeInclusive<f64> = 1200.0..=2200.0;

/// The note that asks for `--unit` when an inferred centimetre may be an inch: a scan in inches has the size of a small
/// child in centimetres. `stature` is in the mesh's unit.
pub(crate) fn ambiguity(inferred: Unit, stature: f64) -> Option<Note> {
    let [taken, inches] = [inferred, Unit::Inch].map(|unit| stature * unit.mm());
    if inferred != Unit::Centimetre || !STATURE_MM.contains(&inches) {
        return None;
    }
    let text = format!(
        "the subject is about {:.0} cm tall in centimetres, {:.0} cm in inches: choose with --unit cm or --unit in",
        taken / 10.0,
        inches / 10.0
    );
    Some(Note::new("unit-ambiguous", text))
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Inch => "in",
        })
    }
}

/// A mesh whose size fits no unit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the mesh is {extent:.4} units across, not the size of a body in m, cm or mm: give its unit with --unit, or export it in one of these"
)]
pub struct UnitError {
    /// Extent of the mesh, in its own unit.
    pub extent: f64,
}
