//! Acceptance limits on photographs with known landmarks that were not learned from, from the folder that
//! `MOCAPD_FACES` names.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;

use mocapd_face::Photo;
use mocapd_face::find::{self, DetectedFace};
use mocapd_face::model::{FeatureId, FitOptions, Model};
use mocapd_face::points::{self, RoughFace};
use mocapd_testkit::recorded::RecordedData;

#[expect(dead_code, reason = "the example draws, too")]
#[path = "../examples/faces_points/data.rs"]
mod data;

use data::{Face, Noise, distance};

/// Limits of median errors, in outer interocular distances.
const PHOTOGRAPHS_MEDIAN_MAX: f64 = 0.06;
const SYNTHETIC_MEDIAN_MAX: f64 = 0.05;
/// A face is good if its mean error is below this; the minimum fraction of good faces.
const GOOD_IO: f64 = 0.1;
const GOOD_SHARE: f64 = 0.85;
const YAW_ERROR_MAX_DEG: f64 = 4.0;
/// Disturbance of the eyes and mouth from which the search starts.
const START_SD_INTEROCULAR: f64 = 0.04;
const STARTS: usize = 3;
/// Photographs whose yaw is unknown are included.
const PHOTOGRAPHS_YAW_DEG: f64 = 20.0;
const SYNTHETIC_YAW_DEG: f64 = 35.0;
/// Smallest face that must be found, and the largest error of its eyes.
const FOUND_INTEROCULAR_PX: f64 = 40.0;
const FOUND_NEAR_INTEROCULAR: f64 = 0.25;
const FOUND_SHARE: f64 = 0.9;
/// The criterion is a half; the result is a twentieth.
const FALSE_PER_PHOTOGRAPH_MAX: f64 = 0.15;

/// Faces that were not learned from, turned by at most this.
fn reported(folder: &Path, synthetic: bool, yaw_deg: f64) -> Vec<Face> {
    let mut faces = data::read(folder).unwrap();
    faces.retain(|face| {
        let turned = face.truth.yaw_deg.unwrap_or(0.0).abs();
        !face.development && face.synthetic == synthetic && turned <= yaw_deg
    });
    assert!(!faces.is_empty(), "{} has no faces that count", folder.display());
    faces
}

fn disturbed(face: &Face, noise: &mut Noise) -> RoughFace {
    let off_px = START_SD_INTEROCULAR * face.truth.interocular_px();
    let mut near = |range| face.truth.centre(range).map(|at| at + off_px * noise.normal());
    RoughFace { left_eye: near(36..42), right_eye: near(42..48), mouth: near(48..60) }
}

/// Mean error of the points that iBUG-68 has, too, in outer interocular distances.
fn error_io(face: &Face, rough: &RoughFace) -> f64 {
    let found = points::find(&face.photo, rough).unwrap();
    let off = |landmark: usize| {
        let id = FeatureId::from_ibug(landmark)?;
        let is_seen = face.truth.visible[landmark];
        is_seen.then(|| distance(found.points[id.index()].at, face.truth.landmarks[landmark]))
    };
    // The bridge of the nose and the outline are not single places.
    let off: Vec<f64> = (17..27).chain(31..68).filter_map(off).collect();
    off.iter().sum::<f64>() / off.len() as f64 / face.truth.interocular_px()
}

/// Sorted errors.
fn errors_io(faces: &[Face]) -> Vec<f64> {
    let mut noise = Noise::new(1);
    let mut errors = Vec::new();
    for face in faces {
        errors.extend((0..STARTS).map(|_| error_io(face, &disturbed(face, &mut noise))));
    }
    errors.sort_by(f64::total_cmp);
    errors
}

fn median_and_good_share(faces: &[Face]) -> (f64, f64) {
    let errors = errors_io(faces);
    let good = errors.iter().filter(|error| **error < GOOD_IO).count();
    (errors[errors.len() / 2], good as f64 / errors.len() as f64)
}

