//! Seeded pictures of drawn faces, and what is detected on them: they cover many more people, lights and poses than the
//! available photographs with known faces.

use std::path::Path;

use image::{Rgb, RgbImage};
use mocapd_face::Photo;
use mocapd_face::find::{self, DetectedFace};
use mocapd_face::model::FeatureId;
use mocapd_testkit::{
    photograph::{GroundTruth, Occlusions, Scene},
    random::Random,
};
use serde_json::json;

use super::{Face, score};

/// Size of the pictures: 0.25 megapixels.
const SIZE_PX: (u32, u32) = (480, 520);

/// `amount` with probability `share`, else 0.
fn sometimes(random: &mut Random, share: f64, amount: f64) -> f64 {
    if random.unit() < share { amount } else { 0.0 }
}

/// A picture, its face (none on every fifth picture), and the rows of the table to which it belongs.
struct Drawn {
    image: RgbImage,
    face: Option<(Face, GroundTruth, f64)>,
    kinds: Vec<&'static str>,
}

fn draw(seed: u64) -> Option<Drawn> {
    let mut random = Random::new(seed.wrapping_mul(0x0005_851f_42d4_c957));
    let eyes_px = 40.0 * 5.0_f64.powf(random.unit().powf(1.3));
    let yaw_deg = random.between(-35.0, 35.0);
    let mut scene = Scene::portrait(seed, eyes_px, yaw_deg);
    (scene.width_px, scene.height_px) = SIZE_PX;
    scene.noise = random.between(1.0, 6.0);
    let sitter = scene.faces.first_mut()?;
    let room =
        |side: u32, before: f64, after: f64| (before * eyes_px, f64::from(side) - after * eyes_px);
    let (left, right) = room(SIZE_PX.0, 0.85, 0.85);
    let (top, bottom) = room(SIZE_PX.1, 0.9, 1.4);
    sitter.eyes_px = [random.between(left, right), random.between(top, bottom)];
    sitter.pitch_deg = random.between(-14.0, 14.0);
    sitter.roll_deg = random.between(-20.0, 20.0);
    sitter.variety = 1.0;
    let rims_mm = random.between(1.0, 2.5);
    let beard = random.between(0.4, 0.95);
    let fringe_mm = random.between(10.0, 45.0);
    sitter.extras = Occlusions {
        rims_mm: sometimes(&mut random, 0.2, rims_mm),
        beard: sometimes(&mut random, 0.25, beard),
        fringe_mm: sometimes(&mut random, 0.3, fringe_mm),
        light: Some([random.between(-1.4, 1.4), random.between(-0.3, 1.6), 1.0]),
    };
    let Occlusions { rims_mm, beard, fringe_mm, light } = sitter.extras;
    let empty = seed % 5 == 4;
    if empty {
        scene.faces.clear();
    }
    let mut picture = scene.render().ok()?;
    let mut kinds = vec!["all"];
    if let Some(truth) = picture.faces.first() {
        let [x, y] = truth.at(FeatureId::from_ibug(33)?);
        let Rgb([r, g, b]) =
            *picture.image.get_pixel_checked(x.max(0.0) as u32, y.max(0.0) as u32)?;
        let luma = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
        kinds.push(if luma < 100.0 {
            "dark"
        } else if luma < 160.0 {
            "middling"
        } else {
            "light"
        });
        kinds.push(if yaw_deg.abs() < 12.0 {
            "yaw < 12"
        } else if yaw_deg.abs() < 24.0 {
            "yaw < 24"
        } else {
            "yaw < 35"
        });
        kinds.push(if eyes_px < 60.0 {
            "io < 60"
        } else if eyes_px < 110.0 {
            "io < 110"
        } else {
            "io < 200"
        });
        let aside = light.is_some_and(|[x, y, _]| x.abs() > 0.9 || y > 1.1);
        let worn = [
            (rims_mm > 0.0, "glasses"),
            (beard > 0.0, "beard"),
            (fringe_mm > 0.0, "fringe"),
            (aside, "light aside"),
        ];
        kinds.extend(worn.iter().filter(|(is, _)| *is).map(|(_, name)| name));
    } else {
        kinds.push("no face");
    }
    kinds.push(develop(&mut picture.image, &mut random));
    let face =
        picture.faces.into_iter().next().and_then(|truth| Some((known(&truth)?, truth, yaw_deg)));
    Some(Drawn { image: picture.image, face, kinds })
}

