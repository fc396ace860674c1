//! Where the landmarks lie at first sight: linear regressions, one after the other, from how the crop looks to the face
//! (Xiong and De la Torre 2013). The first looks at the whole crop, each other one at what lies around the landmarks of the
//! one before it.
//!
//! What is said of all landmarks is a sum of a few ways in which faces differ in a crop: turned, nodding, wide, with an open
//! mouth, beside the middle. `benches/subject/face_glance.py` learns them, and how a look tells them, from random heads.

use std::ops::Range;

use super::RoughFace;
use super::crop::{Crop, HEIGHT, WIDTH};
use crate::oriented_gradients::{DIRECTIONS, FLOOR, Histograms, SLOPE_BYTES, byte, directions};
use crate::photo::Photo;
use crate::plane::Plane;
use crate::vector::{self, Point};

/// Landmarks that are told, by their numbers in iBUG-68: all that the generic face has.
pub const REGRESSED: [usize; 60] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25,
    26, 27, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51,
    52, 53, 54, 55, 56, 57, 58, 59, 62, 66,
];

/// The landmarks of [`REGRESSED`] in the crop (pixels).
pub type LandmarkPoints = [Point; REGRESSED.len()];

/// The mean of those told whose numbers in iBUG-68 are within the range.
pub(crate) fn mean(landmarks: &LandmarkPoints, range: Range<usize>) -> Point {
    let part = REGRESSED.iter().zip(landmarks).filter(|(landmark, _)| range.contains(landmark));
    vector::mean(part.map(|(_, at)| *at))
}

/// Pixels of the halved crop along the side of a cell: 0.27 of the eyes' distance.
const CELL: usize = 8;
/// Bytes of the look of a crop.
pub const CROP_FEATURES: usize = (WIDTH / 2 / CELL) * (HEIGHT / 2 / CELL) * (DIRECTIONS + 1);

/// Pixels of the halved crop along the side of a patch's cell: a fifth of the eyes' distance. A landmark lies where four
/// meet.
const PATCH_CELL: usize = 6;
const PATCH: usize = 2 * PATCH_CELL;
const PER_POINT: usize = 4 * DIRECTIONS;
/// Beyond that there is nothing else to be seen (pixels of the crop).
const FAR: f64 = 1e4;
/// Bytes of the look of all patches.
pub const PATCH_FEATURES: usize = PER_POINT * REGRESSED.len();

/// What a glance is at: a face's crop, and how it looks.
#[derive(Debug, Clone)]
pub struct LandmarkRegressor {
    crop: Crop,
    roots: Plane,
}

impl LandmarkRegressor {
    /// At the face that `rough` points at.
    #[must_use]
    pub fn new(photo: &Photo, rough: &RoughFace) -> LandmarkRegressor {
        let crop = Crop::cut(photo, rough);
        // Roots: noise in the dark is no slope, nor is that of light. Half as wide and as high.
        let luma = crop.plane(|[r, g, b]| 0.299 * r + 0.587 * g + 0.114 * b);
        let roots = luma.halved().map(|v| v.max(0.0).sqrt());
        LandmarkRegressor { crop, roots }
    }

    /// A point of the photograph in the crop (pixels).
    #[must_use]
    pub fn in_crop(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.in_crop(p)
    }

    /// A point of the crop in the photograph (pixels).
    #[must_use]
    pub fn to_photo(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.to_photo(p)
    }

    /// What the first regression looks at, [`CROP_FEATURES`] bytes: row by row, cell by cell, eight slopes from the right on
    /// clockwise, brightness.
    #[must_use]
    pub fn crop_features(&self) -> Vec<u8> {
        Histograms::pooled(&self.roots, CELL).bytes(0, |_, _| {})
    }

    /// What each other one does, [`PATCH_FEATURES`] bytes: landmark by landmark, its upper left cell first, then the upper
    /// right one, eight slopes from the right on clockwise.
    #[must_use]
    pub fn patch_features(&self, landmarks: &LandmarkPoints) -> Vec<u8> {
        landmarks.iter().flat_map(|point| patch(&self.roots, *point)).collect()
    }

    pub(super) fn crop(&self) -> &Crop {
        &self.crop
    }

    /// The landmarks, as they look to lie.
    #[must_use]
    pub fn predict(&self) -> LandmarkPoints {
        let mut landmarks = Stage::crop().predict(&self.crop_features());
        for stage in Stage::patches() {
            let moves = stage.predict(&self.patch_features(&landmarks));
            for (point, by) in landmarks.iter_mut().zip(moves) {
                *point = [point[0] + by[0], point[1] + by[1]];
            }
        }
        landmarks
    }
}