/// Yaw errors of the search, and of the generic face fitted to its points.
fn yaw_errors_deg(faces: &[Face]) -> [f64; 2] {
    let mut noise = Noise::new(1);
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for face in faces {
        for _ in 0..STARTS {
            let found = points::find(&face.photo, &disturbed(face, &mut noise)).unwrap();
            let model = Model::generic().unwrap();
            let fit = model.fit_shape(&found.found(), &FitOptions::default()).unwrap();
            let Some(yaw_deg) = face.truth.yaw_deg else { continue };
            sums[0] += (found.yaw_deg.unwrap() - yaw_deg).abs();
            sums[1] += (fit.camera.yaw_deg - yaw_deg).abs();
            count += 1.0;
        }
    }
    sums.map(|sum| sum / count)
}

#[test]
fn points_of_photographs_are_accurate() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    let (median, good) = median_and_good_share(&reported(&folder, false, PHOTOGRAPHS_YAW_DEG));
    assert!(median <= PHOTOGRAPHS_MEDIAN_MAX, "median error {median} of the eyes' distance");
    assert!(good >= GOOD_SHARE, "{good} of the faces are good");
}

#[test]
fn points_of_synthetic_faces_are_accurate() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    let (median, good) = median_and_good_share(&reported(&folder, true, SYNTHETIC_YAW_DEG));
    assert!(median <= SYNTHETIC_MEDIAN_MAX, "median error {median} of the eyes' distance");
    assert!(good >= GOOD_SHARE, "{good} of the faces are good");
}

#[test]
fn yaw_is_accurate() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    for is_synthetic in [false, true] {
        let errors = yaw_errors_deg(&reported(&folder, is_synthetic, SYNTHETIC_YAW_DEG));
        assert!(errors.iter().all(|deg| *deg <= YAW_ERROR_MAX_DEG), "{errors:?} degrees");
    }
}

fn is_near(found: &DetectedFace, face: &Face) -> bool {
    let eyes = [face.truth.centre(36..42), face.truth.centre(42..48)];
    let near_px = FOUND_NEAR_INTEROCULAR * face.truth.interocular_px();
    (0..2).all(|eye| distance(found.eyes[eye], eyes[eye]) <= near_px)
}

#[test]
fn nine_of_ten_faces_are_found() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    let mut faces = reported(&folder, false, SYNTHETIC_YAW_DEG);
    faces.extend(reported(&folder, true, SYNTHETIC_YAW_DEG));
    faces.retain(|face| face.truth.interocular_px() >= FOUND_INTEROCULAR_PX);
    let is_found = |face: &&Face| {
        find::faces(&face.photo, find::SCORE_MIN).iter().any(|found| is_near(found, face))
    };
    let found = faces.iter().filter(is_found).count();
    let share = found as f64 / faces.len() as f64;
    assert!(share >= FOUND_SHARE, "{found} of {} faces are found", faces.len());
}

#[test]
fn few_photographs_have_a_false_detection() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    // In any orientation and at any size.
    let mut faces = reported(&folder, false, f64::INFINITY);
    faces.extend(reported(&folder, true, f64::INFINITY));
    let (mut photographs, mut wrong) = (0, 0);
    for of_one in faces.chunk_by(|a, b| a.name == b.name) {
        let found = find::faces(&of_one[0].photo, find::SCORE_MIN);
        wrong += found.iter().filter(|f| !of_one.iter().any(|face| is_near(f, face))).count();
        photographs += 1;
    }
    let share = wrong as f64 / f64::from(photographs);
    assert!(share <= FALSE_PER_PHOTOGRAPH_MAX, "{wrong} false ones on {photographs}");
}

#[test]
fn pictures_without_a_face_have_no_detection() {
    let Some(folder) = RecordedData::Faces.folder() else { return };
    let mut pictures = 0;
    for entry in std::fs::read_dir(folder.join("negative")).unwrap() {
        let photo = Photo::from_bytes(&std::fs::read(entry.unwrap().path()).unwrap()).unwrap();
        assert_eq!(find::faces(&photo, find::SCORE_MIN).len(), 0);
        pictures += 1;
    }
    assert!(pictures > 0);
}
