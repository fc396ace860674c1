//! How often the points of the paper's chain get a note, and how often they are wrong, on drawn faces.

use std::error::Error;
use std::io::Write;

use mocapd_face::model::Model;
use mocapd_face::points;
use mocapd_face::proportions::ProportionModel;

use super::data::{Face, Noise};
use super::table::Row;
use super::{STARTS, detected, disturbed};

/// Mean error above which points count as wrong, in per cent of the outer interocular distance.
const OFF: f64 = 10.0;

/// Number of faces, and of those with a note: with a large error as a whole; in one feature; in none.
#[derive(Default)]
struct Counts([[usize; 2]; 3]);

impl Counts {
    fn add(&mut self, row: &Row, is_warned: bool) {
        let part = [row.eyes, row.brows, row.nose, row.mouth].into_iter().fold(0.0, f64::max);
        let kind = if row.all > OFF { 0 } else { usize::from(part <= OFF) + 1 };
        self.0[kind][0] += 1;
        self.0[kind][1] += usize::from(is_warned);
    }
}

pub(crate) fn print(
    out: &mut impl Write,
    kinds: &[(&str, &[Face])],
    each: bool,
) -> Result<(), Box<dyn Error>> {
    let proportions = ProportionModel::of(Model::generic()?);
    writeln!(
        out,
        "| faces | off by more than 10 %: n | warned of | a part of them is: n | warned of | neither: n | warned of |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|")?;
    for (kind, faces) in kinds {
        let mut noise = Noise::new(1);
        let mut counts = Counts::default();
        for face in *faces {
            let mut starts: Vec<_> =
                (0..STARTS).map(|_| Some(disturbed(&face.truth, &mut noise))).collect();
            starts.push(detected(face));
            for (number, rough) in starts.into_iter().enumerate() {
                let Some(rough) = rough else { continue };
                let found = points::paper::find(&face.photo, &rough);
                let notes = proportions.contradictions(&found.points.map(|point| point.at));
                let row = Row::of(face, &found);
                if each {
                    writeln!(out, "{:22} {number} {row} | {}", face.name, notes.join("; "))?;
                }
                counts.add(&row, !notes.is_empty());
            }
        }
        write!(out, "| {kind} |")?;
        for [n, warned] in counts.0 {
            write!(out, " {n} | {:.0} % |", 100.0 * warned as f64 / n as f64)?;
        }
        writeln!(out)?;
    }
    Ok(())
}
