//! Small photographs in every format, fitted faces, mappings and face models.

use mocapd_face::{
    fitted::{FittedFace, Method, Source},
    mapping::Mapping,
    model::{FeatureId, Landmark, Model},
};
use mocapd_testkit::photograph::{Picture, Scene};

/// PNM files of 8 and 16 bits, in grey, as text, cut off, and with fewer pixels than promised; the signatures of PNG
/// and JPEG, from which a fuzzer continues; and a bitmap, which is refused.
pub(crate) fn photos() -> Vec<Vec<u8>> {
    let pixels: Vec<u8> = (0..40 * 36 * 6).map(|i: usize| (i * i / 7 % 251) as u8).collect();
    let with = |header: &str, bytes: usize| [header.as_bytes(), &pixels[..bytes]].concat();
    let text: String = pixels[..32 * 32].iter().map(|value| format!("{value} ")).collect();
    vec![
        with("P6 40 36 255\n", 40 * 36 * 3),
        with("P6 40 36 65535\n", 40 * 36 * 6),
        with("P5 40 36 255\n", 40 * 36),
        with("P5 36 40 1023\n", 40 * 36 * 2),
        format!("P2 32 32 255\n{text}").into_bytes(),
        with("P6 40 36 255\n", 40 * 36),
        with("P6 6000 6000 255\n", 900),
        with("P6 4 4 255\n", 48),
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x28\0\0\0\x24\x08\x02\0\0\0".to_vec(),
        b"\xff\xd8\xff\xe0\0\x10JFIF\0\x01\x01\0\0\x01\0\x01\0\0\xff\xc0\0\x14\x08\0\x28\0\x24\x04\xff\xd9".to_vec(),
        b"BM and so on".to_vec(),
    ]
}

/// Fitted faces, whole and cut off.
pub(crate) fn faces() -> Vec<Vec<u8>> {
    let (Ok(model), Ok(Picture { image, faces })) =
        (Model::generic(), Scene::portrait(4, 70.0, 20.0).render())
    else {
        return Vec::new();
    };
    let (width, height) = (Some(image.width()), Some(image.height()));
    let face = |method| {
        let truth = faces.first()?;
        let points =
            FeatureId::all().map(|id| Landmark { id, xy_px: truth.at(id), confidence: 0.5 });
        let source = Source { name: "a.png".to_owned(), sha256: "0f".repeat(32), width, height };
        let vertices = model.shape(&truth.coefficients);
        let face = FittedFace::new(model, method, source, truth.camera, points.collect(), vertices);
        face.to_json().ok().map(String::into_bytes)
    };
    let whole: Vec<_> = [Method::Default, Method::Paper].into_iter().filter_map(face).collect();
    let cut = whole.iter().map(|json| json[..json.len() / 2].to_vec());
    cut.chain(whole.clone()).collect()
}

/// The mapping of a public recording, one with vertices by number, and one of a later version.
pub(crate) fn mappings() -> Vec<Vec<u8>> {
    let file = include_bytes!("../../../../subject/face/data/singing-face-mapping.json");
    let own = Mapping::from_json(file).and_then(|mapping| mapping.to_json()).unwrap_or_default();
    let kind = r#"{"format": "mocapd-face-mapping", "version": "#;
    let markers =
        r#", "markers": [{"label": "a", "at": 7}, {"label": "é", "at": "chin", "weight": 0.1}]}"#;
    vec![
        own.into_bytes(),
        format!("{kind}1{markers}").into_bytes(),
        format!("{kind}2{markers}").into_bytes(),
    ]
}

/// A model of a pyramid with all features and two modes, whole and cut off in each of its parts.
pub(crate) fn models() -> Vec<Vec<u8>> {
    let fixed = FeatureId::all().filter(|id| !id.is_contour()).enumerate();
    let features: Vec<String> =
        fixed.map(|(i, id)| format!("{:?}: {}", id.name(), i % 5)).collect();
    let contours: Vec<String> = (0..FeatureId::CONTOUR)
        .map(|i| format!("[[{}, 0, 0.5], [{}, 1, 0]]", i % 5, (i + 1) % 5))
        .collect();
    let text = format!(
        r#"{{"format": "mocapd-face-model", "version": 2, "model": {{
"vertices": [[0, 0, 9], [-45, 0, 0], [45, 0, 0], [0, 30, 0], [0, -70, 1]],
"triangles": [[0, 1, 4], [0, 4, 2]], "features": {{{}}}, "contours": [{}], "modes": [
{{"kind": "identity", "displacements": [[1, 2, 3], [4, 5, 6], [7, 8, 9], [0, 0, 0], [-5, -5, 5]]}},
{{"kind": "expression", "displacements": [[0, 0, 0], [9, 0, 0], [-9, 0, 0], [0, 7, 0], [1, 1, 1]]}}]}}}}"#,
        features.join(", "),
        contours.join(", ")
    );
    let parts = ["\"model\"", "\"triangles\"", "\"features\"", "\"contours\"", "\"modes\""];
    let cut =
        parts.iter().filter_map(|part| text.find(part)).map(|at| text.as_bytes()[..at].to_vec());
    cut.chain([text.clone().into_bytes()]).collect()
}
