//! Collects vertices and faces for the readers, within limits, and checks them at the end.

use super::{FACES_MAX, Format, ReadError, Scan, VERTICES_MAX};
use crate::mesh::{self, Point, unit};
use crate::{Mesh, Note, Unit};

/// Largest coordinate in any unit; squares of distances cannot overflow within it.
const COORDINATE_MAX: f64 = 1e9;
/// Maximum number of corners of a face: those of the largest mesh.
const CORNERS_MAX: usize = FACES_MAX + 2;
/// Largest fraction of vertices that are not numbers; scanners leave single ones, a damaged file many.
const NOT_FINITE_SHARE_MAX: f64 = 0.01;

/// Adds a corner to a face, within the limit.
pub(super) fn put_corner(corners: &mut Vec<u32>, index: u32) -> Result<(), ReadError> {
    if corners.len() >= CORNERS_MAX {
        let found = corners.len() + 1;
        return Err(ReadError::TooLarge { what: "corners of a face", found, limit: CORNERS_MAX });
    }
    corners.push(index);
    Ok(())
}

/// A mesh under construction.
#[derive(Debug)]
pub(super) struct Surface {
    format: Format,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Triangulated once all vertices are known.
    polygons: Polygons,
    /// Number of triangles, polygons included.
    n_faces: usize,
    /// Unit from a comment.
    pub(super) unit: Option<Unit>,
    pub(super) notes: Vec<Note>,
}

/// Faces with more than three corners.
#[derive(Debug, Default)]
struct Polygons {
    /// Corners of all polygons in sequence.
    corners: Vec<u32>,
    /// Number of corners of each.
    sizes: Vec<u32>,
}

impl Surface {
    pub(super) fn new(format: Format) -> Self {
        Self {
            format,
            positions: Vec::new(),
            triangles: Vec::new(),
            polygons: Polygons::default(),
            n_faces: 0,
            unit: None,
            notes: Vec::new(),
        }
    }

    pub(super) fn n_vertices(&self) -> usize {
        self.positions.len()
    }

    pub(super) fn vertex(&mut self, position: [f64; 3]) -> Result<(), ReadError> {
        if self.positions.len() >= VERTICES_MAX {
            let found = VERTICES_MAX + 1;
            return Err(ReadError::TooLarge { what: "vertices", found, limit: VERTICES_MAX });
        }
        self.positions.push(position);
        Ok(())
    }

    /// Adds a face; its vertices may follow later. Faces of fewer than three corners are ignored.
    pub(super) fn face(&mut self, corners: &[u32]) -> Result<(), ReadError> {
        self.n_faces += corners.len().saturating_sub(2);
        if self.n_faces > FACES_MAX {
            let found = self.n_faces;
            return Err(ReadError::TooLarge { what: "faces", found, limit: FACES_MAX });
        }
        match *corners {
            [] | [_] | [_, _] => {}
            [a, b, c] => self.triangles.push([a, b, c]),
            _ => {
                self.polygons.corners.extend_from_slice(corners);
                self.polygons.sizes.push(corners.len() as u32);
            }
        }
        Ok(())
    }

    /// Checks that every index is valid and every position finite, and triangulates polygons.
    pub(super) fn finish(mut self) -> Result<Scan, ReadError> {
        let n = self.positions.len();
        let corners = self.triangles.as_flattened().iter().chain(&self.polygons.corners);
        if let Some(index) = corners.copied().find(|&index| index as usize >= n) {
            let reason = format!(
                "uses vertex {} of {n}: cut off or damaged, export the scan again",
                u64::from(index) + 1
            );
            return Err(self.format.malformed("a face", reason));
        }
        self.cut_polygons();
        if self.triangles.is_empty() {
            return Err(ReadError::NoSurface { format: self.format, vertices: n });
        }
        self.drop_not_finite()?;
        let Self { format, positions, triangles, unit, notes, .. } = self;
        Ok(Scan { mesh: Mesh { positions, triangles }, format, unit, notes })
    }

