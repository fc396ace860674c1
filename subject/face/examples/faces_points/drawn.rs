//! Drawn faces: any number of development faces with exact ground truth.

use std::error::Error;

use mocapd_face::Photo;
use mocapd_face::model::{FeatureId, Model};
use mocapd_testkit::photograph::{Occlusions, Scene};

use super::data::{Face, Noise, Truth};

/// Number of faces.
const FACES: u64 = 80;

/// Faces of all skin tones, with yaw up to 35 degrees and pitch up to 15, and 25 to 110 pixels between the eyes.
pub(crate) fn faces() -> Result<Vec<Face>, Box<dyn Error>> {
    (0..FACES).map(plain).collect()
}

/// Small faces of 20 to 60 pixels, with glasses, beards and fringes, lit from the side, grey and noisy.
pub(crate) fn worn_faces() -> Result<Vec<Face>, Box<dyn Error>> {
    (0..FACES).map(worn).collect()
}

fn worn(seed: u64) -> Result<Face, Box<dyn Error>> {
    let mut random = Noise::new(seed + 5001);
    let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
    let (eyes_px, yaw) = (20.0 * (1.1 * between(0.0, 1.0)).exp(), between(-35.0, 35.0));
    let mut scene = Scene::portrait(2000 + seed, eyes_px, yaw);
    scene.noise = between(1.0, 6.0);
    let mut sometimes = |share: f64, low: f64, high: f64| {
        let amount = between(low, high);
        if between(0.0, 1.0) < share { amount } else { 0.0 }
    };
    let (rims_mm, beard) = (sometimes(0.3, 1.0, 2.5), sometimes(0.3, 0.4, 0.95));
    let (fringe_mm, grey) = (sometimes(0.3, 10.0, 45.0), sometimes(0.2, 1.0, 1.0));
    let light = Some([between(-1.4, 1.4), between(-0.3, 1.6), 1.0]);
    for sitter in &mut scene.faces {
        sitter.pitch_deg = between(-15.0, 15.0);
        sitter.roll_deg = between(-10.0, 10.0);
        sitter.variety = 1.0;
        sitter.extras = Occlusions { rims_mm, beard, fringe_mm, light };
    }
    face(&format!("drawn_worn_{seed:03}"), &scene, yaw, grey > 0.0)
}

fn plain(seed: u64) -> Result<Face, Box<dyn Error>> {
    let mut random = Noise::new(seed + 1);
    let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
    let (eyes_px, yaw) = (25.0 * between(0.0, 1.0).mul_add(1.48, 0.0).exp(), between(-35.0, 35.0));
    let mut scene = Scene::portrait(1000 + seed, eyes_px, yaw);
    for sitter in &mut scene.faces {
        sitter.pitch_deg = between(-15.0, 15.0);
        sitter.roll_deg = between(-10.0, 10.0);
    }
    face(&format!("drawn_{seed:03}"), &scene, yaw, false)
}

fn face(name: &str, scene: &Scene, yaw_deg: f64, grey: bool) -> Result<Face, Box<dyn Error>> {
    let picture = scene.render()?;
    let truth = picture.faces.first().ok_or("the scene has no face")?;
    let model = Model::generic()?;
    let vertex = |name: &str| {
        let at = truth.vertices_px.get(*model.features.get(name)?)?;
        Some([at[0], at[1]])
    };
    let landmark = |i: usize| match i {
        0..=7 => vertex(&format!("right_jaw_{}", i + 1)),
        8 => vertex("chin"),
        9..=16 => vertex(&format!("left_jaw_{}", 17 - i)),
        _ => FeatureId::from_ibug(i).map(|id| truth.at(id)),
    };
    let landmarks: Vec<_> = (0..68).map(landmark).collect();
    let (w, h) = picture.image.dimensions();
    let shade = |[r, g, b]: [u8; 3]| {
        let luma = (0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)) as u8;
        if grey { [luma; 3] } else { [r, g, b] }
    };
    let pixels = picture.image.pixels().map(|p| shade(p.0)).collect();
    Ok(Face {
        name: name.to_owned(),
        number: 0,
        development: true,
        synthetic: true,
        photo: Photo::from_pixels(w as usize, h as usize, pixels)?,
        truth: Truth {
            visible: landmarks.iter().map(Option::is_some).collect(),
            landmarks: landmarks.into_iter().map(Option::unwrap_or_default).collect(),
            yaw_deg: Some(yaw_deg),
        },
    })
}
