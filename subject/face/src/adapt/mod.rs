//! Adaptation of the wireframe to the points of a photograph by radial basis functions (Yang et al. 2004, (6) to (14)).

#[cfg(test)]
mod tests;

use nalgebra::DMatrix;
use thiserror::Error;

use crate::model::{Camera, Landmark, Model, OUTER_EYES_MM};

/// The d of the multiquadric ([`RadialMap`]): how far around a point the vertices follow it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Width {
    /// In pixels of the photograph.
    Pixels(f64),
    /// In outer interocular distances, as the camera would see them from the front.
    OuterEyes(f64),
}

impl Width {
    /// The value of Yang et al. 2004: 1. They state no unit; here it is a pixel.
    ///
    /// In outer interocular distances it would be twenty times the distance between features: the map would meet the
    /// points, but vertices between them would be up to an interocular distance from where they belong.
    pub const PAPER: Self = Self::Pixels(1.0);
}

impl Default for Width {
    /// A twentieth of the interocular distance, about the distance between features: the same at every resolution.
    fn default() -> Self {
        Self::OuterEyes(0.05)
    }
}

/// Source of the result's depth. A photograph has none, and Yang et al. 2004 do not mention it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth<'a> {
    /// The model's depth, scaled like its width and height.
    Model,
    /// A separate map in three dimensions through the depth of each point: pixels in front of the model's origin, in
    /// the order of the points. A fitted shape provides them.
    Points(&'a [f64]),
}

/// An adapted face.
#[derive(Debug, Clone, PartialEq)]
pub struct Adapted {
    /// Each vertex in the picture: x, y and depth in front of the model's origin, in pixels.
    pub vertices_px: Vec<[f64; 3]>,
    /// Each vertex facing forward, in the model's frame and nominal millimetres.
    pub vertices_mm: Vec<[f64; 3]>,
}

/// Adapts the face `vertices_mm`, posed by `camera`, to `points` (Yang et al. 2004, section 5): the features come to
/// lie on the points, the other vertices between them.
///
/// # Errors
/// [`AdaptError`] if the points determine no map: too few, duplicates, or on one line.
pub fn adapt(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    points: &[Landmark],
    width: Width,
    depth: Depth<'_>,
) -> Result<Adapted, AdaptError> {
    // Steps 1 and 2: rotation and orthographic projection, in interocular distances.
    let turned = Camera { scale_px_per_mm: 1.0 / OUTER_EYES_MM, origin_px: [0.0; 2], ..*camera };
    let projected = turned.project(vertices_mm);
    let features = turned.project(&model.feature_points(vertices_mm, &camera.rotation()));
    // Step 3: centres and targets.
    let nodes: Vec<_> = points.iter().map(|point| features[point.id.index()]).collect();
    let flat: Vec<_> = nodes.iter().map(|&[x, y, _]| [x, y]).collect();
    let interocular_px = camera.scale_px_per_mm * OUTER_EYES_MM;
    let unit = |point: &Landmark| point.xy_px.map(|v| v / interocular_px);
    let targets: Vec<_> = points.iter().map(unit).collect();
    // Steps 4 to 6. Another unit of r scales d, and adds a factor that the weights absorb.
    let d = match width {
        Width::Pixels(d) => d * (1.0 / interocular_px),
        Width::OuterEyes(d) => d,
    };
    let map = RadialMap::new(d, &flat, &targets)?;
    let place = |&[x, y, z]: &[f64; 3]| {
        let [u, v] = map.at(&[x, y]);
        [u * interocular_px, v * interocular_px, z]
    };
    let mut vertices_px: Vec<_> = projected.iter().map(place).collect();
    match depth {
        Depth::Model => {
            let scale_px = interocular_px * spread(&targets) / spread(&flat);
            vertices_px.iter_mut().for_each(|v| v[2] *= scale_px);
        }
        Depth::Points(depths) => {
            let targets: Vec<_> = depths.iter().map(|z| [z / interocular_px]).collect();
            let map = RadialMap::<3, 1>::new(d, &nodes, &targets)?;
            for (vertex, place) in vertices_px.iter_mut().zip(&projected) {
                vertex[2] = map.at(place)[0] * interocular_px;
            }
        }
    }
    let vertices_mm = camera.unproject(&vertices_px);
    Ok(Adapted { vertices_px, vertices_mm })
}

