//! Level-set curves of the distance field of a limb, all levels in one pass, and the marks along the limb, in body
//! scales from its end, which place the landmarks.

use nalgebra::{Matrix3, Vector3};

use super::{STEP, model::GIRTHS};
use crate::{Mesh, mesh::Point};

/// Number of levels: up to 1.08 body scales from the end, past the far end of the trunk.
pub(super) const LEVELS: usize = 180;

/// Level-set curves of one extremity, in body scales: level `i` is `(i + 1) * STEP` from the end.
#[derive(Debug, Clone)]
pub struct Sections {
    /// Length of the curve at each level.
    pub perimeter: Vec<f64>,
    /// Centre of the curve, weighted by its length and by the weights of the vertices that it passes.
    pub centre: Vec<Point>,
}

#[derive(Clone, Copy, Default)]
struct Sum {
    perimeter: f64,
    weight: f64,
    moment: Point,
}

#[derive(Clone, Copy)]
struct Corner {
    level: f64,
    weight: f64,
    position: Point,
}

impl Sections {
    /// Cuts `mesh` by `field` (mesh's unit, one value per vertex; infinite if unreachable): (3) and (4) of (Yu et al.
    /// 2008), with points weighted by curve length, so that the size of triangles does not matter.
    ///
    /// `weights`, one per vertex, are 0 where the surface belongs to another limb. Levels farther than `reach` from the
    /// end, in body scales, stay empty. None if no level has a curve.
    pub(super) fn new(
        mesh: &Mesh,
        field: &[f64],
        weights: &[f64],
        scale: f64,
        reach: f64,
    ) -> Option<Self> {
        let mut sums = vec![Sum::default(); LEVELS];
        let end = ((reach / STEP).ceil() as usize).min(LEVELS);
        let corner = |vertex: usize| {
            let position = Point::from(*mesh.positions.get(vertex)?) / scale;
            let level = field.get(vertex)? / (scale * STEP);
            let weight = *weights.get(vertex)?;
            level.is_finite().then_some(Corner { level, weight, position })
        };
        let corners: Vec<Option<Corner>> = (0..mesh.positions.len()).map(corner).collect();
        for triangle in &mesh.triangles {
            let corner = |vertex: u32| corners.get(vertex as usize).copied().flatten();
            let [Some(a), Some(b), Some(c)] = triangle.map(corner) else { continue };
            if a.level.min(b.level).min(c.level) < end as f64 {
                cut([a, b, c], &mut sums[..end]);
            }
        }
        let perimeter: Vec<f64> = sums.iter().map(|sum| sum.perimeter).collect();
        let mut found = sums.iter().filter(|sum| sum.weight > 0.0);
        let mut last = found.next().map(|sum| sum.moment / sum.weight)?;
        let centres = sums.iter().map(|sum| {
            // An empty level repeats the previous centre.
            if sum.weight > 0.0 {
                last = sum.moment / sum.weight;
            }
            last
        });
        let centre: Vec<Point> = centres.collect();
        Some(Self {
            perimeter: smoothed(&perimeter, &[1.0, 2.0, 3.0, 2.0, 1.0]),
            centre: smoothed(&centre, &[1.0, 2.0, 1.0]),
        })
    }

    /// Centre of the curve at `level`, in body scales, interpolated.
    pub(super) fn centre_at(&self, level: f64) -> Point {
        let at = (level / STEP - 1.0).clamp(0.0, (LEVELS - 1) as f64 - 1e-9);
        let (below, part) = (at.floor() as usize, at.fract());
        match self.centre.get(below..below + 2) {
            Some([low, high]) => low.lerp(high, part),
            _ => Point::zeros(),
        }
    }
}

/// Position of level `index`, in body scales.
pub(super) fn level(index: usize) -> f64 {
    (index + 1) as f64 * STEP
}

/// The curves from one level up to another, the first included, with their indices.
pub(super) fn between(
    perimeter: &[f64],
    [from, to]: [f64; 2],
) -> impl Iterator<Item = (usize, f64)> {
    let curves = perimeter.iter().copied().enumerate();
    curves.filter(move |(index, _)| (from..to).contains(&level(*index)))
}