/// Applies a tone curve and a colour of the light: natural, grey or cast.
fn develop(image: &mut RgbImage, random: &mut Random) -> &'static str {
    let gamma = random.between(0.7, 1.5);
    let (grey, cast) = (random.unit() < 0.2, random.unit() < 0.2);
    let warm = random.between(0.6, 0.85);
    for Rgb(pixel) in image.pixels_mut() {
        let [r, g, b] = pixel.map(|value| 255.0 * (f64::from(value) / 255.0).powf(gamma));
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        let changed = if grey {
            [luma; 3]
        } else if cast {
            [r, g * warm.sqrt(), b * warm * warm]
        } else {
            [r, g, b]
        };
        *pixel = changed.map(|value| value.round() as u8);
    }
    if grey {
        "grey"
    } else if cast {
        "cast"
    } else {
        "natural"
    }
}

/// Eyes in the convention of the annotations: the mean of six points each.
fn known(truth: &GroundTruth) -> Option<Face> {
    let mean = |from: usize, count: usize| {
        let points = (from..from + count).map(|i| FeatureId::from_ibug(i).map(|id| truth.at(id)));
        let sum = points.sum_points()?;
        Some(sum.map(|s| s / count as f64))
    };
    let [a, b] = [36, 45].map(|i| FeatureId::from_ibug(i).map(|id| truth.at(id)));
    let (a, b) = (a?, b?);
    let interocular_px = (a[0] - b[0]).hypot(a[1] - b[1]);
    let eyes = [mean(36, 6)?, mean(42, 6)?];
    Some(Face { eyes, mouth: mean(48, 12)?, interocular_px, counts: true })
}

trait SumPoints {
    fn sum_points(self) -> Option<[f64; 2]>;
}

impl<I: Iterator<Item = Option<[f64; 2]>>> SumPoints for I {
    fn sum_points(self) -> Option<[f64; 2]> {
        self.into_iter().try_fold([0.0; 2], |sum, p| p.map(|p| [sum[0] + p[0], sum[1] + p[1]]))
    }
}

/// Detection results on the pictures `seeds`, by kind.
pub(crate) fn table(seeds: std::ops::Range<u64>) {
    let mut rows: Vec<(&str, [usize; 4])> = Vec::new();
    for drawn in seeds.filter_map(draw) {
        let Some(photo) = photo(&drawn.image) else { continue };
        let found: Vec<DetectedFace> = find::faces(&photo, find::SCORE_MIN);
        let faces: Vec<Face> = drawn.face.into_iter().map(|(face, ..)| face).collect();
        let (hits, wrong) = score(&faces, &found);
        for kind in drawn.kinds {
            let at = rows.iter().position(|row| row.0 == kind).unwrap_or(rows.len());
            if at == rows.len() {
                rows.push((kind, [0; 4]));
            }
            for (sum, count) in rows[at].1.iter_mut().zip([1, faces.len(), hits, wrong]) {
                *sum += count;
            }
        }
    }
    println!(
        "{:12} {:>8} {:>6} {:>6} {:>6} {:>16}",
        "", "pictures", "faces", "found", "%", "false a picture"
    );
    rows.sort_unstable();
    for (kind, [pictures, faces, hits, wrong]) in rows {
        let share = 100.0 * hits as f64 / faces.max(1) as f64;
        let wrong = wrong as f64 / pictures.max(1) as f64;
        println!("{kind:12} {pictures:>8} {faces:>6} {hits:>6} {share:>6.0} {wrong:>16.2}");
    }
}

fn photo(image: &RgbImage) -> Option<Photo> {
    let pixels = image.pixels().map(|pixel| pixel.0).collect();
    Photo::from_pixels(image.width() as usize, image.height() as usize, pixels).ok()
}

/// Writes the pictures `seeds` into a folder, each with a JSON file of its face.
pub(crate) fn write(seeds: std::ops::Range<u64>, folder: &Path) {
    for seed in seeds {
        let Some(drawn) = draw(seed) else { continue };
        let at = folder.join(format!("drawn_{seed:05}.png"));
        let faces: Vec<_> = drawn
            .face
            .iter()
            .map(|(face, _, yaw)| {
                let points = [face.eyes[0], face.eyes[1], face.mouth];
                json!({ "points": points, "io": face.interocular_px, "yaw": yaw })
            })
            .collect();
        let text = json!({ "faces": faces, "kinds": drawn.kinds }).to_string();
        if drawn.image.save(&at).is_err()
            || std::fs::write(at.with_extension("json"), text).is_err()
        {
            eprintln!("{}: not written", at.display());
        }
    }
}
