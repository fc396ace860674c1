//! The marks along a limb, in body scales from its end: what the landmarks are placed by.

use super::girth_weights;
use super::hinge::{Window, bend};
use super::least::Least;
use super::section::{STEP, Sections, level};
use super::wrist::wrist;

/// The middle of the ankle, from the end of the foot, on average.
const ANKLE: f64 = 0.128;
/// Where the curves come to the heel, from the end of the foot, on average.
const HEEL: f64 = 0.119;
/// The heel is taken no farther than this from there.
const HEEL_REACH: f64 = 0.03;
/// From there to the middle of the ankle.
const HEEL_TO_ANKLE: f64 = 0.009;
/// From there to the middle of the knee.
const HEEL_TO_KNEE: f64 = 0.225;
/// How far the knee may be from there.
const KNEE_REACH: f64 = 0.07;
/// The groin, from the end of the foot.
const GROIN: f64 = 0.558;
/// The armpit, from the end of the hand, on average.
const ARMPIT: f64 = 0.387;
/// The same as a part of the way between the hands.
const ARMPIT_OF_HANDS: f64 = 0.402;
/// The armpit as the curve's widening has it is taken no farther than this from the average.
const ARMPIT_REACH: f64 = 0.05;
/// How much the widening counts, the way between the hands, and the average. Raised arms widen late, and stout ones early.
const ARMPIT_WEIGHTS: [f64; 3] = [0.4, 0.3, 0.3];
/// Where between wrist and armpit the elbow is on average.
const ELBOW: f64 = 0.505;
/// The levels of the upper arm, whose girth the widening is measured by: stout or lean, it is that of the trunk that counts.
const UPPER_ARM: [f64; 2] = [0.28, 0.33];
/// The curve round the arm is so much longer at the armpit than round the upper arm.
const WIDENED: f64 = 1.6;
/// [`Window::weight`] of the elbow, whose centre line is straight on both sides.
const ELBOW_WEIGHT: f64 = 1e-3;
/// [`Window::rounded`] of the elbow. Where the middle of a long corner is taken for the line, the elbow is drawn to the middle of
/// the arm.
const ELBOW_ROUNDED: f64 = 0.015;
/// How much the girth counts at the elbow, which changes little along an arm, and with the muscles.
const ELBOW_GIRTH: f64 = 5e-7;
/// [`Window::weight`] of the knee: the calf alone bends the centre line. By it a misfit of 2e-5 is one of variance, and knees
/// are 0.02 from their average place.
const KNEE_WEIGHT: f64 = 0.05;
/// How much the girth counts at the knee: half of what it would if its deviations were each for itself.
const KNEE_GIRTH: f64 = 1e-5;

/// The marks of an arm or a leg.
#[derive(Debug, Clone, Copy)]
pub(super) struct Marks {
    /// The wrist, or the ankle.
    pub(super) narrow: f64,
    /// Elbow or knee.
    pub(super) hinge: f64,
    /// Armpit or groin.
    pub(super) root: f64,
    /// [`Least::sharpness`] of the hinge.
    pub(super) sharpness: f64,
}

/// The marks of an arm: the wrist; the armpit, where the arm has widened to a multiple of the upper arm's; the elbow where the
/// centre line between them bends.
///
/// `hands` is the way between the hands, in body scales.
pub(super) fn arm(sections: &Sections, hands: f64) -> Option<Marks> {
    let perimeter = &sections.perimeter;
    let within = |from: f64, to: f64| {
        perimeter.iter().enumerate().filter(move |(index, _)| (from..to).contains(&level(*index)))
    };
    let narrow = wrist(perimeter)?;
    let upper: Vec<f64> = within(UPPER_ARM[0], UPPER_ARM[1]).map(|(_, length)| *length).collect();
    let upper = upper.iter().sum::<f64>() / upper.len().max(1) as f64;
    let widened = widens(perimeter, WIDENED * upper, narrow + 0.18).unwrap_or(ARMPIT);
    let widened = widened.clamp(ARMPIT - ARMPIT_REACH, ARMPIT + ARMPIT_REACH);
    let of_hands = ARMPIT_OF_HANDS * hands.clamp(0.8, 1.15);
    let evidence = [widened, of_hands, ARMPIT];
    let root = evidence.iter().zip(ARMPIT_WEIGHTS).map(|(at, weight)| at * weight).sum::<f64>();
    let length = root - narrow;
    let window = Window {
        line: [narrow + 0.02, root - 0.03],
        joint: [narrow + 0.3 * length, narrow + 0.7 * length],
        prior: narrow + ELBOW * length,
        weight: ELBOW_WEIGHT,
        rounded: ELBOW_ROUNDED,
    };
    let of_girth = |at| ELBOW_GIRTH * girth_weights::ELBOW.misfit(perimeter, at);
    let Least { level: hinge, sharpness } = bend(sections, &window, of_girth)?;
    Some(Marks { narrow, hinge, root, sharpness })
}

