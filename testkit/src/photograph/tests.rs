use mocapd_face::model::Landmark;

use super::*;

#[test]
fn the_same_scene_gives_the_same_pixels() {
    let scene = Scene::portrait(5, 40.0, 15.0);
    let first = scene.render().unwrap();
    assert_eq!(first, scene.render().unwrap());
    assert_ne!(first, Scene { seed: 6, ..scene }.render().unwrap());
}

/// The picture agrees with the ground truth: eyes are dark, lips are red, and skin has its colour.
#[test]
fn features_have_their_colours() {
    for seed in 0..6 {
        let picture = Scene { noise: 0.0, ..Scene::portrait(seed, 80.0, 0.0) }.render().unwrap();
        let truth = &picture.faces[0];
        let at = |name: &str| truth.at(FeatureId::from_name(name).unwrap());
        let mean = |names: &[&str]| {
            let sum = names.iter().map(|n| at(n)).fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
            sum.map(|s| s / names.len() as f64)
        };
        let pixel = |p: [f64; 2]| {
            picture.image[(p[0].round() as u32, p[1].round() as u32)].0.map(f64::from)
        };
        let light = |p: [f64; 2]| pixel(p).iter().sum::<f64>();
        let red = |p: [f64; 2]| pixel(p)[0] / pixel(p)[1].max(1.0);
        let pupil = truth.vertices_px[Model::generic().unwrap().features["right_pupil"]];
        let eye = [pupil[0], pupil[1]];
        let mut cheek = mean(&["right_eye_bottom_outer", "mouth_right", "nose_right"]);
        cheek[0] -= 4.0;
        assert!(
            light(eye) < 0.6 * light(cheek),
            "{seed}: iris {} cheek {}",
            light(eye),
            light(cheek)
        );
        let lip = mean(&["mouth_bottom", "mouth_inner_bottom"]);
        assert!(red(lip) > 1.1 * red(cheek), "{seed}: lip {} cheek {}", red(lip), red(cheek));
        // Skin: red over green over blue.
        let [r, g, b] = pixel(cheek);
        assert!(r > 1.1 * g && g > 1.02 * b, "{seed}: {r} {g} {b}");
    }
}

#[test]
fn the_ground_truth_matches_the_camera() {
    let mut scene = Scene::portrait(3, 50.0, -30.0);
    scene.faces[0].roll_deg = 12.0;
    let truth = scene.render().unwrap().faces.remove(0);
    let model = Model::generic().unwrap();
    let points: Vec<_> =
        FeatureId::all().map(|id| Landmark { id, xy_px: truth.at(id), confidence: 1.0 }).collect();
    let fit = model.fit_shape(&points, &Default::default()).unwrap();
    assert!((fit.camera.yaw_deg + 30.0).abs() < 6.0, "{:?}", fit.camera);
    assert!((fit.camera.roll_deg - 12.0).abs() < 3.0, "{:?}", fit.camera);
    assert_eq!(truth.vertices_px, truth.camera.project(&model.shape(&truth.coefficients)));
}

#[test]
fn scenes_out_of_range_are_refused() {
    let scene = Scene::portrait(1, 20.0, 0.0);
    assert!(matches!(
        Scene { width_px: 0, ..scene.clone() }.render(),
        Err(RenderError::Size(0, _))
    ));
    assert!(matches!(
        Scene { height_px: 5000, ..scene.clone() }.render(),
        Err(RenderError::Size(_, 5000))
    ));
    for change in [
        |s: &mut Sitter| s.interocular_px = f64::NAN,
        |s: &mut Sitter| s.interocular_px = 1e9,
        |s: &mut Sitter| s.yaw_deg = f64::INFINITY,
        |s: &mut Sitter| s.eyes_px = [1e9, 0.0],
    ] {
        let mut bad = scene.clone();
        change(&mut bad.faces[0]);
        assert_eq!(bad.render(), Err(RenderError::Sitter(0)));
    }
    // A face outside the picture is allowed, and so is an empty scene.
    let mut far = scene.clone();
    far.faces[0].eyes_px = [-9000.0, 40.0];
    far.render().unwrap();
    Scene { faces: Vec::new(), ..scene }.render().unwrap();
}

/// Writes sample pictures to the folder `MOCAPD_FACES_DRAWN`, for visual inspection.
#[test]
fn sample_pictures() {
    let Some(folder) = std::env::var_os("MOCAPD_FACES_DRAWN").map(std::path::PathBuf::from) else {
        println!("skipped: MOCAPD_FACES_DRAWN is not set");
        return;
    };
    for (seed, yaw) in (0..8).zip([0.0, 20.0, -35.0, 0.0, 10.0, -15.0, 30.0, 0.0]) {
        let picture = Scene::portrait(seed, 80.0, yaw).render().unwrap();
        picture.image.save(folder.join(format!("face-{seed}.png"))).unwrap();
    }
}

#[test]
fn a_beard_covers_the_chin_but_not_nose_and_lips() {
    let mut chins = 0.0;
    for seed in 0..8 {
        let mut scene = Scene { noise: 0.0, ..Scene::portrait(seed, 90.0, 0.0) };
        let plain = scene.render().unwrap();
        scene.faces[0].extras = Occlusions { beard: 0.9, ..Occlusions::default() };
        let worn = scene.render().unwrap();
        let at = |name: &str| plain.faces[0].at(FeatureId::from_name(name).unwrap());
        let change = |[x, y]: [f64; 2]| {
            let light = |picture: &Picture| {
                let pixel = picture.image[(x.round() as u32, y.round() as u32)].0;
                pixel.map(f64::from).iter().sum::<f64>()
            };
            light(&worn) / light(&plain)
        };
        let (lip, below) = (at("mouth_inner_bottom"), at("mouth_bottom"));
        let (nose, middle) = (at("nose_bottom"), (lip[1] + below[1]) / 2.0);
        assert_eq!(change([nose[0], nose[1] - 6.0]), 1.0, "{seed}: the nose has none");
        assert!((change([lip[0], middle]) - 1.0).abs() < 0.1, "{seed}: nor have the lips");
        chins += change([below[0], below[1] + 14.0]) / 8.0;
    }
    // Hair is darker than skin on average.
    assert!(chins < 0.8, "{chins}");
}

#[test]
fn rims_stay_below_the_brow_and_a_fringe_above() {
    let (mut rims, mut fringe) = (0, 0);
    let mut scene = Scene { noise: 0.0, ..Scene::portrait(1, 90.0, 0.0) };
    let plain = scene.render().unwrap().image;
    scene.faces[0].extras = Occlusions { rims_mm: 2.5, ..Occlusions::default() };
    let rimmed = scene.render().unwrap().image;
    scene.faces[0].extras = Occlusions { fringe_mm: 30.0, ..Occlusions::default() };
    let fringed = scene.render().unwrap().image;
    let eyes = scene.faces[0].eyes_px[1];
    for (x, y, pixel) in plain.enumerate_pixels() {
        let above = f64::from(y) < eyes - 24.0;
        rims += usize::from(rimmed[(x, y)] != *pixel && !above);
        fringe += usize::from(fringed[(x, y)] != *pixel && above);
        assert!(rimmed[(x, y)] == *pixel || !above, "a rim at {x}, {y}");
        assert!(fringed[(x, y)] == *pixel || above, "hair at {x}, {y}");
    }
    assert!(rims > 400 && fringe > 1000, "{rims} {fringe}");
    scene.faces[0].extras.beard = f64::NAN;
    assert_eq!(scene.render(), Err(RenderError::Sitter(0)));
}
