use super::*;
use mocapd_testkit::photograph::PictureRng;

/// A face of the model in a given pose, with an annotator's noise.
fn example(random: &mut PictureRng, yaw_deg: f64, pitch_deg: f64) -> [[f64; 2]; FeatureId::COUNT] {
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
    for ((id, point), [x, y, _]) in FeatureId::all().zip(&mut points).zip(camera.project(&places)) {
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

const POSES: [[f64; 2]; 5] = [[0.0, 0.0], [30.0, 0.0], [-20.0, 10.0], [10.0, -12.0], [0.0, 15.0]];

#[test]
fn faces_of_the_model_contradict_nothing() {
    let proportions = ProportionModel::of(Model::generic().unwrap());
    let mut random = PictureRng::new(11);
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
    let mut random = PictureRng::new(12);
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
