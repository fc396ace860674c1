//! The surface of a solid: an implicit field, negative inside, positive outside, and close to the distance near the
//! surface; and its zero surface by marching tetrahedra on a body-centred cubic lattice.
//!
//! A tetrahedron has only one way to separate inner from outer corners, so the surface is closed and manifold for any
//! field. The body-centred lattice has tetrahedra of a single shape and hardly any preferred axis.

use std::collections::HashMap;

use mocapd_body::Mesh;

use super::{Point, unit};

/// A tapered capsule (the hull of two spheres), which may be flattened.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capsule {
    pub(super) ends: [Point; 2],
    pub(super) radii: [f64; 2],
    /// Ratio of depth (z) to width; 1 is round.
    pub(super) depth: f64,
}

impl Capsule {
    pub(super) fn round(ends: [Point; 2], radii: [f64; 2]) -> Self {
        Self { ends, radii, depth: 1.0 }
    }

    /// A cheap lower bound of the field: valid outside the bounding sphere, minus infinity inside.
    fn lower_bound(&self, p: Point) -> f64 {
        let [from, to] = self.ends;
        let middle = (from + to) * 0.5;
        let reach = (from - middle).norm() + self.radii[0].max(self.radii[1]);
        let beyond = (p - middle).norm() - reach;
        if beyond > 0.0 { self.depth.min(1.0) * beyond } else { f64::NEG_INFINITY }
    }

    fn at(&self, p: Point) -> f64 {
        let squeeze = |q: Point| Point::new(q.x, q.y, q.z / self.depth);
        let [from, to] = self.ends.map(squeeze);
        self.depth.min(1.0) * round_cone(squeeze(p), from, to, self.radii)
    }
}

/// Distance to the hull of two spheres.
fn round_cone(p: Point, from: Point, to: Point, [r_from, r_to]: [f64; 2]) -> f64 {
    let axis = to - from;
    let length_sq = axis.norm_squared();
    let taper = r_from - r_to;
    let reach = p - from;
    let along = reach.dot(&axis);
    let beyond = along - length_sq;
    let across_sq = (reach * length_sq - axis * along).norm_squared();
    let slant_sq = length_sq - taper * taper;
    let bound = taper.signum() * taper * taper * across_sq;
    if beyond.signum() * slant_sq * beyond * beyond * length_sq > bound {
        return (across_sq + beyond * beyond * length_sq).sqrt() / length_sq - r_to;
    }
    if along.signum() * slant_sq * along * along * length_sq < bound {
        return (across_sq + along * along * length_sq).sqrt() / length_sq - r_from;
    }
    ((across_sq * slant_sq / length_sq).sqrt() + along * taper) / length_sq - r_from
}

/// The smooth union of capsules.
#[derive(Debug, Clone)]
pub(super) struct Field {
    pub(super) capsules: Vec<Capsule>,
    /// Width over which two capsules blend.
    pub(super) blend: f64,
}

impl Field {
    pub(super) fn at(&self, p: Point) -> f64 {
        let mut nearest = f64::INFINITY;
        for capsule in &self.capsules {
            // Most capsules are too far away to contribute.
            if capsule.lower_bound(p) < nearest + self.blend {
                let other = capsule.at(p);
                let overlap = (self.blend - (nearest - other).abs()).max(0.0);
                nearest = nearest.min(other) - overlap * overlap / (4.0 * self.blend);
            }
        }
        nearest
    }

    /// The outermost point at either end of each capsule, unless another capsule covers it, with the radius there.
    fn tips(&self) -> impl Iterator<Item = (Point, f64)> {
        let of = |capsule: &Capsule| {
            let [from, to] = capsule.ends;
            let along = unit(to - from);
            let [back, front] = capsule.radii;
            [(from + along * -back, back), (to + along * front, front)]
        };
        let ends = self.capsules.iter().flat_map(of);
        // Blending moves the surface outwards by at most a quarter of the blend: a deeper tip is covered.
        ends.filter(|(tip, _)| self.at(*tip) > -self.blend / 2.0)
    }

