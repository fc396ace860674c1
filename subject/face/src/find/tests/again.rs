use super::super::look::second;
use super::super::{Found, SECOND, hypotheses, hypotheses_again};
use super::{drawn, turned};
use crate::photo::Photo;
use crate::plane::Pyramid;
use crate::points::Rough;

fn found(eyes: [[f64; 2]; 2], mouth: [f64; 2]) -> Found {
    let io_px = 1.43 * (eyes[1][0] - eyes[0][0]);
    Found { eyes, mouth, roll_rad: 0.0, io_px, score: 0.5 }
}

#[test]
fn few_are_looked_at_again_and_those_whole() {
    let photo = drawn(9, 60.0, 0.0).0;
    let again = hypotheses_again(&photo);
    assert!((1..hypotheses(&photo).len() / 2).contains(&again.len()), "{}", again.len());
    for hypothesis in &again {
        assert_eq!(hypothesis.look.len(), SECOND);
        assert!((0.0..=1.0).contains(&hypothesis.found.score), "{hypothesis:?}");
    }
}

#[test]
fn a_second_look_sees_eyes_and_mouth_and_where_the_nose_points() {
    for (seed, yaw_deg) in [(11, -25.0), (12, 25.0), (13, -18.0), (14, 18.0)] {
        let io_px = 80.0;
        let (photo, [left, right, mouth]) = turned(seed, io_px, yaw_deg, 0.0);
        // As far beside them as a first look may be.
        let beside = |[x, y]: [f64; 2]| [x + 0.05 * io_px, y - 0.05 * io_px];
        let first = found([beside(left), beside(right)], beside(mouth));
        let (frame, look) = second(&Pyramid::new(photo.grey()), &photo, &first).unwrap();
        assert_eq!(look.len(), SECOND);
        let [to_left, to_right] = frame.eyes();
        let pairs =
            [(to_left, left), (to_right, right), (frame.at(0.0, super::Frame::MOUTH), mouth)];
        for (seen, truth) in pairs {
            let off = (f64::from(seen[0]) - truth[0]).hypot(f64::from(seen[1]) - truth[1]) / io_px;
            assert!(off < 0.07, "{seed} {yaw_deg}: {off}");
        }
        let turn = f64::from(frame.turn);
        let expected = -yaw_deg.to_radians().tan() / 2.3;
        assert!((turn - expected).abs() < 0.12, "{seed} {yaw_deg}: {turn}, not {expected}");
    }
}

#[test]
fn what_is_nowhere_or_nothing_is_not_looked_at_or_seen_whole() {
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
            let seen = second(pyramid, photo, place);
            assert!(seen.is_none_or(|(_, look)| look.len() == SECOND), "{place:?}");
        }
    }
}

#[test]
fn a_mouth_on_the_nose_is_begun_lower_and_one_far_aside_nearer() {
    let eyes = [[100.0, 100.0], [140.0, 100.0]];
    let rough = Rough::from(&found(eyes, [120.0, 130.0]));
    assert_eq!((rough.left_eye, rough.right_eye), (eyes[0], eyes[1]));
    assert_eq!(rough.mouth, [120.0, 142.0]);
    assert_eq!(Rough::from(&found(eyes, [150.0, 150.0])).mouth, [132.0, 150.0]);
    assert_eq!(Rough::from(&found(eyes, [124.0, 146.0])).mouth, [124.0, 146.0]);
}
