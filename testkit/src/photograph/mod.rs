//! Synthetic photographs of faces, with ground truth, for tests of face detection without pictures of real people.
//!
//! Each face is the [model](mocapd_face::model) in a random shape, posed, lit and painted with skin, lips, brows,
//! irises, nostrils and hair, in front of clutter in the colours of skin and wood. The same [`Scene`] gives the same
//! pixels.

mod head;
mod paint;
mod raster;
#[cfg(test)]
mod tests;

use image::RgbImage;
use mocapd_face::model::{Camera, FeatureId, Model, ModelError, OUTER_EYES_MM};
use thiserror::Error;

use self::raster::{Canvas, Colour};
use crate::random::Random;
pub use paint::Occlusions;

/// A picture to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Width of the picture, at most [`Scene::MAX_SIDE_PX`].
    pub width_px: u32,
    /// Height of the picture, at most [`Scene::MAX_SIDE_PX`].
    pub height_px: u32,
    /// The faces, from the farthest to the nearest; may be empty.
    pub faces: Vec<Sitter>,
    /// Standard deviation of the pixel noise, on a scale of 255.
    pub noise: f64,
    /// Seed of the background and the noise.
    pub seed: u64,
}

/// One face of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Sitter {
    /// Seed of shape, skin, hair, eyes and light.
    pub seed: u64,
    /// Outer interocular distance of a frontal face of average width, pixels.
    pub interocular_px: f64,
    /// See [`Camera::yaw_deg`].
    pub yaw_deg: f64,
    /// See [`Camera::pitch_deg`].
    pub pitch_deg: f64,
    /// See [`Camera::roll_deg`].
    pub roll_deg: f64,
    /// Midpoint of the outer eye corners, pixels.
    pub eyes_px: [f64; 2],
    /// Standard deviation of the shape's modes: 0 gives the average face, 1 the variation of the population.
    pub variety: f64,
    /// Glasses, beard, fringe and light.
    pub extras: Occlusions,
}

/// Ground truth of one face in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct GroundTruth {
    /// Pose of the head relative to the camera.
    pub camera: Camera,
    /// Standard deviations of the model's modes.
    pub coefficients: Vec<f64>,
    /// The 53 landmarks by [`FeatureId::index`]: x, y and depth, pixels.
    pub points_px: Vec<[f64; 3]>,
    /// The vertices of the model: x, y and depth, pixels.
    pub vertices_px: Vec<[f64; 3]>,
}

/// A picture and its ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The pixels.
    pub image: RgbImage,
    /// One entry per sitter, in the order of the scene.
    pub faces: Vec<GroundTruth>,
}

/// Why a scene cannot be drawn.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RenderError {
    /// A side of the picture is 0 or too large.
    #[error("{0} x {1} pixels: expected 1 to {max} on each side", max = Scene::MAX_SIDE_PX)]
    Size(u32, u32),
    /// The size, pose or position of a sitter is not finite or too large.
    #[error("sitter {0}: expected finite numbers and 1 to {max} pixels between the eyes", max = Scene::MAX_SIDE_PX)]
    Sitter(usize),
    /// The built-in model is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl Scene {
    /// Largest width and height, pixels. A picture is drawn at twice its size, with a depth per sample.
    pub const MAX_SIDE_PX: u32 = 4096;

    /// One centred face in a picture that is 4 interocular distances wide and 4.6 high.
    pub fn portrait(seed: u64, interocular_px: f64, yaw_deg: f64) -> Self {
        let side =
            |factor: f64| (factor * interocular_px).clamp(1.0, f64::from(Self::MAX_SIDE_PX)) as u32;
        let (width_px, height_px) = (side(4.0), side(4.6));
        let eyes_px = [2.0 * interocular_px, 2.0 * interocular_px];
        let sitter = Sitter {
            seed,
            interocular_px,
            yaw_deg,
            pitch_deg: 0.0,
            roll_deg: 0.0,
            eyes_px,
            variety: 0.8,
            extras: Occlusions::default(),
        };
        Self { width_px, height_px, faces: vec![sitter], noise: 3.0, seed }
    }

    /// Draws the picture.
    ///
    /// # Errors
    /// When the size or a sitter is out of range.
    pub fn render(&self) -> Result<Picture, RenderError> {
        let sides = 1..=Self::MAX_SIDE_PX;
        if !(sides.contains(&self.width_px) && sides.contains(&self.height_px)) {
            return Err(RenderError::Size(self.width_px, self.height_px));
        }
        let model = Model::generic()?;
        let mut canvas = Canvas::new(self.width_px, self.height_px);
        fill_with_clutter(&mut canvas, &mut Random::new(self.seed ^ 0xb0c4));
        let mut faces = Vec::new();
        for (number, sitter) in self.faces.iter().enumerate() {
            if !sitter.is_valid() {
                return Err(RenderError::Sitter(number));
            }
            canvas.clear_depth();
            faces.push(sitter.draw(model, &mut canvas));
        }
        let image = canvas.to_image(self.noise, &mut Random::new(self.seed ^ 0x5e45));
        Ok(Picture { image, faces })
    }
}

