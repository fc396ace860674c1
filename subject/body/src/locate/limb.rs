//! The marks along a limb, in body scales from its end: what the landmarks are placed by.

use nalgebra::{Matrix3, Vector3};

use super::model::GIRTHS;
use super::section::{STEP, Sections, between, level};
use crate::mesh::Point;

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
    /// [`Minimum::sharpness`] of the hinge.
    pub(super) sharpness: f64,
}

/// The marks of an arm: the wrist; the armpit, where the arm has widened to a multiple of the upper arm's; the elbow where the
/// centre line between them bends.
///
/// `hands` is the way between the hands, in body scales.
pub(super) fn arm(sections: &Sections, hands: f64) -> Option<Marks> {
    let perimeter = &sections.perimeter;
    let narrow = wrist(perimeter)?;
    let upper: Vec<f64> = between(perimeter, UPPER_ARM).map(|(_, length)| length).collect();
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
    let of_girth = |at| ELBOW_GIRTH * GIRTHS.elbow.misfit(perimeter, at);
    let Minimum { level: hinge, sharpness } = bend(sections, &window, of_girth)?;
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
    let of_girth = |at| KNEE_GIRTH * GIRTHS.knee.misfit(&sections.perimeter, at);
    let Minimum { level: hinge, sharpness } = bend(sections, &window, of_girth)?;
    let narrow = f64::midpoint(ANKLE, heel + HEEL_TO_ANKLE);
    Some(Marks { narrow, hinge, root: GROIN, sharpness })
}

