//! The surface where a field is zero: marching tetrahedra over a body-centred cubic lattice.
//!
//! In a tetrahedron there is one way to separate corners within from corners outside, so that the surface is closed and
//! manifold whatever the field. The body-centred lattice has tetrahedra of one shape and no preferred axis to speak of.

use std::collections::HashMap;

use mocapd_body::Mesh;

use super::Point;
use super::field::Field;

/// Cells of the lattice at most: memory for it stays below 100 MB.
const CELLS_MAX: f64 = 2e6;
/// Cell, in metres, that gave a person of middle size one face, would the square law hold: a first guess.
const CELL_OF_ONE_FACE: f64 = 2.6;
/// No corner of the lattice is nearer to the surface than this share of a cell: a vertex of the surface beside it would
/// make needles.
const CLEARANCE: f64 = 0.12;
/// Lattices that are tried where limbs grow together in one, or come off, or an end slips between its corners: at 5000 faces
/// a cell is about 5 cm, and a foot 5 to 7 cm across.
const TRIES: usize = 32;

/// A closed surface without handles, of about so many faces.
pub(super) fn surface(field: &Field, n_faces: usize) -> Mesh {
    let n_faces = n_faces.clamp(500, 200_000) as f64;
    let mut cell = CELL_OF_ONE_FACE / n_faces.sqrt();
    let mut mesh = Mesh::default();
    // A lattice that is coarser than a foot has no better one.
    let mut first_ball = None;
    for round in 0..2 + TRIES {
        let shift = round as f64 * 0.137;
        mesh = Lattice::new(field, cell, shift).surface();
        let found = mesh.triangles.len() as f64;
        // The number of faces goes with the square of what is cut.
        let settled = (found / n_faces - 1.0).abs() < 0.05;
        if settled && is_ball(&mesh) {
            if has_tips(&mesh, field) {
                return mesh;
            }
            first_ball.get_or_insert_with(|| mesh.clone());
        }
        // Shifts alone go along one diagonal, so that the next lattice is a little finer, too.
        cell *= if settled { 0.995 } else { (found.max(1.0) / n_faces).sqrt() };
    }
    first_ball.unwrap_or(mesh)
}

/// One piece, and Euler's number of a ball. All edges are of two triangles, whatever the field.
fn is_ball(mesh: &Mesh) -> bool {
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

/// Whether every tip of the solid is within its own radius of a vertex: toes that fall between corners of the lattice are not in
/// the mesh, without leaving a piece.
fn has_tips(mesh: &Mesh, field: &Field) -> bool {
    field.tips().all(|(tip, radius)| {
        mesh.positions.iter().any(|at| (Point::from(*at) - tip).norm() < radius)
    })
}

struct Lattice {
    /// Edge of a cubic cell.
    cell: f64,
    origin: Point,
    /// Cells along each axis.
    size: [usize; 3],
    /// The field at the corners of cells, then at their centres; both in the order of `index`.
    values: Vec<f64>,
}

impl Lattice {
    fn new(field: &Field, cell: f64, shift: f64) -> Self {
        let [low, high] = field.bounds();
        let extent = high - low;
        let smallest = (extent[0] * extent[1] * extent[2] / CELLS_MAX).cbrt();
        let cell = cell.max(smallest);
        // One cell around, so that the border is outside.
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

    /// Of a corner; that of the centre of the same cell is as many further as there are cells.
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

    /// Around each square between two cells there are four tetrahedra: an edge of the square, and both centres.
    fn surface(&self) -> Mesh {
        let mut surface = Cut { lattice: self, mesh: Mesh::default(), vertices: HashMap::new() };
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

struct Cut<'a> {
    lattice: &'a Lattice,
    mesh: Mesh,
    /// By the corners of the edge that each lies on.
    vertices: HashMap<(usize, usize), u32>,
}

impl Cut<'_> {
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

    /// A triangle between edges that lead from within to outside, turned so that it faces outside.
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
