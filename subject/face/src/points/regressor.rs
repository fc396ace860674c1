//! Landmark regressor: a cascade of linear regressions from image features to landmark positions (supervised descent,
//! Xiong and De la Torre 2013). The first stage uses the whole crop, the others patches around the landmarks of the
//! stage before.
//!
//! Each stage predicts 24 components, the principal ways in which faces differ in a crop: yaw, pitch, width, an open
//! mouth, an offset from the centre. `benches/subject/face_glance.py` learns the components and their regressions from
//! random heads. The positions then fit a linear model of their shape, by a weak-perspective fit.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Matrix2x3, Vector3};

use super::{
    RoughFace,
    crop::{Crop, HEIGHT, WIDTH},
};
use crate::{
    model::{FeatureId, Model, OUTER_EYES_MM},
    oriented_gradients::{DIRECTIONS, FLOOR, Histograms, SLOPE_BYTES, byte, directions},
    photo::Photo,
    plane::{self, Plane, Point},
};

/// The landmarks that are predicted, by iBUG-68 number: all that the generic face has.
pub const REGRESSED: [usize; 60] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25,
    26, 27, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51,
    52, 53, 54, 55, 56, 57, 58, 59, 62, 66,
];

/// Positions of the landmarks [`REGRESSED`] in the crop (pixels).
pub type LandmarkPoints = [Point; REGRESSED.len()];

/// The mean of the landmarks whose iBUG-68 numbers lie in the range.
pub(crate) fn mean(landmarks: &LandmarkPoints, range: Range<usize>) -> Point {
    let part = REGRESSED.iter().zip(landmarks).filter(|(landmark, _)| range.contains(landmark));
    plane::mean(part.map(|(_, at)| *at))
}

/// Side of a cell in pixels of the halved crop: 0.27 of the eye distance.
const CELL: usize = 8;
/// Number of features of the whole crop.
pub const CROP_FEATURES: usize = (WIDTH / 2 / CELL) * (HEIGHT / 2 / CELL) * (DIRECTIONS + 1);

/// Side of a patch's cell in pixels of the halved crop: a fifth of the eye distance. Four cells meet at the landmark.
const PATCH_CELL: usize = 6;
const PATCH: usize = 2 * PATCH_CELL;
const PER_POINT: usize = 4 * DIRECTIONS;
/// Bound on coordinates (pixels of the crop); beyond it the border repeats.
const FAR: f64 = 1e4;
/// Number of features of all patches.
pub const PATCH_FEATURES: usize = PER_POINT * REGRESSED.len();

/// A face's crop, prepared for the regression of its landmarks.
#[derive(Debug, Clone)]
pub struct LandmarkRegressor {
    crop: Crop,
    roots: Plane,
}

impl LandmarkRegressor {
    /// Crops the face at `rough`.
    #[must_use]
    pub fn new(photo: &Photo, rough: &RoughFace) -> LandmarkRegressor {
        let crop = Crop::cut(photo, rough);
        // Square roots equalise the noise of dark and bright pixels. Half as wide and as high.
        let luma = crop.plane(|[r, g, b]| 0.299 * r + 0.587 * g + 0.114 * b);
        let roots = luma.halved().map(|v| v.max(0.0).sqrt());
        LandmarkRegressor { crop, roots }
    }

    /// Maps a point of the photograph to the crop (pixels).
    #[must_use]
    pub fn in_crop(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.in_crop(p)
    }

    /// Maps a point of the crop to the photograph (pixels).
    #[must_use]
    pub fn to_photo(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.to_photo(p)
    }

    /// Input of the first stage, [`CROP_FEATURES`] bytes: cell by cell in row order, eight gradients clockwise from the
    /// right, brightness.
    #[must_use]
    pub fn crop_features(&self) -> Vec<u8> {
        Histograms::pooled(&self.roots, CELL).bytes(0, |_, _| {})
    }

    /// Input of the other stages, [`PATCH_FEATURES`] bytes: landmark by landmark, its four cells in row order, eight
    /// gradients clockwise from the right.
    #[must_use]
    pub fn patch_features(&self, landmarks: &LandmarkPoints) -> Vec<u8> {
        landmarks.iter().flat_map(|point| patch(&self.roots, *point)).collect()
    }

    pub(super) fn crop(&self) -> &Crop {
        &self.crop
    }

