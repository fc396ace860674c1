use mocapd_testkit::random::Random;

use super::{Labels, Mask, Plane};

/// Pseudo-random values from 0 to 256.
fn noise(width: usize, height: usize) -> Plane {
    let mut random = Random::new(1);
    let values = (0..width * height).map(|_| random.between(0.0, 256.0) as f32);
    Plane::from_values(width, height, values.collect())
}

#[test]
fn a_blur_keeps_the_mean_and_has_the_requested_width() {
    let mut dot = Plane::filled(41, 41, 0.0);
    dot.values_mut()[20 * 41 + 20] = 1.0;
    let blurred = dot.blurred(2.5);
    let (mut sum, mut second) = (0.0, 0.0);
    for y in 0..41 {
        for x in 0..41 {
            let value = f64::from(blurred.get(x, y));
            sum += value;
            second += value * ((x - 20) as f64).powi(2);
        }
    }
    assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    // Truncated at three deviations or a little more, a Gaussian keeps more than 0.986 of its width.
    let share = second.sqrt() / 2.5;
    assert!((0.986..1.001).contains(&share), "{share}");
    let flat = Plane::filled(5, 7, 3.0).blurred(40.0);
    assert!(flat.values().iter().all(|value| (value - 3.0).abs() < 1e-4));
}

#[test]
fn slopes_of_a_ramp_are_constant() {
    let ramp = Plane::from_fn(12, 10, |x, y| 3.0 * x as f32 - 2.0 * y as f32);
    let gradient = ramp.gradient();
    assert_eq!(gradient.x.get(5, 5), 3.0);
    assert_eq!(gradient.y.get(5, 5), -2.0);
    assert!((gradient.magnitude.get(5, 5) - 13.0f32.sqrt()).abs() < 1e-6);
}

#[test]
fn interpolation_between_pixels_is_bilinear() {
    let ramp = Plane::from_fn(6, 6, |x, y| (x + 10 * y) as f32);
    assert!((ramp.sample(2.25, 3.5) - 37.25).abs() < 1e-5);
    assert_eq!(ramp.sample(-7.0, 99.0), 50.0);
    assert_eq!(ramp.sample(f32::NAN, 1.0), 0.0);
}

#[test]
fn a_new_size_keeps_the_mean() {
    let plane = noise(37, 23);
    let mean = |plane: &Plane| plane.values().iter().sum::<f32>() / plane.values().len() as f32;
    for (width, height) in [(12, 7), (37, 1), (5, 23), (74, 46)] {
        let other = plane.resized(width, height);
        assert_eq!((other.width(), other.height()), (width, height));
        assert!((mean(&other) - mean(&plane)).abs() < 0.01);
    }
    assert_eq!(plane.resized(37, 23), plane);
    let quarter = Plane::from_values(2, 2, vec![1.0, 2.0, 3.0, 6.0]).resized(1, 1);
    assert_eq!(quarter.values(), [3.0]);
}

#[test]
fn dilation_and_erosion_use_a_square() {
    let mask = noise(31, 17).map(|value| value > 235.0);
    for radius in [0, 1, 3] {
        let near = |x: usize, y: usize| {
            let rows = y.saturating_sub(radius)..(y + radius + 1).min(17);
            rows.into_iter().any(|y| {
                (x.saturating_sub(radius)..(x + radius + 1).min(31))
                    .any(|x| mask.get(x as isize, y as isize))
            })
        };
        let grown = mask.dilated(radius);
        for y in 0..17 {
            for x in 0..31 {
                assert_eq!(grown.get(x as isize, y as isize), near(x, y), "{x} {y} {radius}");
            }
        }
        assert_eq!(mask.map(|is| !is).eroded(radius), grown.map(|is| !is));
    }
}

#[test]
fn blobs_have_the_expected_moments() {
    // A bar along the diagonal, and a square that touches it by a corner alone.
    let picture = ["#.......", ".#......", "..#.....", "...##...", "...##...", "......##"];
    let values = picture.iter().flat_map(|row| row.bytes().map(|byte| byte == b'#')).collect();
    let mask = Mask::from_values(8, 6, values);
    assert_eq!(Labels::of(&mask, false).blobs.len(), 5);
    let labels = Labels::of(&mask, true);
    assert_eq!(labels.blobs.len(), 2);
    let bar = labels.blobs[0];
    assert_eq!((bar.area, bar.left, bar.top, bar.right, bar.bottom), (7, 0, 0, 5, 5));
    assert!((bar.axis_rad() - std::f64::consts::FRAC_PI_4).abs() < 1e-9);
    assert!(bar.eccentricity() > 0.8);
    assert_eq!(labels.mask(1).values().iter().filter(|&&inside| inside).count(), 2);
    assert_eq!(labels.blobs[1].axis_rad(), 0.0);
}