/// How it looks around a landmark, in the contrast of the whole patch.
fn patch(roots: &Plane, [x, y]: [f64; 2]) -> [u8; PER_POINT] {
    // A pixel of the halved crop lies between two of the crop; what is not a number becomes 0.
    let first = |v: f64| {
        let v = v.clamp(-FAR, FAR);
        (v / 2.0 - 0.25 - (PATCH - 1) as f64 / 2.0).round() as isize
    };
    let (left, top) = (first(x), first(y));
    let mut sums = [0.0_f32; PER_POINT];
    let mut energy = 0.0;
    for row in 0..PATCH {
        for column in 0..PATCH {
            let (x, y) = (left + column as isize, top + row as isize);
            let dx = roots.get(x + 1, y) - roots.get(x - 1, y);
            let dy = roots.get(x, y + 1) - roots.get(x, y - 1);
            let cell = 2 * (row / PATCH_CELL) + column / PATCH_CELL;
            for (direction, by) in directions(dx, dy) {
                if let Some(sum) = sums.get_mut(cell * DIRECTIONS + direction) {
                    *sum += by;
                }
            }
            energy += dx * dx + dy * dy;
        }
    }
    let contrast = (energy / (PATCH * PATCH) as f32).sqrt() + FLOOR;
    sums.map(|sum| byte(SLOPE_BYTES * sum / (PATCH_CELL * PATCH_CELL) as f32 / contrast))
}

/// Ways in which the landmarks are told to move.
const COMPONENTS: usize = 24;
/// x and y of each landmark.
const COORDINATES: usize = 2 * REGRESSED.len();
/// How many regressions look around landmarks.
const PATCH_STAGES: usize = 2;

/// Bytes of a number, and of what every stage begins with: where the landmarks are on the mean, how far each way moves them
/// (pixels of the crop); for each way, its constant, and the unit of its weights. A weight a byte follows, look by look,
/// for each way.
const F32: usize = 4;
const HEADER_BYTES: usize = F32 * (COORDINATES + COMPONENTS * COORDINATES + 2 * COMPONENTS);
const CROP_STAGE: usize = HEADER_BYTES + COMPONENTS * CROP_FEATURES;
const PATCH_STAGE: usize = HEADER_BYTES + COMPONENTS * PATCH_FEATURES;

/// Little-endian.
static TABLE: &[u8] = include_bytes!("../../data/face-glance.bin");
const _: () = assert!(
    include_bytes!("../../data/face-glance.bin").len() == CROP_STAGE + PATCH_STAGES * PATCH_STAGE,
    "face-glance.bin is of another size: learn it again by benches/subject/face_glance.py"
);

/// A linear regression from the bytes of a look to all landmarks.
struct Stage {
    bytes: &'static [u8],
}

impl Stage {
    /// From the cells of the crop to where the landmarks are.
    fn crop() -> Stage {
        Stage { bytes: TABLE.get(..CROP_STAGE).unwrap_or_default() }
    }

    /// From the patches around landmarks to how they are to be moved.
    fn patches() -> impl Iterator<Item = Stage> {
        let tables = TABLE.get(CROP_STAGE..).unwrap_or_default().chunks_exact(PATCH_STAGE);
        tables.map(|bytes| Stage { bytes })
    }

    /// Of each landmark, pixels of the crop.
    fn predict(&self, features: &[u8]) -> LandmarkPoints {
        let (head, weights) = self.bytes.split_at(HEADER_BYTES.min(self.bytes.len()));
        let mut numbers = head.chunks_exact(F32).filter_map(|bytes| bytes.try_into().ok());
        let mut next = || numbers.next().map_or(0.0, f32::from_le_bytes);
        let mut all: [f32; COORDINATES] = std::array::from_fn(|_| next());
        let components: [[f32; COORDINATES]; COMPONENTS] =
            std::array::from_fn(|_| std::array::from_fn(|_| next()));
        let added: [f32; COMPONENTS] = std::array::from_fn(|_| next());
        let unit: [f32; COMPONENTS] = std::array::from_fn(|_| next());
        let mut sums = [0_i32; COMPONENTS];
        for (byte, weights) in features.iter().zip(weights.chunks_exact(COMPONENTS)) {
            // 2016 bytes of 255 times 127 are far from the end of 32 bits.
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum += i32::from(*byte) * i32::from(weight.cast_signed());
            }
        }
        for (((component, sum), added), unit) in components.iter().zip(sums).zip(added).zip(unit) {
            let amount = added + unit * sum as f32;
            all.iter_mut().zip(component).for_each(|(at, by)| *at += amount * by);
        }
        let mut landmarks: LandmarkPoints = [[0.0; 2]; REGRESSED.len()];
        for (point, at) in landmarks.iter_mut().zip(all.chunks_exact(2)) {
            for (to, from) in point.iter_mut().zip(at) {
                *to = f64::from(*from);
            }
        }
        landmarks
    }
}

