//! How a face looks once it is upright, in bytes that regressions and trees ask about: a first look at where the template
//! has it, and a second one straight at the landmarks that a glance finds there.

use super::DetectedFace;
use super::frame::{Frame, length};
use crate::oriented_gradients::{DIRECTIONS, FLOOR, Histograms, MIDDLE, byte};
use crate::photo::Photo;
use crate::plane::{Plane, Pyramid};
use crate::points::RoughFace;
use crate::points::regressor::{LandmarkPoints, LandmarkRegressor, PATCH_FEATURES, mean};

/// Cells along each side, a quarter of the distance of the eyes wide: two and a half distances in all.
const SIDE: usize = 10;
/// Samples along the side of a cell.
const CELL: usize = 4;
/// Cells beyond the border, that contrast is told from.
const AROUND: usize = 1;
const SAMPLES: usize = (SIDE + 2 * AROUND) * CELL;
/// Where the cells begin, in distances of the eyes from the middle of the eyes.
const LEFT: f32 = -1.25;
const TOP: f32 = -0.75;
/// Between samples, in distances of the eyes.
const STEP: f32 = 1.0 / 16.0;
/// What is told of a cell: its slopes, its brightness, its contrast.
const FEATURES_PER_CELL: usize = DIRECTIONS + 2;
/// Numbers of one look.
pub const FEATURE_COUNT: usize = SIDE * SIDE * FEATURES_PER_CELL;
/// Bytes of twice the contrast.
const CONTRAST_BYTES: f32 = 40.0;

/// Bytes of a second look: how it looks in the frame of the landmarks, what lies around each of them, and how sure the first
/// look was.
pub const SECOND_STAGE_COUNT: usize = FEATURE_COUNT + PATCH_FEATURES + 1;
/// The nasion, by its number in iBUG-68: it lies where the middle of the face crosses the line of the eyes.
const NASION: usize = 27;
/// The turn by how far aside the nasion is, in distances of the eyes: of 600 random heads, whose turn is known. It lies before
/// the cylinder that a [`Frame`] takes a face for, so this is less than the cylinder's 4.
const TURN_BY_ASIDE: f32 = -2.4;
/// Beyond this turn, of 54 degrees, an eye is hidden.
const TURN_MOST: f32 = 0.6;

/// [`FEATURE_COUNT`] bytes, and more of a second look: row by row, cell by cell, eight slopes from the right on clockwise, brightness, contrast.
pub type FeatureVector = Vec<u8>;

/// Of the face that has this frame on the photograph.
pub(super) fn extract(pyramid: &Pyramid, frame: &Frame) -> FeatureVector {
    let Some((plane, done)) = pyramid.at(length(frame.down) * STEP) else { return Vec::new() };
    let by = 1.0 / done;
    let mut roots = Plane::filled(SAMPLES, SAMPLES, 0.0);
    for (y, row) in roots.values_mut().chunks_exact_mut(SAMPLES).enumerate() {
        for (x, value) in row.iter_mut().enumerate() {
            let at = |i: usize, from: f32| from + STEP * (i as f32 + 0.5 - (AROUND * CELL) as f32);
            let [px, py] = frame.at(at(x, LEFT), at(y, TOP));
            *value = plane.sample((px + 0.5) * by - 0.5, (py + 0.5) * by - 0.5).max(0.0).sqrt();
        }
    }
    let cells = Histograms::pooled(&roots, CELL);
    let energy = cells.inner(AROUND).map(|(_, _, cell)| cell.energy).sum::<f32>();
    let whole = (energy / (SIDE * SIDE) as f32).sqrt();
    cells.bytes(AROUND, |cell, bytes| {
        let own = cell.energy.sqrt() + FLOOR;
        bytes.push(byte(MIDDLE + CONTRAST_BYTES * (own / (whole + FLOOR)).log2()));
    })
}

/// The look of the mirror image.
pub(super) fn mirrored(features: &FeatureVector) -> FeatureVector {
    let swapped = |cell: &[u8]| -> [u8; FEATURES_PER_CELL] {
        let mut out = [0; FEATURES_PER_CELL];
        for (to, from) in out.iter_mut().zip([4, 3, 2, 1, 0, 7, 6, 5, 8, 9]) {
            *to = cell.get(from).copied().unwrap_or_default();
        }
        out
    };
    let rows = features.chunks(SIDE * FEATURES_PER_CELL);
    rows.flat_map(|row| row.chunks(FEATURES_PER_CELL).rev().flat_map(swapped)).collect()
}

/// Where eyes and mouth are by a glance, and how it looks there; nothing where they give no frame that could be looked at.
pub(super) fn second_stage(
    pyramid: &Pyramid,
    photo: &Photo,
    found: &DetectedFace,
) -> Option<(Frame, FeatureVector)> {
    let regressor = LandmarkRegressor::new(photo, &RoughFace::from(found));
    let landmarks = regressor.predict();
    let frame = frame(&regressor, &landmarks);
    let mut bytes = extract(pyramid, &frame);
    bytes.extend(regressor.patch_features(&landmarks));
    bytes.push((255.0 * found.score).round().clamp(0.0, 255.0) as u8);
    (bytes.len() == SECOND_STAGE_COUNT).then_some((frame, bytes))
}

fn frame(regressor: &LandmarkRegressor, landmarks: &LandmarkPoints) -> Frame {
    let at = |range| regressor.to_photo(mean(landmarks, range)).map(|v| v as f32);
    let (left, right, mouth) = (at(36..42), at(42..48), at(48..60));
    let nasion = at(NASION..NASION + 1);
    let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
    let across = [right[0] - left[0], right[1] - left[1]];
    let wide = across[0] * across[0] + across[1] * across[1];
    let aside = (nasion[0] - origin[0]) * across[0] + (nasion[1] - origin[1]) * across[1];
    let turn = TURN_BY_ASIDE * aside / wide.max(f32::MIN_POSITIVE);
    Frame::through([left, right], mouth, turn.clamp(-TURN_MOST, TURN_MOST))
}
