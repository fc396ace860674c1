//! Where a limb bends.

use nalgebra::{Matrix3, Vector3};

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
    /// How far from the joint the centre line is round and no corner: points within this count less.
    pub(super) rounded: f64,
}

/// Fits two straight lines that meet to the centre line, for each place where they might meet, and weighs the misfit
/// against how thick the limb is there, and the place's distance from where the joint is on average.
///
/// A flexed limb has one place that fits. On a straight one all fit alike, and the girth decides; on one as thick everywhere,
/// the average. `of_girth` is what a place costs by the girth, in the unit of the two lines' mean square.
pub(super) fn bend(
    sections: &Sections,
    window: &Window,
    of_girth: impl Fn(f64) -> f64,
) -> Option<Least> {
    let points: Vec<(f64, Vector3<f64>)> = (0..)
        .map(level)
        .zip(&sections.centre)
        .filter(|(at, _)| (window.line[0]..=window.line[1]).contains(at))
        .map(|(at, centre)| (at, *centre))
        .collect();
    if points.len() < 6 {
        return None;
    }
    least(window.joint, |at| {
        let from_average = window.weight * (at - window.prior).powi(2);
        misfit(&points, at, window.rounded) + from_average + of_girth(at)
    })
}

/// Mean squared distance of the points from two lines that meet at `knot`, fitted by least squares. Points count the less the
/// nearer they are to the knot: by a Gaussian whose standard deviation is `rounded`.
fn misfit(points: &[(f64, Vector3<f64>)], knot: f64, rounded: f64) -> f64 {
    let mut normal = Matrix3::zeros();
    let mut right = Matrix3::zeros();
    let (mut square, mut total) = (0.0, 0.0);
    // Relative to the first point, or far from the origin the digits would go.
    let Some((_, origin)) = points.first().copied() else { return 0.0 };
    for (at, point) in points {
        let counts =
            if rounded > 0.0 { 1.0 - (-0.5 * ((at - knot) / rounded).powi(2)).exp() } else { 1.0 };
        let offset = (at - knot) / STEP;
        let row = Vector3::new(1.0, offset.min(0.0), offset.max(0.0));
        let point = point - origin;
        normal += row * row.transpose() * counts;
        right += row * point.transpose() * counts;
        square += point.norm_squared() * counts;
        total += counts;
    }
    // At least one point lies off the knot, for there are more than two.
    let total = f64::max(total, f64::MIN_POSITIVE);
    let Some(cholesky) = normal.cholesky() else { return square / total };
    let solution = cholesky.solve(&right);
    let explained = solution.component_mul(&right).sum();
    (square - explained).max(0.0) / total
}
