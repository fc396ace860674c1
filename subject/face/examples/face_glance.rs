//! Features of heads with known landmarks, the training data of `benches/subject/face_glance.py`.
//!
//!     cargo run --release -p mocapd-face --features measure --example face_glance -- cells HEADS > ROWS
//!     cargo run --release -p mocapd-face --features measure --example face_glance -- patches HEADS POINTS > ROWS
//!
//! HEADS is a folder written by `benches/subject/heads/make.py`. Each head is started from its eyes and mouth,
//! disturbed four times with a fixed seed. A row is, little-endian: x and y of 60 landmarks in the crop (pixels, 32-bit
//! floats), then the bytes of the features. POINTS contains for each row, in the same order, the landmarks whose
//! patches are described: 60 times x and y.

use std::error::Error;
use std::io::{Read, Write};
use std::path::Path;

use mocapd_face::Photo;
use mocapd_face::points::RoughFace;
use mocapd_face::points::regressor::{LandmarkPoints, LandmarkRegressor, REGRESSED};

#[expect(dead_code, reason = "the table has its own")]
#[path = "faces_points/data.rs"]
mod data;

/// Disturbance of eyes and mouth at each start (standard deviation, in outer interocular distances).
const START_SD_INTEROCULAR: [f64; 4] = [0.02, 0.04, 0.06, 0.1];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (folder, mut points) = match arguments.as_slice() {
        ["cells", folder] => (folder, None),
        ["patches", folder, points] => {
            (folder, Some(std::io::BufReader::new(std::fs::File::open(points)?)))
        }
        _ => return Err("say cells HEADS, or patches HEADS POINTS".into()),
    };
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut files: Vec<_> =
        std::fs::read_dir(folder)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
    files.sort();
    let mut noise = data::Noise::new(1);
    for file in files.iter().filter(|f| f.extension().is_some_and(|e| e == "png")) {
        let landmarks = landmarks(&file.with_extension("json"))?;
        let photo = Photo::from_bytes(&std::fs::read(file)?)?;
        for sd_interocular in START_SD_INTEROCULAR {
            let rough = disturbed(&landmarks, sd_interocular, &mut noise);
            let regressor = LandmarkRegressor::new(&photo, &rough);
            for at in REGRESSED.iter().filter_map(|i| landmarks.get(*i)) {
                for value in regressor.in_crop(*at) {
                    out.write_all(&(value as f32).to_le_bytes())?;
                }
            }
            let features = match &mut points {
                None => regressor.crop_features(),
                Some(points) => regressor.patch_features(&read(points)?),
            };
            out.write_all(&features)?;
        }
    }
    out.flush()?;
    Ok(())
}

fn landmarks(json: &Path) -> Result<Vec<[f64; 2]>, Box<dyn Error>> {
    let value: serde_json::Value = serde_json::from_slice(&std::fs::read(json)?)?;
    let landmarks: Vec<[f64; 2]> = serde_json::from_value(value["faces"][0]["landmarks"].clone())?;
    if landmarks.len() == 68 { Ok(landmarks) } else { Err("no 68 landmarks".into()) }
}

fn disturbed(landmarks: &[[f64; 2]], sd_interocular: f64, noise: &mut data::Noise) -> RoughFace {
    let sd = sd_interocular * data::distance(landmarks[36], landmarks[45]);
    let mut near = |range: std::ops::Range<usize>| {
        let n = range.len() as f64;
        let [x, y] = landmarks[range].iter().fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
        [x / n + sd * noise.normal(), y / n + sd * noise.normal()]
    };
    RoughFace { left_eye: near(36..42), right_eye: near(42..48), mouth: near(48..60) }
}

fn read(points: &mut impl Read) -> Result<LandmarkPoints, Box<dyn Error>> {
    let mut landmarks: LandmarkPoints = [[0.0; 2]; REGRESSED.len()];
    for value in landmarks.iter_mut().flatten() {
        let mut bytes = [0; 4];
        points.read_exact(&mut bytes)?;
        *value = f64::from(f32::from_le_bytes(bytes));
    }
    Ok(landmarks)
}