impl Sitter {
    fn is_valid(&self) -> bool {
        let numbers = [
            self.yaw_deg,
            self.pitch_deg,
            self.roll_deg,
            self.eyes_px[0],
            self.eyes_px[1],
            self.variety,
        ];
        let most = f64::from(Scene::MAX_SIDE_PX);
        self.extras.is_finite()
            && numbers.iter().all(|v| v.abs() < 1e6)
            && (1.0..=most).contains(&self.interocular_px)
    }

    fn draw(&self, model: &Model, canvas: &mut Canvas) -> GroundTruth {
        let mut random = Random::new(self.seed);
        // Clipped, because shapes beyond a few standard deviations are unnatural.
        let mut amount = || self.variety * random.normal().clamp(-2.0, 2.0);
        let coefficients: Vec<f64> = model.modes.iter().map(|_| amount()).collect();
        let camera = Camera {
            scale_px_per_mm: self.interocular_px / OUTER_EYES_MM,
            yaw_deg: self.yaw_deg,
            pitch_deg: self.pitch_deg,
            roll_deg: self.roll_deg,
            origin_px: self.eyes_px,
        };
        let vertices_mm = model.shape(&coefficients);
        let palette = paint::Palette::new(&mut random).with(self.extras);
        head::draw(model, &vertices_mm, &camera, &palette, canvas);
        let places = model.feature_points(&vertices_mm, &camera.rotation());
        GroundTruth {
            camera,
            coefficients,
            points_px: camera.project(&places),
            vertices_px: camera.project(&vertices_mm),
        }
    }
}

impl GroundTruth {
    /// Position of one of the 53 landmarks, pixels.
    pub fn at(&self, id: FeatureId) -> [f64; 2] {
        let [x, y, _] = self.points_px[id.index()];
        [x, y]
    }
}

const CLUTTER_SHAPES: usize = 22;
/// Linear colours of wood, plaster, brick, cloth, leaves, shade.
const CLUTTER_COLOURS: [Colour; 8] = [
    [0.42, 0.23, 0.11],
    [0.62, 0.52, 0.41],
    [0.40, 0.16, 0.10],
    [0.68, 0.42, 0.28],
    [0.10, 0.16, 0.30],
    [0.12, 0.22, 0.08],
    [0.05, 0.05, 0.06],
    [0.55, 0.56, 0.55],
];

/// Fills the canvas with clutter.
fn fill_with_clutter(canvas: &mut Canvas, random: &mut Random) {
    let size = canvas.size_px();
    let base: Colour = random.one_of(&CLUTTER_COLOURS);
    let tilt = [random.between(-0.3, 0.3), random.between(-0.3, 0.3)];
    canvas.paint(|at, _| {
        let light = 1.0 + tilt[0] * (at[0] / size[0] - 0.5) + tilt[1] * (at[1] / size[1] - 0.5);
        base.map(|c| c * light)
    });
    for _ in 0..CLUTTER_SHAPES {
        clutter_shape(canvas, random, size);
    }
}

/// Draws a slanted box or ellipse with a grain.
fn clutter_shape(canvas: &mut Canvas, random: &mut Random, size: [f64; 2]) {
    let colour: Colour = random.one_of(&CLUTTER_COLOURS);
    let light = random.between(0.5, 1.3);
    let middle = size.map(|s| random.between(-0.1, 1.1) * s);
    let half = size.map(|s| random.between(0.03, 0.25) * s);
    let (sin, cos) = random.between(-1.0, 1.0).sin_cos();
    let round = random.unit() < 0.5;
    let (grain, pitch) = (random.between(0.0, 0.25), random.between(0.2, 1.5));
    canvas.paint(|at, under| {
        let d = [at[0] - middle[0], at[1] - middle[1]];
        let local = [(cos * d[0] + sin * d[1]) / half[0], (cos * d[1] - sin * d[0]) / half[1]];
        let reach =
            if round { local[0].hypot(local[1]) } else { local[0].abs().max(local[1].abs()) };
        if reach > 1.0 {
            return under;
        }
        let shade = light
            * (1.0 - 0.25 * reach * reach)
            * (1.0 + grain * (pitch * d[1] + 0.05 * d[0]).sin());
        colour.map(|c| (c * shade).max(0.0))
    });
}
