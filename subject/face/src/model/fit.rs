//! The model fitted to points of a picture.

use thiserror::Error;

use super::OUTER_EYES_MM;
use super::camera::Camera;
use super::feature::FeatureId;
use super::shape::Model;
use super::solve::{Observed, Solver};

/// How far the points are trusted, against the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// Standard deviation of a point of weight 1, as a share of the outer eye corners' distance. Two careful annotators
    /// differ by 0.03 to 0.04.
    pub noise_io: f64,
    /// The same of a point of the outline, whose place depends on hair and chin.
    pub contour_noise_io: f64,
    /// From how many standard deviations on a point pulls no harder (Huber 1964).
    pub huber: f64,
    /// Standard deviation of pitch. Without it a long face and one that looks down are hard to tell apart.
    pub pitch_sd_deg: f64,
    /// How many of the modes are used, first to last; the others stay 0. 0 fits the pose alone.
    pub modes: usize,
    /// At most so many steps from each start.
    pub steps: usize,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            noise_io: 0.03,
            contour_noise_io: 0.08,
            huber: 1.5,
            pitch_sd_deg: 15.0,
            modes: usize::MAX,
            steps: 12,
        }
    }
}

/// Why a model was not fitted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FitError {
    /// Pose and scale alone are six numbers.
    #[error("{0} points with a weight, where a face needs at least 6 of them")]
    TooFew(usize),
    /// A coordinate or weight that is no number, or a negative weight.
    #[error("{name} at ({x}, {y}) with weight {weight}: give finite numbers, and weights from 0")]
    NotFinite {
        /// Of the point.
        name: &'static str,
        /// As given.
        x: f64,
        /// As given.
        y: f64,
        /// As given.
        weight: f64,
    },
    /// All in one place, or on one line.
    #[error("the points lie on one line, or in one place: no face looks like that")]
    Degenerate,
}

/// A model fitted to points of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeFit {
    /// How the head stands in the picture.
    pub camera: Camera,
    /// Standard deviations of each of the model's modes.
    pub coefficients: Vec<f64>,
    /// The fitted face in the model's own frame, unturned, in the model's millimetres.
    pub vertices_mm: Vec<[f64; 3]>,
    /// Each vertex in the picture: x, y and how far before the model's origin, in pixels.
    pub vertices_px: Vec<[f64; 3]>,
    /// Where the fit has each of the 53 points, by [`FeatureId::index`]: x, y and depth, in pixels.
    pub points_px: Vec<[f64; 3]>,
    /// How many standard deviations each of the 53 points was from there; none where none was given.
    pub residuals_sd: Vec<Option<f64>>,
    /// Of the points given, weighted, in pixels.
    pub rms_px: f64,
}

impl Model {
    /// Fits pose and shape to points of a picture: pixels, and a weight each (1 as trusted as the options say, 0 not at all;
    /// a weight of 4 halves the standard deviation). Points may be missing, and a few may be wrong.
    ///
    /// Least squares by damped Gauss-Newton steps, with Huber's weights, and a normal prior on each mode: pose and shape
    /// together, since each alone trades with the other. Begun from three yaws, because a wrong one can be a trap.
    /// A given point counts once: the last of those with the same name.
    ///
    /// # Errors
    /// Points that are no face: too few, not finite, or on one line.
    pub fn fit_shape(
        &self,
        points: &[(FeatureId, [f64; 2], f64)],
        options: &FitOptions,
    ) -> Result<ShapeFit, FitError> {
        let observed = observed(points, options)?;
        let solver = Solver::new(self, &observed, options);
        let state = solver.solve().ok_or(FitError::Degenerate)?;
        let camera = state.camera();
        let vertices_mm = self.shape(&state.coefficients);
        let places = self.feature_points(&vertices_mm, &camera.rotation());
        let points_px = camera.project(&places);
        let sd_px = camera.scale_px_per_mm * OUTER_EYES_MM;
        let mut residuals_sd = vec![None; FeatureId::COUNT];
        let (mut squares, mut weights) = (0.0, 0.0);
        for point in &observed {
            let [x, y, _] = points_px[point.id.index()];
            let off = (point.at[0] - x).hypot(point.at[1] - y);
            residuals_sd[point.id.index()] = Some(off / (sd_px * point.noise_io));
            squares += point.weight * off * off;
            weights += point.weight;
        }
        let vertices_px = camera.project(&vertices_mm);
        let rms_px = (squares / weights).sqrt();
        let coefficients = state.coefficients;
        Ok(ShapeFit {
            camera,
            coefficients,
            vertices_mm,
            vertices_px,
            points_px,
            residuals_sd,
            rms_px,
        })
    }
}

fn observed(
    points: &[(FeatureId, [f64; 2], f64)],
    options: &FitOptions,
) -> Result<Vec<Observed>, FitError> {
    let mut by_id = vec![None; FeatureId::COUNT];
    for &(id, at, weight) in points {
        if !(at[0].is_finite() && at[1].is_finite() && weight.is_finite() && weight >= 0.0) {
            return Err(FitError::NotFinite { name: id.name(), x: at[0], y: at[1], weight });
        }
        let noise_io = if id.is_contour() { options.contour_noise_io } else { options.noise_io };
        by_id[id.index()] = (weight > 0.0).then_some(Observed { id, at, weight, noise_io });
    }
    let observed: Vec<_> = by_id.into_iter().flatten().collect();
    if observed.len() < 6 { Err(FitError::TooFew(observed.len())) } else { Ok(observed) }
}