/// Where the curves come to the heel.
fn heel(perimeter: &[f64]) -> Option<f64> {
    let by_length = |one: &(usize, f64), other: &(usize, f64)| one.1.total_cmp(&other.1);
    let (thickest, longest) = between(perimeter, [0.10, 0.19]).max_by(by_length)?;
    let (thinnest, shortest) = between(perimeter, [0.05, level(thickest)]).min_by(by_length)?;
    let half = f64::midpoint(shortest, longest);
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
const ELBOW_SD: f64 = 0.012;
/// How far knees are from theirs.
const KNEE_SD: f64 = 0.008;

/// How far along the arm the elbow may be off, as a standard deviation in body scales: as much as elbows vary on a straight
/// arm, less the more sharply the arm bends.
pub(super) fn elbow_sigma(sharpness: f64) -> f64 {
    hinge_sigma(ELBOW_SD, ELBOW_WEIGHT, sharpness)
}

/// The same for a knee.
pub(super) fn knee_sigma(sharpness: f64) -> f64 {
    hinge_sigma(KNEE_SD, KNEE_WEIGHT, sharpness)
}

/// The prior alone has a sharpness of twice its weight, and costs are to each other as variances.
fn hinge_sigma(varies: f64, weight: f64, sharpness: f64) -> f64 {
    varies * (2.0 * weight / sharpness.max(2.0 * weight)).sqrt()
}

/// Where the hand is thickest: nearer to its end than this, in body scales.
const HAND_ENDS: f64 = 0.13;
/// The forearm is thinnest at most so far behind that.
const THINNEST_REACH: f64 = 0.11;
/// At the wrist the curve is about so much longer than where it is shortest, which is on the forearm: where exactly is hard to
/// say of a lean one, and the hand ends all at once.
const HAND_TO_FOREARM: f64 = 1.2;
/// How far the wrist is looked for from there, towards the hand and towards the elbow. A layer of fat makes the forearm more
/// like the hand, and a stout hand then seems to end too early.
const WRIST_REACH: [f64; 2] = [0.02, 0.03];
/// How far it is from there, as a standard deviation.
const WRIST_SD: f64 = 0.01;
/// How much the girth counts: a quarter of what it would if its deviations were each for itself.
const WRIST_GIRTH: f64 = 0.25;
/// A wrist is no farther from the end of the hand than this.
const WRIST_MAX: f64 = 0.17;

/// Where the wrist is, in body scales from the end of the hand: where the hand, open or a fist, has narrowed almost to the
/// forearm, weighed against how thick hand and forearm are round there.
pub(super) fn wrist(perimeter: &[f64]) -> Option<f64> {
    let narrowed = narrowed(perimeter)?.min(WRIST_MAX);
    let cost = |at: f64| {
        WRIST_GIRTH * GIRTHS.wrist.misfit(perimeter, at) + ((at - narrowed) / WRIST_SD).powi(2)
    };
    let found = minimise([narrowed - WRIST_REACH[0], narrowed + WRIST_REACH[1]], cost)?;
    Some(found.level.min(WRIST_MAX))
}

/// Where the hand has narrowed almost to the forearm.
fn narrowed(perimeter: &[f64]) -> Option<f64> {
    let by_length = |one: &(usize, f64), other: &(usize, f64)| one.1.total_cmp(&other.1);
    let (thickest, _) = between(perimeter, [0.0, HAND_ENDS]).max_by(by_length)?;
    let behind = level(thickest) + STEP / 2.0;
    let (least, shortest) =
        between(perimeter, [behind, behind + THINNEST_REACH]).min_by(by_length)?;
    Some(narrows(perimeter, HAND_TO_FOREARM * shortest, least))
}

/// The last level before that of `least` where the curve is longer than `length`.
fn narrows(perimeter: &[f64], length: f64, least: usize) -> f64 {
    let before = perimeter.iter().enumerate().take(least).rev();
    let mut last = perimeter.get(least).copied().unwrap_or(length);
    for (index, at) in before {
        if *at > length {
            let part = ((at - length) / (at - last).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            return level(index) + STEP * part;
        }
        last = *at;
    }
    level(least)
}

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
) -> Option<Minimum> {
    let points: Vec<(f64, Point)> = (0..)
        .map(level)
        .zip(&sections.centre)
        .filter(|(at, _)| (window.line[0]..=window.line[1]).contains(at))
        .map(|(at, centre)| (at, *centre))
        .collect();
    if points.len() < 6 {
        return None;
    }
    minimise(window.joint, |at| {
        let from_average = window.weight * (at - window.prior).powi(2);
        misfit(&points, at, window.rounded) + from_average + of_girth(at)
    })
}

/// Mean squared distance of the points from two lines that meet at `knot`, fitted by least squares. Points count the less the
/// nearer they are to the knot: by a Gaussian whose standard deviation is `rounded`.
fn misfit(points: &[(f64, Point)], knot: f64, rounded: f64) -> f64 {
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

/// Distance between two places that are tried, in body scales.
const SEARCH_STEP: f64 = 0.004;
/// At most so many places are tried; the windows hold some thirty.
const SEARCH_STEPS_MAX: usize = 200;

/// The place of the least cost.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    /// Where, in body scales from the end of the limb.
    pub(super) level: f64,
    /// How sharply the cost rises to both sides: its second derivative.
    pub(super) sharpness: f64,
}

/// Tries places from `low` to `high`, and takes the lowest point of the parabola through the best and its neighbours.
///
/// Nothing if there is no place to try.
pub(super) fn minimise([low, high]: [f64; 2], cost: impl Fn(f64) -> f64) -> Option<Minimum> {
    let tries = (((high - low) / SEARCH_STEP).ceil().max(0.0) as usize).min(SEARCH_STEPS_MAX);
    let place = |index: usize| low + index as f64 * SEARCH_STEP;
    let costs: Vec<f64> = (0..tries).map(|index| cost(place(index))).collect();
    let (best, _) = costs.iter().enumerate().min_by(|one, other| one.1.total_cmp(other.1))?;
    let (offset, curvature) = vertex_of_parabola(&costs, best);
    Some(Minimum {
        level: place(best) + SEARCH_STEP * offset,
        sharpness: curvature / (SEARCH_STEP * SEARCH_STEP),
    })
}

/// Where between the neighbours of `index` the parabola through the three is least or greatest, in steps, and its second
/// difference there. At an end of `values`, and where they are on a line, 0.
fn vertex_of_parabola(values: &[f64], index: usize) -> (f64, f64) {
    let three = index.checked_sub(1).and_then(|before| values.get(before..before + 3));
    let Some([before, at, after]) = three else { return (0.0, 0.0) };
    let curvature = before - 2.0 * at + after;
    if curvature.abs() < f64::EPSILON * at.abs() {
        return (0.0, 0.0);
    }
    (((before - after) / (2.0 * curvature)).clamp(-1.0, 1.0), curvature)
}
