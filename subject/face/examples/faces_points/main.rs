//! Accuracy of the 53 points, as Markdown, on the photographs in the folder that `MOCAPD_FACES` names:
//!
//!     MOCAPD_FACES=../shared/faces cargo run --release -p mocapd-face --features measure --example faces_points
//!
//! Two tables for each half: started from the true eyes and mouth disturbed by seeded noise, and from detected faces.
//! In addition to the photographs there are the development ones reduced in size, and two kinds of drawn faces. The
//! arguments `development`, `small`, `drawn`, `worn` and `reported` select one of them, `each` adds a line per face,
//! and `offsets` prints the positions of the annotators of the development half relative to the found ones:
//! `OFFSETS_IO` of the default chain. `warned` prints instead how often the paper's points on drawn faces get a note,
//! and `confidence` prints the training data of the confidence, from development and drawn faces.

mod confidence;
mod data;
mod drawn;
mod offsets;
mod table;
mod warned;

use std::io::Write;

use data::Truth;
use mocapd_face::find;
use mocapd_face::points::{self, FacePoints, RoughFace};
use offsets::Offsets;
use table::{Row, Table};

/// Standard deviation of the starting positions, in outer interocular distances.
const START_SD_INTEROCULAR: f64 = 0.04;
/// Outer interocular distance to which the development photographs' faces are reduced.
const SMALL_INTEROCULAR_PX: f64 = 24.0;
/// Number of disturbed starts of each face.
const STARTS: usize = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut out = std::io::stdout().lock();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let requested = |word: &str| arguments.iter().any(|a| a == word);
    let Some(folder) = std::env::var_os("MOCAPD_FACES") else {
        writeln!(out, "MOCAPD_FACES is not set: it names the folder of the photographs")?;
        return Ok(());
    };
    let mut offsets = Offsets::default();
    let photographs = data::read(folder.as_ref())?;
    let small = data::reduced(&photographs, SMALL_INTEROCULAR_PX)?;
    let (drawn, worn) = (drawn::faces()?, drawn::worn_faces()?);
    if requested("warned") {
        return warned::print(&mut out, &[("drawn", &drawn), ("worn", &worn)], requested("each"));
    }
    if requested("confidence") {
        let photographs = photographs.iter().filter(|f| f.development);
        let learned_from: Vec<_> = photographs.chain(&small).chain(&drawn).chain(&worn).collect();
        return confidence::print(&mut out, &learned_from);
    }
    let halves = [
        ("development", true, &photographs),
        ("small", true, &small),
        ("drawn", true, &drawn),
        ("worn", true, &worn),
        ("reported", false, &photographs),
    ];
    let all = !halves.iter().any(|(half, ..)| requested(half));
    for (half, development, faces) in halves {
        if !all && !requested(half) {
            continue;
        }
        let (mut disturbed_table, mut detected_table) = (Table::default(), Table::default());
        let mut missed = 0;
        let mut noise = data::Noise::new(1);
        for face in faces.iter().filter(|f| f.development == development) {
            let mut starts: Vec<Option<RoughFace>> =
                (0..STARTS).map(|_| Some(disturbed(&face.truth, &mut noise))).collect();
            starts.push(detected(face));
            missed += usize::from(starts.last() == Some(&None));
            for (number, rough) in starts.into_iter().enumerate() {
                let Some(rough) = rough else { continue };
                let started = std::time::Instant::now();
                let found = points::find(&face.photo, &rough)?;
                let spent_ms = started.elapsed().as_secs_f64() * 1e3;
                let paper = points::paper::find(&face.photo, &rough);
                let table =
                    if number < STARTS { &mut disturbed_table } else { &mut detected_table };
                for (method, found) in [("default", &found), ("paper", &paper)] {
                    let row = Row::of(face, found);
                    if requested("each") {
                        writeln!(
                            out,
                            "{:22} {}.{number} {method:8} {row}",
                            face.name, face.number
                        )?;
                    }
                    table.add(face, method, row);
                }
                table.spent_ms.push(spent_ms);
                if half == "development" && number < STARTS {
                    offsets.add(face, &found);
                    if let Some(folder) = std::env::var_os("OVERLAYS") {
                        data::overlay(face, &found, folder.as_ref())?;
                    }
                }
            }
        }
        writeln!(out, "\n### {half}, from disturbed eyes and mouths\n\n{disturbed_table}")?;
        writeln!(
            out,
            "### {half}, from detected ones ({missed} not detected)\n\n{detected_table}"
        )?;
    }
    if requested("offsets") {
        writeln!(out, "{offsets}")?;
    }
    Ok(())
}

/// The detected face that overlaps this one, if there is one: its eyes are within 0.35 of the true interocular
/// distance.
fn detected(face: &data::Face) -> Option<RoughFace> {
    let (left, right) = (face.truth.centre(36..42), face.truth.centre(42..48));
    let near = 0.35 * data::distance(left, right);
    find::faces(&face.photo, find::SCORE_MIN)
        .iter()
        .find(|f| data::distance(f.eyes[0], left) < near && data::distance(f.eyes[1], right) < near)
        .map(RoughFace::from)
}

fn disturbed(truth: &Truth, noise: &mut data::Noise) -> RoughFace {
    disturbed_by(START_SD_INTEROCULAR, truth, noise)
}

fn disturbed_by(sd_interocular: f64, truth: &Truth, noise: &mut data::Noise) -> RoughFace {
    let sd_px = sd_interocular * truth.interocular_px();
    let mut near = |range: std::ops::Range<usize>| {
        let [x, y] = truth.centre(range);
        [x + sd_px * noise.normal(), y + sd_px * noise.normal()]
    };
    RoughFace { left_eye: near(36..42), right_eye: near(42..48), mouth: near(48..60) }
}

/// The found points by their numbers in iBUG-68.
fn ibug(found: &FacePoints, point: usize) -> Option<[f64; 2]> {
    let id = mocapd_face::model::FeatureId::from_ibug(point)?;
    found.points.get(id.index()).map(|p| p.at)
}