/// Adds the pieces of the curves in one triangle: one for each whole number in `(least, greatest]` of its corners.
fn cut(mut corners: [Corner; 3], sums: &mut [Sum]) {
    corners.sort_by(|one, other| one.level.total_cmp(&other.level));
    let [low, middle, high] = corners;
    // The first level is 1, at index 0.
    let first = low.level.floor().max(0.0) as usize;
    let end = (high.level.floor().max(0.0) as usize).min(sums.len());
    for (index, sum) in sums.iter_mut().enumerate().take(end).skip(first) {
        let at = (index + 1) as f64;
        let from = passing(low, high, at);
        let to =
            if middle.level < at { passing(middle, high, at) } else { passing(low, middle, at) };
        let length = (from.0 - to.0).norm();
        let weight = length * f64::midpoint(from.1, to.1);
        sum.perimeter += length;
        sum.weight += weight;
        sum.moment += (from.0 + to.0) * (weight / 2.0);
    }
}

/// The point where the side from `low` to `high` has the value `level`, and its weight.
fn passing(low: Corner, high: Corner, level: f64) -> (Point, f64) {
    let span = high.level - low.level;
    let part = if span > 0.0 { ((level - low.level) / span).clamp(0.0, 1.0) } else { 0.0 };
    (low.position.lerp(&high.position, part), low.weight + (high.weight - low.weight) * part)
}

/// `values` convolved with a symmetric kernel of odd length; end values continue beyond the ends.
fn smoothed<T>(values: &[T], kernel: &[f64]) -> Vec<T>
where
    T: Copy + std::ops::Add<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let (reach, total) = (kernel.len() / 2, kernel.iter().sum::<f64>());
    let at = |index: usize| values.get(index.clamp(reach, values.len() + reach - 1) - reach);
    (0..values.len())
        .filter_map(|index| {
            let mut terms = kernel.iter().enumerate().filter_map(|(offset, weight)| {
                at(index + offset).map(|value| *value * (weight / total))
            });
            let first = terms.next()?;
            Some(terms.fold(first, |sum, term| sum + term))
        })
        .collect()
}

/// Average distance from the end of the foot to the middle of the ankle.
const ANKLE: f64 = 0.128;
/// Average distance from the end of the foot to where the curves reach the heel.
const HEEL: f64 = 0.119;
/// Largest deviation of the heel from that average.
const HEEL_REACH: f64 = 0.03;
/// From the heel to the middle of the ankle.
const HEEL_TO_ANKLE: f64 = 0.009;
/// From the heel to the middle of the knee.
const HEEL_TO_KNEE: f64 = 0.225;
/// Search range of the knee.
const KNEE_REACH: f64 = 0.07;
/// From the end of the foot to the groin.
const GROIN: f64 = 0.558;
/// Average distance from the end of the hand to the armpit.
const ARMPIT: f64 = 0.387;
/// The armpit as a fraction of the distance between the hands.
const ARMPIT_OF_HANDS: f64 = 0.402;
/// Largest deviation of the armpit by widening from the average.
const ARMPIT_REACH: f64 = 0.05;
/// Weights of the widening, of the distance between the hands, and of the average. Raised arms widen late, stout ones
/// early.
const ARMPIT_WEIGHTS: [f64; 3] = [0.4, 0.3, 0.3];
/// Average position of the elbow between wrist and armpit.
const ELBOW: f64 = 0.505;
/// Levels of the upper arm, whose girth is the reference for the widening: stout or lean, what counts is the trunk's
/// girth.
const UPPER_ARM: [f64; 2] = [0.28, 0.33];
/// Girth at the armpit relative to the upper arm.
const WIDENED: f64 = 1.6;
/// [`Window::weight`] of the elbow, whose centre line is straight on both sides.
const ELBOW_WEIGHT: f64 = 1e-3;
/// [`Window::rounded`] of the elbow. If the middle of a long corner counted for the lines, the elbow would be drawn to
/// the middle of the arm.
const ELBOW_ROUNDED: f64 = 0.015;
/// Weight of the girth at the elbow, which changes little along an arm, and with the muscles.
const ELBOW_GIRTH: f64 = 5e-7;
/// [`Window::weight`] of the knee: the calf alone bends the centre line. With it a misfit of 2e-5 is one variance, and
/// knees are 0.02 from their average place.
const KNEE_WEIGHT: f64 = 0.05;
/// Weight of the girth at the knee: half of what independent deviations would have.
const KNEE_GIRTH: f64 = 1e-5;

