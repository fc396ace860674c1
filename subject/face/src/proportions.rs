//! Check of independently located points against the proportions of the generic face, in the pose that fits best.
//!
//! Nothing here is learned from photographs. The expected value and standard deviation of a proportion follow from the
//! [model](super::model): one standard deviation of each mode, and an annotator's noise. Deviations beyond `LIMIT_SD`
//! are reported.
//!
//! Nothing here is learned from photographs. The expected value and standard deviation of a proportion follow from the
//! [model](super::model): one standard deviation of each mode, and an annotator's noise. Deviations beyond `LIMIT_SD`
//! are reported.

use std::ops::Range;

use Noise::{Outline, Pair, Part};

use super::{
    model::{Camera, FeatureId, FitOptions, Model},
    plane::{mean, middle},
};

/// Reporting limit in standard deviations: by the model, one face in 370 exceeds it for each proportion.
const LIMIT_SD: f64 = 3.0;
/// Range and step of the poses that are tried, in degrees.
const YAW_DEG: (i32, i32) = (40, 8);
const PITCH_DEG: (i32, i32) = (20, 5);

/// Expected proportions of a face in every pose that is tried.
#[derive(Debug, Clone, PartialEq)]
pub struct ProportionModel {
    poses: Vec<PoseExpectation>,
}

/// Mean and standard deviation of each proportion in one pose.
#[derive(Debug, Clone, PartialEq)]
struct PoseExpectation {
    /// Prior cost of the pose: squared standard deviations from a frontal one.
    cost: f64,
    expected: Vec<(f64, f64)>,
}

impl ProportionModel {
    /// Computes the expectations from the modes of a model.
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
            let mut shapes = shapes.iter().filter_map(|shape| measure(model, shape, &camera));
            let mean = shapes.next()?;
            let mut squares = PROPORTIONS.map(|one| one.noise_interocular(&options).powi(2));
            for shape in shapes {
                for ((square, value), mean) in squares.iter_mut().zip(shape).zip(mean) {
                    *square += (value - mean).powi(2);
                }
            }
            let expected = mean.into_iter().zip(squares.map(f64::sqrt)).collect();
            let cost = (camera.pitch_deg / options.pitch_sd_deg).powi(2);
            Some(PoseExpectation { cost, expected })
        };
        let poses = steps(YAW_DEG).flat_map(|yaw| steps(PITCH_DEG).map(move |pitch| (yaw, pitch)));
        Self { poses: poses.filter_map(|(yaw, pitch)| pose(yaw, pitch)).collect() }
    }

    /// Reports which of the 53 points (by [`FeatureId::index`], in pixels) contradict the rest; empty for a face. Each
    /// report is a phrase, lower case, no dot: `the mouth lies 1.12 of the eyes' width below the eyes, where 0.83 is
    /// expected`.
    #[must_use]
    pub fn contradictions(&self, points: &[[f64; 2]; FeatureId::COUNT]) -> Vec<String> {
        let Some(values) = proportions(points) else {
            return vec!["the corners of the eyes coincide".to_owned()];
        };
        let off = |pose: &PoseExpectation| -> Vec<Deviation> {
            let each = PROPORTIONS.iter().zip(&pose.expected).zip(values);
            each.map(|((proportion, &(mean, sd)), value)| Deviation {
                value,
                mean,
                sd: proportion.deviation(value, mean, sd),
            })
            .collect()
        };
        // A deviation beyond the limit costs no more than one at it, so the other proportions determine the pose.
        let cost = |pose: &PoseExpectation| {
            let each = off(pose).into_iter().map(|off| off.sd.abs().min(LIMIT_SD).powi(2));
            pose.cost + each.sum::<f64>()
        };
        let best = self.poses.iter().map(|pose| (cost(pose), pose));
        let Some((_, pose)) = best.min_by(|a, b| a.0.total_cmp(&b.0)) else { return Vec::new() };
        let wrong = PROPORTIONS.iter().zip(off(pose)).filter(|(_, off)| off.sd.abs() > LIMIT_SD);
        wrong.map(|(proportion, off)| proportion.message(&off)).collect()
    }
}

/// The proportions of a shape as a camera sees it.
fn measure(model: &Model, shape: &[[f64; 3]], camera: &Camera) -> Option<[f64; PROPORTIONS.len()]> {
    let places = camera.project(&model.feature_points(shape, &camera.rotation()));
    let mut points = [[0.0; 2]; FeatureId::COUNT];
    points.iter_mut().zip(places).for_each(|(point, [x, y, _])| *point = [x, y]);
    proportions(&points)
}

/// A proportion: its wording, the noise of its points, and how to compute it.
struct Proportion {
    /// Subject, verb and relation: `the mouth`, `lies`, `below the eyes`.
    phrase: [&'static str; 3],
    noise: Noise,
    value: fn(&Upright) -> f64,
}

/// The noise of a proportion's points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Noise {
    /// A feature as a whole, whose points err together.
    Part,
    /// Two points with independent errors.
    Pair,
    /// Outline and lips. The located outline is often hair or neck, which is harmless; lips outside of it are not.
    Outline,
}

