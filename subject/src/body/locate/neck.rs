//! Whether there is a neck, and so a head above it.

use super::section::level;

/// A head is thickest between these levels from its crown, in body scales.
const HEAD: [f64; 2] = [0.03, 0.13];
/// The neck is thinnest at most so far from there.
const NECK_ENDS: f64 = 0.24;
/// No neck is thicker: 0.38 at most, as they are and in other builds.
const NECK_MOST: f64 = 0.5;

/// The longest curve round the head over the shortest behind that, up to the shoulders. On what is left of a neck the curves
/// only grow, or go round shoulders and arms, and it is 1.
pub(super) fn narrows(perimeter: &[f64]) -> f64 {
    let within = |from: f64, to: f64| {
        perimeter.iter().enumerate().filter(move |(index, _)| (from..to).contains(&level(*index)))
    };
    let longest = within(HEAD[0], HEAD[1]).max_by(|one, other| one.1.total_cmp(other.1));
    let Some((at, longest)) = longest else { return 1.0 };
    let shortest = within(level(at), NECK_ENDS).map(|(_, length)| *length);
    let shortest = shortest.fold(*longest, f64::min);
    if shortest > NECK_MOST { 1.0 } else { longest / shortest.max(f64::MIN_POSITIVE) }
}
