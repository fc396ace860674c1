//! The whole chain: from a photograph to fitted wireframes, by either method.

use std::fmt;

use crate::adapt::{Depth, Width, adapt};
use crate::find::DetectedFace;
use crate::fitted::{FittedFace, Method, Source};
use crate::model::{Camera, FeatureId, FitOptions, Landmark, Model, ModelError, OUTER_EYES_MM};
use crate::photo::Photo;
use crate::plane::{distance, middle};
use crate::points::{FacePoints, RoughFace};
use crate::proportions::ProportionModel;
use crate::{find, paper, points};

/// Maximum number of faces that are fitted, by score: a class, or a team.
pub const FACES_MAX: usize = 64;

/// Why no face was fitted to a photograph.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoFace {
    /// No face was detected.
    #[error(
        "no face found: photograph one person from the front, a third of the picture's height or more, in even light, \
         with at least 40 pixels between the outer corners of the eyes"
    )]
    NotFound,
    /// A face was detected, but its points give no wireframe.
    #[error("found a face, but not its features ({0}): take a sharper photograph from the front")]
    NotFitted(String),
    /// The built-in model is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl NoFace {
    fn not_fitted(error: impl fmt::Display) -> Self {
        Self::NotFitted(error.to_string())
    }
}

/// Detects the faces of a photograph and fits the wireframe to each, best detection first.
///
/// # Errors
/// [`NoFace`] if no face was fitted.
pub fn fit(photo: &Photo, source: &Source, method: Method) -> Result<Vec<FittedFace>, NoFace> {
    let model = Model::generic()?;
    let found: Vec<DetectedFace> = match method {
        Method::Default => find::faces(photo, find::SCORE_MIN),
        Method::Paper => paper::faces(photo),
    };
    // The published chain has no confidence of its own; its points are checked against the proportions of a face.
    let proportions = (method == Method::Paper).then(|| ProportionModel::of(model));
    let mut fitted = Vec::new();
    let mut why = NoFace::NotFound;
    for face in found.iter().take(FACES_MAX) {
        let rough = RoughFace::from(face);
        let located = match method {
            Method::Default => points::find(photo, &rough)?,
            Method::Paper => points::paper::find(photo, &rough),
        };
        let one = match method {
            Method::Default => by_default(model, &located),
            Method::Paper => by_paper(model, face, &located),
        };
        match one {
            Ok(FaceFit { camera, points, vertices_mm }) => {
                let source = source.clone();
                let mut one = FittedFace::new(model, method, source, camera, points, vertices_mm);
                one.confidence = located.confidence();
                if let Some(proportions) = &proportions {
                    one.notes = proportions.contradictions(&located.points.map(|point| point.at));
                }
                fitted.push(one);
            }
            Err(reason) => why = reason,
        }
    }
    if fitted.is_empty() { Err(why) } else { Ok(fitted) }
}

/// Result of a chain for one face.
struct FaceFit {
    camera: Camera,
    points: Vec<Landmark>,
    vertices_mm: Vec<[f64; 3]>,
}

/// Fits pose, shape and depth by the shape model. Points that were not located take the model's place. So does the
/// hairline: what is visible there is the edge of the hair, which would squeeze the forehead.
fn by_default(model: &Model, found: &FacePoints) -> Result<FaceFit, NoFace> {
    let fit = model.fit_shape(&found.found(), &FitOptions::default());
    let fit = fit.map_err(NoFace::not_fitted)?;
    let points: Vec<Landmark> = FeatureId::all()
        .zip(&found.points)
        .zip(&fit.points_px)
        .map(|((id, located), &[x, y, _])| {
            let confidence = if id.is_hairline() { 0.0 } else { located.confidence };
            let xy_px = if confidence > 0.0 { located.at } else { [x, y] };
            Landmark { id, xy_px, confidence }
        })
        .collect();
    let depths: Vec<f64> = fit.points_px.iter().map(|point| point[2]).collect();
    let (camera, depth) = (fit.camera, Depth::Points(&depths));
    let adapted = adapt(model, &fit.vertices_mm, &camera, &points, Width::default(), depth);
    let adapted = adapted.map_err(NoFace::not_fitted)?;
    Ok(FaceFit { camera, points, vertices_mm: adapted.vertices_mm })
}

/// Adapts the average face, with yaw from the outline (Yang et al. 2004, sections 4 and 5). Points that were not
/// located are left out.
fn by_paper(model: &Model, face: &DetectedFace, found: &FacePoints) -> Result<FaceFit, NoFace> {
    let yaw_deg = found.yaw_deg.unwrap_or(0.0);
    let corner = |ibug| {
        let id = FeatureId::from_ibug(ibug)?;
        found.points.get(id.index()).filter(|point| point.confidence > 0.0).map(|point| point.at)
    };
    let (Some(left), Some(right)) = (corner(36), corner(45)) else {
        return Err(NoFace::NotFitted("the corners of the eyes".to_owned()));
    };
    let turned = yaw_deg.to_radians().cos().max(0.1);
    let camera = Camera {
        scale_px_per_mm: distance(left, right).max(1.0) / (OUTER_EYES_MM * turned),
        yaw_deg,
        pitch_deg: 0.0,
        roll_deg: -face.roll_rad.to_degrees(),
        origin_px: middle(left, right),
    };
    let points = found.found();
    let adapted = adapt(model, &model.vertices, &camera, &points, Width::PAPER, Depth::Model);
    let adapted = adapted.map_err(NoFace::not_fitted)?;
    Ok(FaceFit { camera, points, vertices_mm: adapted.vertices_mm })
}
