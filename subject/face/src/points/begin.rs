//! Where a face is begun from: the rough place first, then others that it may be meant for.

use super::Rough;
use super::glance::{Glance, TOLD, Told};
use super::search::Point;

/// Where the mouth may be instead, in distances of the eyes: lower, as where a nose was taken for it, or higher.
const LOWER: [f64; 2] = [0.17, -0.13];

/// Where else to begin: where the first glance has eyes and mouth, so that a second one is straight at them; and with the
/// mouth elsewhere.
pub(super) fn others(rough: &Rough, glance: &Glance, told: &Told) -> [Rough; 3] {
    let at = |range: std::ops::Range<usize>| {
        let part = || TOLD.iter().zip(told).filter(|(landmark, _)| range.contains(landmark));
        let n = part().count().max(1) as f64;
        let sum = part().fold([0.0; 2], |s: Point, (_, p)| [s[0] + p[0], s[1] + p[1]]);
        glance.to_photo([sum[0] / n, sum[1] / n])
    };
    let again = Rough { left_eye: at(36..42), right_eye: at(42..48), mouth: at(48..60) };
    let ([ax, ay], [bx, by]) = (rough.left_eye, rough.right_eye);
    let [lower, higher] = LOWER.map(|by_eyes| {
        let [x, y] = rough.mouth;
        let mouth = [x - by_eyes * (by - ay), y + by_eyes * (bx - ax)];
        Rough { mouth, ..*rough }
    });
    [again, lower, higher]
}