#[cfg(test)]
mod tests {
    //! Faces of the seeded renderer, which nothing here was learned from.

    use mocapd_testkit::photograph::Scene;

    use super::*;
    use crate::model::{FeatureId, Model};

    const INTEROCULAR_PX: f64 = 80.0;

    struct Drawn {
        photo: Photo,
        /// Those of [`REGRESSED`].
        landmarks: Vec<[f64; 2]>,
        rough: RoughFace,
    }

    fn drawn(seed: u64, yaw_deg: f64) -> Drawn {
        let picture = Scene::portrait(seed, INTEROCULAR_PX, yaw_deg).render().unwrap();
        let truth = &picture.faces[0];
        let features = &Model::generic().unwrap().features;
        let vertex = |name: &str| {
            let [x, y, _] = truth.vertices_px[features[name]];
            [x, y]
        };
        let landmark = |i: usize| match i {
            0..=7 => vertex(&format!("right_jaw_{}", i + 1)),
            8 => vertex("chin"),
            9..=16 => vertex(&format!("left_jaw_{}", 17 - i)),
            27 => vertex("nasion"),
            30 => vertex("nose_tip"),
            _ => {
                let [x, y, _] = truth.points_px[FeatureId::from_ibug(i).unwrap().index()];
                [x, y]
            }
        };
        let landmarks: Vec<_> = REGRESSED.iter().map(|i| landmark(*i)).collect();
        let middle = |range: Range<usize>| {
            let part: Vec<_> =
                REGRESSED.iter().zip(&landmarks).filter(|(i, _)| range.contains(i)).collect();
            [0, 1].map(|axis| part.iter().map(|(_, p)| p[axis]).sum::<f64>() / part.len() as f64)
        };
        let (w, h) = picture.image.dimensions();
        let pixels = picture.image.pixels().map(|p| p.0).collect();
        Drawn {
            photo: Photo::from_pixels(w as usize, h as usize, pixels).unwrap(),
            rough: RoughFace {
                left_eye: middle(36..42),
                right_eye: middle(42..48),
                mouth: middle(48..60),
            },
            landmarks,
        }
    }

    /// Mean distance of eyes, brows, nose and mouth, in outer eye corners' distances.
    fn off(drawn: &Drawn, glance: &LandmarkRegressor, landmarks: &LandmarkPoints) -> f64 {
        let inner = |i: &usize| (17..27).contains(i) || *i > 30;
        let far: Vec<f64> = REGRESSED
            .iter()
            .zip(landmarks)
            .zip(&drawn.landmarks)
            .filter(|((i, _), _)| inner(i))
            .map(|((_, landmarks), at)| {
                let [x, y] = glance.to_photo(*landmarks);
                (x - at[0]).hypot(y - at[1])
            })
            .collect();
        far.iter().sum::<f64>() / far.len() as f64 / INTEROCULAR_PX
    }

    #[test]
    fn a_glance_says_where_the_landmarks_are_however_the_head_turns() {
        for (seed, yaw_deg) in [(1, 0.0), (2, 15.0), (3, -15.0), (4, 30.0), (5, -30.0)] {
            let drawn = drawn(seed, yaw_deg);
            let glance = LandmarkRegressor::new(&drawn.photo, &drawn.rough);
            let off = off(&drawn, &glance, &glance.landmarks());
            assert!(off < 0.08, "seed {seed}, {yaw_deg} degrees: {off}");
        }
    }

    #[test]
    fn eyes_and_mouth_that_are_a_tenth_off_do_no_harm() {
        let mut drawn = drawn(6, 10.0);
        drawn.rough.left_eye[0] += 0.1 * INTEROCULAR_PX;
        drawn.rough.mouth[1] -= 0.1 * INTEROCULAR_PX;
        let glance = LandmarkRegressor::new(&drawn.photo, &drawn.rough);
        let off = off(&drawn, &glance, &glance.landmarks());
        assert!(off < 0.08, "{off}");
    }

    #[test]
    fn looks_are_as_long_as_the_table_has_weights() {
        let photo = Photo::from_pixels(100, 80, vec![[90; 3]; 8000]).unwrap();
        let (left_eye, right_eye, mouth) = ([1e300, -5.0], [20.0, f64::NAN], [0.0; 2]);
        let rough = RoughFace { left_eye, right_eye, mouth };
        let glance = LandmarkRegressor::new(&photo, &rough);
        assert_eq!(glance.cells().len(), CROP_FEATURES);
        let far: LandmarkPoints = [[f64::NAN, 1e300]; REGRESSED.len()];
        assert_eq!(glance.patches(&far).len(), PATCH_FEATURES);
        assert!(glance.landmarks().iter().flatten().all(|v| v.is_finite()));
    }
}