    /// Predicts the landmarks.
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

/// Features of the patch around a landmark, normalised by the contrast of the whole patch.
fn patch(roots: &Plane, [x, y]: [f64; 2]) -> [u8; PER_POINT] {
    // A pixel of the halved crop lies between two of the crop; NaN becomes 0.
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

/// Number of components per stage.
const COMPONENTS: usize = 24;
/// Number of coordinates: x and y of each landmark.
const COORDINATES: usize = 2 * REGRESSED.len();
/// Number of stages that use patches.
const PATCH_STAGES: usize = 2;

/// Layout of a stage: mean positions, displacement per component (pixels of the crop), a constant per component, the
/// unit of its weights; then one weight byte per feature and component.
const F32: usize = 4;
const HEADER_BYTES: usize = F32 * (COORDINATES + COMPONENTS * COORDINATES + 2 * COMPONENTS);
const CROP_STAGE: usize = HEADER_BYTES + COMPONENTS * CROP_FEATURES;
const PATCH_STAGE: usize = HEADER_BYTES + COMPONENTS * PATCH_FEATURES;

/// Little-endian.
static TABLE: &[u8] = include_bytes!("../../data/face-glance.bin");

const _: () = assert!(
    include_bytes!("../../data/face-glance.bin").len() == CROP_STAGE + PATCH_STAGES * PATCH_STAGE,
    "face-glance.bin has the wrong size: regenerate it with benches/subject/face_glance.py"
);

/// A linear regression from feature bytes to all landmarks.
struct Stage {
    bytes: &'static [u8],
}

impl Stage {
    /// The first stage: from the crop's cells to positions.
    fn crop() -> Stage {
        Stage { bytes: TABLE.get(..CROP_STAGE).unwrap_or_default() }
    }

    /// The other stages: from patches to displacements.
    fn patches() -> impl Iterator<Item = Stage> {
        let tables = TABLE.get(CROP_STAGE..).unwrap_or_default().chunks_exact(PATCH_STAGE);
        tables.map(|bytes| Stage { bytes })
    }

    /// Position or displacement of each landmark, in pixels of the crop.
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
            // 2016 bytes of 255 times 127 are far below the limit of 32 bits.
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

/// Number of landmarks, in the order of iBUG-68. Those that the model lacks (the ridge of the nose, the inner lips
/// except their middles) lie at the nasion and are never searched.
pub(crate) const LANDMARKS: usize = 68;

/// Landmarks of the generic face and their modes, in outer interocular distances: x right, y down, z to the camera.
#[derive(Debug)]
pub(crate) struct Landmarks {
    mean: Vec<Vector3<f64>>,
    modes: Vec<Vec<Vector3<f64>>>,
}

impl Landmarks {
    pub(crate) fn of(model: &Model) -> Landmarks {
        let vertex = |name: &str| model.features.get(name).copied();
        let nasion = vertex("nasion").unwrap_or(0);
        let vertices: Vec<usize> = (0..LANDMARKS)
            .map(|i| {
                let named = match i {
                    0..=7 => vertex(&format!("right_jaw_{}", i + 1)),
                    8 => vertex("chin"),
                    9..=16 => vertex(&format!("left_jaw_{}", 17 - i)),
                    30 => vertex("nose_tip"),
                    _ => FeatureId::from_ibug(i).and_then(|id| vertex(id.name())),
                };
                named.unwrap_or(nasion)
            })
            .collect();
        let pick = |from: &[[f64; 3]]| -> Vec<Vector3<f64>> {
            let at = |v: &usize| from.get(*v).copied().unwrap_or_default();
            vertices
                .iter()
                .map(at)
                .map(|[x, y, z]| Vector3::new(x, -y, z) / OUTER_EYES_MM)
                .collect()
        };
        Landmarks {
            mean: pick(&model.vertices),
            modes: model.modes.iter().map(|mode| pick(&mode.displacements)).collect(),
        }
    }
}

/// Pose parameters: rotation, scale, shift.
const POSE: usize = 6;
/// Prior standard deviations of yaw and pitch over photographs (radians).
const YAW_SD_RAD: f64 = 0.6;
const PITCH_SD_RAD: f64 = 0.25;

/// A located landmark.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target {
    pub(crate) landmark: usize,
    pub(crate) at: Point,
    /// Standard deviation (pixels of the crop).
    pub(crate) sd: f64,
}

/// The shape model in a pose.
#[derive(Debug, Clone)]
pub(crate) struct PosedModel<'a> {
    landmarks: &'a Landmarks,
    /// Rows: the image's x and y axes in the model's frame.
    pub(crate) rotation: Matrix2x3<f64>,
    /// Pixels per outer interocular distance.
    pub(crate) scale: f64,
    pub(crate) shift: Point,
    pub(crate) coefficients: Vec<f64>,
}

impl<'a> PosedModel<'a> {
    /// The frontal mean face with an outer interocular distance of `scale` pixels and the midpoint of its eyes at
    /// `eyes`.
    pub(crate) fn frontal(landmarks: &'a Landmarks, scale: f64, eyes: Point) -> Self {
        let mut pose = PosedModel {
            landmarks,
            rotation: Matrix2x3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
            scale,
            shift: [0.0; 2],
            coefficients: vec![0.0; landmarks.modes.len()],
        };
        let p = pose.project();
        let mid = plane::mean(p[36..48].iter().copied());
        pose.shift = [eyes[0] - mid[0], eyes[1] - mid[1]];
        pose
    }

