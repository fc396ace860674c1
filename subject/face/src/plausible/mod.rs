//! Whether points that were found feature by feature are those of one face: what contradicts the generic face's
//! proportions, in whatever pose fits best.
//!
//! Nothing here is learned from photographs. A proportion's expected value and its standard deviation are those of the
//! [model](super::model): each mode at one standard deviation, and an annotator's noise. What is further off than
//! `LIMIT_SD` is said.

mod proportion;
#[cfg(test)]
mod tests;

use nalgebra::Matrix3;

use super::model::{Camera, FeatureId, FitOptions, Model};
use proportion::{Off, PROPORTIONS, proportions};

/// From so many standard deviations on a proportion is none of a face: one in 370 is, of each, by the model.
const LIMIT_SD: f64 = 3.0;
/// Poses that are tried: turned, and nodding, so far and in such steps (degrees).
const YAW_DEG: (i32, i32) = (40, 8);
const PITCH_DEG: (i32, i32) = (20, 5);

/// What the proportions of a face are, in every pose that is tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Plausible {
    poses: Vec<Pose>,
}

/// Mean and standard deviation of each proportion in one pose.
#[derive(Debug, Clone, PartialEq)]
struct Pose {
    /// Squared standard deviations that the pose itself is from one that looks ahead.
    cost: f64,
    expected: Vec<(f64, f64)>,
}

impl Plausible {
    /// From the modes of a model.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let options = FitOptions::default();
        let shapes: Vec<_> = (0..=model.modes.len())
            .map(|mode| {
                let mut coefficients = vec![0.0; mode];
                if let Some(last) = coefficients.last_mut() {
                    *last = 1.0;
                }
                model.shape(&coefficients)
            })
            .collect();
        let steps = |(most, step): (i32, i32)| (-most..=most).step_by(step as usize);
        let pose = |yaw: i32, pitch: i32| {
            let camera = Camera {
                scale_px_per_mm: 1.0,
                yaw_deg: yaw.into(),
                pitch_deg: pitch.into(),
                roll_deg: 0.0,
                origin_px: [0.0; 2],
            };
            let rotation = camera.rotation();
            let of_shape = |shape: &Vec<[f64; 3]>| seen(model, shape, &camera, &rotation);
            let mut shapes = shapes.iter().filter_map(of_shape);
            let mean = shapes.next()?;
            let mut squares = PROPORTIONS.map(|proportion| proportion.noise_io(&options).powi(2));
            for shape in shapes {
                for ((square, value), mean) in squares.iter_mut().zip(shape).zip(mean) {
                    *square += (value - mean).powi(2);
                }
            }
            let expected = mean.into_iter().zip(squares.map(f64::sqrt)).collect();
            let cost = (camera.pitch_deg / options.pitch_sd_deg).powi(2);
            Some(Pose { cost, expected })
        };
        let poses = steps(YAW_DEG).flat_map(|yaw| steps(PITCH_DEG).map(move |pitch| (yaw, pitch)));
        Self { poses: poses.filter_map(|(yaw, pitch)| pose(yaw, pitch)).collect() }
    }

    /// What of the 53 points, by [`FeatureId::index`] in pixels, contradicts the rest; nothing of a face. Each is a phrase,
    /// lower case and without a dot: `the mouth lies 1.12 of the eyes' width below the eyes, where 0.83 is expected`.
    #[must_use]
    pub fn contradictions(&self, points: &[[f64; 2]; FeatureId::COUNT]) -> Vec<String> {
        let Some(values) = proportions(points) else {
            return vec!["the corners of the eyes lie in one place".to_owned()];
        };
        let off = |pose: &Pose| -> Vec<Off> {
            let each = PROPORTIONS.iter().zip(&pose.expected).zip(values);
            each.map(|((proportion, &(mean, sd)), value)| Off {
                value,
                mean,
                sd: proportion.deviation(value, mean, sd),
            })
            .collect()
        };
        // What is wrong counts no more than what is just wrong: the others tell the pose.
        let cost = |pose: &Pose| {
            let each = off(pose).into_iter().map(|off| off.sd.abs().min(LIMIT_SD).powi(2));
            pose.cost + each.sum::<f64>()
        };
        let best = self.poses.iter().map(|pose| (cost(pose), pose));
        let Some((_, pose)) = best.min_by(|a, b| a.0.total_cmp(&b.0)) else { return Vec::new() };
        let wrong = PROPORTIONS.iter().zip(off(pose)).filter(|(_, off)| off.sd.abs() > LIMIT_SD);
        wrong.map(|(proportion, off)| proportion.words(&off)).collect()
    }
}

/// The proportions of a shape as a camera sees it.
fn seen(
    model: &Model,
    shape: &[[f64; 3]],
    camera: &Camera,
    rotation: &Matrix3<f64>,
) -> Option<[f64; PROPORTIONS.len()]> {
    let places = camera.project(&model.feature_points(shape, rotation));
    let mut points = [[0.0; 2]; FeatureId::COUNT];
    points.iter_mut().zip(places).for_each(|(point, [x, y, _])| *point = [x, y]);
    proportions(&points)
}