    fn cut_polygons(&mut self) {
        let Polygons { corners, sizes } = std::mem::take(&mut self.polygons);
        let mut rest = &corners[..];
        let positions = &self.positions;
        for &size in &sizes {
            let (polygon, after) = rest.split_at((size as usize).min(rest.len()));
            triangulate(polygon, |corner| positions[corner as usize].into(), &mut self.triangles);
            rest = after;
        }
        if !sizes.is_empty() {
            let text = format!("triangulated faces with more than three corners: {}", sizes.len());
            self.notes.push(Note::new("polygons", text));
        }
        let large = sizes.iter().filter(|&&size| size as usize > EARS_MAX).count();
        if large > 0 {
            let text =
                format!("faces with more than {EARS_MAX} corners, triangulated as fans: {large}");
            self.notes.push(Note::new("fans", text));
        }
    }

    /// Removes vertices without a finite position and their faces; the holes can be closed later.
    fn drop_not_finite(&mut self) -> Result<(), ReadError> {
        let usable = |p: &[f64; 3]| p.iter().all(|c| c.abs() <= COORDINATE_MAX);
        let vertices = self.positions.len();
        let found = self.positions.iter().filter(|p| !usable(p)).count();
        if found == 0 {
            return Ok(());
        }
        if found as f64 > NOT_FINITE_SHARE_MAX * vertices as f64 {
            return Err(ReadError::NotFinite { found, vertices });
        }
        let mut kept = 0;
        let moved = self.positions.iter().map(|p| {
            let index = usable(p).then_some(kept);
            kept += u32::from(index.is_some());
            index
        });
        let moved: Vec<Option<u32>> = moved.collect();
        let of = |corner: u32| moved.get(corner as usize).copied().flatten();
        let before = self.triangles.len();
        self.triangles =
            self.triangles.iter().filter_map(|&[a, b, c]| Some([of(a)?, of(b)?, of(c)?])).collect();
        self.positions.retain(usable);
        let faces = before - self.triangles.len();
        let text =
            format!("left out {found} vertices without a finite position and their {faces} faces");
        self.notes.push(Note::new("not-finite", text));
        if self.triangles.is_empty() {
            return Err(ReadError::NotFinite { found, vertices });
        }
        Ok(())
    }
}

/// Maximum number of corners of a polygon that is cut by ears, which takes quadratic time or more; larger ones are cut
/// as fans.
const EARS_MAX: usize = 64;

/// Triangulates a polygon of three or more corners, keeping its orientation. `at` gives the position of a corner.
///
/// A polygon with a notch must be cut from its ears, and a quad that is not planar is best cut where its halves bend
/// least. So the ear whose triangle agrees most with the polygon's normal goes first.
fn triangulate(corners: &[u32], at: impl Fn(u32) -> Point, out: &mut Vec<[u32; 3]>) {
    let mut left = corners.to_vec();
    while left.len() > 3 && corners.len() <= EARS_MAX {
        let positions: Vec<Point> = left.iter().map(|&corner| at(corner)).collect();
        let normal = unit(area_vector(&positions));
        let n = left.len();
        let mut best = (0, f64::NEG_INFINITY);
        for i in 0..n {
            let value = ear(&positions, i, normal);
            if value > best.1 {
                best = (i, value);
            }
        }
        let i = best.0;
        out.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]]);
        left.remove(i);
    }
    if let [first, rest @ ..] = &left[..] {
        out.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}

/// Quality of an ear: the minimum agreement with the polygon's normal of its triangle and of the two triangles
/// that remain next to it; the worst value if another corner lies within.
fn ear(positions: &[Point], i: usize, normal: Point) -> f64 {
    let n = positions.len();
    let at = |k: usize| positions[(i + n + k) % n];
    let (before, corner, after) = (at(n - 1), at(0), at(1));
    let facing = |a: Point, b: Point, c: Point| unit(mesh::normal([a, b, c])).dot(&normal);
    let own = facing(before, corner, after);
    let inside = |p: Point| {
        [(before, corner), (corner, after), (after, before)]
            .iter()
            .all(|&(a, b)| mesh::normal([a, b, p]).dot(&normal) > 0.0)
    };
    if own <= 0.0 || (2..n - 1).any(|k| inside(at(k))) {
        return -2.0 + own;
    }
    own.min(facing(before, after, at(2))).min(facing(at(n - 2), before, after)).max(-0.99)
}

/// The vector area, doubled.
fn area_vector(positions: &[Point]) -> Point {
    let Some(&origin) = positions.first() else { return Point::zeros() };
    positions.windows(2).map(|pair| mesh::normal([origin, pair[0], pair[1]])).sum()
}
