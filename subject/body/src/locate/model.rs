//! Joints as weighted means of landmarks.

use nalgebra::Vector3;

use super::Landmarks;

/// A run of landmarks, as seen from one side of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Arm,
    OtherArm,
    Leg,
    OtherLeg,
    Head,
}

/// Weights of landmarks that follow one another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) part: Part,
    pub(super) first: usize,
    pub(super) weights: &'static [f64],
}

/// Where a joint is among the landmarks. The weights of all spans add up to one: the joint then moves, turns and grows
/// with the body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Model {
    /// Root mean square of the error on a shape that was not learned from, in body scales.
    pub(super) sigma: f64,
    pub(super) spans: &'static [Span],
}

impl Model {
    /// The joint of the half `side`, in body scales.
    pub(super) fn locate(&self, landmarks: &Landmarks, side: usize) -> Vector3<f64> {
        let [one, other] = &landmarks.halves;
        let (own, other) = if side == 0 { (one, other) } else { (other, one) };
        let mut sum = Vector3::zeros();
        for span in self.spans {
            let points = match span.part {
                Part::Arm => &own.arm,
                Part::OtherArm => &other.arm,
                Part::Leg => &own.leg,
                Part::OtherLeg => &other.leg,
                Part::Head => &landmarks.head,
            };
            for (weight, point) in span.weights.iter().zip(points.iter().skip(span.first)) {
                sum += point * *weight;
            }
        }
        sum
    }

    /// The same for a joint in the middle of the body: as seen from both sides.
    pub(super) fn locate_midline(&self, landmarks: &Landmarks) -> Vector3<f64> {
        (self.locate(landmarks, 0) + self.locate(landmarks, 1)) / 2.0
    }
}
