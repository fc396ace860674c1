//! Which side is the left.

use nalgebra::Vector3;

/// The hips' axis and the legs' must agree at least so well, as the cosine of the angle between them, or it is not told.
const AGREEMENT_MIN: f64 = 0.3;

/// The same where one foot alone is seen: a leg that is turned out by 60 degrees does not tell.
const AGREEMENT_OF_ONE_MIN: f64 = 0.5;

/// The joints of one leg.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    pub(super) hip: Vector3<f64>,
    pub(super) knee: Vector3<f64>,
    pub(super) ankle: Vector3<f64>,
    /// A point in the front of the foot.
    pub(super) toes: Vector3<f64>,
    /// Whether the foot is in the scan.
    pub(super) has_foot: bool,
}

/// Which of two legs is the left; nothing if the feet do not tell.
///
/// Toes point forwards. Hip, knee and ankle bend about axes that run from right to left, so whatever they do, shank
/// upwards x foot forwards stays along these axes and points to the left.
pub(super) fn left(legs: [Leg; 2]) -> Option<usize> {
    let to_left = |leg: &Leg| (leg.knee - leg.ankle).cross(&(leg.toes - leg.ankle)).normalize();
    let feet: Vec<_> = legs.iter().filter(|leg| leg.has_foot).map(to_left).collect();
    let least = match feet.len() {
        0 => return None,
        1 => AGREEMENT_OF_ONE_MIN,
        _ => AGREEMENT_MIN,
    };
    // Two legs turned against each other cancel out, and the sum is short: not divided by its length for that.
    let sum: Vector3<f64> = feet.iter().sum();
    let agreement = (legs[0].hip - legs[1].hip).normalize().dot(&sum) / feet.len() as f64;
    (agreement.abs() >= least).then_some(usize::from(agreement < 0.0))
}
