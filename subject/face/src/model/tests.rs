mod recorded;

use std::collections::HashSet;

use super::*;
use mocapd_testkit::random::Random;

fn camera(yaw_deg: f64, pitch_deg: f64, roll_deg: f64) -> Camera {
    Camera { scale_px_per_mm: 1.3, yaw_deg, pitch_deg, roll_deg, origin_px: [210.0, 180.0] }
}

/// Points of a face that the model can represent, as a camera sees them.
fn seen(model: &Model, camera: &Camera, coefficients: &[f64]) -> Vec<[f64; 3]> {
    let vertices = model.shape(coefficients);
    camera.project(&model.feature_points(&vertices, &camera.rotation()))
}

fn given(points: &[[f64; 3]]) -> Vec<Landmark> {
    FeatureId::all()
        .zip(points)
        .map(|(id, p)| Landmark { id, xy_px: [p[0], p[1]], confidence: 1.0 })
        .collect()
}

#[test]
fn the_generic_face_is_complete_and_named() {
    let model = Model::generic().unwrap();
    assert!((110..=500).contains(&model.vertices.len()), "{}", model.vertices.len());
    assert!(model.modes.iter().all(|m| m.displacements.len() == model.vertices.len()));
    let eyes =
        ["right_eye_outer", "left_eye_outer"].map(|name| model.vertices[model.features[name]]);
    assert!((eyes[1][0] - eyes[0][0] - OUTER_EYES_MM).abs() < 0.02, "{eyes:?}");
    // The features are at anatomically correct positions.
    let y = |name: &str| model.vertices[model.features[name]][1];
    let downward = [
        "right_brow_3",
        "right_eye_top_outer",
        "right_eye_bottom_outer",
        "nose_tip",
        "nose_bottom",
        "mouth_top",
        "mouth_inner_top",
        "mouth_inner_bottom",
        "mouth_bottom",
        "chin",
    ];
    for pair in downward.windows(2) {
        assert!(y(pair[0]) > y(pair[1]), "{pair:?}");
    }
    // Each edge belongs to at most two triangles, which traverse it in opposite directions.
    let mut directed = std::collections::BTreeSet::new();
    for &[a, b, c] in &model.triangles {
        for edge in [(a, b), (b, c), (c, a)] {
            assert!(directed.insert(edge), "{edge:?} twice");
        }
    }
}

#[test]
fn left_mirrors_right() {
    let model = Model::generic().unwrap();
    for (name, &left) in &model.features {
        if let Some(other) = name.strip_prefix("left_") {
            let right = model.vertices[model.features[&format!("right_{other}")]];
            let left = model.vertices[left];
            for (a, b) in [(left[0], -right[0]), (left[1], right[1]), (left[2], right[2])] {
                assert!((a - b).abs() < 0.05, "{name}: {left:?} {right:?}");
            }
        }
    }
}

#[test]
fn modes_are_orthogonal() {
    let model = Model::generic().unwrap();
    let dot = |a: &Mode, b: &Mode| -> f64 {
        a.displacements
            .iter()
            .flatten()
            .zip(b.displacements.iter().flatten())
            .map(|(a, b)| a * b)
            .sum()
    };
    for (i, a) in model.modes.iter().enumerate() {
        for b in &model.modes[..i] {
            let cosine = dot(a, b) / (dot(a, a) * dot(b, b)).sqrt();
            assert!(cosine.abs() < 0.03, "{i}: {cosine}");
        }
    }
}

#[test]
fn names_and_numbers_agree() {
    for id in FeatureId::all() {
        assert_eq!(FeatureId::from_name(id.name()), Some(id));
        assert_eq!(FeatureId::from_index(id.index()), Some(id));
        if let Some(point) = id.ibug() {
            assert_eq!(FeatureId::from_ibug(point), Some(id));
        }
    }
    assert_eq!(FeatureId::RIGHT_EYE_OUTER.ibug(), Some(36));
    assert_eq!(FeatureId::LEFT_EYE_OUTER.ibug(), Some(45));
    assert_eq!(FeatureId::from_index(FeatureId::COUNT), None);
}

#[test]
fn projecting_and_back_is_the_identity() {
    let model = Model::generic().unwrap();
    let camera = camera(25.0, -11.0, 38.0);
    let back = camera.unproject(&camera.project(&model.vertices));
    for (a, b) in model.vertices.iter().flatten().zip(back.iter().flatten()) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    let angles = Camera::angles_deg(&camera.rotation());
    for (a, b) in angles.iter().zip([25.0, -11.0, 38.0]) {
        assert!((a - b).abs() < 1e-9, "{angles:?}");
    }
}

#[test]
fn yaw_turns_the_nose_to_the_right_of_the_picture() {
    let model = Model::generic().unwrap();
    let tip = [model.vertices[model.features["nose_tip"]]];
    assert!(
        camera(30.0, 0.0, 0.0).project(&tip)[0][0]
            > camera(0.0, 0.0, 0.0).project(&tip)[0][0] + 5.0
    );
    assert!(
        camera(0.0, 20.0, 0.0).project(&tip)[0][1]
            > camera(0.0, 0.0, 0.0).project(&tip)[0][1] + 5.0
    );
}

