use super::*;

#[test]
fn the_same_scene_gives_the_same_pixels() {
    let scene = Scene::portrait(5, 40.0, 15.0);
    let first = scene.render().unwrap();
    assert_eq!(first, scene.render().unwrap());
    assert_ne!(first, Scene { seed: 6, ..scene }.render().unwrap());
}

/// Where the truth says that something is, the picture shows it: the light and the colour are a face's.
#[test]
fn a_face_is_dark_and_red_where_faces_are() {
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
fn the_truth_is_the_cameras() {
    let mut scene = Scene::portrait(3, 50.0, -30.0);
    scene.faces[0].roll_deg = 12.0;
    let truth = scene.render().unwrap().faces.remove(0);
    let model = Model::generic().unwrap();
    let points: Vec<_> = FeatureId::all().map(|id| (id, truth.at(id), 1.0)).collect();
    let fit = model.fit_shape(&points, &Default::default()).unwrap();
    assert!((fit.camera.yaw_deg + 30.0).abs() < 6.0, "{:?}", fit.camera);
    assert!((fit.camera.roll_deg - 12.0).abs() < 3.0, "{:?}", fit.camera);
    assert_eq!(truth.vertices_px, truth.camera.project(&model.shape(&truth.coefficients)));
}

#[test]
fn scenes_that_cannot_be_drawn_are_refused() {
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
        |s: &mut Sitter| s.io_px = f64::NAN,
        |s: &mut Sitter| s.io_px = 1e9,
        |s: &mut Sitter| s.yaw_deg = f64::INFINITY,
        |s: &mut Sitter| s.eyes_px = [1e9, 0.0],
    ] {
        let mut bad = scene.clone();
        change(&mut bad.faces[0]);
        assert_eq!(bad.render(), Err(RenderError::Sitter(0)));
    }
    // A face that is out of the picture is no error, and neither is none.
    let mut far = scene.clone();
    far.faces[0].eyes_px = [-9000.0, 40.0];
    far.render().unwrap();
    Scene { faces: Vec::new(), ..scene }.render().unwrap();
}

/// Writes pictures into the folder that `MOCAPD_FACES_DRAWN` names, to be looked at.
#[test]
fn pictures_to_look_at() {
    let Some(folder) = std::env::var_os("MOCAPD_FACES_DRAWN").map(std::path::PathBuf::from) else {
        println!("passed over: MOCAPD_FACES_DRAWN names no folder");
        return;
    };
    for (seed, yaw) in (0..8).zip([0.0, 20.0, -35.0, 0.0, 10.0, -15.0, 30.0, 0.0]) {
        let picture = Scene::portrait(seed, 80.0, yaw).render().unwrap();
        picture.image.save(folder.join(format!("face-{seed}.png"))).unwrap();
    }
}
