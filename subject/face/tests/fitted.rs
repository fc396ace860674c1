//! Writing, reading and drawing fitted faces.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use image::Rgb;
use mocapd_face::DocumentError;
use mocapd_face::fitted::{FittedFace, Method, Overlay, Part, Source};
use mocapd_face::model::{FeatureId, Landmark, Model};
use mocapd_testkit::{photograph::Scene, random::Random};

fn example() -> (image::RgbImage, FittedFace) {
    let model = Model::generic().unwrap();
    let picture = Scene::portrait(4, 70.0, 20.0).render().unwrap();
    let truth = &picture.faces[0];
    let points = FeatureId::all()
        .map(|id| Landmark {
            id,
            xy_px: truth.at(id),
            confidence: if id.is_contour() { 0.3 } else { 0.9 },
        })
        .collect();
    let (width, height) = picture.image.dimensions();
    let (width, height) = (Some(width), Some(height));
    let source =
        Source { name: "a <b> & \"c\".png".into(), sha256: "0f".repeat(32), width, height };
    let vertices = model.shape(&truth.coefficients);
    let face = FittedFace::new(model, Method::Default, source, truth.camera, points, vertices);
    (picture.image, face)
}

#[test]
fn a_written_face_is_read_back() {
    let (_, face) = example();
    let text = face.to_json().unwrap();
    let again = FittedFace::from_json(text.as_bytes()).unwrap();
    assert_eq!(again.to_json().unwrap(), text);
    assert_eq!(
        (again.source, again.triangles, again.features),
        (face.source, face.triangles, face.features)
    );
    for (a, b) in again.vertices_mm.iter().flatten().zip(face.vertices_mm.iter().flatten()) {
        assert!((a - b).abs() <= 0.0005 + 1e-9, "{a} {b}");
    }
    for (a, b) in again.points.iter().zip(&face.points) {
        assert!((a.xy_px[0] - b.xy_px[0]).abs() < 0.006 && a.id == b.id, "{a:?} {b:?}");
    }
}

#[test]
fn a_confidence_is_kept_and_may_be_missing() {
    let (_, mut face) = example();
    assert_eq!(face.confidence, None);
    let older = face.to_json().unwrap();
    assert!(!FittedFace::from_json(older.as_bytes()).unwrap().is_unsure());
    for (confidence, unsure) in [(0.0, true), (0.4996, true), (0.75, false), (1.0, false)] {
        face.confidence = Some(confidence);
        let again = FittedFace::from_json(face.to_json().unwrap().as_bytes()).unwrap();
        assert!((again.confidence.unwrap() - confidence).abs() < 0.000_51);
        assert_eq!(face.is_unsure(), unsure, "{confidence}");
    }
    face.confidence = Some(1.2);
    assert!(matches!(face.to_json(), Err(DocumentError::Value(_))));
}

#[test]
fn an_uncertain_face_has_a_wireframe_of_another_colour() {
    let (photograph, mut face) = example();
    let drawn =
        |face: &FittedFace| Overlay::new(&photograph, std::slice::from_ref(face)).into_image();
    let plain = drawn(&face);
    face.confidence = Some(0.9);
    assert_eq!(drawn(&face), plain);
    face.confidence = Some(0.1);
    // White lines have turned orange: less blue than they had.
    let less_blue = plain
        .pixels()
        .zip(drawn(&face).pixels())
        .filter(|(a, b)| a[2].saturating_sub(b[2]) > 40)
        .count();
    assert!(less_blue > 1000, "{less_blue}");
}

/// Difference of brightness of two pixels, of 255.
fn apart(a: &Rgb<u8>, b: &Rgb<u8>) -> f64 {
    let luma =
        |p: &Rgb<u8>| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]);
    (luma(a) - luma(b)).abs()
}

#[test]
fn a_wireframe_is_visible_on_any_background_at_any_size() {
    let (photograph, mut face) = example();
    // The orange of uncertain lines, skin, white and black, and the wireframe alone.
    face.points.clear();
    for ground in [[255, 160, 32], [224, 172, 136], [255; 3], [0; 3]] {
        for factor in [1, 6] {
            let (width, height) = (factor * photograph.width(), factor * photograph.height());
            let plain = image::RgbImage::from_pixel(width, height, Rgb(ground));
            for confidence in [0.9, 0.1] {
                let mut face = face.clone();
                face.confidence = Some(confidence);
                let mut camera = face.camera().unwrap();
                camera.scale_px_per_mm *= f64::from(factor);
                camera.origin_px = camera.origin_px.map(|v| v * f64::from(factor));
                face.set_camera(camera);
                let drawn = Overlay::new(&plain, &[face]).into_image();
                let ground = Rgb(ground);
                let seen = drawn.pixels().filter(|pixel| apart(pixel, &ground) > 60.0).count();
                let share = seen as f64 / f64::from(drawn.width() * drawn.height());
                assert!(share > 0.02, "{ground:?} x {factor}, {confidence}: {share:.4}");
            }
        }
    }
}

