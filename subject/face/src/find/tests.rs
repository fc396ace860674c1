use mocapd_testkit::photograph::Scene;
use mocapd_testkit::random::Random;

use super::learned_stages::{STEPS, first_stage_features, mirrored, second_stage_features};
use super::{
    DetectedFace, FEATURE_COUNT, Frame, SCORE_MIN, SECOND_STAGE_COUNT, faces, hypotheses,
    second_stage_hypotheses,
};
use crate::model::FeatureId;
use crate::photo::Photo;
use crate::plane;
use crate::plane::Pyramid;
use crate::points::RoughFace;

/// A drawn person in front of clutter, and the centres of eyes and mouth.
fn drawn(seed: u64, interocular_px: f64, roll_deg: f64) -> (Photo, [[f64; 2]; 3]) {
    turned(seed, interocular_px, 0.0, roll_deg)
}

/// The same, turned to the right of the picture.
fn turned(seed: u64, interocular_px: f64, yaw_deg: f64, roll_deg: f64) -> (Photo, [[f64; 2]; 3]) {
    let mut scene = Scene::portrait(seed, interocular_px, yaw_deg);
    for sitter in &mut scene.faces {
        sitter.roll_deg = roll_deg;
    }
    let picture = scene.render().unwrap();
    let size = (picture.image.width() as usize, picture.image.height() as usize);
    let pixels = picture.image.pixels().map(|pixel| pixel.0).collect();
    let at = |i: usize| {
        let [x, y, _] = picture.faces[0].points_px[FeatureId::from_ibug(i).unwrap().index()];
        [x, y]
    };
    let mean = |from: usize, to: usize| plane::mean((from..to).map(at));
    let photo = Photo::from_pixels(size.0, size.1, pixels).unwrap();
    (photo, [mean(36, 42), mean(42, 48), mean(48, 60)])
}

/// A photograph as it is, without its colours, or otherwise modified.
fn with(photo: &Photo, change: impl Fn([u8; 3]) -> [u8; 3]) -> Photo {
    let pixels = photo.pixels().iter().copied().map(change).collect();
    Photo::from_pixels(photo.width(), photo.height(), pixels).unwrap()
}

#[test]
fn a_drawn_face_is_found_at_any_size_and_roll_once() {
    let faces_drawn =
        [(1, 44.0, 0.0), (2, 64.0, 0.0), (3, 130.0, 0.0), (4, 70.0, 26.0), (5, 70.0, -26.0)];
    for (seed, interocular_px, roll_deg) in faces_drawn {
        let (photo, [left, right, mouth]) = drawn(seed, interocular_px, roll_deg);
        for photo in [with(&photo, |[_, green, _]| [green; 3]), photo] {
            let all = faces(&photo, SCORE_MIN);
            assert_eq!(all.len(), 1, "{seed} {interocular_px} {roll_deg}: {all:?}");
            let found = all[0];
            let pairs = [(found.eyes[0], left), (found.eyes[1], right), (found.mouth, mouth)];
            for (seen, truth) in pairs {
                let off = (seen[0] - truth[0]).hypot(seen[1] - truth[1]) / interocular_px;
                assert!(off < 0.12, "{seed} {interocular_px} {roll_deg}: {off} of {found:?}");
            }
            let roll_rad = (right[1] - left[1]).atan2(right[0] - left[0]);
            assert!((found.roll_rad - roll_rad).abs() < 0.12, "{found:?}");
            assert!((found.interocular_px / interocular_px - 1.0).abs() < 0.2, "{found:?}");
        }
    }
}

#[test]
fn an_upside_down_face_has_a_lower_score() {
    let upright = drawn(6, 70.0, 0.0).0;
    let pixels: Vec<[u8; 3]> = upright.pixels().iter().rev().copied().collect();
    let over = Photo::from_pixels(upright.width(), upright.height(), pixels).unwrap();
    let best = |photo: &Photo| faces(photo, 0.0).first().map_or(0.0, |found| found.score);
    assert!(best(&over) < best(&upright), "{} {}", best(&over), best(&upright));
}

