//! Training data of `benches/subject/face_confidence.py`: a line for each start of each development face, with the mean
//! error of its points (per cent of the outer interocular distance) and the evidence.

use std::error::Error;
use std::io::Write;

use mocapd_face::points;

use super::data::{Face, Noise};
use super::table::Row;
use super::{detected, disturbed_by};

/// Standard deviations of the starting positions (in outer interocular distances): from that of a good detection to
/// that of one half outside the face.
const START_SDS: [f64; 6] = [0.02, 0.04, 0.08, 0.12, 0.2, 0.3];

pub(crate) fn print(out: &mut impl Write, faces: &[&Face]) -> Result<(), Box<dyn Error>> {
    let mut noise = Noise::new(2);
    for face in faces {
        let disturbed = START_SDS.map(|sd| Some(disturbed_by(sd, &face.truth, &mut noise)));
        for (start, rough) in disturbed.into_iter().chain([detected(face)]).enumerate() {
            let Some(rough) = rough else { continue };
            let found = points::find(&face.photo, &rough)?;
            let Some(evidence) = found.evidence else { continue };
            write!(out, "{},{start},{:.2}", face.name, Row::of(face, &found).all)?;
            for term in evidence.terms() {
                write!(out, ",{term:.4}")?;
            }
            writeln!(out)?;
        }
    }
    Ok(())
}
