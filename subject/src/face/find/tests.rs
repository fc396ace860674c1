use super::align::{STEPS, aligned};
use super::look::{look, mirrored};
use super::octaves::Octaves;
use super::{Found, Frame, LOOK, SCORE_MIN, faces};
use crate::face::Photo;
use crate::face::model::FeatureId;
use crate::face::render::Scene;

/// Numbers without a pattern, the same each time.
fn noise(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    }
}

/// A face of ellipses, `eyes` pixels between the eyes, turned by `roll_rad`, before a noisy wall.
fn drawn(eyes: f32, roll_rad: f32, colours: bool) -> Photo {
    let (sin, cos) = roll_rad.sin_cos();
    let frame = Frame {
        origin: [118.0, 96.0],
        across: [eyes * cos, eyes * sin],
        down: [-eyes * sin, eyes * cos],
        turn: 0.0,
    };
    let mut noise = noise(7);
    let pixels = (0..240 * 240)
        .map(|i| {
            let [x, y] = frame.inside([(i % 240) as f32, (i / 240) as f32]);
            // 1 inside of an ellipse, 0 outside, soft between.
            let inside = |cx: f32, cy: f32, wide: f32, high: f32| {
                let d = ((x.abs() - cx) / wide).hypot((y - cy) / high);
                ((1.15 - d) / 0.3).clamp(0.0, 1.0)
            };
            let mut rgb = [120.0, 128.0, 122.0];
            let mut paint = |share: f32, colour: [f32; 3]| {
                for (channel, to) in rgb.iter_mut().zip(colour) {
                    *channel += share * (to - *channel);
                }
            };
            paint(inside(0.0, 0.45, 1.15, 1.55), [205.0, 155.0, 128.0]);
            paint(inside(0.0, -1.1, 1.1, 0.45), [60.0, 45.0, 35.0]);
            paint(0.4 * inside(0.48, -0.05, 0.34, 0.2), [120.0, 80.0, 65.0]);
            paint(inside(0.5, 0.0, 0.17, 0.08), [45.0, 32.0, 28.0]);
            paint(0.9 * inside(0.5, -0.3, 0.32, 0.07), [75.0, 50.0, 40.0]);
            paint(0.6 * inside(0.1, 0.68, 0.1, 0.06), [110.0, 70.0, 60.0]);
            paint(0.35 * inside(0.0, 0.7, 0.25, 0.07), [120.0, 80.0, 70.0]);
            paint(inside(0.0, 1.1, 0.36, 0.08), [135.0, 62.0, 66.0]);
            paint(0.4 * inside(0.55, 0.45, 0.25, 0.2), [235.0, 185.0, 160.0]);
            let grain = 14.0 * (noise() - 0.5);
            let rgb = rgb.map(|channel| (channel + grain) as u8);
            if colours { rgb } else { [rgb[1]; 3] }
        })
        .collect();
    Photo::from_pixels(240, 240, pixels).unwrap()
}

fn off(found: &Found, eyes: f32, roll_rad: f32) -> f64 {
    let half = f64::from(eyes) / 2.0;
    let (sin, cos) = f64::from(roll_rad).sin_cos();
    let far = |eye: [f64; 2], side: f64| {
        (eye[0] - 118.0 - side * half * cos).hypot(eye[1] - 96.0 - side * half * sin)
    };
    far(found.eyes[0], -1.0).max(far(found.eyes[1], 1.0)) / found.io_px
}

#[test]
fn a_drawn_face_is_found_at_any_size_and_roll_once() {
    for (eyes, roll_rad) in [(30.0, 0.0), (44.0, 0.0), (60.0, 0.0), (48.0, 0.4), (48.0, -0.5)] {
        for colours in [true, false] {
            let found = faces(&drawn(eyes, roll_rad, colours), SCORE_MIN);
            assert_eq!(found.len(), 1, "{eyes} {roll_rad} {colours}: {found:?}");
            let off = off(&found[0], eyes, roll_rad);
            assert!(off < 0.12, "{eyes} {roll_rad} {colours}: {off} of {found:?}");
            assert!((found[0].roll_rad - f64::from(roll_rad)).abs() < 0.12);
            assert!((found[0].io_px / f64::from(eyes) / 1.43 - 1.0).abs() < 0.2);
        }
    }
}

#[test]
fn upside_down_it_is_less_of_a_face() {
    let upright = drawn(48.0, 0.0, true);
    let pixels: Vec<[u8; 3]> = upright.pixels().iter().rev().copied().collect();
    let turned = Photo::from_pixels(240, 240, pixels).unwrap();
    let best = |photo: &Photo| faces(photo, 0.0).first().map_or(0.0, |found| found.score);
    assert!(best(&turned) < best(&upright), "{} {}", best(&turned), best(&upright));
}