/// Deviation of a proportion.
#[derive(Debug, Clone, Copy)]
struct Deviation {
    value: f64,
    mean: f64,
    /// Deviation in standard deviations.
    sd: f64,
}

/// Indices of points, by [`FeatureId::index`].
const OUTLINE_CHIN: [usize; 2] = [5, 11];
const BROWS: [Range<usize>; 2] = [12..17, 17..22];
const NOSE: Range<usize> = 22..27;
const WINGS: [usize; 2] = [22, 26];
const EYES: [Range<usize>; 2] = [27..33, 33..39];
const MOUTH: Range<usize> = 39..53;
const MOUTH_CORNERS: [usize; 2] = [39, 45];
const LIPS: [usize; 2] = [42, 48];

/// The eyes are the unit of all proportions. The outline's width is left out, since hair determines it.
const PROPORTIONS: [Proportion; 11] = [
    Proportion::new(["the mouth", "lies", "below the eyes"], Part, |face| face.middle(MOUTH)[1]),
    Proportion::new(
        ["the mouth", "lies", "beside the eyes' middle (to the picture's left where less than 0)"],
        Part,
        |face| face.middle(MOUTH)[0],
    ),
    Proportion::new(["the mouth", "is", "wide"], Pair, |face| face.across(MOUTH_CORNERS)),
    Proportion::new(["the mouth", "is", "high"], Pair, |face| face.down(LIPS)),
    Proportion::new(["the nose", "ends", "below the eyes"], Part, |face| face.middle(NOSE)[1]),
    Proportion::new(
        ["the nose", "ends", "beside the eyes' middle (to the picture's left where less than 0)"],
        Part,
        |face| face.middle(NOSE)[0],
    ),
    Proportion::new(["the nose", "is", "wide"], Pair, |face| face.across(WINGS)),
    Proportion::new(["the mouth", "lies", "below the nose"], Part, |face| {
        face.middle(MOUTH)[1] - face.middle(NOSE)[1]
    }),
    Proportion::new(["the right brow", "lies", "above its eye"], Part, |face| face.brow(0)),
    Proportion::new(["the left brow", "lies", "above its eye"], Part, |face| face.brow(1)),
    Proportion::new(["the chin", "lies", "below the lips"], Outline, |face| {
        let [right, left] = OUTLINE_CHIN.map(|i| face.at[i][1]);
        (right + left) / 2.0 - face.at[LIPS[1]][1]
    }),
];

impl Proportion {
    const fn new(phrase: [&'static str; 3], noise: Noise, value: fn(&Upright) -> f64) -> Self {
        Self { phrase, noise, value }
    }

    /// Standard deviation from the noise of its points, as a fraction of the outer interocular distance.
    fn noise_interocular(&self, options: &FitOptions) -> f64 {
        match self.noise {
            Part => options.noise_interocular,
            Pair => std::f64::consts::SQRT_2 * options.noise_interocular,
            Outline => options.noise_interocular.hypot(options.contour_noise_interocular),
        }
    }

    /// Deviation in standard deviations; 0 if it is harmless.
    fn deviation(&self, value: f64, mean: f64, sd: f64) -> f64 {
        let off = (value - mean) / sd;
        if self.noise == Outline { off.min(0.0) } else { off }
    }

    /// The report, such as `the mouth lies 1.12 of the eyes' width below the eyes, where 0.83 is expected`.
    fn message(&self, off: &Deviation) -> String {
        let [subject, verb, below] = self.phrase;
        let Deviation { value, mean, .. } = off;
        format!(
            "{subject} {verb} {value:.2} of the eyes' width {below}, where {mean:.2} is expected"
        )
    }
}

/// All proportions of a face; none if the eyes coincide.
fn proportions(points: &[[f64; 2]; FeatureId::COUNT]) -> Option<[f64; PROPORTIONS.len()]> {
    let face = Upright::new(points)?;
    let values = PROPORTIONS.map(|proportion| (proportion.value)(&face));
    values.iter().all(|value| value.is_finite()).then_some(values)
}

/// A face rotated upright and scaled to an outer interocular distance of 1.
struct Upright {
    /// x to the right of the picture, y down, from the midpoint of the outer eye corners.
    at: [[f64; 2]; FeatureId::COUNT],
}

impl Upright {
    fn new(points: &[[f64; 2]; FeatureId::COUNT]) -> Option<Self> {
        let [right, left] = [FeatureId::RIGHT_EYE_OUTER, FeatureId::LEFT_EYE_OUTER]
            .map(|corner| points[corner.index()]);
        let across = [left[0] - right[0], left[1] - right[1]];
        let squared_px2 = across[0] * across[0] + across[1] * across[1];
        let middle = middle(left, right);
        let upright = |[x, y]: [f64; 2]| {
            let [x, y] = [x - middle[0], y - middle[1]];
            [x * across[0] + y * across[1], y * across[0] - x * across[1]].map(|v| v / squared_px2)
        };
        (squared_px2 > 0.0).then(|| Self { at: points.map(upright) })
    }

