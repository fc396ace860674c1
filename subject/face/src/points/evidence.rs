//! Locates features and outline near their places in a pose, and estimates the confidence of the whole face: a logistic
//! function of terms such as how clearly the features are visible at these places.

use super::crop::Maps;
use super::features::Ray;
use super::features::SearchResult;
use super::regressor::{LANDMARKS, PosedModel, Target};
use super::regressor::{LandmarkPoints, REGRESSED};
use super::{BROWS, EYES, MOUTH, NOSE, features};
use crate::plane::{Plane, Point, distance, middle};
use crate::pose::{EyeLine, YawRule};
use crate::table::f64s;

/// Standard deviations of a clearly visible point (pixels): eyelids and lips are edges, a brow is not.
const EYE_SD: f64 = 1.8;
const BROW_SD: f64 = 3.0;
const NOSE_SD: f64 = 2.5;
const MOUTH_SD: f64 = 2.5;
const OUTLINE_SD: f64 = 9.0;
/// Contrast (natural logarithm) at which a feature counts as clearly visible.
const CLEAR: f64 = 0.2;
/// Contrast, including colour, at which a piece of the outline counts as clearly visible.
const CLEAR_OUTLINE: f64 = 0.5;
/// Minimum confidence: even an invisible point lies within the search range.
pub const FAINT: f64 = 0.2;

/// Ratio of the head's yaw to that of the visible edge, which bulges on the far side: measured on the rendered faces of
/// `--example faces_points drawn`.
const OUTLINE_YAW_FACTOR: f64 = 1.2;

/// The features located from one pose.
#[derive(Default)]
pub(super) struct LocatedFeatures {
    pub(super) targets: Vec<Target>,
    /// For each eye, brow, nose and mouth: clearness (0 to 1), and the score less the cost of the deviation.
    pub(super) clear: Vec<f64>,
    pub(super) penalised: Vec<f64>,
}

impl LocatedFeatures {
    fn add<const N: usize>(&mut self, which: &[usize; N], found: &SearchResult<N>, sd: f64) {
        let clear = (found.score / CLEAR).clamp(FAINT, 1.0);
        self.clear.push(clear);
        self.penalised.push(found.penalised);
        for (landmark, at) in which.iter().zip(&found.points) {
            self.targets.push(Target { landmark: *landmark, at: *at, sd: sd / clear });
        }
    }
}

/// Searches every feature near its place in the pose.
pub(super) fn locate_features(maps: &Maps, pose: &PosedModel<'_>, reach: f64) -> LocatedFeatures {
    let p = pose.project();
    let mut located = LocatedFeatures::default();
    let mut lids = Vec::new();
    for which in EYES {
        let found = features::eye(maps, &pick(&p, which), reach);
        let [_, outer, inner, ..] = found.points;
        lids.push([outer, inner]);
        located.add(&which, &found, EYE_SD);
    }
    for (which, lid) in BROWS.into_iter().zip(lids) {
        located.add(&which, &features::brow(maps, &pick(&p, which), lid, reach), BROW_SD);
    }
    located.add(&NOSE, &features::nose(maps, &pick(&p, NOSE), reach), NOSE_SD);
    // A mouth moves more than other features.
    located.add(&MOUTH, &features::mouth(maps, &pick(&p, MOUTH), 1.2 * reach), MOUTH_SD);
    located
}

/// Mean squared distance of the targets from the pose, in units of 6 px, each target limited to 4.
fn misfit(pose: &PosedModel<'_>, targets: &[Target]) -> f64 {
    let p = pose.project();
    let sum: f64 = targets
        .iter()
        .filter_map(|t| p.get(t.landmark).map(|p| distance(*p, t.at)))
        .map(|d| (d / 6.0).min(2.0).powi(2))
        .sum();
    sum / targets.len().max(1) as f64
}

/// Dissimilarity of each pixel to the skin of cheeks and nose.
pub(super) fn unlike(maps: &Maps, pose: &PosedModel<'_>) -> Plane {
    let p = pose.project();
    maps.unlike_skin(&[middle(p[41], p[48]), middle(p[46], p[54]), middle(p[27], p[33])])
}

/// Traces the outline near its place in the pose.
fn trace(maps: &Maps, unlike: &Plane, p: &[Point; LANDMARKS], sd: f64) -> Vec<Ray> {
    let brow = (p[19][1] + p[24][1]) / 2.0;
    let across = |share: f64, y: f64| [p[0][0] + share * (p[16][0] - p[0][0]), y];
    // The forehead has no landmarks: it is three quarters as high above the brows as they are above the base of the
    // nose.
    let top = brow - 0.75 * (p[33][1] - brow);
    let temple = (brow + top) / 2.0;
    let mut hull: Vec<Point> = p.iter().take(17).copied().collect();
    hull.extend([across(0.15, temple), across(0.85, temple), across(0.4, top), across(0.6, top)]);
    hull.extend([p[17], p[26], p[36], p[45], p[33], p[30]]);
    let centre = middle(p[27], p[33]);
    features::trace(maps, unlike, centre, &features::hull_radii(&hull, centre), sd)
}

/// Traces the outline. Returns targets for the landmarks of the jaw, and the rays of the outline.
pub(super) fn locate_outline(
    maps: &Maps,
    unlike: &Plane,
    pose: &PosedModel<'_>,
    sd: f64,
) -> (Vec<Target>, Vec<Ray>) {
    let p = pose.project();
    let line = trace(maps, unlike, &p, sd);
    let centre = middle(p[27], p[33]);
    let target = |landmark: usize| {
        let at = p.get(landmark)?;
        let (ray, place) = features::towards(&line, centre, *at)?;
        Some(Target { landmark, at: place, sd: OUTLINE_SD / clearness(&ray) })
    };
    let targets = (0..17).filter_map(target).collect();
    (targets, line)
}

