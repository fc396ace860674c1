//! Faces of the seeded renderer, which nothing here was learned from.

use super::{CELLS_LOOK, Glance, PATCHES_LOOK, TOLD, Told};
use crate::Photo;
use crate::model::{FeatureId, Model};
use crate::points::Rough;
use crate::render::Scene;

const IO_PX: f64 = 80.0;

struct Drawn {
    photo: Photo,
    /// Those of [`TOLD`].
    landmarks: Vec<[f64; 2]>,
    rough: Rough,
}

fn drawn(seed: u64, yaw_deg: f64) -> Drawn {
    let picture = Scene::portrait(seed, IO_PX, yaw_deg).render().unwrap();
    let truth = &picture.faces[0];
    let features = &Model::generic().unwrap().features;
    let vertex = |name: &str| {
        let [x, y, _] = truth.vertices_px[features[name]];
        [x, y]
    };
    let landmark = |i: usize| match i {
        0..=7 => vertex(&format!("right_jaw_{}", i + 1)),
        8 => vertex("chin"),
        9..=16 => vertex(&format!("left_jaw_{}", 17 - i)),
        27 => vertex("nasion"),
        30 => vertex("nose_tip"),
        _ => truth.at(FeatureId::from_ibug(i).unwrap()),
    };
    let landmarks: Vec<_> = TOLD.iter().map(|i| landmark(*i)).collect();
    let middle = |range: std::ops::Range<usize>| {
        let part: Vec<_> = TOLD.iter().zip(&landmarks).filter(|(i, _)| range.contains(i)).collect();
        [0, 1].map(|axis| part.iter().map(|(_, p)| p[axis]).sum::<f64>() / part.len() as f64)
    };
    let (w, h) = picture.image.dimensions();
    let pixels = picture.image.pixels().map(|p| p.0).collect();
    Drawn {
        photo: Photo::from_pixels(w as usize, h as usize, pixels).unwrap(),
        rough: Rough { left_eye: middle(36..42), right_eye: middle(42..48), mouth: middle(48..60) },
        landmarks,
    }
}

/// Mean distance of eyes, brows, nose and mouth, in outer eye corners' distances.
fn off(drawn: &Drawn, glance: &Glance, told: &Told) -> f64 {
    let inner = |i: &usize| (17..27).contains(i) || *i > 30;
    let far: Vec<f64> = TOLD
        .iter()
        .zip(told)
        .zip(&drawn.landmarks)
        .filter(|((i, _), _)| inner(i))
        .map(|((_, told), at)| {
            let [x, y] = glance.to_photo(*told);
            (x - at[0]).hypot(y - at[1])
        })
        .collect();
    far.iter().sum::<f64>() / far.len() as f64 / IO_PX
}

#[test]
fn a_glance_says_where_the_landmarks_are_however_the_head_turns() {
    for (seed, yaw_deg) in [(1, 0.0), (2, 15.0), (3, -15.0), (4, 30.0), (5, -30.0)] {
        let drawn = drawn(seed, yaw_deg);
        let glance = Glance::at(&drawn.photo, &drawn.rough);
        let off = off(&drawn, &glance, &glance.told());
        assert!(off < 0.08, "seed {seed}, {yaw_deg} degrees: {off}");
    }
}

#[test]
fn eyes_and_mouth_that_are_a_tenth_off_do_no_harm() {
    let mut drawn = drawn(6, 10.0);
    drawn.rough.left_eye[0] += 0.1 * IO_PX;
    drawn.rough.mouth[1] -= 0.1 * IO_PX;
    let glance = Glance::at(&drawn.photo, &drawn.rough);
    let off = off(&drawn, &glance, &glance.told());
    assert!(off < 0.08, "{off}");
}

#[test]
fn looks_are_as_long_as_the_table_has_weights() {
    let photo = Photo::from_pixels(100, 80, vec![[90; 3]; 8000]).unwrap();
    let rough = Rough { left_eye: [1e300, -5.0], right_eye: [20.0, f64::NAN], mouth: [0.0; 2] };
    let glance = Glance::at(&photo, &rough);
    assert_eq!(glance.cells().len(), CELLS_LOOK);
    let far: Told = [[f64::NAN, 1e300]; TOLD.len()];
    assert_eq!(glance.patches(&far).len(), PATCHES_LOOK);
    assert!(glance.told().iter().flatten().all(|v| v.is_finite()));
}