/// The marks of an arm or a leg.
#[derive(Debug, Clone, Copy)]
pub(super) struct Marks {
    /// Wrist or ankle.
    pub(super) narrow: f64,
    /// Elbow or knee.
    pub(super) hinge: f64,
    /// Armpit or groin.
    pub(super) root: f64,
    /// [`Minimum::sharpness`] of the hinge.
    pub(super) sharpness: f64,
}

/// The marks of an arm: the wrist; the armpit, where the girth reaches a multiple of the upper arm's; the elbow, where
/// the centre line between them bends.
///
/// `hands` is the geodesic distance between the hands, in body scales.
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

/// The marks of a leg. Going up from the toes, the curves jump to include the heel. The level half-way between the
/// thinnest curve of the foot and the thickest around the heel is equally far from ankle and knee on everybody.
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

/// The level at which the curves reach the heel.
fn heel(perimeter: &[f64]) -> Option<f64> {
    let by_length = |one: &(usize, f64), other: &(usize, f64)| one.1.total_cmp(&other.1);
    let (thickest, longest) = between(perimeter, [0.10, 0.19]).max_by(by_length)?;
    let (thinnest, shortest) = between(perimeter, [0.05, level(thickest)]).min_by(by_length)?;
    let half = f64::midpoint(shortest, longest);
    widens(perimeter.get(..=thickest)?, half, level(thinnest))
}

/// The first level after `from` where the curve is longer than `length`, interpolated.
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

/// Standard deviation of elbows from their average place on the arm, in body scales.
const ELBOW_SD: f64 = 0.012;
/// Standard deviation of knees from their average place on the leg, in body scales.
const KNEE_SD: f64 = 0.008;

/// Standard deviation of an elbow along the arm, in body scales: that of all elbows on a straight arm, and smaller the
/// more sharply the arm bends.
pub(super) fn elbow_sigma(sharpness: f64) -> f64 {
    hinge_sigma(ELBOW_SD, ELBOW_WEIGHT, sharpness)
}

/// Standard deviation of a knee along the leg, in body scales.
pub(super) fn knee_sigma(sharpness: f64) -> f64 {
    hinge_sigma(KNEE_SD, KNEE_WEIGHT, sharpness)
}

/// A variance is inversely proportional to the second derivative of the cost; that of the prior alone is twice its
/// weight.
fn hinge_sigma(varies: f64, weight: f64, sharpness: f64) -> f64 {
    varies * (2.0 * weight / sharpness.max(2.0 * weight)).sqrt()
}

/// Largest distance from the end of the hand to its thickest curve, in body scales.
const HAND_ENDS: f64 = 0.13;
/// Largest distance from that thickest curve to the thinnest one of the forearm.
const THINNEST_REACH: f64 = 0.11;
/// Girth at the wrist relative to the least girth. The minimum lies on the forearm, is hard to place on a lean one, and
/// the hand ends abruptly.
const HAND_TO_FOREARM: f64 = 1.2;
/// Search range of the wrist around the level of [`HAND_TO_FOREARM`], towards the hand and towards the elbow. Fat makes the forearm more like the
/// hand, and a stout hand then seems to end too early.
const WRIST_REACH: [f64; 2] = [0.02, 0.03];
/// Standard deviation of the wrist from that level.
const WRIST_SD: f64 = 0.01;
/// Weight of the girth: a quarter of what independent deviations would have.
const WRIST_GIRTH: f64 = 0.25;
/// Largest distance of a wrist from the end of the hand.
const WRIST_MAX: f64 = 0.17;

