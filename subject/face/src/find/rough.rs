//! A face that was found, as the search of its points takes it.

use super::Found;
use crate::points::Rough;

/// A detected mouth may be the base of the nose, which is 0.8 of the eyes' distance below them, often so by the paper's way;
/// no mouth is nearer than this (in their distance), nor this far aside in a face that is not turned too far.
const MOUTH_BELOW_MIN: f64 = 1.05;
const MOUTH_ASIDE: f64 = 0.3;

impl From<&Found> for Rough {
    fn from(found: &Found) -> Self {
        let [left_eye, right_eye] = found.eyes;
        let across = [right_eye[0] - left_eye[0], right_eye[1] - left_eye[1]];
        let squared = (across[0] * across[0] + across[1] * across[1]).max(f64::MIN_POSITIVE);
        let middle = [(left_eye[0] + right_eye[0]) / 2.0, (left_eye[1] + right_eye[1]) / 2.0];
        let to = [found.mouth[0] - middle[0], found.mouth[1] - middle[1]];
        let aside = (to[0] * across[0] + to[1] * across[1]) / squared;
        let below = (to[1] * across[0] - to[0] * across[1]) / squared;
        let (aside, below) = (aside.clamp(-MOUTH_ASIDE, MOUTH_ASIDE), below.max(MOUTH_BELOW_MIN));
        let mouth = [
            middle[0] + aside * across[0] - below * across[1],
            middle[1] + aside * across[1] + below * across[0],
        ];
        Rough { left_eye, right_eye, mouth }
    }
}
