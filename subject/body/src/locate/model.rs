//! What was learned of bodies: joints as weighted means of landmarks, and how thick limbs are round their joints.
//!
//! `benches/subject/learn.py` writes both files of `data/`, from the shapes mavg and favg: it is changed there.

use std::sync::LazyLock;

use serde::{Deserialize, de::DeserializeOwned};

use super::section::STEP;

/// Where joints are among the landmarks.
pub(super) static JOINTS: LazyLock<JointModels> =
    LazyLock::new(|| built_in(include_str!("../../data/joint-weights.json")));

/// How thick limbs are.
pub(super) static GIRTHS: LazyLock<Girths> =
    LazyLock::new(|| built_in(include_str!("../../data/girths.json")));

/// A file that is built in, and is read by tests: it has no error.
fn built_in<T: DeserializeOwned + Default>(json: &str) -> T {
    serde_json::from_str(json).unwrap_or_default()
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointModels {
    pub(super) head: Model,
    pub(super) throat: Model,
    pub(super) shoulder: Model,
    pub(super) elbow: Model,
    pub(super) wrist: Model,
    pub(super) hip: Model,
    pub(super) knee: Model,
    pub(super) ankle: Model,
    /// Length of the average body's, in body scales.
    pub(super) upper_arm: f64,
    pub(super) thigh: f64,
}

/// Where a joint is among the landmarks. The weights of all spans add up to one: the joint then moves, turns and grows
/// with the body.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Model {
    /// Root mean square of the error on a shape that was not learned from, in body scales.
    pub(super) sigma: f64,
    pub(super) spans: Vec<Span>,
}

/// Weights of landmarks that follow one another.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Span {
    pub(super) part: LandmarkGroup,
    pub(super) first: usize,
    pub(super) weights: Vec<f64>,
}

/// A run of landmarks, as seen from one side of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum LandmarkGroup {
    Arm,
    OtherArm,
    Leg,
    OtherLeg,
    Head,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Girths {
    pub(super) knee: Girth,
    pub(super) elbow: Girth,
    pub(super) wrist: Girth,
}

/// From one level that is looked at to the next, in body scales: two levels.
const LEVEL_STEP: f64 = 2.0 * STEP;

/// How thick a limb is round a joint: a mean over bodies, and the ways in which bodies differ from it.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Girth {
    /// The first level that is looked at, from the joint towards the end of the limb, in body scales.
    pub(super) first: f64,
    /// What is compared of the lengths of level-set curves.
    pub(super) measure: Measure,
    /// The measure at each level.
    pub(super) mean: Vec<f64>,
    /// Orthogonal, each as long as the part of a deviation along it that counts for nothing. The first two are thicker or thinner
    /// as a whole, and towards one end.
    modes: Vec<Vec<f64>>,
    /// Standard deviation of what is left.
    rest: f64,
}

/// What is compared of the length of a curve.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Measure {
    /// Its logarithm, of a length in body scales: a limb twice as thick has the same ups and downs.
    #[default]
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

impl Girth {
    /// How far the limb with these lengths of curves is from having its joint `at` so far from its end, in body scales: the
    /// squared deviation in units of the expected variance (Tipping and Bishop 1999).
    pub(super) fn misfit(&self, perimeter: &[f64], at: f64) -> f64 {
        let deviation = |(index, mean): (usize, &f64)| {
            let level = at + self.first + index as f64 * LEVEL_STEP;
            self.measure.of(length(perimeter, level)) - mean
        };
        let deviations: Vec<f64> = self.mean.iter().enumerate().map(deviation).collect();
        let dot = |mode: &Vec<f64>| mode.iter().zip(&deviations).map(|(a, b)| a * b).sum::<f64>();
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
