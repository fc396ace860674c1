//! Whether there is a neck, and so a head above it.

use super::section::level;

/// A head is thickest between these levels from its crown, in body scales.
const HEAD: [f64; 2] = [0.03, 0.13];
/// The neck is thinnest at most so far from there.
const NECK_ENDS: f64 = 0.24;
/// No neck is thicker: 0.38 at most, as they are and in other builds.
const NECK_MOST: f64 = 0.5;

/// No head has less girth: the means are 0.33 of stature of men and 0.34 of women (ANSUR II, Gordon et al. 2014), those of hands
/// 0.12 and 0.11; curves that go round spread fingers have up to 0.25, measured.
const HEAD_LEAST: f64 = 0.27;
/// No neck is thinner behind a head of less than [`HEAD_STOUT`]: the means are 0.23 of stature of men and 0.20 of women, of
/// wrists 0.10 (ANSUR II); stout wrists of measured bodies have 0.14.
const NECK_LEAST: f64 = 0.16;
/// No hand is this thick.
const HEAD_STOUT: f64 = 0.36;

/// No curve round a hand is longer, in body scales, however its fingers are spread: 0.255 was seen of stout ones. One round a
/// head is.
const HAND_MOST: f64 = 0.30;
/// Where a hand ends on a body with its fist closed, in body scales.
const HAND_ENDS: f64 = 0.10;

/// Whether the curves round an arm's end may be those of a hand or of what is left of an arm, and not of a head.
pub(super) fn may_be_a_hand(perimeter: &[f64]) -> bool {
    let curves = perimeter.iter().enumerate().filter(|(index, _)| level(*index) < HAND_ENDS);
    curves.map(|(_, length)| *length).fold(0.0, f64::max) <= HAND_MOST
}

/// The curves round the head and behind it, in body scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neck {
    /// The longest round the head.
    pub head: f64,
    /// The shortest behind that, up to the shoulders.
    pub neck: f64,
}

impl Neck {
    /// The longest curve round the head over the shortest behind it. On what is left of a neck the curves only grow, or go
    /// round shoulders and arms, and it is 1.
    #[must_use]
    pub fn narrows(self) -> f64 {
        if self.neck > NECK_MOST { 1.0 } else { self.head / self.neck.max(f64::MIN_POSITIVE) }
    }

    /// Whether this may be a head, and is no hand and no stump that was taken for one.
    #[must_use]
    pub fn may_be_a_head(self) -> bool {
        let is_thin = self.head < HEAD_LEAST || (self.neck < NECK_LEAST && self.head < HEAD_STOUT);
        !is_thin
    }

    pub(super) fn new(perimeter: &[f64]) -> Self {
        let within = |from: f64, to: f64| {
            let at = perimeter.iter().enumerate();
            at.filter(move |(index, _)| (from..to).contains(&level(*index)))
        };
        let longest = within(HEAD[0], HEAD[1]).max_by(|one, other| one.1.total_cmp(other.1));
        let Some((at, longest)) = longest else { return Self { head: 0.0, neck: 0.0 } };
        let shortest = within(level(at), NECK_ENDS).map(|(_, length)| *length);
        Self { head: *longest, neck: shortest.fold(*longest, f64::min) }
    }
}
