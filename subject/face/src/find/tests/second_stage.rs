use super::super::features::second_stage;
use super::super::{DetectedFace, SECOND_STAGE_COUNT, hypotheses, second_stage_hypotheses};
use super::{drawn, turned};
use crate::photo::Photo;
use crate::plane::Pyramid;
use crate::points::RoughFace;

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
        let (frame, features) = second_stage(&Pyramid::new(photo.grey()), &photo, &first).unwrap();
        assert_eq!(features.len(), SECOND_STAGE_COUNT);
        let [to_left, to_right] = frame.eyes();
        let pairs =
            [(to_left, left), (to_right, right), (frame.at(0.0, super::Frame::MOUTH), mouth)];
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
            let seen = second_stage(pyramid, photo, place);
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