#[test]
fn noise_and_nothing_have_no_faces() {
    let mut noise = noise(3);
    let mut grain = || (noise() * 255.0) as u8;
    let noisy = (0..200 * 160).map(|_| [grain(), grain(), grain()]).collect();
    assert_eq!(faces(&Photo::from_pixels(200, 160, noisy).unwrap(), SCORE_MIN), []);
    for (width, height) in [(32, 32), (32, 400), (33, 35), (300, 40)] {
        let flat = Photo::from_pixels(width, height, vec![[200, 150, 130]; width * height]);
        assert_eq!(faces(&flat.unwrap(), SCORE_MIN), []);
    }
}

#[test]
fn a_frame_and_its_inverse_are_each_others() {
    for turn in [0.0, 0.2, -0.3] {
        let frame = Frame { origin: [40.0, 30.0], across: [20.0, 4.0], down: [-3.0, 24.0], turn };
        for (x, y) in [(0.0, 0.0), (-0.5, 0.0), (0.6, 1.1), (-0.8, -0.4)] {
            let [px, py] = frame.at(x, y);
            let [bx, by] = frame.inside([px, py]);
            assert!((bx - x).abs() < 1e-4 && (by - y).abs() < 1e-4, "{turn} {x} {y}");
        }
        // However far it is turned, the eyes are where they are.
        assert_eq!(frame.at(0.5, 0.0), [50.0, 32.0]);
    }
}

#[test]
fn the_same_photograph_gives_the_same_faces() {
    let photo = drawn(40.0, 0.1, true);
    assert_eq!(faces(&photo, 0.0), faces(&photo, 0.0));
}

#[test]
fn the_mirror_image_of_a_look_is_the_look_of_the_mirror_image() {
    let photo = drawn(48.0, 0.2, false);
    let mirrored_pixels = photo.pixels().chunks(240).flat_map(|row| row.iter().rev().copied());
    let other = Photo::from_pixels(240, 240, mirrored_pixels.collect()).unwrap();
    let frame = Frame { origin: [112.0, 99.0], across: [45.0, 6.0], down: [-5.0, 50.0], turn: 0.1 };
    let back = Frame {
        origin: [239.0 - 112.0, 99.0],
        across: [45.0, -6.0],
        down: [5.0, 50.0],
        turn: -0.1,
    };
    let own = look(&Octaves::new(photo.grey()), &frame);
    let of_other = look(&Octaves::new(other.grey()), &back);
    assert_eq!(own.len(), LOOK);
    assert_eq!(mirrored(&mirrored(&own)), own);
    let off = mirrored(&own).iter().zip(&of_other).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(off <= Some(2), "{off:?}");
}

#[test]
fn eyes_and_mouth_are_nearer_once_they_are_aligned() {
    let (mut before, mut after) = (0.0, 0.0);
    for seed in 0..8 {
        let picture = Scene::portrait(seed, 80.0, 0.0).render().unwrap();
        let size = (picture.image.width() as usize, picture.image.height() as usize);
        let pixels = picture.image.pixels().map(|pixel| pixel.0).collect();
        let octaves = Octaves::new(Photo::from_pixels(size.0, size.1, pixels).unwrap().grey());
        let mean = |from: usize, to: usize| {
            let points = (from..to).map(|i| picture.faces[0].at(FeatureId::from_ibug(i).unwrap()));
            let sum = points.fold([0.0; 2], |sum, at| [sum[0] + at[0], sum[1] + at[1]]);
            sum.map(|sum| (sum / (to - from) as f64) as f32)
        };
        let truth = [mean(36, 42), mean(42, 48), mean(48, 60)];
        let apart = truth[1][0] - truth[0][0];
        let far = |frame: &Frame| {
            let [left, right] = frame.eyes();
            let seen = [left, right, frame.at(0.0, Frame::MOUTH)];
            let off = seen.iter().zip(&truth).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
            off.sum::<f32>() / apart
        };
        let aside = if seed % 2 == 0 { 0.15 } else { -0.15 };
        let rough = Frame {
            origin: [(truth[0][0] + truth[1][0]) / 2.0 + aside * apart, truth[0][1]],
            across: [apart, 0.0],
            down: [0.0, 0.85 * (truth[2][1] - truth[0][1]) / Frame::MOUTH],
            turn: 0.0,
        };
        before += far(&rough);
        let aligned = |frame: Frame, step| aligned(&frame, &look(&octaves, &frame), step);
        after += far(&STEPS.into_iter().fold(rough, aligned));
    }
    assert!(after < 0.7 * before, "{after} of {before}");
}
