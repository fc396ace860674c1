use super::*;

/// The outline of an upright cylinder of radius 100 around the origin, turned in the picture by `roll`, and its eyes
/// painted at `side` radians left and right of a middle that is turned by `yaw`.
fn cylinder(yaw_deg: f64, roll_deg: f64) -> ([f64; 2], [f64; 2], Vec<[f64; 2]>) {
    let (sin, cos) = roll_deg.to_radians().sin_cos();
    // Counter-clockwise in a picture whose y points down.
    let rolled = |[x, y]: [f64; 2]| [300.0 + cos * x + sin * y, 200.0 - sin * x + cos * y];
    let eye = |side: f64| rolled([100.0 * (yaw_deg.to_radians() + side).sin(), -10.0]);
    let outline = [[-100.0, -150.0], [100.0, -150.0], [100.0, 150.0], [-100.0, 150.0]];
    (eye(-0.3), eye(0.3), outline.map(rolled).to_vec())
}

#[test]
fn on_a_cylinder_the_arcsine_is_right() {
    for roll in [-25.0, 0.0, 13.0] {
        for yaw in [-40.0, -20.0, 0.0, 10.0, 35.0] {
            let (left, right, outline) = cylinder(yaw, roll);
            let line = EyeLine::new(left, right, &outline).unwrap();
            assert!((line.roll_deg - roll).abs() < 1e-9, "{line:?}");
            // The middle of a chord is nearer to the axis than its arc's middle, by the cosine of half its width.
            let expected = (yaw.to_radians().sin() * 0.3f64.cos()).asin().to_degrees();
            assert!((line.yaw_deg(YawRule::Arcsine) - expected).abs() < 1e-9, "{yaw}: {line:?}");
        }
    }
}

#[test]
fn the_printed_rule_is_as_printed() {
    let line = EyeLine::new(
        [90.0, 0.0],
        [130.0, 0.0],
        &[[0.0, -50.0], [200.0, -50.0], [200.0, 60.0], [0.0, 60.0]],
    );
    let line = line.unwrap();
    assert_eq!((line.left_px, line.right_px), ([0.0, 0.0], [200.0, 0.0]));
    assert_eq!(line.offset, 0.05);
    assert!((line.yaw_deg(YawRule::Printed) - 9.0).abs() < 1e-12);
    assert!((line.yaw_deg(YawRule::Arcsine) - 0.1f64.asin().to_degrees()).abs() < 1e-12);
}

#[test]
fn the_crossings_nearest_to_the_eyes_count() {
    // A face with an ear that the outline runs around.
    let outline = [
        [0.0, -50.0],
        [200.0, -50.0],
        [200.0, 30.0],
        [220.0, 30.0],
        [220.0, -20.0],
        [240.0, -20.0],
        [240.0, 60.0],
        [0.0, 60.0],
    ];
    let line = EyeLine::new([80.0, 0.0], [120.0, 0.0], &outline).unwrap();
    assert_eq!((line.left_px[0], line.right_px[0]), (0.0, 200.0));
}

#[test]
fn eyes_outside_of_the_face_are_refused() {
    let outline = [[0.0, -50.0], [200.0, -50.0], [200.0, 60.0], [0.0, 60.0]];
    assert_eq!(EyeLine::new([5.0, 5.0], [5.0, 5.0], &outline), Err(PoseError::Eyes));
    assert_eq!(EyeLine::new([5.0, f64::NAN], [9.0, 5.0], &outline), Err(PoseError::Eyes));
    assert_eq!(EyeLine::new([300.0, 0.0], [340.0, 0.0], &outline), Err(PoseError::Outline));
    assert_eq!(EyeLine::new([50.0, 90.0], [90.0, 90.0], &outline), Err(PoseError::Outline));
    assert_eq!(EyeLine::new([50.0, 0.0], [90.0, 0.0], &[]), Err(PoseError::Outline));
}