#[test]
fn the_pose_and_points_of_random_faces_are_recovered() {
    let model = Model::generic().unwrap();
    let mut noise = Random::new(7);
    let (mut worst_yaw, mut sum) = (0.0f64, 0.0);
    let rounds = 60;
    for _ in 0..rounds {
        let coefficients: Vec<f64> = model.modes.iter().map(|_| 0.7 * noise.normal()).collect();
        let camera =
            camera(90.0 * noise.unit() - 45.0, 8.0 * noise.normal(), 40.0 * noise.unit() - 20.0);
        let truth = seen(model, &camera, &coefficients);
        let mut points = given(&truth);
        for Landmark { xy_px: at, .. } in &mut points {
            at[0] += 2.0 * noise.normal();
            at[1] += 2.0 * noise.normal();
        }
        let fit = model.fit_shape(&points, &FitOptions::default()).unwrap();
        worst_yaw = worst_yaw.max((fit.camera.yaw_deg - camera.yaw_deg).abs());
        let off = |p: &[f64; 3], q: &[f64; 3]| (p[0] - q[0]).hypot(p[1] - q[1]);
        sum += fit.points_px.iter().zip(&truth).map(|(p, q)| off(p, q)).sum::<f64>() / 53.0;
    }
    // The noise moved each point by 2.5 px on average: the model removes a good part of it.
    let mean = sum / f64::from(rounds);
    assert!(mean < 1.9, "{mean} px");
    assert!(worst_yaw < 8.0, "{worst_yaw} degrees");
}

#[test]
fn a_few_wrong_points_are_corrected() {
    let model = Model::generic().unwrap();
    let camera = camera(12.0, 3.0, -9.0);
    let truth = seen(model, &camera, &[0.8, -0.5, 0.3]);
    let mut points = given(&truth);
    for name in
        ["mouth_left", "right_eye_top_outer", "left_brow_1", "nose_right", "left_contour_top"]
    {
        let index = FeatureId::from_name(name).unwrap().index();
        points[index].xy_px[0] += 45.0;
        points[index].xy_px[1] -= 30.0;
    }
    let fit = model.fit_shape(&points, &FitOptions::default()).unwrap();
    for (id, (p, q)) in FeatureId::all().zip(fit.points_px.iter().zip(&truth)) {
        let off = (p[0] - q[0]).hypot(p[1] - q[1]);
        // As a fraction of the outer interocular distance of 117 px; the points were off by 54 px.
        let share = if id.is_contour() { 0.08 } else { 0.05 };
        assert!(off < share * 117.0, "{}: {off}", id.name());
    }
    let mouth = FeatureId::from_name("mouth_left").unwrap().index();
    let ([x, y, _], at) = (fit.points_px[mouth], points[mouth].xy_px);
    let off_sd = (x - at[0]).hypot(y - at[1]) / (117.0 * FitOptions::default().noise_interocular);
    assert!(off_sd > 5.0, "{off_sd}");
}

#[test]
fn points_that_cannot_be_a_face_are_refused() {
    let model = Model::generic().unwrap();
    let options = FitOptions::default();
    let points = given(&seen(model, &camera(0.0, 0.0, 0.0), &[]));
    assert!(matches!(model.fit_shape(&points[..5], &options), Err(FitError::TooFew(5))));
    let line: Vec<_> =
        points.iter().map(|p| Landmark { xy_px: [p.xy_px[0], 2.0 * p.xy_px[0]], ..*p }).collect();
    assert_eq!(model.fit_shape(&line, &options), Err(FitError::Degenerate));
    let place: Vec<_> = points.iter().map(|p| Landmark { xy_px: [3.0, 4.0], ..*p }).collect();
    assert_eq!(model.fit_shape(&place, &options), Err(FitError::Degenerate));
    let mut bad = points.clone();
    bad[9].xy_px[0] = f64::NAN;
    assert!(matches!(model.fit_shape(&bad, &options), Err(FitError::NotFinite { .. })));
    bad = points;
    bad[9].confidence = -1.0;
    assert!(matches!(model.fit_shape(&bad, &options), Err(FitError::NotFinite { .. })));
}

#[test]
fn damaged_models_are_refused() {
    let text = include_str!("../../data/face-model.json").trim_end();
    let mut reasons = HashSet::new();
    for (from, to) in [
        ("\"version\": 2", "\"version\": 3"),
        ("\"vertices\": [", "\"vertices\": [[0, 0, 0],"),
        ("\"nose_tip\": ", "\"nose_tip\": 9"),
        ("\"nose_bottom\"", "\"nose_base\""),
        ("\"contours\": [", "\"contours\": [[],"),
        ("identity", "identify"),
        ("0.2915]", "1.2915]"),
        ("\"displacements\":[[", "\"displacements\":[[0,0,0],["),
        ("[-35.64,", "[-35.64e9,"),
    ] {
        let damaged = text.replacen(from, to, 1);
        assert_ne!(damaged, text, "{from}");
        let reason = Model::parse(&damaged).unwrap_err().to_string();
        assert!(reasons.insert(reason.clone()), "{from}: duplicate message: {reason}");
    }
    for end in (0..text.len()).step_by(997) {
        assert!(Model::parse(&text[..end]).is_err());
    }
}

#[test]
fn an_error_is_a_short_line_for_any_model() {
    let word = "z\u{7}".repeat(3000);
    let model = |vertices: &str, triangles: &str| {
        format!(
            r#"{{"format": "mocapd-face-model", "version": 2, "model": {{"vertices": [{vertices}],
            "triangles": [{triangles}], "features": {{}}, "contours": [], "modes": []}}}}"#
        )
    };
    for text in [
        word.clone(),
        format!(r#"{{"format": "{}"}}"#, "z\\n".repeat(3000)),
        format!(r#"{{"format": "mocapd-face-model", "{}": 2}}"#, "z\\n".repeat(3000)),
        model("", ""),
        model("[0, 0, 0]", ""),
        model("[0, 0, 1e999]", ""),
        model("[0, 0, 0]", "[0, 0, -1]"),
        model("[0, 0, 0]", "[0, 0, 99999999999999999999]"),
        "[".repeat(100_000),
    ] {
        let reason = Model::parse(&text).unwrap_err().to_string();
        assert!(reason.chars().count() < 300 && !reason.contains(char::is_control), "{reason:?}");
    }
}