/// Yaw from the outline (degrees); none if the eyes are outside of it.
fn outline_yaw_deg(line: &[Ray], p: &[Point; LANDMARKS]) -> Option<f64> {
    let outline: Vec<_> = line.iter().map(|ray| ray.at).collect();
    let eyes = EyeLine::new(p[36], p[45], &outline).ok()?;
    Some(OUTLINE_YAW_FACTOR * eyes.yaw_deg(YawRule::Arcsine))
}

/// Clearness of a piece of the outline, used as a point's confidence.
pub(super) fn clearness(ray: &Ray) -> f64 {
    (ray.contrast / CLEAR_OUTLINE).clamp(FAINT, 1.0)
}

fn pick<const N: usize>(p: &[Point], which: [usize; N]) -> [Point; N] {
    which.map(|i| p.get(i).copied().unwrap_or([0.0; 2]))
}

/// Evidence for the confidence of a face. Scores are contrasts (natural logarithms) less the cost of the deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Mean confidence of the features, weighted by their number of points.
    pub clear: f64,
    /// Score of the less visible eye.
    pub eyes: f64,
    /// Score of the less visible brow.
    pub brows: f64,
    /// Score of the nose.
    pub nose: f64,
    /// Score of the mouth.
    pub mouth: f64,
    /// Mean clearness of the outline.
    pub outline: f64,
    /// Mean squared distance of the located points from the fitted face (units of 6 px of the crop).
    pub misfit: f64,
    /// Sum of the squared shape coefficients.
    pub strain: f64,
    /// Absolute pitch of the head (degrees).
    pub pitch_deg: f64,
    /// Difference between the head's yaw and that of the visible edge (degrees).
    pub yaw_mismatch_deg: f64,
    /// Mean distance of the fitted face from the regressor's landmarks (pixels of the crop).
    pub regressor_offset: f64,
}

/// A term of the logistic function: its weight, and the range to which it is clamped.
#[derive(Clone, Copy)]
struct Term {
    weight: f64,
    low: f64,
    high: f64,
}

/// Learned by `benches/subject/face_confidence.py`: the constant, then weight, minimum and maximum of each term.
const TABLE: &[u8; (1 + 3 * Evidence::COUNT) * size_of::<f64>()] =
    include_bytes!("../../data/face-confidence.bin");
const CONSTANT: f64 = f64s::<1>(TABLE, 0)[0];
const TERMS: [Term; Evidence::COUNT] = {
    let mut terms = [Term { weight: 0.0, low: 0.0, high: 0.0 }; Evidence::COUNT];
    let mut i = 0;
    while i < Evidence::COUNT {
        let [weight, low, high] = f64s(TABLE, (1 + 3 * i) * size_of::<f64>());
        terms[i] = Term { weight, low, high };
        i += 1;
    }
    terms
};

impl Evidence {
    /// Number of terms.
    pub const COUNT: usize = 11;

    pub(super) fn of(
        pose: &PosedModel<'_>,
        located: &LocatedFeatures,
        line: &[Ray],
        predicted: &LandmarkPoints,
    ) -> Self {
        let score = |i: usize| located.penalised.get(i).copied().unwrap_or_default();
        let counts = [6.0, 6.0, 5.0, 5.0, 5.0, 14.0];
        let points: f64 = counts.iter().sum();
        Self {
            clear: located.clear.iter().zip(counts).map(|(c, n)| c * n).sum::<f64>() / points,
            eyes: score(0).min(score(1)),
            brows: score(2).min(score(3)),
            nose: score(4),
            mouth: score(5),
            outline: line.iter().map(clearness).sum::<f64>() / line.len().max(1) as f64,
            misfit: misfit(pose, &located.targets),
            strain: pose.strain(),
            pitch_deg: pose.pitch_deg().abs(),
            yaw_mismatch_deg: outline_yaw_deg(line, &pose.project())
                .map_or(0.0, |t| (t - pose.yaw_deg()).abs()),
            regressor_offset: regressor_offset(pose, predicted),
        }
    }

    /// The terms in the order of the fields.
    #[must_use]
    pub fn terms(&self) -> [f64; Self::COUNT] {
        [
            self.clear,
            self.eyes,
            self.brows,
            self.nose,
            self.mouth,
            self.outline,
            self.misfit,
            self.strain,
            self.pitch_deg,
            self.yaw_mismatch_deg,
            self.regressor_offset,
        ]
    }

    /// Probability, 0 to 1, that the mean error of the points is below a tenth of the outer interocular distance, by a
    /// logistic function of the terms.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let weighted = |(term, value): (&Term, f64)| term.weight * value.clamp(term.low, term.high);
        let log_odds = CONSTANT + TERMS.iter().zip(self.terms()).map(weighted).sum::<f64>();
        1.0 / (1.0 + (-log_odds).exp())
    }
}

/// Mean distance of the pose's landmarks from the regressor's.
fn regressor_offset(pose: &PosedModel<'_>, landmarks: &LandmarkPoints) -> f64 {
    let p = pose.project();
    let pairs = REGRESSED.iter().zip(landmarks);
    let distances = pairs.filter_map(|(i, at)| p.get(*i).map(|p| distance(*p, *at)));
    distances.sum::<f64>() / REGRESSED.len() as f64
}
