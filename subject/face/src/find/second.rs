//! A second look at what may be a face: straight at the landmarks that a glance finds there.

use super::frame::Frame;
use super::look::{LOOK, Look, look};
use super::octaves::Octaves;
use super::{Found, Photo};
use crate::points::Rough;
use crate::points::glance::{Glance, PATCHES_LOOK, TOLD, Told};

/// Bytes of a second look: how it looks in the frame of the landmarks, what lies around each of them, and how sure the first
/// look was.
pub const SECOND: usize = LOOK + PATCHES_LOOK + 1;

/// The nasion, by its number in iBUG-68: it lies where the middle of the face crosses the line of the eyes.
const NASION: usize = 27;
/// The turn by how far aside the nasion is, in distances of the eyes: of 600 random heads, whose turn is known. It lies before
/// the cylinder that a [`Frame`] takes a face for, so this is less than the cylinder's 4.
const TURN_BY_ASIDE: f32 = -2.4;

/// Beyond this turn, of 54 degrees, an eye is hidden.
const TURN_MOST: f32 = 0.6;

/// Where eyes and mouth are by a glance, and how it looks there; nothing where they give no frame that could be looked at.
pub(super) fn second(octaves: &Octaves, photo: &Photo, found: &Found) -> Option<(Frame, Look)> {
    let glance = Glance::at(photo, &Rough::from(found));
    let told = glance.told();
    let frame = frame(&glance, &told);
    let mut bytes = look(octaves, &frame);
    bytes.extend(glance.patches(&told));
    bytes.push((255.0 * found.score).round().clamp(0.0, 255.0) as u8);
    (bytes.len() == SECOND).then_some((frame, bytes))
}

fn frame(glance: &Glance, told: &Told) -> Frame {
    let mean = |range: std::ops::RangeInclusive<usize>| {
        let part = || TOLD.iter().zip(told).filter(|(landmark, _)| range.contains(landmark));
        let n = part().count().max(1) as f64;
        let sum = part().fold([0.0; 2], |s, (_, p)| [s[0] + p[0], s[1] + p[1]]);
        glance.to_photo([sum[0] / n, sum[1] / n]).map(|v| v as f32)
    };
    let (left, right, mouth) = (mean(36..=41), mean(42..=47), mean(48..=59));
    let nasion = mean(NASION..=NASION);
    let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
    let across = [right[0] - left[0], right[1] - left[1]];
    let wide = across[0] * across[0] + across[1] * across[1];
    let aside = (nasion[0] - origin[0]) * across[0] + (nasion[1] - origin[1]) * across[1];
    let turn = TURN_BY_ASIDE * aside / wide.max(f32::MIN_POSITIVE);
    let turn = turn.clamp(-TURN_MOST, TURN_MOST);
    let along = |i: usize| {
        let of = |point: &[f32; 2]| point.get(i).copied().unwrap_or_default();
        (of(&mouth) - of(&origin) + turn / 4.0 * of(&across)) / Frame::MOUTH
    };
    Frame { origin, across, down: [along(0), along(1)], turn }
}
