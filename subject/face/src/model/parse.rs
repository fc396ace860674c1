//! The model file format (`docs/subject-face-model.md`).

use serde::Deserialize;
use thiserror::Error;

use super::{FeatureId, Model};
use crate::shortened;

const FORMAT: &str = "mocapd-face-model";
const VERSION: u32 = 2;
/// More than any wireframe needs; the cost of a fit grows with it.
const MAX_VERTICES: usize = 20_000;
const MAX_MODES: usize = 200;
/// Beyond any head, and within what a fit can handle.
const MAX_COORDINATE_MM: f64 = 1e7;

/// Why a text is not a model.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("not a face model: {0}")]
pub struct ModelError(String);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    format: String,
    version: u32,
    #[serde(rename = "about")]
    _about: Option<String>,
    model: Model,
}

/// Reads the output of `subject/face/data/build/face_model.py`.
pub(super) fn model(text: &str) -> Result<Model, ModelError> {
    let wrong = |what: String| ModelError(shortened(&what));
    let file: ModelFile = serde_json::from_str(text).map_err(|error| wrong(error.to_string()))?;
    if file.format != FORMAT || file.version != VERSION {
        let found = format!("{:?}, version {}", file.format, file.version);
        return Err(wrong(format!("expected {FORMAT:?}, version {VERSION}; found {found}")));
    }
    let mut model = file.model;
    check(&model).map_err(wrong)?;
    for id in FeatureId::all().skip(FeatureId::CONTOUR) {
        let vertex = model.features.get(id.name());
        model.fixed.push(*vertex.ok_or_else(|| wrong(format!("{} is missing", id.name())))?);
    }
    Ok(model)
}

/// Checks counts, indices and coordinates.
fn check(model: &Model) -> Result<(), String> {
    let count = model.vertices.len();
    if count > MAX_VERTICES || model.triangles.len() > 2 * MAX_VERTICES {
        let triangles = model.triangles.len();
        return Err(format!(
            "{count} vertices, {triangles} triangles; the limits are {MAX_VERTICES} and twice that"
        ));
    }
    if model.modes.len() > MAX_MODES {
        return Err(format!("{} modes, the limit is {MAX_MODES}", model.modes.len()));
    }
    if let Some(mode) = model.modes.iter().find(|mode| mode.displacements.len() != count) {
        return Err(format!("a mode moves {} of {count} vertices", mode.displacements.len()));
    }
    if model.contours.len() != FeatureId::CONTOUR || model.contours.iter().any(Vec::is_empty) {
        return Err(format!("expected {} non-empty outline rows", FeatureId::CONTOUR));
    }
    let places = || model.contours.iter().flatten();
    if let Some(place) = places().find(|place| !(0.0..=1.0).contains(&place.fraction)) {
        return Err(format!("a fraction of {}, expected 0 to 1", place.fraction));
    }
    let corners = model.triangles.iter().flatten().copied();
    let ends = places().flat_map(|place| [place.from, place.to]);
    let mut indices = corners.chain(model.features.values().copied()).chain(ends);
    if let Some(index) = indices.find(|&index| index >= count) {
        return Err(format!("vertex index {index}, expected less than {count}"));
    }
    let modes = model.modes.iter().flat_map(|mode| &mode.displacements);
    let mut lengths = model.vertices.iter().chain(modes).flatten();
    match lengths.find(|length| length.abs() > MAX_COORDINATE_MM) {
        Some(length) => Err(format!("coordinate {length} mm, the limit is {MAX_COORDINATE_MM}")),
        None => Ok(()),
    }
}
