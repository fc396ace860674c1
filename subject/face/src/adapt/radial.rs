//! Interpolation by radial basis functions: a map that takes given nodes exactly to their targets and is smooth between
//! them.

use nalgebra::DMatrix;
use thiserror::Error;

/// Most nodes, since the solution takes cubic time; a face has 53.
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
        /// Least number: dimensions plus one.
        least: usize,
        /// Largest number.
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
    pub(super) weights: Vec<[f64; K]>,
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