    /// Lower and upper corner of a bounding box, with a margin of one blend width.
    fn bounds(&self) -> [Point; 2] {
        let mut bounds = [f64::INFINITY, f64::NEG_INFINITY].map(Point::repeat);
        for capsule in &self.capsules {
            for (end, radius) in capsule.ends.into_iter().zip(capsule.radii) {
                let reach = Point::repeat(radius + self.blend);
                bounds = [bounds[0].inf(&(end - reach)), bounds[1].sup(&(end + reach))];
            }
        }
        bounds
    }
}

/// Maximum number of cells of the lattice, which keeps its memory below 100 MB.
const CELLS_MAX: f64 = 2e6;
/// First guess of the cell size, metres: the size at which a person of medium height has one face, if the number of
/// faces followed the inverse square law.
const CELL_OF_ONE_FACE: f64 = 2.6;
/// Minimum distance of lattice corners from the surface, in cells: nearer corners would cause needle-shaped triangles.
const CLEARANCE: f64 = 0.12;
/// Maximum number of lattices tried when limbs merge or become detached, or an extremity falls between lattice
/// corners: at 5000 faces a cell is about 5 cm, and a foot 5 to 7 cm across.
const TRIES: usize = 32;

/// A closed surface of genus 0 with about `n_faces` faces.
pub(super) fn surface(field: &Field, n_faces: usize) -> Mesh {
    let n_faces = n_faces.clamp(500, 200_000) as f64;
    let mut cell = CELL_OF_ONE_FACE / n_faces.sqrt();
    let mut mesh = Mesh::default();
    // The fallback when cells are larger than a foot.
    let mut first_sphere = None;
    for round in 0..2 + TRIES {
        let shift = round as f64 * 0.137;
        mesh = Lattice::new(field, cell, shift).surface();
        let found = mesh.triangles.len() as f64;
        // The number of faces scales with the inverse square of the cell size.
        let settled = (found / n_faces - 1.0).abs() < 0.05;
        if settled && is_sphere(&mesh) {
            if covers_tips(&mesh, field) {
                return mesh;
            }
            first_sphere.get_or_insert_with(|| mesh.clone());
        }
        // All shifts lie on one diagonal, so the next lattice is also made a little finer.
        cell *= if settled { 0.995 } else { (found.max(1.0) / n_faces).sqrt() };
    }
    first_sphere.unwrap_or(mesh)
}

/// Whether the mesh is one piece with the Euler characteristic of a sphere. Every edge belongs to two triangles anyway.
fn is_sphere(mesh: &Mesh) -> bool {
    let n = mesh.positions.len();
    let mut leader: Vec<usize> = (0..n).collect();
    let mut pieces = n;
    for &[a, b, c] in &mesh.triangles {
        for (a, b) in [(a, b), (b, c)] {
            let [a, b] = [a, b].map(|index| {
                let mut at = index as usize;
                while leader[at] != at {
                    leader[at] = leader[leader[at]];
                    at = leader[at];
                }
                at
            });
            pieces -= usize::from(a != b);
            leader[a] = b;
        }
    }
    pieces == 1 && 2 * n == mesh.triangles.len() + 4
}

/// Whether every tip of the solid has a vertex within its own radius. Toes that fall between lattice corners are
/// missing from the mesh without a trace.
fn covers_tips(mesh: &Mesh, field: &Field) -> bool {
    field.tips().all(|(tip, radius)| {
        mesh.positions.iter().any(|at| (Point::from(*at) - tip).norm() < radius)
    })
}

/// The field, sampled on a body-centred cubic lattice.
struct Lattice {
    /// Edge length of a cubic cell.
    cell: f64,
    origin: Point,
    /// Cells along each axis.
    size: [usize; 3],
    /// The field at the cell corners, then at the cell centres, both in the order of `index`.
    values: Vec<f64>,
}

impl Lattice {
    fn new(field: &Field, cell: f64, shift: f64) -> Self {
        let [low, high] = field.bounds();
        let extent = high - low;
        let smallest = (extent[0] * extent[1] * extent[2] / CELLS_MAX).cbrt();
        let cell = cell.max(smallest);
        // A margin of one cell keeps the border outside the solid.
        let size: [usize; 3] = extent.map(|length| (length / cell) as usize + 4).into();
        let origin = low.map(|c| c - cell * (1.5 + shift.fract() * 0.5));
        let mut lattice = Self { cell, origin, size, values: Vec::new() };
        let n = size.iter().product::<usize>();
        lattice.values = (0..2 * n).map(|index| lattice.value(field, index)).collect();
        lattice
    }