/// Root mean square distance from the centroid.
fn spread(points: &[[f64; 2]]) -> f64 {
    let n = points.len() as f64;
    let mean = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n);
    let squares: f64 =
        points.iter().map(|p| (p[0] - mean[0]).powi(2) + (p[1] - mean[1]).powi(2)).sum();
    (squares / n).sqrt()
}

/// Maximum number of nodes, since the solution takes cubic time; a face has 53.
const MAX_NODES: usize = 1000;
/// Nodes closer than this fraction of their extent are duplicates: no double distinguishes them after the solution.
const DUPLICATE: f64 = 1e-7;
/// Nodes are collinear (coplanar) if their spread across is below this fraction of that along.
const FLAT: f64 = 1e-7;

/// Why there is no map.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AdaptError {
    /// The numbers of nodes and targets differ.
    #[error("{nodes} nodes and {targets} targets: give one target per node")]
    Count {
        /// Number of nodes.
        nodes: usize,
        /// Number of targets.
        targets: usize,
    },
    /// Too few nodes for the linear part, or too many.
    #[error("{found} nodes, expected {least} to {most}")]
    Nodes {
        /// Number of nodes.
        found: usize,
        /// Minimum number: dimensions plus one.
        least: usize,
        /// Maximum number.
        most: usize,
    },
    /// A coordinate that is not finite.
    #[error("node {0} or its target is not finite")]
    NotFinite(usize),
    /// Two nodes coincide.
    #[error("nodes {0} and {1} are in the same place: leave one of them out")]
    Duplicate(usize, usize),
    /// The nodes are collinear or coplanar, so the linear part is undetermined.
    #[error("the nodes lie on one line or in one plane: add a node off it")]
    Flat,
    /// The parameter d is out of range.
    #[error("d of the multiquadric is {0}: give 0 or more")]
    Basis(f64),
    /// The equations are singular to working precision.
    #[error("the nodes are too close together for this basis: use a smaller d, or leave some out")]
    Singular,
}

/// `F(x) = Σ ω_j φ(‖x - x_j‖) + v·(x, 1)` (Yang et al. 2004, (12)), from `D` dimensions to `K`.
///
/// φ(r) is the multiquadric √(d² + r²), family (11) with m = 1 and t = 1/2. r and d are in the unit of the coordinates;
/// the smaller d, the sharper its tip.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialMap<const D: usize, const K: usize> {
    d: f64,
    nodes: Vec<[f64; D]>,
    /// ω, one per node.
    weights: Vec<[f64; K]>,
    /// v: one per coordinate, the constant last.
    linear: Vec<[f64; K]>,
    /// Origin of the coordinates: it keeps the equations well scaled and does not change the map.
    middle: [f64; D],
    /// Correction of rounding errors at the nodes.
    rest: Option<Box<Self>>,
}

/// Tolerated error at a node, as a fraction of the largest target: a thousandth of any practical requirement.
const NEGLIGIBLE: f64 = 1e-12;
/// |r| is sharp and well conditioned, so its own rounding does not matter.
const SHARP: f64 = 0.0;

impl<const D: usize, const K: usize> RadialMap<D, K> {
    /// The map with F(node) = target for each pair (Yang et al. 2004, (6)): (13) and (14) solved by LU with pivoting.
    ///
    /// Affine maps are reproduced exactly. A smooth basis with close nodes has large weights of both signs, whose sum a
    /// double cannot hold; the remaining error at the nodes goes to a second map with a sharp basis.
    ///
    /// # Errors
    /// [`AdaptError`] if the nodes determine no map or a parameter is out of range.
    pub fn new(d: f64, nodes: &[[f64; D]], targets: &[[f64; K]]) -> Result<Self, AdaptError> {
        check(d, nodes, targets)?;
        let mut map = Self::solve(d, nodes, targets)?;
        let missing = |(x, y): (&[f64; D], &[f64; K])| {
            let at = map.at(x);
            std::array::from_fn(|axis| y[axis] - at[axis])
        };
        let missing: Vec<[f64; K]> = nodes.iter().zip(targets).map(missing).collect();
        let largest = targets.iter().flatten().fold(0.0, |most: f64, y| most.max(y.abs()));
        if missing.iter().flatten().any(|m| m.abs() > NEGLIGIBLE * largest) {
            map.rest = Some(Box::new(Self::solve(SHARP, nodes, &missing)?));
        }
        Ok(map)
    }

