//! Where the head turns, before anything else is known of it.

use super::look::{look, misfit, trace, turn_deg, unlike};
use super::maps::Maps;
use super::search::Point;
use super::shape::{Pose, Turn};

/// Yaws that are begun from (degrees): a step is what the search of a feature bridges.
const YAWS_DEG: [f64; 5] = [-40.0, -20.0, 0.0, 20.0, 40.0];
/// Of which so many are looked at in full: those whose outline fits best.
const LOOKED_AT: usize = 3;
/// How far a feature is looked for (pixels of the crop), and how far the outline.
const FIRST: (f64, f64) = (4.5, 14.0);
/// The mouth may be lower than it was told to be, or higher (pixels of the crop): those are begun from last.
const LOWER: [f64; 2] = [10.0, -8.0];

/// The poses to begin from, the likeliest first. Eyes and mouth lie nearly in a plane and cannot tell where a head turns;
/// the nose before them and the outline around them can.
pub(super) fn begin<'a>(maps: &Maps, frontal: &Pose<'a>, places: [Point; 3]) -> Vec<Pose<'a>> {
    let unlike = unlike(maps, frontal);
    let (reach, sd) = FIRST;
    let mut starts: Vec<(f64, f64, Pose<'a>)> = YAWS_DEG
        .into_iter()
        .map(|yaw| {
            let pose = frontal.turned(yaw, places);
            let (line, gain) = trace(maps, &unlike, &pose, sd);
            let seen_turn = turn_deg(&line, &pose.project()).unwrap_or(yaw);
            // The right yaw is the one that its own outline confirms; most heads look at the camera.
            let score =
                gain - 0.4 * ((seen_turn - yaw) / 20.0).powi(2) - 0.2 * (yaw / 30.0).powi(2);
            (score, seen_turn, pose)
        })
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(LOOKED_AT);
    for (score, _, pose) in &mut starts {
        let seen = look(maps, pose, reach);
        pose.fit(&seen.targets, Turn::UNKNOWN, 3);
        let weights = [1.0 / 3.0, 1.0 / 3.0, 0.5, 0.5, 0.6, 0.2];
        let features: f64 = seen.held.iter().zip(weights).map(|(s, w)| s * w).sum();
        *score += features - misfit(pose, &seen.targets) - 0.1 / 30.0 * pose.strain();
    }
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut poses: Vec<_> = starts.iter().map(|(_, yaw, _)| frontal.turned(*yaw, places)).collect();
    if let Some((_, yaw, _)) = starts.first() {
        let [left, right, mouth] = places;
        poses
            .extend(LOWER.map(|by| frontal.turned(*yaw, [left, right, [mouth[0], mouth[1] + by]])));
    }
    poses
}
