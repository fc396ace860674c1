//! What `subject face` says of the faces that it fitted.

use mocapd_face::{fitted::FittedFace, model::OUTER_EYES_MM, points::FAINT};

use crate::cli::numbers::count;

/// Beyond this a face hides so much of itself that the points of two photographs of three were off (docs/subject-face.md).
const YAW_SEEN_DEG: f64 = 35.0;

/// What is to be looked at.
pub(super) fn doubts(faces: &[FittedFace]) -> Vec<String> {
    let mut words = Vec::new();
    for (number, face) in faces.iter().enumerate() {
        let number = number + 1;
        if face.is_unsure() {
            words.push(format!("face {number}: points may be off: look at the overlay"));
        }
        let yaw_deg = face.camera.yaw_deg.abs();
        if yaw_deg > YAW_SEEN_DEG {
            words.push(format!(
                "face {number} is turned by {yaw_deg:.0} degrees: beyond {YAW_SEEN_DEG:.0} its far side is a guess"
            ));
        }
    }
    words
}

/// What people read.
pub(super) fn table(faces: &[FittedFace]) -> String {
    let mut out = format!("{}\n", count(faces.len() as u64, "face"));
    out += "face     at x, y px   eye corners px   yaw deg   pitch deg   roll deg   points seen   confidence\n";
    for (number, face) in faces.iter().enumerate() {
        let camera = &face.camera;
        let seen = face.points.iter().filter(|point| point.confidence > FAINT).count();
        out += &format!(
            "{:>4} {:>14} {:>16.0} {:>9.1} {:>11.1} {:>10.1} {:>7} of 53 {:>12}\n",
            number + 1,
            format!("{:.0}, {:.0}", camera.origin_px[0], camera.origin_px[1]),
            camera.scale_px_per_mm * OUTER_EYES_MM,
            camera.yaw_deg,
            camera.pitch_deg,
            camera.roll_deg,
            seen,
            face.confidence.map_or("-".to_owned(), |sure| format!("{sure:.2}"))
        );
    }
    for (number, face) in faces.iter().enumerate() {
        for note in &face.notes {
            out += &format!("{:>4} points may be off: {note}\n", number + 1);
        }
    }
    out
}