#[test]
fn only_several_faces_are_numbered() {
    let mut scene = Scene::portrait(4, 60.0, 0.0);
    scene.width_px *= 2;
    let mut other = scene.faces[0].clone();
    other.eyes_px[0] += 240.0;
    scene.faces.push(other);
    let picture = scene.render().unwrap();
    let (_, example) = example();
    let faces: Vec<FittedFace> = picture
        .faces
        .iter()
        .map(|truth| {
            let mut face = example.clone();
            face.set_camera(truth.camera);
            face.points.iter_mut().for_each(|point| point.xy_px = truth.at(point.id));
            face
        })
        .collect();
    let drawn = |faces: &[FittedFace]| Overlay::new(&picture.image, faces).into_image();
    let both = drawn(&faces);
    let swapped = drawn(&[faces[1].clone(), faces[0].clone()]);
    let alone = [drawn(&faces[..1]), drawn(&faces[1..])];
    assert_eq!(both.dimensions(), alone[0].dimensions());
    // Pixels that are on neither picture of one face belong to a number; the numbers change places with the order of
    // the faces.
    let wider = both.width() / picture.image.width();
    let numbers = |drawn: &image::RgbImage| -> Vec<[u32; 2]> {
        let is_new = |(x, y, pixel): &(u32, u32, &Rgb<u8>)| {
            alone.iter().all(|one| apart(one.get_pixel(*x, *y), pixel) > 40.0)
        };
        drawn.enumerate_pixels().filter(is_new).map(|(x, y, _)| [x / wider, y / wider]).collect()
    };
    let found = numbers(&both);
    assert!(found.len() > 200, "{}", found.len());
    for truth in &picture.faces {
        let [x, y] = truth.camera.origin_px;
        let near = |at: &&[u32; 2]| {
            let [dx, dy] = [f64::from(at[0]) - x, f64::from(at[1]) - y];
            dx.abs() < 120.0 && dy.abs() < 160.0
        };
        assert!(found.iter().filter(near).count() > 100, "no number near {x:.0}, {y:.0}");
    }
    assert_ne!(both, swapped);
    // Ten faces and more have two digits; a face beyond the picture's edge has its number inside.
    let mut many = vec![faces[0].clone(); 12];
    many[11].origin_px = Some([-1e5, 9e5]);
    many[11].points.clear();
    assert_ne!(drawn(&many), drawn(&many[..11]));
}

#[test]
fn notes_are_kept_and_make_a_face_uncertain() {
    let (_, mut face) = example();
    assert!(!face.is_unsure());
    face.notes = vec!["the mouth lies low".to_owned()];
    assert!(face.is_unsure());
    let again = FittedFace::from_json(face.to_json().unwrap().as_bytes()).unwrap();
    assert_eq!(again.notes, face.notes);
    face.notes = vec!["a\nb".to_owned()];
    assert!(matches!(face.to_json(), Err(DocumentError::Value(_))));
    face.notes = vec!["a".to_owned(); 51];
    assert!(matches!(face.to_json(), Err(DocumentError::Value(_))));
}