    fn solve(d: f64, nodes: &[[f64; D]], targets: &[[f64; K]]) -> Result<Self, AdaptError> {
        let n = nodes.len();
        let size = n + D + 1;
        let middle =
            std::array::from_fn(|axis| nodes.iter().map(|x| x[axis]).sum::<f64>() / n as f64);
        let mut a = DMatrix::zeros(size, size);
        let mut b = DMatrix::zeros(size, K);
        for (i, (x, y)) in nodes.iter().zip(targets).enumerate() {
            for (j, other) in nodes[..=i].iter().enumerate() {
                let phi = multiquadric(d, x, other);
                (a[(i, j)], a[(j, i)]) = (phi, phi);
            }
            for (l, p) in polynomial(x, &middle).into_iter().enumerate() {
                (a[(i, n + l)], a[(n + l, i)]) = (p, p);
            }
            for axis in 0..K {
                b[(i, axis)] = y[axis];
            }
        }
        let solution = a.lu().solve(&b).ok_or(AdaptError::Singular)?;
        if solution.iter().any(|s| !s.is_finite()) {
            return Err(AdaptError::Singular);
        }
        let row = |i: usize| std::array::from_fn(|axis| solution[(i, axis)]);
        let weights = (0..n).map(row).collect();
        let linear = (n..size).map(row).collect();
        Ok(Self { d, nodes: nodes.to_vec(), weights, linear, middle, rest: None })
    }

    /// Maps `x`.
    pub fn at(&self, x: &[f64; D]) -> [f64; K] {
        let mut y = [0.0; K];
        for (node, weight) in self.nodes.iter().zip(&self.weights) {
            let phi = multiquadric(self.d, x, node);
            for axis in 0..K {
                y[axis] += phi * weight[axis];
            }
        }
        for (p, coefficients) in polynomial(x, &self.middle).into_iter().zip(&self.linear) {
            for axis in 0..K {
                y[axis] += p * coefficients[axis];
            }
        }
        if let Some(rest) = &self.rest {
            let more = rest.at(x);
            (0..K).for_each(|axis| y[axis] += more[axis]);
        }
        y
    }
}

/// The linear polynomials at `x`: its coordinates from `middle`, and 1.
fn polynomial<const D: usize>(x: &[f64; D], middle: &[f64; D]) -> impl IntoIterator<Item = f64> {
    let shifted: [f64; D] = std::array::from_fn(|axis| x[axis] - middle[axis]);
    shifted.into_iter().chain([1.0])
}

fn squared_distance<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (0..D).map(|axis| (a[axis] - b[axis]) * (a[axis] - b[axis])).sum()
}

fn multiquadric<const D: usize>(d: f64, a: &[f64; D], b: &[f64; D]) -> f64 {
    (d * d + squared_distance(a, b)).sqrt()
}

fn check<const D: usize, const K: usize>(
    d: f64,
    nodes: &[[f64; D]],
    targets: &[[f64; K]],
) -> Result<(), AdaptError> {
    if !(d.is_finite() && d >= 0.0) {
        return Err(AdaptError::Basis(d));
    }
    if nodes.len() != targets.len() {
        return Err(AdaptError::Count { nodes: nodes.len(), targets: targets.len() });
    }
    if !(D + 1..=MAX_NODES).contains(&nodes.len()) {
        return Err(AdaptError::Nodes { found: nodes.len(), least: D + 1, most: MAX_NODES });
    }
    let finite = |i: usize| nodes[i].iter().chain(&targets[i]).all(|v| v.is_finite());
    if let Some(i) = (0..nodes.len()).find(|&i| !finite(i)) {
        return Err(AdaptError::NotFinite(i));
    }
    let mean: [f64; D] =
        std::array::from_fn(|axis| nodes.iter().map(|x| x[axis]).sum::<f64>() / nodes.len() as f64);
    let extent2 = nodes.iter().map(|x| squared_distance(x, &mean)).fold(0.0, f64::max);
    for (i, x) in nodes.iter().enumerate() {
        for (j, other) in nodes[..i].iter().enumerate() {
            // Not `<`: if all nodes coincide, extent and distance are both 0.
            if squared_distance(x, other) <= extent2 * DUPLICATE * DUPLICATE {
                return Err(AdaptError::Duplicate(j, i));
            }
        }
    }
    let spread = DMatrix::from_fn(nodes.len(), D, |i, axis| nodes[i][axis] - mean[axis]);
    let widths = spread.singular_values();
    if widths.min() <= FLAT * widths.max() { Err(AdaptError::Flat) } else { Ok(()) }
}
