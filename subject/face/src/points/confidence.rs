//! How sure the points of a whole face are: a logistic function of how clearly its features were seen where the generic
//! face, in one pose and one shape, has them.

use super::contour::Ray;
use super::glance::{TOLD, Told};
use super::look::{CLEAR_OUTLINE, FAINT, Seen, misfit, turn_deg};
use super::shape::Pose;

/// What the points of a face are judged by. Scores are contrasts (natural logarithms) less what the deviation costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Mean of the features' confidences, by their points.
    pub clear: f64,
    /// Score of the eye that was seen worse.
    pub eyes: f64,
    /// Score of the brow that was seen worse.
    pub brows: f64,
    /// Score of the nose.
    pub nose: f64,
    /// Score of the mouth.
    pub mouth: f64,
    /// How clear the outline is, on the average: as a point's confidence.
    pub outline: f64,
    /// Mean squared distance of what was seen from the fitted face (units of 6 px of the crop).
    pub misfit: f64,
    /// Sum of the squared coefficients of the fitted shape.
    pub strain: f64,
    /// How far the head nods either way (degrees).
    pub nod_deg: f64,
    /// How far the head's turn is from what the edge of what is seen says (degrees).
    pub turn_off_deg: f64,
    /// Mean distance of the fitted face from what the first glance said (pixels of the crop).
    pub glance_off: f64,
}

/// A term of the evidence: its weight, and the range that it is held to.
struct Term {
    weight: f64,
    low: f64,
    high: f64,
}

/// Learned by `benches/subject/face_confidence.py`, as all of these are.
const CONSTANT: f64 = -7.52;
const TERMS: [Term; Evidence::COUNT] = [
    Term { weight: 10.176, low: 0.0, high: 1.0 },
    Term { weight: 5.290, low: 0.0, high: 0.6 },
    Term { weight: 2.719, low: 0.0, high: 0.3 },
    Term { weight: 0.000, low: 0.0, high: 0.6 },
    Term { weight: 7.346, low: 0.0, high: 0.6 },
    Term { weight: 1.515, low: 0.2, high: 1.0 },
    Term { weight: -7.072, low: 0.0, high: 0.4 },
    Term { weight: -0.198, low: 0.0, high: 30.0 },
    Term { weight: -0.071, low: 0.0, high: 40.0 },
    Term { weight: -0.121, low: 0.0, high: 40.0 },
    Term { weight: -0.175, low: 0.0, high: 12.0 },
];

impl Evidence {
    /// How many terms there are.
    pub const COUNT: usize = 11;

    pub(super) fn of(pose: &Pose<'_>, seen: &Seen, line: &[Ray], told: &Told) -> Self {
        let held = |i: usize| seen.held.get(i).copied().unwrap_or_default();
        let clear = |ray: &Ray| (ray.contrast / CLEAR_OUTLINE).clamp(FAINT, 1.0);
        let counts = [6.0, 6.0, 5.0, 5.0, 5.0, 14.0];
        let points: f64 = counts.iter().sum();
        Self {
            clear: seen.clear.iter().zip(counts).map(|(clear, n)| clear * n).sum::<f64>() / points,
            eyes: held(0).min(held(1)),
            brows: held(2).min(held(3)),
            nose: held(4),
            mouth: held(5),
            outline: line.iter().map(clear).sum::<f64>() / line.len().max(1) as f64,
            misfit: misfit(pose, &seen.targets),
            strain: pose.strain(),
            nod_deg: pose.nod_deg().abs(),
            turn_off_deg: turn_deg(line, &pose.project())
                .map_or(0.0, |t| (t - pose.yaw_deg()).abs()),
            glance_off: off(pose, told),
        }
    }

    /// In the order of the fields.
    #[must_use]
    pub fn terms(&self) -> [f64; Self::COUNT] {
        let Self {
            clear,
            eyes,
            brows,
            nose,
            mouth,
            outline,
            misfit,
            strain,
            nod_deg,
            turn_off_deg,
            glance_off,
        } = *self;
        [
            clear,
            eyes,
            brows,
            nose,
            mouth,
            outline,
            misfit,
            strain,
            nod_deg,
            turn_off_deg,
            glance_off,
        ]
    }

    /// Logarithm of the odds that the points are less than a tenth of the outer eye corners' distance off, on the mean.
    pub(super) fn log_odds(&self) -> f64 {
        let held = |(term, value): (&Term, f64)| term.weight * value.clamp(term.low, term.high);
        CONSTANT + TERMS.iter().zip(self.terms()).map(held).sum::<f64>()
    }

    /// The probability of that, 0 to 1, on what it was learned from.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        1.0 / (1.0 + (-self.log_odds()).exp())
    }
}

/// Mean distance of the pose's landmarks from those told.
fn off(pose: &Pose<'_>, told: &Told) -> f64 {
    let p = pose.project();
    let far = |(landmark, at): (&usize, &[f64; 2])| {
        p.get(*landmark).map(|p| (p[0] - at[0]).hypot(p[1] - at[1]))
    };
    TOLD.iter().zip(told).filter_map(far).sum::<f64>() / TOLD.len() as f64
}
