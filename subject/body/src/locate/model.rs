//! Learned constants: joints as weighted means of landmarks, and the girths of limbs around their joints.
//!
//! `benches/subject/learn.py` writes both files in `data/` from two shapes of `MakeHuman`, the average man (mavg) and
//! the average woman (favg). Change them there.

use std::sync::LazyLock;

use serde::{Deserialize, de::DeserializeOwned};

use super::STEP;

/// Weights of landmarks for each joint.
pub(super) static JOINTS: LazyLock<JointModels> =
    LazyLock::new(|| built_in(include_str!("../../data/joint-weights.json")));

/// Girths of limbs.
pub(super) static GIRTHS: LazyLock<Girths> =
    LazyLock::new(|| built_in(include_str!("../../data/girths.json")));

/// Parses a built-in file, whose validity a test checks.
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
    /// Bone lengths of the average body, in body scales.
    pub(super) upper_arm: f64,
    pub(super) thigh: f64,
}

/// A joint as a weighted mean of landmarks. The weights of all spans add up to one, so the joint moves, turns and grows
/// with the body.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Model {
    /// Root mean square error on a shape that was not learned from, in body scales.
    pub(super) sigma: f64,
    pub(super) spans: Vec<Span>,
}

/// Weights of consecutive landmarks.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Span {
    pub(super) part: LandmarkGroup,
    pub(super) first: usize,
    pub(super) weights: Vec<f64>,
}

/// A group of landmarks, as seen from one side of the body.
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

/// Distance between the levels that are compared, in body scales: two levels.
const LEVEL_STEP: f64 = 2.0 * STEP;

/// Girth of a limb around a joint: a probabilistic principal component model (Tipping and Bishop 1999).
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Girth {
    /// First level that is compared, relative to the joint and towards the end of the limb, in body scales.
    pub(super) first: f64,
    /// Measure of the level-set curves' lengths.
    pub(super) measure: Measure,
    /// Mean of the measure at each level.
    pub(super) mean: Vec<f64>,
    /// Orthogonal modes, each scaled by the fraction of a deviation along it that adds nothing to the misfit. The first two are overall
    /// thickness and taper.
    modes: Vec<Vec<f64>>,
    /// Standard deviation of the residual.
    #[serde(rename = "rest")]
    residual_sd: f64,
}

/// A measure of a curve's length.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Measure {
    /// Logarithm of the length in body scales: a limb twice as thick has the same profile.
    #[default]
    Logarithm,
    /// Length relative to an average in body scales: a layer of fat lengthens all curves by the same amount.
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
    /// Misfit of a limb with these curve lengths to a joint at distance `at` from its end, in body scales: squared
    /// deviation in units of the expected variance (Tipping and Bishop 1999).
    pub(super) fn misfit(&self, perimeter: &[f64], at: f64) -> f64 {
        let deviation = |(index, mean): (usize, &f64)| {
            let level = at + self.first + index as f64 * LEVEL_STEP;
            self.measure.of(length(perimeter, level)) - mean
        };
        let deviations: Vec<f64> = self.mean.iter().enumerate().map(deviation).collect();
        let dot = |mode: &Vec<f64>| mode.iter().zip(&deviations).map(|(a, b)| a * b).sum::<f64>();
        let square: f64 = deviations.iter().map(|deviation| deviation * deviation).sum();
        let explained: f64 = self.modes.iter().map(|mode| dot(mode).powi(2)).sum();
        (square - explained).max(0.0) / (self.residual_sd * self.residual_sd)
    }
}

/// Length of the curve at `level`, interpolated.
fn length(perimeter: &[f64], level: f64) -> f64 {
    let last = perimeter.len().saturating_sub(1);
    let at = (level / STEP - 1.0).clamp(0.0, last as f64);
    let (below, part) = (at.floor() as usize, at.fract());
    let of = |index: usize| perimeter.get(index.min(last)).copied().unwrap_or(0.0);
    of(below) + (of(below + 1) - of(below)) * part
}