    fn middle(&self, of: Range<usize>) -> [f64; 2] {
        mean(self.at[of].iter().copied())
    }

    fn across(&self, [right, left]: [usize; 2]) -> f64 {
        self.at[left][0] - self.at[right][0]
    }

    fn down(&self, [upper, lower]: [usize; 2]) -> f64 {
        self.at[lower][1] - self.at[upper][1]
    }

    fn brow(&self, side: usize) -> f64 {
        self.middle(EYES[side].clone())[1] - self.middle(BROWS[side].clone())[1]
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    /// A face of the model in a given pose, with an annotator's noise.
    fn example(random: &mut Random, yaw_deg: f64, pitch_deg: f64) -> [[f64; 2]; FeatureId::COUNT] {
        let model = Model::generic().unwrap();
        let options = FitOptions::default();
        let coefficients: Vec<f64> = model.modes.iter().map(|_| random.normal()).collect();
        let camera = Camera {
            scale_px_per_mm: 1.3,
            yaw_deg,
            pitch_deg,
            roll_deg: 25.0,
            origin_px: [300.0, 200.0],
        };
        let places = model.feature_points(&model.shape(&coefficients), &camera.rotation());
        let mut points = [[0.0; 2]; FeatureId::COUNT];
        for ((id, point), [x, y, _]) in
            FeatureId::all().zip(&mut points).zip(camera.project(&places))
        {
            let noise = options.noise_of(id);
            // Half of an annotator's noise, because this tests the modes.
            let mut off = || 0.5 * noise * 90.0 * 1.3 * random.normal();
            *point = [x + off(), y + off()];
        }
        points
    }

    /// Displaces some of the points, in outer interocular distances, to the right of the face and downwards.
    fn moved(
        points: &[[f64; 2]; FeatureId::COUNT],
        which: Range<usize>,
        by: [f64; 2],
    ) -> [[f64; 2]; FeatureId::COUNT] {
        let [right, left] =
            [FeatureId::RIGHT_EYE_OUTER, FeatureId::LEFT_EYE_OUTER].map(|id| points[id.index()]);
        let across = [left[0] - right[0], left[1] - right[1]];
        let mut points = *points;
        for point in &mut points[which] {
            point[0] += by[0] * across[0] - by[1] * across[1];
            point[1] += by[0] * across[1] + by[1] * across[0];
        }
        points
    }

    const POSES: [[f64; 2]; 5] =
        [[0.0, 0.0], [30.0, 0.0], [-20.0, 10.0], [10.0, -12.0], [0.0, 15.0]];

    #[test]
    fn faces_of_the_model_contradict_nothing() {
        let proportions = ProportionModel::of(Model::generic().unwrap());
        let mut random = Random::new(11);
        let (mut warned, mut n) = (0, 0);
        for [yaw_deg, pitch_deg] in POSES {
            for _ in 0..40 {
                let points = example(&mut random, yaw_deg, pitch_deg);
                warned += usize::from(!proportions.contradictions(&points).is_empty());
                n += 1;
            }
        }
        // Each of fourteen proportions exceeds its limit once in 370 faces; most of them are correlated.
        assert!(warned * 20 <= n, "{warned} of {n}");
    }

    #[test]
    fn displaced_features_are_named() {
        let proportions = ProportionModel::of(Model::generic().unwrap());
        let mut random = Random::new(12);
        let mouth = 39..53;
        for [yaw_deg, pitch_deg] in POSES {
            let good = example(&mut random, yaw_deg, pitch_deg);
            let named = |points: &[[f64; 2]; FeatureId::COUNT], what: &str| {
                let contradictions = proportions.contradictions(points);
                let is_named = contradictions.iter().any(|text| text.contains(what));
                assert!(is_named, "{what}: {contradictions:?}");
            };
            // On the chin, on the nose, on a cheek.
            named(&moved(&good, mouth.clone(), [0.0, 0.45]), "mouth");
            named(&moved(&good, mouth.clone(), [0.0, -0.45]), "mouth");
            named(&moved(&good, mouth.clone(), [0.5, 0.0]), "mouth");
            named(&moved(&good, 22..27, [0.0, 0.4]), "nose");
            named(&moved(&good, 12..17, [0.0, -0.4]), "right brow");
            // A chin above the lips.
            named(&moved(&good, 0..12, [0.0, -0.9]), "chin");
        }
    }

    #[test]
    fn coinciding_eyes_are_not_a_face() {
        let proportions = ProportionModel::of(Model::generic().unwrap());
        assert_eq!(proportions.contradictions(&[[7.0; 2]; FeatureId::COUNT]).len(), 1);
        assert_eq!(proportions.contradictions(&[[f64::NAN; 2]; FeatureId::COUNT]).len(), 1);
    }
}
