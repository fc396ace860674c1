//! Vertices, triangles, features and modes.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use nalgebra::Matrix3;

use super::feature::{FeatureId, Side};
use super::parse::{self, ModelError};

/// What a mode tells apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One person from another.
    Identity,
    /// What one face does from what it does next.
    Expression,
}

/// One way in which a face differs from the average.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Between people, or in one face.
    pub kind: Kind,
    /// Displacement of each vertex at one standard deviation, in millimetres.
    pub displacements: Vec<[f64; 3]>,
}

/// A place on an edge: a fraction of the way from one vertex to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Anchor {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) fraction: f64,
}

/// A wireframe of the average face, and the modes in which faces differ from it. See the [module](super) for frame and unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// One position a vertex, in millimetres.
    pub vertices: Vec<[f64; 3]>,
    /// Three vertices a triangle, counter-clockwise from in front.
    pub triangles: Vec<[usize; 3]>,
    /// Named vertices: those of the 53 points that lie on the skin, and others (`nasion`, `nose_tip`, `chin`,
    /// `right_jaw_1` … `left_jaw_8`, `right_pupil`, `left_pupil`).
    pub features: BTreeMap<String, usize>,
    /// The modes, identity first. Two modes' displacements are orthogonal, but for rounding.
    pub modes: Vec<Mode>,
    /// For each point of the outline the places that become it as the head turns, from the middle of the face outward.
    pub(super) contours: Vec<Vec<Anchor>>,
    /// For each of the other points, its vertex.
    pub(super) fixed: Vec<usize>,
}

const GENERIC: &str = include_str!("../../data/face-model.txt");

impl Model {
    /// The model that comes with mocapd.
    ///
    /// # Errors
    /// None, unless the program was built with a damaged file.
    pub fn generic() -> Result<&'static Self, ModelError> {
        static MODEL: OnceLock<Result<Model, ModelError>> = OnceLock::new();
        MODEL.get_or_init(|| Self::parse(GENERIC)).as_ref().map_err(Clone::clone)
    }

    /// Reads a model in the format of `subject/face/data/face-model.txt` (docs/subject-face-model.md).
    ///
    /// # Errors
    /// What is wrong, and in which line.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        parse::model(text)
    }

    /// The vertices of a face: the average and so many standard deviations of each mode. Missing coefficients are 0.
    pub fn shape(&self, coefficients: &[f64]) -> Vec<[f64; 3]> {
        let mut vertices = self.vertices.clone();
        for (mode, amount) in self.modes.iter().zip(coefficients) {
            for (vertex, by) in vertices.iter_mut().zip(&mode.displacements) {
                for axis in 0..3 {
                    vertex[axis] += amount * by[axis];
                }
            }
        }
        vertices
    }

    /// The edges of the triangles, each once, as pairs of vertices in rising order.
    pub fn edges(&self) -> Vec<[usize; 2]> {
        let mut edges: Vec<_> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                [[a.min(b), a.max(b)], [b.min(c), b.max(c)], [c.min(a), c.max(a)]]
            })
            .collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Where the 53 points lie on a face, in the model's frame. The outline is that of a head turned by `rotation`.
    pub fn feature_points(&self, vertices: &[[f64; 3]], rotation: &Matrix3<f64>) -> Vec<[f64; 3]> {
        FeatureId::all().map(|id| self.anchor(id, vertices, rotation).on(vertices)).collect()
    }

    /// The place that is `id` as the camera sees it.
    pub(super) fn anchor(
        &self,
        id: FeatureId,
        vertices: &[[f64; 3]],
        rotation: &Matrix3<f64>,
    ) -> Anchor {
        let Some(side) = id.contour_side() else {
            let vertex = self.fixed[id.index() - FeatureId::CONTOUR];
            return Anchor { from: vertex, to: vertex, fraction: 0.0 };
        };
        // Outward is across the face as the camera sees it: along its right, with roll taken out.
        let sign = if side == Side::Left { 1.0 } else { -1.0 };
        let across = rotation.row(0) * rotation[(1, 1)] - rotation.row(1) * rotation[(0, 1)];
        let outward = |anchor: &Anchor| {
            let [x, y, z] = anchor.on(vertices);
            sign * (across[0] * x + across[1] * y + across[2] * z)
        };
        let mut best = self.contours[id.index()][0];
        let mut furthest = outward(&best);
        for anchor in &self.contours[id.index()][1..] {
            let reach = outward(anchor);
            if reach > furthest {
                (best, furthest) = (*anchor, reach);
            }
        }
        best
    }
}

impl Anchor {
    /// The place itself.
    pub(super) fn on(&self, vertices: &[[f64; 3]]) -> [f64; 3] {
        let (from, to) = (vertices[self.from], vertices[self.to]);
        std::array::from_fn(|axis| from[axis] + self.fraction * (to[axis] - from[axis]))
    }
}