/// The wrist, in body scales from the end of the hand: where the hand, open or a fist, has narrowed almost to the
/// forearm, weighed against the girths of hand and forearm there.
pub(super) fn wrist(perimeter: &[f64]) -> Option<f64> {
    let narrowed = narrowed(perimeter)?.min(WRIST_MAX);
    let cost = |at: f64| {
        WRIST_GIRTH * GIRTHS.wrist.misfit(perimeter, at) + ((at - narrowed) / WRIST_SD).powi(2)
    };
    let found = minimise([narrowed - WRIST_REACH[0], narrowed + WRIST_REACH[1]], cost)?;
    Some(found.level.min(WRIST_MAX))
}

/// The level at which the hand has narrowed almost to the forearm.
fn narrowed(perimeter: &[f64]) -> Option<f64> {
    let by_length = |one: &(usize, f64), other: &(usize, f64)| one.1.total_cmp(&other.1);
    let (thickest, _) = between(perimeter, [0.0, HAND_ENDS]).max_by(by_length)?;
    let from = level(thickest) + STEP / 2.0;
    let (least, shortest) = between(perimeter, [from, from + THINNEST_REACH]).min_by(by_length)?;
    Some(narrowing_level(perimeter, HAND_TO_FOREARM * shortest, least))
}

/// The last level before `least` where the curve is longer than `length`, interpolated.
fn narrowing_level(perimeter: &[f64], length: f64, least: usize) -> f64 {
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

/// Search for the hinge of a limb.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Range of the centre line that is fitted, in body scales.
    pub(super) line: [f64; 2],
    /// Range of the joint.
    pub(super) joint: [f64; 2],
    /// Average place of the joint.
    pub(super) prior: f64,
    /// Cost of a deviation from there: mean squared misfit of the two lines per squared distance.
    pub(super) weight: f64,
    /// Radius of the rounded corner: points within it count less.
    pub(super) rounded: f64,
}

/// Finds the bend of a limb. For each candidate place, two straight lines that meet there are fitted to the centre
/// line; their misfit is weighed against the girth of the limb there and the distance from the joint's average place.
///
/// A flexed limb has one place that fits. On a straight limb all places fit alike and the girth decides; without a
/// change of girth, the average does. `of_girth` is the cost by girth, in the unit of the lines' mean square.
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

/// Mean squared distance of the points from two lines that meet at `knot`, fitted by least squares. Points near the
/// knot are down-weighted by a Gaussian of standard deviation `rounded`.
fn misfit(points: &[(f64, Point)], knot: f64, rounded: f64) -> f64 {
    let mut normal = Matrix3::zeros();
    let mut right = Matrix3::zeros();
    let (mut square, mut total) = (0.0, 0.0);
    // Relative to the first point, to keep digits far from the origin.
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
    // At least one point lies off the knot, since there are more than two.
    let total = f64::max(total, f64::MIN_POSITIVE);
    let Some(cholesky) = normal.cholesky() else { return square / total };
    let solution = cholesky.solve(&right);
    let explained = solution.component_mul(&right).sum();
    (square - explained).max(0.0) / total
}

/// Step of the search, in body scales.
const SEARCH_STEP: f64 = 0.004;
/// Maximum number of candidate places; the windows hold about thirty.
const SEARCH_STEPS_MAX: usize = 200;

/// The minimum of a cost along a limb.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    /// Place, in body scales from the end of the limb.
    pub(super) level: f64,
    /// Second derivative of the cost.
    pub(super) sharpness: f64,
}

/// Samples the cost from `low` to `high` and returns the vertex of the parabola through the minimum and its neighbours.
///
/// None if the range is empty.
fn minimise([low, high]: [f64; 2], cost: impl Fn(f64) -> f64) -> Option<Minimum> {
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

/// Offset of the vertex of the parabola through `index` and its neighbours, in steps, and the second difference there;
/// zeros at an end of `values` and on a line.
fn vertex_of_parabola(values: &[f64], index: usize) -> (f64, f64) {
    let three = index.checked_sub(1).and_then(|before| values.get(before..before + 3));
    let Some([before, at, after]) = three else { return (0.0, 0.0) };
    let curvature = before - 2.0 * at + after;
    if curvature.abs() < f64::EPSILON * at.abs() {
        return (0.0, 0.0);
    }
    (((before - after) / (2.0 * curvature)).clamp(-1.0, 1.0), curvature)
}