/// The marks of a leg. From the toes on, the curves come to the heel all at once, and are half-way between the thinnest of
/// the foot and the thickest round the heel at a place that is as far from the ankle and the knee on everybody.
pub(super) fn leg(sections: &Sections) -> Option<Marks> {
    let heel =
        heel(&sections.perimeter).unwrap_or(HEEL).clamp(HEEL - HEEL_REACH, HEEL + HEEL_REACH);
    let knee = heel + HEEL_TO_KNEE;
    let window = Window {
        line: [0.17, 0.53],
        joint: [knee - KNEE_REACH, knee + KNEE_REACH],
        prior: knee,
        weight: KNEE_WEIGHT,
        rounded: 0.0,
    };
    let of_girth = |at| KNEE_GIRTH * girth_weights::KNEE.misfit(&sections.perimeter, at);
    let Least { level: hinge, sharpness } = bend(sections, &window, of_girth)?;
    let narrow = f64::midpoint(ANKLE, heel + HEEL_TO_ANKLE);
    Some(Marks { narrow, hinge, root: GROIN, sharpness })
}

/// Where the curves come to the heel.
fn heel(perimeter: &[f64]) -> Option<f64> {
    let inside = |index: &usize, from: f64, to: f64| (from..to).contains(&level(*index));
    let of = |index: &usize| perimeter.get(*index).copied().unwrap_or(0.0);
    let by_length = |one: &usize, other: &usize| of(one).total_cmp(&of(other));
    let all = || 0..perimeter.len();
    let thickest = all().filter(|index| inside(index, 0.10, 0.19)).max_by(by_length)?;
    let thinnest = all().filter(|index| inside(index, 0.05, level(thickest))).min_by(by_length)?;
    let half = f64::midpoint(of(&thinnest), of(&thickest));
    widens(perimeter.get(..=thickest)?, half, level(thinnest))
}

/// The first level behind `from` where the curve is longer than `length`.
fn widens(perimeter: &[f64], length: f64, from: f64) -> Option<f64> {
    let mut pairs = perimeter.windows(2).enumerate().map(|(index, pair)| (index + 1, pair));
    pairs.find_map(|(index, pair)| {
        let [before, at] = pair else { return None };
        if level(index) <= from || *at <= length {
            return None;
        }
        let part = ((at - length) / (at - before).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        Some(level(index) - STEP * part)
    })
}

/// How far elbows are from their average place on the arm, as a standard deviation in body scales.
const ELBOW_VARIES: f64 = 0.012;
/// How far knees are from theirs.
const KNEE_VARIES: f64 = 0.008;

/// How far along the arm the elbow may be off, as a standard deviation in body scales: as much as elbows vary on a straight
/// arm, less the more sharply the arm bends.
pub(super) fn elbow_spread(sharpness: f64) -> f64 {
    spread(ELBOW_VARIES, ELBOW_WEIGHT, sharpness)
}

/// The same for a knee.
pub(super) fn knee_spread(sharpness: f64) -> f64 {
    spread(KNEE_VARIES, KNEE_WEIGHT, sharpness)
}

/// The prior alone has a sharpness of twice its weight, and costs are to each other as variances.
fn spread(varies: f64, weight: f64, sharpness: f64) -> f64 {
    varies * (2.0 * weight / sharpness.max(2.0 * weight)).sqrt()
}
