//! Arbitrary bytes as photographs, fitted faces, mappings and face models.

use mocapd_face::{
    Photo,
    fitted::FittedFace,
    mapping::Mapping,
    model::{FeatureId, FitOptions, Landmark, Model},
    photo::BYTES_MAX,
};

/// Maximum number of characters in an error message.
const REASON_MAX: usize = 400;
/// Maximum number of vertices of a model that is also fitted: the cost of a fit grows with them.
const FITTED_VERTICES_MAX: usize = 2000;

/// Reads a photograph: gives an error with a message, or a complete picture.
pub fn read_photo(bytes: &[u8]) {
    match Photo::from_bytes(bytes) {
        Ok(photo) => {
            assert!(bytes.len() <= BYTES_MAX);
            assert_eq!(photo.pixels().len(), photo.width() * photo.height());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Reads a fitted face: gives a one-line error, or a face that can be drawn and survives being written and read again.
pub fn read_face(bytes: &[u8]) {
    let face = match FittedFace::from_json(bytes) {
        Ok(face) => face,
        Err(error) => return one_line(&error.to_string()),
    };
    assert!(face.triangles.as_flattened().iter().all(|&v| v < face.vertices_mm.len()));
    face.to_obj();
    face.to_svg();
    // Numbers are rounded when written, which may make a scale 0.
    if let Ok(written) = face.to_json() {
        let again = FittedFace::from_json(written.as_bytes()).expect("what we write can be read");
        assert_eq!(again.to_json().expect("as before"), written);
    }
}

/// Reads a mapping: gives a one-line error, or a mapping that survives being written and read again.
pub fn read_mapping(bytes: &[u8]) {
    match Mapping::from_json(bytes) {
        Ok(mapping) => {
            let written = mapping.to_json().expect("what was read can be written");
            let again = Mapping::from_json(written.as_bytes()).expect("what we write can be read");
            assert_eq!(again.markers.len(), mapping.markers.len());
            for (a, b) in again.markers.iter().zip(&mapping.markers) {
                assert!((&a.label, &a.place) == (&b.label, &b.place));
                assert!((a.weight - b.weight).abs() <= 1e-12 * b.weight.abs());
            }
        }
        Err(error) => one_line(&error.to_string()),
    }
}

/// Reads a face model: gives a one-line error, or a model that can be fitted, which gives a face or a one-line error.
pub fn read_face_model(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let model = match Model::parse(text) {
        Ok(model) => model,
        Err(error) => return one_line(&error.to_string()),
    };
    let n = model.vertices.len();
    assert!(n <= text.len() && model.modes.len() <= text.len());
    assert!(model.triangles.as_flattened().iter().chain(model.features.values()).all(|&v| v < n));
    if n > FITTED_VERTICES_MAX {
        return;
    }
    let own = FeatureId::all().filter_map(|id| {
        let [x, y, _] = *model.vertices.get(*model.features.get(id.name())?)?;
        Some(Landmark { id, xy_px: [100.0 + x, 100.0 - y], confidence: 1.0 })
    });
    let options = FitOptions { modes: 4, steps: 2, ..FitOptions::default() };
    match model.fit_shape(&own.collect::<Vec<_>>(), &options) {
        Ok(fit) => assert_eq!(fit.vertices_mm.len(), n),
        Err(error) => one_line(&error.to_string()),
    }
}

fn one_line(text: &str) {
    assert!(text.chars().count() < REASON_MAX && !text.contains(char::is_control), "{text:?}");
}
