//! How thick a limb is round a joint.

use super::section::STEP;

/// From one level that is looked at to the next, in body scales: two levels.
const EVERY: f64 = 2.0 * STEP;

/// How thick a limb is round a joint: a mean over bodies, and the ways in which bodies differ from it.
#[derive(Debug)]
pub(super) struct Girth<const PLACES: usize, const MODES: usize> {
    /// The first level that is looked at, from the joint towards the end of the limb, in body scales.
    pub(super) first: f64,
    /// What is compared of the lengths of level-set curves.
    pub(super) measure: Measure,
    /// The measure at each level.
    pub(super) mean: [f64; PLACES],
    /// Orthogonal, each as long as the part of a deviation along it that counts for nothing. The first two are thicker or thinner
    /// as a whole, and towards one end.
    pub(super) modes: [[f64; PLACES]; MODES],
    /// Standard deviation of what is left.
    pub(super) rest: f64,
}

/// What is compared of the length of a curve.
#[derive(Debug, Clone, Copy)]
pub(super) enum Measure {
    /// Its logarithm, of a length in body scales: a limb twice as thick has the same ups and downs.
    Logarithm,
    /// Over the average, which is this in body scales: a layer of fat makes all curves longer by the same.
    Length(f64),
}

impl Measure {
    fn of(self, length: f64) -> f64 {
        match self {
            Self::Logarithm => length.max(f64::MIN_POSITIVE).ln(),
            Self::Length(average) => length / average,
        }
    }
}

impl<const PLACES: usize, const MODES: usize> Girth<PLACES, MODES> {
    /// How far the limb with these lengths of curves is from having its joint `at` so far from its end, in body scales: the
    /// squared deviation in units of the expected variance (Tipping and Bishop 1999).
    pub(super) fn misfit(&self, perimeter: &[f64], at: f64) -> f64 {
        let deviations: [f64; PLACES] = std::array::from_fn(|index| {
            let level = at + self.first + index as f64 * EVERY;
            self.measure.of(length(perimeter, level)) - self.mean[index]
        });
        let dot =
            |mode: &[f64; PLACES]| mode.iter().zip(&deviations).map(|(a, b)| a * b).sum::<f64>();
        let square: f64 = deviations.iter().map(|deviation| deviation * deviation).sum();
        let explained: f64 = self.modes.iter().map(|mode| dot(mode).powi(2)).sum();
        (square - explained).max(0.0) / (self.rest * self.rest)
    }
}

/// The length of the curve at `level`, and between two levels in between.
fn length(perimeter: &[f64], level: f64) -> f64 {
    let last = perimeter.len().saturating_sub(1);
    let at = (level / STEP - 1.0).clamp(0.0, last as f64);
    let (below, part) = (at.floor() as usize, at.fract());
    let of = |index: usize| perimeter.get(index.min(last)).copied().unwrap_or(0.0);
    of(below) + (of(below + 1) - of(below)) * part
}
