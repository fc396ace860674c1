//! Head pose from eyes and outline alone (Yang et al. 2004, section 4).

use thiserror::Error;

use crate::plane::{Point, along, direction, distance};

/// The rule that gives yaw from the position of the eyes between the edges of the face.
///
/// On random heads of the [model](super::model) turned by up to 35 degrees, with an outline of annotated places on the
/// jaw, the mean error of the arcsine is 3.3 degrees and that of the printed rule 5.0. With the visible edge, which
/// bulges on the far side, it is 4.8 and 2.8. A [fit](super::model::Model::fit_shape) of all points needs no outline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum YawRule {
    /// π · MC/PQ, as (Yang et al. 2004) print it. Near 0 it is 57 % too steep: on a cylinder MC/PQ is half the sine.
    Printed,
    /// arcsin(2 · MC/PQ): exact on a cylinder whose front half is visible.
    #[default]
    Arcsine,
}

/// Why there is no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PoseError {
    /// The outer eye corners coincide or are not finite.
    #[error("the outer eye corners coincide")]
    Eyes,
    /// The line does not cross the outline on both sides of the face.
    #[error("the line through the eyes does not cross the face's outline on both sides")]
    Outline,
}

/// The line through the outer eye corners, cut by the outline of the face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EyeLine {
    /// P: where the line leaves the face at the left of the picture.
    pub left_px: [f64; 2],
    /// Q: where it leaves the face at the right of the picture.
    pub right_px: [f64; 2],
    /// Angle of the line in degrees, positive if the head is rotated counter-clockwise in the picture.
    pub roll_deg: f64,
    /// MC/PQ, where M is the middle of the eyes and C that of PQ: positive if the eyes sit to the right in the face.
    pub offset: f64,
}

impl EyeLine {
    /// Cuts a closed outline (pixels, y down, either orientation) with the line through the outer eye corners, the
    /// picture's left one first.
    ///
    /// If there are more than two crossings, those nearest to the eyes count.
    ///
    /// # Errors
    /// [`PoseError`] if the eyes coincide or the outline does not enclose them.
    pub fn new(
        left_eye_px: [f64; 2],
        right_eye_px: [f64; 2],
        outline_px: &[[f64; 2]],
    ) -> Result<Self, PoseError> {
        let middle = distance(left_eye_px, right_eye_px) / 2.0;
        if !(middle > 0.0 && middle.is_finite()) {
            return Err(PoseError::Eyes);
        }
        let line = direction(left_eye_px, right_eye_px);
        // Coordinates from the left eye, along the line and across it.
        let local = |p: Point| {
            let d = [p[0] - left_eye_px[0], p[1] - left_eye_px[1]];
            [d[0] * line[0] + d[1] * line[1], d[1] * line[0] - d[0] * line[1]]
        };
        let (mut left, mut right) = (f64::NEG_INFINITY, f64::INFINITY);
        let next = outline_px.iter().cycle().skip(1);
        for (a, b) in outline_px.iter().zip(next) {
            let (a, b) = (local(*a), local(*b));
            if (a[1] < 0.0) == (b[1] < 0.0) {
                continue;
            }
            let at = a[0] + a[1] / (a[1] - b[1]) * (b[0] - a[0]);
            if at < middle {
                left = left.max(at);
            } else if at > middle {
                right = right.min(at);
            }
        }
        if !(left.is_finite() && right.is_finite()) {
            return Err(PoseError::Outline);
        }
        Ok(Self {
            left_px: along(left_eye_px, line, left),
            right_px: along(left_eye_px, line, right),
            roll_deg: (-line[1]).atan2(line[0]).to_degrees(),
            offset: (middle - (left + right) / 2.0) / (right - left),
        })
    }

