//! Pictures of faces that do not exist, with the truth about them: so that whatever looks for faces can be tested without a
//! photograph of anybody.
//!
//! The [model](mocapd_face::model) in a random shape, posed, lit and painted: skin, lips, brows, irises, nostrils, hair; before a
//! clutter that has the colours of skin and wood. The same [`Scene`] gives the same pixels.

mod clutter;
mod extras;
mod head;
mod paint;
mod random;
mod raster;
#[cfg(test)]
mod tests;

use image::RgbImage;
use mocapd_face::model::{Camera, FeatureId, Model, ModelError, OUTER_EYES_MM};
use thiserror::Error;

pub use extras::Extras;
pub use random::Random;

/// What is to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Width of the picture, at most [`Scene::MAX_SIDE_PX`].
    pub width_px: u32,
    /// Height of the picture, at most [`Scene::MAX_SIDE_PX`].
    pub height_px: u32,
    /// The faces, from the furthest to the nearest. None gives clutter alone.
    pub faces: Vec<Sitter>,
    /// Standard deviation of each pixel's noise, of 255.
    pub noise: f64,
    /// Of the background and the noise.
    pub seed: u64,
}

/// One face of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Sitter {
    /// Who it is, how they look, and how they are lit: shape, skin, hair, eyes and light are drawn from this.
    pub seed: u64,
    /// Pixels between the outer eye corners of a face of average width that looks at the camera.
    pub io_px: f64,
    /// As of [`Camera::yaw_deg`].
    pub yaw_deg: f64,
    /// As of [`Camera::pitch_deg`].
    pub pitch_deg: f64,
    /// As of [`Camera::roll_deg`].
    pub roll_deg: f64,
    /// Where the middle of the outer eye corners is, in pixels.
    pub eyes_px: [f64; 2],
    /// How many standard deviations the shape's modes are drawn with: 0 is the average face, 1 is anybody.
    pub variety: f64,
    /// Glasses, beard, and such.
    pub extras: Extras,
}

/// The truth about one face of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// How the head stands in the picture.
    pub camera: Camera,
    /// Standard deviations of the model's modes.
    pub coefficients: Vec<f64>,
    /// Each of the 53 points by [`FeatureId::index`]: x, y and depth, in pixels.
    pub points_px: Vec<[f64; 3]>,
    /// Each vertex of the model: x, y and depth, in pixels.
    pub vertices_px: Vec<[f64; 3]>,
}

/// A picture, and the truth about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The pixels.
    pub image: RgbImage,
    /// One a sitter, in their order.
    pub faces: Vec<Truth>,
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RenderError {
    /// An empty picture, or one that is too large.
    #[error("a picture of {0} x {1} pixels: give 1 to {max} each way", max = Scene::MAX_SIDE_PX)]
    Size(u32, u32),
    /// A sitter whose size, pose or place is not finite, or too large to be drawn.
    #[error("sitter {0}: give finite numbers, and 1 to {max} pixels between the eyes", max = Scene::MAX_SIDE_PX)]
    Sitter(usize),
    /// The model that comes with mocapd is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl Scene {
    /// Pixels along each side that a picture may have: it is drawn at twice that, with a depth a pixel.
    pub const MAX_SIDE_PX: u32 = 4096;

    /// One face in the middle of a picture that is four times as wide as its eyes, and a little higher.
    pub fn portrait(seed: u64, io_px: f64, yaw_deg: f64) -> Self {
        let side = |factor: f64| (factor * io_px).clamp(1.0, f64::from(Self::MAX_SIDE_PX)) as u32;
        let (width_px, height_px) = (side(4.0), side(4.6));
        let eyes_px = [2.0 * io_px, 2.0 * io_px];
        let sitter = Sitter {
            seed,
            io_px,
            yaw_deg,
            pitch_deg: 0.0,
            roll_deg: 0.0,
            eyes_px,
            variety: 0.8,
            extras: Extras::default(),
        };
        Self { width_px, height_px, faces: vec![sitter], noise: 3.0, seed }
    }

    /// Draws it.
    ///
    /// # Errors
    /// A size or a sitter that cannot be drawn.
    pub fn render(&self) -> Result<Picture, RenderError> {
        let sides = 1..=Self::MAX_SIDE_PX;
        if !(sides.contains(&self.width_px) && sides.contains(&self.height_px)) {
            return Err(RenderError::Size(self.width_px, self.height_px));
        }
        let model = Model::generic()?;
        let mut canvas = raster::Canvas::new(self.width_px, self.height_px);
        clutter::fill(&mut canvas, &mut Random::new(self.seed ^ 0xb0c4));
        let mut faces = Vec::new();
        for (number, sitter) in self.faces.iter().enumerate() {
            if !sitter.can_be_drawn() {
                return Err(RenderError::Sitter(number));
            }
            canvas.clear_depth();
            faces.push(sitter.draw(model, &mut canvas));
        }
        let image = canvas.develop(self.noise, &mut Random::new(self.seed ^ 0x5e45));
        Ok(Picture { image, faces })
    }
}

impl Sitter {
    fn can_be_drawn(&self) -> bool {
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
            && (1.0..=most).contains(&self.io_px)
    }

    fn draw(&self, model: &Model, canvas: &mut raster::Canvas) -> Truth {
        let mut random = Random::new(self.seed);
        // Clipped: a face four deviations out is rare among people, and odd among modes.
        let mut amount = || self.variety * random.normal().clamp(-2.0, 2.0);
        let coefficients: Vec<f64> = model.modes.iter().map(|_| amount()).collect();
        let camera = Camera {
            scale_px_per_mm: self.io_px / OUTER_EYES_MM,
            yaw_deg: self.yaw_deg,
            pitch_deg: self.pitch_deg,
            roll_deg: self.roll_deg,
            origin_px: self.eyes_px,
        };
        let vertices_mm = model.shape(&coefficients);
        let look = paint::Look::new(&mut random).with(self.extras);
        head::draw(model, &vertices_mm, &camera, &look, canvas);
        let places = model.feature_points(&vertices_mm, &camera.rotation());
        Truth {
            camera,
            coefficients,
            points_px: camera.project(&places),
            vertices_px: camera.project(&vertices_mm),
        }
    }
}

impl Truth {
    /// Where one of the 53 points is, in pixels.
    pub fn at(&self, id: FeatureId) -> [f64; 2] {
        let [x, y, _] = self.points_px[id.index()];
        [x, y]
    }
}
