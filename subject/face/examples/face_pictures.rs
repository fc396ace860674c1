//! Draws two synthetic faces with their fitted wireframes, one with a high and one with a low confidence:
//!
//!     cargo run --release -p mocapd-face --features measure --example face_pictures docs/faces

use std::error::Error;
use std::path::Path;

use image::imageops::{crop_imm, thumbnail};
use image::{ImageFormat, Rgb, RgbImage};
use mocapd_face::Photo;
use mocapd_face::fit::fit;
use mocapd_face::fitted::{FittedFace, Method, Overlay, Source};
use mocapd_face::model::FeatureId;
use mocapd_testkit::photograph::{GroundTruth, Scene};

const INTEROCULAR_PX: f64 = 70.0;
const SEED: u64 = 2;
const YAW_DEG: f64 = 12.0;
const WIDTH_PX: u32 = 300;

#[expect(clippy::print_stdout, reason = "an example prints")]
fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("name a folder that the pictures go to")?;
    std::fs::create_dir_all(&folder)?;
    for (name, covered) in [("sure", false), ("unsure", true)] {
        let mut scene = Scene::portrait(SEED, INTEROCULAR_PX, YAW_DEG);
        scene.noise = 1.0;
        let mut picture = scene.render()?;
        if covered {
            let truth = picture.faces.first().ok_or("the scene has no face")?;
            cover(&mut picture.image, truth, &[48, 54], [1.1, 0.35]);
            cover(&mut picture.image, truth, &[36, 39], [0.25, 0.5]);
        }
        let face = fitted(&picture.image)?;
        let path = Path::new(&folder).join(format!("{name}.png"));
        let drawn = Overlay::new(&picture.image, std::slice::from_ref(&face)).into_image();
        let (width, height) = (drawn.width() * 3 / 5, drawn.height() * 4 / 5);
        let face_only = crop_imm(&drawn, width / 3, height / 8, width, height).to_image();
        thumbnail(&face_only, WIDTH_PX, height * WIDTH_PX / width.max(1)).save(&path)?;
        println!("{}: confidence {:.2}", path.display(), face.confidence.unwrap_or_default());
    }
    Ok(())
}

/// A plain patch over the centre of some of the points, of the given width and height in outer interocular distances.
fn cover(image: &mut RgbImage, truth: &GroundTruth, ibug: &[usize], size_interocular: [f64; 2]) {
    let points = ibug.iter().filter_map(|i| FeatureId::from_ibug(*i)).map(|id| truth.at(id));
    let sum = points.fold([0.0, 0.0], |s, p| [s[0] + p[0], s[1] + p[1]]);
    let middle = sum.map(|s| s / ibug.len() as f64);
    let within = |x: u32, y: u32| {
        let off = [f64::from(x) - middle[0], f64::from(y) - middle[1]];
        off.iter().zip(size_interocular).all(|(d, size)| d.abs() < size * INTEROCULAR_PX / 2.0)
    };
    for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(x, y, _)| within(*x, *y)) {
        let shade = 120 + ((x + y) % 7) as u8;
        *pixel = Rgb([shade, shade - 30, shade - 45]);
    }
}

fn fitted(image: &RgbImage) -> Result<FittedFace, Box<dyn Error>> {
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, ImageFormat::Png)?;
    let photo = Photo::from_bytes(&png.into_inner())?;
    let (width, height) = (Some(image.width()), Some(image.height()));
    let source = Source { name: "drawn.png".into(), sha256: "0".repeat(64), width, height };
    let faces = fit(&photo, &source, Method::Default)?;
    faces.into_iter().next().ok_or_else(|| "no face found".into())
}
