//! Where a limb bends.

use nalgebra::{Matrix3, Vector3};

use super::girth_weights::KneeGirth;
use super::least::{Least, least};
use super::section::{STEP, Sections, level};

/// Where on a limb its middle joint is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// The levels of the centre line that are taken, in body scales.
    pub(super) line: [f64; 2],
    /// The levels between which the joint is.
    pub(super) joint: [f64; 2],
    /// Where it is on average.
    pub(super) prior: f64,
    /// How much a distance from there costs: mean square of the two lines' misfit, over distance squared.
    pub(super) weight: f64,
    /// How thick the limb is round the joint, and how much it counts that it is not: mean square of the two lines' misfit, over
    /// the misfit of the girth.
    pub(super) girth: Option<(&'static KneeGirth, f64)>,
}

/// Fits two straight lines that meet to the centre line, for each place where they might meet, and weighs the misfit
/// against how thick the limb is there, and the place's distance from where the joint is on average.
///
/// A flexed limb has one place that fits. On a straight one all fit alike, and the girth decides; on one as thick everywhere,
/// the average.
pub(super) fn bend(sections: &Sections, window: &Window) -> Option<Least> {
    let points: Vec<(f64, Vector3<f64>)> = (0..)
        .map(level)
        .zip(&sections.centre)
        .filter(|(at, _)| (window.line[0]..=window.line[1]).contains(at))
        .map(|(at, centre)| (at, *centre))
        .collect();
    if points.len() < 6 {
        return None;
    }
    let of_girth = |at: f64| {
        window.girth.map_or(0.0, |(girth, counts)| counts * girth.misfit(&sections.perimeter, at))
    };
    least(window.joint, |at| {
        misfit(&points, at) + window.weight * (at - window.prior).powi(2) + of_girth(at)
    })
}

/// Mean squared distance of the points from two lines that meet at `knot`, fitted by least squares.
fn misfit(points: &[(f64, Vector3<f64>)], knot: f64) -> f64 {
    let mut normal = Matrix3::zeros();
    let mut right = Matrix3::zeros();
    let mut square = 0.0;
    // Relative to the first point, or far from the origin the digits would go.
    let Some((_, origin)) = points.first().copied() else { return 0.0 };
    for (at, point) in points {
        let offset = (at - knot) / STEP;
        let row = Vector3::new(1.0, offset.min(0.0), offset.max(0.0));
        let point = point - origin;
        normal += row * row.transpose();
        right += row * point.transpose();
        square += point.norm_squared();
    }
    let Some(cholesky) = normal.cholesky() else { return square / points.len() as f64 };
    let solution = cholesky.solve(&right);
    let explained = solution.component_mul(&right).sum();
    (square - explained).max(0.0) / points.len() as f64
}