#[test]
fn noise_and_uniform_pictures_have_no_faces() {
    let mut random = Random::new(3);
    let mut grain = || random.byte();
    let noisy = (0..200 * 160).map(|_| [grain(), grain(), grain()]).collect();
    assert_eq!(faces(&Photo::from_pixels(200, 160, noisy).unwrap(), SCORE_MIN), []);
    for (width, height) in [(32, 32), (32, 400), (33, 35), (300, 40)] {
        let flat = Photo::from_pixels(width, height, vec![[200, 150, 130]; width * height]);
        assert_eq!(faces(&flat.unwrap(), SCORE_MIN), []);
    }
}

#[test]
fn a_frame_passes_through_eyes_and_mouth_at_any_turn() {
    let (eyes, mouth) = ([[30.0, 28.0], [50.0, 32.0]], [37.0, 56.0]);
    for turn in [0.0, 0.2, -0.3] {
        let frame = Frame::through(eyes, mouth, turn);
        assert_eq!(frame.eyes(), eyes);
        let [x, y] = frame.at(0.0, Frame::MOUTH);
        assert!((x - mouth[0]).abs() < 1e-4 && (y - mouth[1]).abs() < 1e-4, "{turn}: {x} {y}");
    }
}

#[test]
fn the_same_photograph_gives_the_same_faces() {
    let photo = drawn(7, 60.0, 6.0).0;
    assert_eq!(faces(&photo, 0.0), faces(&photo, 0.0));
}

#[test]
fn features_of_a_mirrored_photograph_are_the_mirrored_features() {
    let photo = drawn(8, 60.0, 11.0).0;
    let mirrored_pixels = photo.pixels().chunks(photo.width()).flat_map(|row| row.iter().rev());
    let pixels = mirrored_pixels.copied().collect();
    let other = Photo::from_pixels(photo.width(), photo.height(), pixels).unwrap();
    let frame = Frame { origin: [112.0, 99.0], across: [45.0, 6.0], down: [-5.0, 50.0], turn: 0.1 };
    let back = Frame {
        origin: [photo.width() as f32 - 1.0 - 112.0, 99.0],
        across: [45.0, -6.0],
        down: [5.0, 50.0],
        turn: -0.1,
    };
    let own = first_stage_features(&Pyramid::new(photo.grey()), &frame);
    let of_other = first_stage_features(&Pyramid::new(other.grey()), &back);
    assert_eq!(own.len(), FEATURE_COUNT);
    assert_eq!(mirrored(&mirrored(&own)), own);
    let off = mirrored(&own).iter().zip(&of_other).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(off <= Some(2), "{off:?}");
}

#[test]
fn alignment_moves_eyes_and_mouth_nearer_to_the_truth() {
    let (mut before, mut after) = (0.0, 0.0);
    for seed in 0..8 {
        let (photo, truth) = drawn(seed, 80.0, 0.0);
        let pyramid = Pyramid::new(photo.grey());
        let truth = truth.map(|at| at.map(|v| v as f32));
        let apart = truth[1][0] - truth[0][0];
        let far = |frame: &Frame| {
            let [left, right] = frame.eyes();
            let seen = [left, right, frame.at(0.0, Frame::MOUTH)];
            let off = seen.iter().zip(&truth).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
            off.sum::<f32>() / apart
        };
        let aside = if seed % 2 == 0 { 0.15 } else { -0.15 };
        let rough = Frame {
            origin: [(truth[0][0] + truth[1][0]) / 2.0 + aside * apart, truth[0][1]],
            across: [apart, 0.0],
            down: [0.0, 0.85 * (truth[2][1] - truth[0][1]) / Frame::MOUTH],
            turn: 0.0,
        };
        before += far(&rough);
        let aligned = STEPS
            .iter()
            .fold(rough, |at, step| step.aligned(&at, &first_stage_features(&pyramid, &at)));
        after += far(&aligned);
    }
    assert!(after < 0.7 * before, "{after} of {before}");
}

