//! Accuracy of the model on annotated faces that are not the project's, given good points.

use mocapd_testkit::recorded::RecordedData;

use crate::model::*;

struct Face {
    name: String,
    landmarks: Vec<[f64; 2]>,
    /// With the sign of this crate.
    yaw_deg: f64,
}

/// Faces whose pose is known, from `MOCAPD_FACES`; empty if it is not set.
fn faces(folder: &str, prefix: &str, yaw_sense: f64) -> Vec<Face> {
    let Some(root) = RecordedData::Faces.folder() else { return Vec::new() };
    let mut paths: Vec<_> = std::fs::read_dir(root.join(folder))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(prefix))
        .collect();
    paths.sort();
    let read = |path: &std::path::PathBuf| {
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        let face = &json["faces"][0];
        let landmarks = serde_json::from_value(face["landmarks"].clone()).unwrap();
        let yaw_deg = yaw_sense * face["pose_deg"][1].as_f64().unwrap();
        Face { name: path.file_stem().unwrap().to_string_lossy().into_owned(), landmarks, yaw_deg }
    };
    paths.iter().map(read).collect()
}

/// Median distance of the fit from the points in outer interocular distances, and the mean error of yaw.
fn measured(faces: &[Face]) -> (f64, f64) {
    let model = Model::generic().unwrap();
    let (mut off, mut yaw) = (Vec::new(), Vec::new());
    for face in faces {
        let points: Vec<_> = FeatureId::all()
            .filter_map(|id| {
                Some(Landmark { id, xy_px: face.landmarks[id.ibug()?], confidence: 1.0 })
            })
            .collect();
        let fit = model.fit_shape(&points, &FitOptions::default()).unwrap();
        let io = {
            let (a, b) = (face.landmarks[36], face.landmarks[45]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        let each = points.iter().map(|Landmark { id, xy_px: at, .. }| {
            let p = fit.points_px[id.index()];
            (p[0] - at[0]).hypot(p[1] - at[1]) / io
        });
        let mean = each.sum::<f64>() / points.len() as f64;
        println!(
            "{}: {:.1} % io, yaw {:.1} of {:.1}",
            face.name,
            100.0 * mean,
            fit.camera.yaw_deg,
            face.yaw_deg
        );
        off.push(mean);
        yaw.push((fit.camera.yaw_deg - face.yaw_deg).abs());
    }
    off.sort_by(f64::total_cmp);
    (off[off.len() / 2], yaw.iter().sum::<f64>() / yaw.len() as f64)
}

#[test]
fn photographs_are_fitted_from_good_points() {
    // Their yaw is positive to the left of the picture.
    let mut faces = faces("photos", "aflw2000_", -1.0);
    faces.retain(|face| face.yaw_deg.abs() <= 50.0);
    if faces.is_empty() {
        return;
    }
    let (off, yaw) = measured(&faces);
    println!("photographs: median {:.2} % io, yaw {yaw:.2} degrees", 100.0 * off);
    assert!(off < 0.04 && yaw < 3.0, "{off} {yaw}");
}

#[test]
fn synthetic_faces_are_fitted_from_good_points() {
    let mut faces = faces("synthetic", "synth_", 1.0);
    if faces.is_empty() {
        return;
    }
    // In this data set the mouth corners are vertices inside the head.
    for face in &mut faces {
        for point in [48, 54] {
            face.landmarks[point] = [60, 64].map(|i| face.landmarks[i])[usize::from(point == 54)];
        }
    }
    let (off, yaw) = measured(&faces);
    println!("synthetic: median {:.2} % io, yaw {yaw:.2} degrees", 100.0 * off);
    assert!(off < 0.04 && yaw < 3.0, "{off} {yaw}");
}