#[test]
fn invalid_face_files_are_refused() {
    let (_, face) = example();
    let good: serde_json::Value = serde_json::from_str(&face.to_json().unwrap()).unwrap();
    let refused = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut bad = good.clone();
        change(&mut bad);
        FittedFace::from_json(bad.to_string().as_bytes()).unwrap_err()
    };
    assert!(matches!(refused(&|v| v["format"] = "mocapd-skeleton".into()), DocumentError::Kind(_)));
    assert!(matches!(refused(&|v| v["version"] = 2.into()), DocumentError::Kind(_)));
    assert!(matches!(refused(&|v| v["points"] = 2.into()), DocumentError::Shape(_)));
    assert!(matches!(refused(&|v| v["points"][3]["name"] = "ear".into()), DocumentError::Shape(_)));
    let only_three = |v: &mut serde_json::Value| {
        v["points"].as_array_mut().unwrap().truncate(3);
    };
    assert!(matches!(refused(&only_three), DocumentError::Value(_)));
    let why = refused(&|v| v["points"][3]["name"] = "mouth_top".into()).to_string();
    assert!(why.contains("`points[3].name` is \"mouth_top\""), "{why}");
    assert!(matches!(
        refused(&|v| v["points"][3]["confidence"] = 1.5.into()),
        DocumentError::Value(_)
    ));
    assert!(matches!(refused(&|v| v["confidence"] = (-0.5).into()), DocumentError::Value(_)));
    assert!(matches!(refused(&|v| v["triangles"][7][1] = 100_000.into()), DocumentError::Value(_)));
    let why = refused(&|v| v["features"]["nose_tip"] = 5000.into()).to_string();
    assert!(why.contains("`features.nose_tip` is 5000, expected vertices"), "{why}");
    assert!(matches!(refused(&|v| v["vertices_mm"][0][0] = 1e300.into()), DocumentError::Value(_)));
    assert!(matches!(
        refused(&|v| v["vertices_mm"] = serde_json::json!([])),
        DocumentError::Value(_)
    ));
    assert!(matches!(refused(&|v| v["scale_px_per_mm"] = 0.into()), DocumentError::Value(_)));
    let why = refused(&|v| v["pose_deg"]["pitch"] = 200.into()).to_string();
    assert!(why.contains("`pose_deg.pitch` is 200.0, expected"), "{why}");
    assert!(matches!(refused(&|v| v["source"]["sha256"] = 7.into()), DocumentError::Shape(_)));
    let why = refused(&|v| v["lines"][7][1] = 100_000.into()).to_string();
    assert!(
        why.contains("`lines[7]` is [") && why.contains(", 100000], expected vertices"),
        "{why}"
    );
    assert!(matches!(refused(&|v| v["source"]["name"] = "a\nb".into()), DocumentError::Value(_)));
    assert!(matches!(FittedFace::from_json(&[b' '; 2 << 20]), Err(DocumentError::Value(_))));
    let text = face.to_json().unwrap();
    for end in (0..text.len()).step_by(1009) {
        assert!(FittedFace::from_json(&text.as_bytes()[..end]).is_err());
    }
    let mut broken = face;
    broken.vertices_mm[3][1] = f64::NAN;
    assert!(matches!(broken.to_json(), Err(DocumentError::Value(_))));
}

#[test]
fn foreign_documents_may_have_other_keys_and_lack_optional_ones() {
    let (photograph, face) = example();
    let good: serde_json::Value = serde_json::from_str(&face.to_json().unwrap()).unwrap();
    let read = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut other = good.clone();
        change(&mut other);
        let face = FittedFace::from_json(other.to_string().as_bytes()).unwrap();
        face.to_obj();
        face.to_svg();
        Overlay::new(&photograph, std::slice::from_ref(&face)).into_image();
        assert_eq!(FittedFace::from_json(face.to_json().unwrap().as_bytes()).as_ref(), Ok(&face));
        face
    };
    assert_eq!(read(&|v| v["colour"] = 2.into()), read(&|_| {}));
    assert_eq!(read(&|v| v["source"]["camera"] = "box".into()), read(&|_| {}));
    assert_eq!(read(&|v| v["source"]["sha256"] = "ABC".into()).source.unwrap().sha256, "ABC");
    assert_eq!(read(&|v| v["method"] = "by hand".into()).method, "by hand");
    assert!(read(&|v| v["points"] = serde_json::json!([])).points.is_empty());
    for key in ["method", "points", "triangles", "features"] {
        read(&|v| drop(v.as_object_mut().unwrap().remove(key)));
    }
    for key in ["source", "pose_deg", "scale_px_per_mm", "origin_px"] {
        let without = read(&|v| drop(v.as_object_mut().unwrap().remove(key)));
        assert_eq!(without, read(&|v| v[key] = serde_json::Value::Null), "{key}");
        assert_eq!(
            (without.source.is_none(), without.camera().is_none()),
            (key == "source", key != "source")
        );
    }
    // A minimal wireframe, with the alternative name of the vertices and its own lines.
    let least = r#"{"format":"mocapd-face","version":1,"vertices":[[0,0,0],[1,2,3]],"lines":[[0,1],[1,1]]}"#;
    let least = FittedFace::from_json(least.as_bytes()).unwrap();
    assert_eq!((least.vertices_mm.len(), &least.lines), (2, &vec![[0, 1], [1, 1]]));
    let plain = Overlay::new(&photograph, &[]).into_image();
    assert!(Overlay::new(&photograph, &[least]).into_image() == plain);
    // More vertices than the generic face has, and more lines than a surface would have.
    let many = |vertices: usize, lines: usize| {
        let (vertices, lines) =
            (vec!["[0,0,0]"; vertices].join(","), vec!["[0,1]"; lines].join(","));
        let text = format!(
            r#"{{"format":"mocapd-face","version":1,"vertices_mm":[{vertices}],"lines":[{lines}]}}"#
        );
        FittedFace::from_json(text.as_bytes())
    };
    assert_eq!(many(100_000, 9).unwrap().vertices_mm.len(), 100_000);
    assert_eq!(many(9, 100_000).unwrap().lines.len(), 100_000);
    assert!(matches!(many(9, (1 << 17) + 1), Err(DocumentError::Value(_))));
}