    /// Yaw in degrees: positive if the nose points to the right of the picture.
    ///
    /// 90 beyond the domain of the arcsine (eyes at the very edge of the face).
    pub fn yaw_deg(&self, rule: YawRule) -> f64 {
        match rule {
            YawRule::Printed => 180.0 * self.offset,
            YawRule::Arcsine => (2.0 * self.offset).clamp(-1.0, 1.0).asin().to_degrees(),
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;
    use crate::model::{Camera, Model};

    /// The outline of an upright cylinder of radius 100 around the origin, rotated in the picture by `roll`, and eyes
    /// painted `side` radians left and right of a midline that is turned by `yaw`.
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
                // The midpoint of a chord is nearer to the axis than that of its arc, by the cosine of half its width.
                let expected = (yaw.to_radians().sin() * 0.3f64.cos()).asin().to_degrees();
                assert!(
                    (line.yaw_deg(YawRule::Arcsine) - expected).abs() < 1e-9,
                    "{yaw}: {line:?}"
                );
            }
        }
    }

    #[test]
    fn the_printed_rule_gives_the_printed_angles() {
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
    fn the_crossings_nearest_to_the_eyes_are_used() {
        // A face with an ear that the outline follows.
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

    /// Mean errors of both rules on random heads turned by up to 35 degrees, for outlines given by the caller.
    fn errors_deg(outline: impl Fn(&Model, &Camera, &[[f64; 3]]) -> Vec<[f64; 2]>) -> [f64; 2] {
        let model = Model::generic().unwrap();
        let mut random = Random::new(21);
        let mut errors = [0.0; 2];
        let rounds = 100;
        for _ in 0..rounds {
            let coefficients: Vec<f64> = model.modes.iter().map(|_| random.normal()).collect();
            let camera = Camera {
                scale_px_per_mm: 1.5,
                yaw_deg: random.between(-35.0, 35.0),
                pitch_deg: 0.0,
                roll_deg: random.between(-20.0, 20.0),
                origin_px: [300.0, 300.0],
            };
            let vertices = model.shape(&coefficients);
            let at = |name: &str| {
                let [x, y, _] = camera.project(&vertices)[model.features[name]];
                [x, y]
            };
            let outline = outline(model, &camera, &vertices);
            let line = EyeLine::new(at("right_eye_outer"), at("left_eye_outer"), &outline).unwrap();
            assert!((line.roll_deg - camera.roll_deg).abs() < 4.0, "{line:?} {camera:?}");
            for (error, rule) in errors.iter_mut().zip([YawRule::Printed, YawRule::Arcsine]) {
                *error += (line.yaw_deg(rule) - camera.yaw_deg).abs() / f64::from(rounds);
            }
        }
        errors
    }

    /// Which rule is more accurate depends on the outline: points on the jaw, as annotators mark them, or the visible edge,
    /// which bulges on the far side.
    #[test]
    fn each_rule_is_better_for_one_kind_of_outline() {
        let annotated = errors_deg(|model, camera, vertices| {
            let side = |side: &str| (1..=8).map(|i| format!("{side}_jaw_{i}")).collect::<Vec<_>>();
            let names = side("right")
                .into_iter()
                .chain(["chin".into()])
                .chain(side("left").into_iter().rev());
            let mut jaw: Vec<[f64; 3]> =
                names.map(|name| vertices[model.features[&name]]).collect();
            // Above the last jaw points, at eye height, the outline continues straight up.
            let up = |[x, y, z]: [f64; 3]| [x, y + 60.0, z];
            let ends = [up(jaw[jaw.len() - 1]), up(jaw[0])];
            jaw.extend(ends);
            camera.project(&jaw).into_iter().map(|[x, y, _]| [x, y]).collect()
        });
        let seen = errors_deg(|model, camera, vertices| {
            let points = camera.project(&model.feature_points(vertices, &camera.rotation()));
            (0..6).chain((6..12).rev()).map(|i| [points[i][0], points[i][1]]).collect()
        });
        println!("printed and arcsine: {annotated:.2?} degrees on places, {seen:.2?} on edges");
        assert!(annotated[1] < annotated[0] && seen[0] < seen[1], "{annotated:?} {seen:?}");
        assert!(annotated[1] < 4.0 && seen[0] < 4.0, "{annotated:?} {seen:?}");
    }
}
