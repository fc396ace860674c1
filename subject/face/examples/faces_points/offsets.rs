//! Median differences between annotated and found points, both sides of the face together.

use std::collections::BTreeMap;
use std::fmt;

use mocapd_face::points::FacePoints;

use super::data::Face;
use super::ibug;

/// Differences by the point's number in iBUG-68, in the right half of the face.
#[derive(Default)]
pub(crate) struct Offsets(BTreeMap<usize, Vec<[f64; 2]>>);

impl Offsets {
    /// Nearly frontal photographs only: the offset of a turned face is different.
    pub(crate) fn add(&mut self, face: &Face, found: &FacePoints) {
        if face.truth.interocular_px() < 40.0
            || face.synthetic
            || face.truth.yaw_deg.is_some_and(|yaw| yaw.abs() > 20.0)
        {
            return;
        }
        let (Some(l), Some(r)) = (ibug(found, 36), ibug(found, 45)) else { return };
        let interocular = super::data::distance(l, r);
        let axis = [(r[0] - l[0]) / interocular, (r[1] - l[1]) / interocular];
        for point in (17..68).filter(|i| ibug(found, *i).is_some()) {
            let (Some(p), t) = (ibug(found, point), face.truth.landmarks[point]) else { continue };
            let d = [(t[0] - p[0]) / interocular, (t[1] - p[1]) / interocular];
            let across = d[0] * axis[0] + d[1] * axis[1];
            let down = d[1] * axis[0] - d[0] * axis[1];
            let (right, sign) = mirrored(point);
            self.0.entry(right).or_default().push([sign * across, down]);
        }
    }
}

/// The point of the subject's right half that mirrors this one, and the sign of x.
fn mirrored(point: usize) -> (usize, f64) {
    match point {
        22..=26 => (43 - point, -1.0),
        34 | 35 => (66 - point, -1.0),
        42..=45 => (81 - point, -1.0),
        46 | 47 => (87 - point, -1.0),
        52..=54 => (102 - point, -1.0),
        55 | 56 => (114 - point, -1.0),
        _ => (point, 1.0),
    }
}

impl fmt::Display for Offsets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (point, d) in &self.0 {
            let median = |axis: usize| {
                let mut v: Vec<f64> = d.iter().map(|d| d[axis]).collect();
                v.sort_by(f64::total_cmp);
                v[v.len() / 2]
            };
            // Points on the midline have no side.
            let x = if [33, 51, 57, 62, 66].contains(point) { 0.0 } else { median(0) };
            writeln!(f, "    ({point}, [{x:.3}, {:.3}]),", median(1))?;
        }
        Ok(())
    }
}