    /// The shape of the landmarks in the model's frame (outer interocular distances).
    pub(crate) fn shape(&self) -> Vec<Vector3<f64>> {
        let mut shape = self.landmarks.mean.clone();
        for (c, mode) in self.coefficients.iter().zip(&self.landmarks.modes) {
            shape.iter_mut().zip(mode).for_each(|(v, d)| *v += *c * d);
        }
        shape
    }

    /// The landmarks in the crop (pixels).
    pub(crate) fn project(&self) -> [Point; LANDMARKS] {
        let mut places = [[0.0; 2]; LANDMARKS];
        for (place, v) in places.iter_mut().zip(self.shape()) {
            let p = self.scale * (self.rotation * v);
            *place = [p.x + self.shift[0], p.y + self.shift[1]];
        }
        places
    }

    /// Yaw (degrees): positive when the face turns to the right of the picture.
    pub(crate) fn yaw_deg(&self) -> f64 {
        self.rotation[(0, 2)].clamp(-1.0, 1.0).asin().to_degrees()
    }

    /// Pitch (degrees).
    pub(crate) fn pitch_deg(&self) -> f64 {
        self.rotation[(1, 2)].clamp(-1.0, 1.0).asin().to_degrees()
    }

    /// Sum of the squared coefficients: how unusual the shape is.
    pub(crate) fn strain(&self) -> f64 {
        self.coefficients.iter().map(|c| c * c).sum()
    }

    /// Fits pose and shape to the targets from the present pose: Gauss-Newton steps on rotation, scale, shift and the
    /// modes' coefficients, which have a standard normal prior.
    pub(crate) fn fit(&mut self, targets: &[Target], rounds: usize) {
        for _ in 0..rounds {
            if self.step(targets).is_none() {
                return;
            }
        }
    }

