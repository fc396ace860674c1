//! Where the hand ends.

use super::girth_weights::WRIST;
use super::least::least;
use super::section::{STEP, level};

/// Where the hand is thickest: nearer to its end than this, in body scales.
const HAND_ENDS: f64 = 0.13;
/// The forearm is thinnest at most so far behind that.
const THINNEST_REACH: f64 = 0.11;
/// At the wrist the curve is about so much longer than where it is shortest, which is on the forearm: where exactly is hard to
/// say of a lean one, and the hand ends all at once.
const HAND_ENDED: f64 = 1.2;
/// How far the wrist is looked for from there, towards the hand and towards the elbow. A layer of fat makes the forearm more
/// like the hand, and a stout hand then seems to end too early.
const REACH: [f64; 2] = [0.02, 0.03];
/// How far it is from there, as a standard deviation.
const VARIES: f64 = 0.01;
/// How much the girth counts: a quarter of what it would if its deviations were each for itself.
const GIRTH: f64 = 0.25;
/// A wrist is no farther from the end of the hand than this.
const MOST: f64 = 0.17;

/// Where the wrist is, in body scales from the end of the hand: where the hand, open or a fist, has narrowed almost to the
/// forearm, weighed against how thick hand and forearm are round there.
pub(super) fn wrist(perimeter: &[f64]) -> Option<f64> {
    let narrowed = narrowed(perimeter)?.min(MOST);
    let cost = |at: f64| GIRTH * WRIST.misfit(perimeter, at) + ((at - narrowed) / VARIES).powi(2);
    let found = least([narrowed - REACH[0], narrowed + REACH[1]], cost)?;
    Some(found.level.min(MOST))
}

/// Where the hand has narrowed almost to the forearm.
fn narrowed(perimeter: &[f64]) -> Option<f64> {
    let within = |from: f64, to: f64| {
        perimeter.iter().enumerate().filter(move |(index, _)| (from..to).contains(&level(*index)))
    };
    let (thickest, _) = within(0.0, HAND_ENDS).max_by(|one, other| one.1.total_cmp(other.1))?;
    let behind = level(thickest) + STEP / 2.0;
    let (least, shortest) =
        within(behind, behind + THINNEST_REACH).min_by(|one, other| one.1.total_cmp(other.1))?;
    Some(narrows(perimeter, HAND_ENDED * shortest, least))
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