#[test]
fn an_error_is_a_short_line_for_any_file() {
    let long = "x\\n\\u0007".repeat(500);
    for text in [
        format!(r#"{{"format": "mocapd-face", "version": 1, "{long}": 0}}"#),
        format!(r#"{{"format": "{long}", "version": 1}}"#),
        "[".repeat(100_000),
        r#"{"format": "mocapd-face", "version": 4294967296}"#.to_owned(),
        r#"{"format": "mocapd-face", "version": 1, "vertices_mm": [[1e999, 0, 0]]}"#.to_owned(),
    ] {
        let reason = FittedFace::from_json(text.as_bytes()).unwrap_err().to_string();
        assert!(reason.chars().count() < 300 && !reason.contains(char::is_control), "{reason:?}");
    }
}

#[test]
fn changed_bytes_give_an_error_or_a_valid_face() {
    let (_, face) = example();
    let good = face.to_json().unwrap().into_bytes();
    let mut random = Random::new(9);
    let mut read = 0;
    for _ in 0..400 {
        let mut bytes = good.clone();
        for _ in 0..1 + (3.0 * random.unit()) as usize {
            let at = (random.unit() * bytes.len() as f64) as usize;
            bytes[at] = random.one_of(b"0123456789-.e,[]{}\"ax ");
        }
        if let Ok(again) = FittedFace::from_json(&bytes) {
            // Every face that is read can be drawn and written.
            again.to_json().unwrap();
            again.to_obj();
            again.to_svg();
            read += 1;
        }
    }
    assert!(read > 20, "{read}");
}

#[test]
fn the_obj_has_every_vertex_and_triangle() {
    let (_, face) = example();
    let obj = face.to_obj();
    let count = |word: &str| obj.lines().filter(|line| line.starts_with(word)).count();
    assert_eq!((count("v "), count("f ")), (face.vertices_mm.len(), face.triangles.len()));
    assert_eq!(count("# feature "), face.features.len());
}

#[test]
fn the_overlay_marks_its_points_in_their_colours() {
    let (photograph, face) = example();
    let picture = Overlay::new(&photograph, std::slice::from_ref(&face)).into_image();
    // 70 px between the eyes are enlarged to three times that.
    assert_eq!(picture.width(), 3 * photograph.width());
    for point in face.points.iter().filter(|p| p.confidence > 0.5 && Part::of(p.id) == Part::Nose) {
        let at = point.xy_px.map(|v| ((v + 0.5) * 3.0 - 0.5).round() as u32);
        assert_eq!(
            picture.get_pixel(at[0], at[1]),
            &Rgb(Part::Nose.colour()),
            "{}",
            point.id.name()
        );
    }
    let mut far = face;
    far.origin_px = Some([-1e5, 1e5]);
    far.points.iter_mut().for_each(|p| p.xy_px = [1e5, -1e5]);
    let untouched = Overlay::new(&photograph, &[far]).into_image();
    let plain = image::imageops::resize(
        &photograph,
        untouched.width(),
        untouched.height(),
        image::imageops::FilterType::CatmullRom,
    );
    assert_eq!(untouched, plain);
}

#[test]
fn the_svg_has_three_views() {
    let (_, face) = example();
    let svg = face.to_svg();
    for text in [
        ">front<",
        ">three-quarter<",
        ">side<",
        "mm, nominal",
        "a &lt;b&gt; &amp; &quot;c&quot;.png",
    ] {
        assert!(svg.contains(text), "{text}");
    }
    // More than half of the triangles face the viewer in each of the first two views.
    assert!(svg.matches('Z').count() > face.triangles.len());
}

/// Writes outputs for visual inspection into the folder that `MOCAPD_FACES_DRAWN` names.
#[test]
fn outputs_to_look_at() {
    let Some(folder) = std::env::var_os("MOCAPD_FACES_DRAWN").map(std::path::PathBuf::from) else {
        println!("passed over: MOCAPD_FACES_DRAWN names no folder");
        return;
    };
    let (photograph, face) = example();
    let overlay = Overlay::new(&photograph, std::slice::from_ref(&face));
    overlay.into_image().save(folder.join("overlay.png")).unwrap();
    std::fs::write(folder.join("views.svg"), face.to_svg()).unwrap();
    std::fs::write(folder.join("face.json"), face.to_json().unwrap()).unwrap();
    std::fs::write(folder.join("face.obj"), face.to_obj()).unwrap();
}
