//! How likely a colour is skin's (Yang et al. 2004, eqs. 1 and 2).

use crate::photo::Photo;
use crate::plane::Plane;

/// Mean of r and g, and their covariance (rr, rg, gg), from the development photographs (`benches/subject/skin.py`): the
/// paper does not give its own.
const MEAN: [f32; 2] = [0.4269, 0.3131];
const COVARIANCE: [f32; 3] = [0.001_304, -0.000_211, 0.000_140];
/// R + G + B below which a pixel has no hue, and is no skin.
const BLACK: f32 = 30.0;

/// Skin(p) = exp(-(p - m)' S^-1 (p - m) / 2), with p = (r, g) and r = R / (R + G + B), at `width` by `height` pixels.
pub(super) fn skin(photo: &Photo, width: usize, height: usize) -> Plane {
    let channel = |i: usize| {
        photo.plane(|rgb| f32::from(rgb.get(i).copied().unwrap_or_default())).resized(width, height)
    };
    let (red, green, blue) = (channel(0), channel(1), channel(2));
    let sum = red.zip(&green, |a, b| a + b).zip(&blue, |a, b| a + b);
    // Two planes are joined at a time: first the chromaticities, with none for what is black.
    let ratio = |value: f32, sum: f32| if sum < BLACK { f32::NAN } else { value / sum };
    red.zip(&sum, ratio).zip(&green.zip(&sum, ratio), likelihood)
}

fn likelihood(r: f32, g: f32) -> f32 {
    if r.is_nan() || g.is_nan() {
        return 0.0;
    }
    let [rr, rg, gg] = COVARIANCE;
    let (dr, dg) = (r - MEAN[0], g - MEAN[1]);
    let square = (gg * dr * dr - 2.0 * rg * dr * dg + rr * dg * dg) / (rr * gg - rg * rg);
    (-0.5 * square).exp()
}