fn found(eyes: [[f64; 2]; 2], mouth: [f64; 2]) -> DetectedFace {
    let interocular_px = 1.43 * (eyes[1][0] - eyes[0][0]);
    DetectedFace { eyes, mouth, roll_rad: 0.0, interocular_px, score: 0.5 }
}

#[test]
fn the_second_stage_gets_few_hypotheses_with_all_features() {
    let photo = drawn(9, 60.0, 0.0).0;
    let again = second_stage_hypotheses(&photo);
    assert!((1..hypotheses(&photo).len() / 2).contains(&again.len()), "{}", again.len());
    for hypothesis in &again {
        assert_eq!(hypothesis.features.len(), SECOND_STAGE_COUNT);
        assert!((0.0..=1.0).contains(&hypothesis.found.score), "{hypothesis:?}");
    }
}

#[test]
fn the_second_stage_locates_eyes_and_mouth_and_estimates_the_turn() {
    for (seed, yaw_deg) in [(11, -25.0), (12, 25.0), (13, -18.0), (14, 18.0)] {
        let interocular_px = 80.0;
        let (photo, [left, right, mouth]) = turned(seed, interocular_px, yaw_deg, 0.0);
        // As far off as the first stage may be.
        let beside = |[x, y]: [f64; 2]| [x + 0.05 * interocular_px, y - 0.05 * interocular_px];
        let first = found([beside(left), beside(right)], beside(mouth));
        let (frame, features) =
            second_stage_features(&Pyramid::new(photo.grey()), &photo, &first).unwrap();
        assert_eq!(features.len(), SECOND_STAGE_COUNT);
        let [to_left, to_right] = frame.eyes();
        let pairs = [(to_left, left), (to_right, right), (frame.at(0.0, Frame::MOUTH), mouth)];
        for (seen, truth) in pairs {
            let off = (f64::from(seen[0]) - truth[0]).hypot(f64::from(seen[1]) - truth[1]);
            let off = off / interocular_px;
            assert!(off < 0.07, "{seed} {yaw_deg}: {off}");
        }
        let turn = f64::from(frame.turn);
        let expected = -yaw_deg.to_radians().tan() / 2.3;
        assert!((turn - expected).abs() < 0.12, "{seed} {yaw_deg}: {turn}, not {expected}");
    }
}

#[test]
fn degenerate_faces_are_skipped_or_have_all_features() {
    let photo = drawn(9, 60.0, 0.0).0;
    let pyramid = Pyramid::new(photo.grey());
    let small = Photo::from_pixels(32, 32, vec![[9; 3]; 32 * 32]).unwrap();
    let of_small = Pyramid::new(small.grey());
    let places = [
        found([[90.0, 90.0]; 2], [90.0, 90.0]),
        found([[90.0, 90.0], [91.0, 90.0]], [90.0, 91.0]),
        found([[-5e3, -5e3], [-4e3, -5e3]], [-4.5e3, -4e3]),
        found([[1e6, 1e6], [3e6, 1e6]], [2e6, 3e6]),
        found([[f64::NAN; 2]; 2], [0.0; 2]),
    ];
    for place in &places {
        for (pyramid, photo) in [(&pyramid, &photo), (&of_small, &small)] {
            let seen = second_stage_features(pyramid, photo, place);
            let is_whole = seen.is_none_or(|(_, features)| features.len() == SECOND_STAGE_COUNT);
            assert!(is_whole, "{place:?}");
        }
    }
}

#[test]
fn an_implausible_mouth_is_moved_to_a_plausible_place() {
    let eyes = [[100.0, 100.0], [140.0, 100.0]];
    let rough = RoughFace::from(&found(eyes, [120.0, 130.0]));
    assert_eq!((rough.left_eye, rough.right_eye), (eyes[0], eyes[1]));
    assert_eq!(rough.mouth, [120.0, 142.0]);
    assert_eq!(RoughFace::from(&found(eyes, [150.0, 150.0])).mouth, [132.0, 150.0]);
    assert_eq!(RoughFace::from(&found(eyes, [124.0, 146.0])).mouth, [124.0, 146.0]);
}