    /// One Gauss-Newton step; none if the equations are singular.
    fn step(&mut self, targets: &[Target]) -> Option<()> {
        let modes = &self.landmarks.modes;
        let n = POSE + modes.len();
        let mut a = DMatrix::<f64>::zeros(n, n);
        let mut b = DVector::<f64>::zeros(n);
        let third = self.rotation.row(0).transpose().cross(&self.rotation.row(1).transpose());
        let shape = self.shape();
        let (mut jx, mut jy) = (vec![0.0; n], vec![0.0; n]);
        let s = self.scale;
        let turned = s * self.rotation;
        for t in targets {
            let Some(v) = shape.get(t.landmark) else { continue };
            let q = self.rotation * v;
            let (qx, qy, qz) = (q.x, q.y, third.dot(v));
            // Small rotations about x, y and z, logarithm of the scale, shift.
            let by = modes.iter().filter_map(|mode| mode.get(t.landmark)).map(|d| turned * d);
            let pose = [
                [0.0, -s * qz],
                [s * qz, 0.0],
                [-s * qy, s * qx],
                [s * qx, s * qy],
                [1.0, 0.0],
                [0.0, 1.0],
            ];
            let columns = pose.into_iter().chain(by.map(|d| [d.x, d.y]));
            for ((x, y), column) in jx.iter_mut().zip(&mut jy).zip(columns) {
                [*x, *y] = column;
            }
            // Beyond three standard deviations the pull stays constant: the target is likely something else.
            let (rx, ry) = (t.at[0] - s * qx - self.shift[0], t.at[1] - s * qy - self.shift[1]);
            let far = (rx * rx + ry * ry).sqrt() / t.sd;
            let w = 3.0 / far.max(3.0) / (t.sd * t.sd);
            // Only the lower half, which Cholesky reads.
            for (j, (x, y)) in jx.iter().zip(&jy).enumerate() {
                let (wx, wy) = (w * x, w * y);
                b[j] += wx * rx + wy * ry;
                let below = jx.iter().zip(&jy).skip(j);
                for (cell, (x, y)) in a.column_mut(j).iter_mut().skip(j).zip(below) {
                    *cell += wx * x + wy * y;
                }
            }
        }
        for (j, c) in self.coefficients.iter().take(modes.len()).enumerate() {
            a[(POSE + j, POSE + j)] += 1.0;
            b[POSE + j] -= c;
        }
        // Prior: a head is roughly upright and faces the camera.
        let yaw = self.rotation[(0, 2)].clamp(-1.0, 1.0).asin();
        let pitch = self.rotation[(1, 2)].clamp(-1.0, 1.0).asin();
        a[(1, 1)] += YAW_SD_RAD.powi(-2);
        b[1] -= yaw * YAW_SD_RAD.powi(-2);
        a[(0, 0)] += PITCH_SD_RAD.powi(-2);
        b[0] += pitch * PITCH_SD_RAD.powi(-2);
        for j in 0..POSE {
            a[(j, j)] += 1e-6;
        }
        let x = a.cholesky()?.solve(&b);
        let about = Vector3::new(x[0], x[1], x[2]);
        let about = about * (0.3 / about.norm().max(0.3));
        let turn = nalgebra::Rotation3::new(about);
        let mut full = nalgebra::Matrix3::zeros();
        full.set_row(0, &self.rotation.row(0));
        full.set_row(1, &self.rotation.row(1));
        full.set_row(2, &third.transpose());
        let full = turn.matrix() * full;
        self.rotation = full.fixed_rows::<2>(0).into_owned();
        self.scale *= x[3].clamp(-0.3, 0.3).exp();
        self.shift = [self.shift[0] + x[4], self.shift[1] + x[5]];
        for (c, by) in self.coefficients.iter_mut().zip(x.iter().skip(POSE)) {
            *c = (*c + by).clamp(-3.0, 3.0);
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    //! Rendered faces that nothing was learned from.

    use mocapd_testkit::photograph::Scene;

    use super::*;
    use crate::model::{FeatureId, Model};

    const INTEROCULAR_PX: f64 = 80.0;

    struct Drawn {
        photo: Photo,
        /// The landmarks of [`REGRESSED`].
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

    /// Mean error of eyes, brows, nose and mouth, as a fraction of the outer interocular distance.
    fn off(drawn: &Drawn, regressor: &LandmarkRegressor, landmarks: &LandmarkPoints) -> f64 {
        let inner = |i: &usize| (17..27).contains(i) || *i > 30;
        let far: Vec<f64> = REGRESSED
            .iter()
            .zip(landmarks)
            .zip(&drawn.landmarks)
            .filter(|((i, _), _)| inner(i))
            .map(|((_, landmarks), at)| {
                let [x, y] = regressor.to_photo(*landmarks);
                (x - at[0]).hypot(y - at[1])
            })
            .collect();
        far.iter().sum::<f64>() / far.len() as f64 / INTEROCULAR_PX
    }

    #[test]
    fn landmarks_are_predicted_at_any_yaw() {
        for (seed, yaw_deg) in [(1, 0.0), (2, 15.0), (3, -15.0), (4, 30.0), (5, -30.0)] {
            let drawn = drawn(seed, yaw_deg);
            let regressor = LandmarkRegressor::new(&drawn.photo, &drawn.rough);
            let off = off(&drawn, &regressor, &regressor.predict());
            assert!(off < 0.08, "seed {seed}, {yaw_deg} degrees: {off}");
        }
    }

    #[test]
    fn starting_positions_off_by_a_tenth_do_no_harm() {
        let mut drawn = drawn(6, 10.0);
        drawn.rough.left_eye[0] += 0.1 * INTEROCULAR_PX;
        drawn.rough.mouth[1] -= 0.1 * INTEROCULAR_PX;
        let regressor = LandmarkRegressor::new(&drawn.photo, &drawn.rough);
        let off = off(&drawn, &regressor, &regressor.predict());
        assert!(off < 0.08, "{off}");
    }

    #[test]
    fn feature_counts_match_the_table() {
        let photo = Photo::from_pixels(100, 80, vec![[90; 3]; 8000]).unwrap();
        let (left_eye, right_eye, mouth) = ([1e300, -5.0], [20.0, f64::NAN], [0.0; 2]);
        let rough = RoughFace { left_eye, right_eye, mouth };
        let regressor = LandmarkRegressor::new(&photo, &rough);
        assert_eq!(regressor.crop_features().len(), CROP_FEATURES);
        let far: LandmarkPoints = [[f64::NAN, 1e300]; REGRESSED.len()];
        assert_eq!(regressor.patch_features(&far).len(), PATCH_FEATURES);
        assert!(regressor.predict().iter().flatten().all(|v| v.is_finite()));
    }
}