    fn value(&self, field: &Field, index: usize) -> f64 {
        let value = field.at(self.position(index));
        let least = CLEARANCE * self.cell;
        if value < 0.0 { value.min(-least) } else { value.max(least) }
    }

    /// Index of a corner; add the number of cells for the centre of the same cell.
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    fn position(&self, index: usize) -> Point {
        let n = self.size.iter().product::<usize>();
        let (of_cell, half) = if index < n { (index, 0.0) } else { (index - n, 0.5) };
        let [nx, ny, _] = self.size;
        let at = [of_cell % nx, of_cell / nx % ny, of_cell / nx / ny];
        Point::from(at.map(|at| self.cell * (at as f64 + half))) + self.origin
    }

    /// Extracts the surface. Each square between two cells has four tetrahedra around it: an edge of the square and the
    /// centres of both cells.
    fn surface(&self) -> Mesh {
        let (mesh, vertices) = (Mesh::default(), HashMap::new());
        let mut surface = SurfaceBuilder { lattice: self, mesh, vertices };
        let n = self.size.iter().product::<usize>();
        let [nx, ny, nz] = self.size;
        for z in 1..nz - 1 {
            for y in 1..ny - 1 {
                for x in 1..nx - 1 {
                    for axis in 0..3 {
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let step = |along: usize, by: usize| {
                            let mut at = [x, y, z];
                            at[u] += usize::from(along & 1 != 0);
                            at[v] += usize::from(along & 2 != 0);
                            at[axis] -= by;
                            self.index(at)
                        };
                        let centres = [n + step(0, 0), n + step(0, 1)];
                        let square = [0, 1, 3, 2].map(|along| step(along, 0));
                        for k in 0..4 {
                            surface.tetrahedron([
                                square[k],
                                square[(k + 1) % 4],
                                centres[0],
                                centres[1],
                            ]);
                        }
                    }
                }
            }
        }
        surface.mesh
    }
}

/// Collects the triangles of the surface.
struct SurfaceBuilder<'a> {
    lattice: &'a Lattice,
    mesh: Mesh,
    /// Vertices by the end points of the lattice edge on which they lie.
    vertices: HashMap<(usize, usize), u32>,
}

impl SurfaceBuilder<'_> {
    fn tetrahedron(&mut self, corners: [usize; 4]) {
        let within = |corner: &usize| self.lattice.values[*corner] < 0.0;
        let (inner, outer): (Vec<usize>, Vec<usize>) = corners.into_iter().partition(within);
        match (&inner[..], &outer[..]) {
            (&[a], &[b, c, d]) => self.face([(a, b), (a, c), (a, d)]),
            (&[b, c, d], &[a]) => self.face([(b, a), (c, a), (d, a)]),
            (&[a, b], &[c, d]) => {
                self.face([(a, c), (a, d), (b, d)]);
                self.face([(a, c), (b, d), (b, c)]);
            }
            _ => {}
        }
    }

    /// Adds the triangle between three edges that cross the surface from inside to outside, oriented outwards.
    fn face(&mut self, edges: [(usize, usize); 3]) {
        let mut triangle = edges.map(|edge| self.vertex(edge));
        let [a, b, c] = triangle.map(|index| Point::from(self.mesh.positions[index as usize]));
        let normal = (b - a).cross(&(c - a));
        let outwards: f64 = edges
            .iter()
            .map(|&(from, to)| {
                normal.dot(&(self.lattice.position(to) - self.lattice.position(from)))
            })
            .sum();
        if outwards < 0.0 {
            triangle.swap(1, 2);
        }
        self.mesh.triangles.push(triangle);
    }

    fn vertex(&mut self, (from, to): (usize, usize)) -> u32 {
        let lattice = self.lattice;
        let positions = &mut self.mesh.positions;
        *self.vertices.entry((from, to)).or_insert_with(|| {
            let (a, b) = (lattice.values[from], lattice.values[to]);
            let share = a / (a - b);
            let (p, q) = (lattice.position(from), lattice.position(to));
            positions.push((p + (q - p) * share).into());
            positions.len() as u32 - 1
        })
    }
}
