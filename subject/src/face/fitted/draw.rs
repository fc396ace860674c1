//! Lines and dots with smooth edges on a picture.

use image::{Rgb, RgbImage};

/// What a stroke is painted with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ink {
    pub(super) colour: [u8; 3],
    /// From 0 to 1.
    pub(super) opacity: f64,
    pub(super) width_px: f64,
}

/// A straight line with round ends. What lies beyond the picture is left out.
pub(super) fn line(picture: &mut RgbImage, from: [f64; 2], to: [f64; 2], ink: Ink) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length2 = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
    stroke(picture, [from, to], ink, |at| {
        let d = [at[0] - from[0], at[1] - from[1]];
        let t = ((d[0] * along[0] + d[1] * along[1]) / length2).clamp(0.0, 1.0);
        (d[0] - t * along[0]).hypot(d[1] - t * along[1])
    });
}

/// A disc of `ink.width_px` across.
pub(super) fn disc(picture: &mut RgbImage, at: [f64; 2], ink: Ink) {
    stroke(picture, [at, at], ink, |p| (p[0] - at[0]).hypot(p[1] - at[1]));
}

/// A circle of `radius_px`.
pub(super) fn circle(picture: &mut RgbImage, at: [f64; 2], radius_px: f64, ink: Ink) {
    let corners = [at.map(|v| v - radius_px), at.map(|v| v + radius_px)];
    stroke(picture, corners, ink, |p| ((p[0] - at[0]).hypot(p[1] - at[1]) - radius_px).abs());
}

/// Inks every pixel by its distance to what is drawn, within the box around two corners.
fn stroke(
    picture: &mut RgbImage,
    corners: [[f64; 2]; 2],
    ink: Ink,
    distance: impl Fn([f64; 2]) -> f64,
) {
    let reach = ink.width_px / 2.0 + 1.0;
    if !corners.iter().flatten().all(|v| v.is_finite()) {
        return;
    }
    let range = |axis: usize, side: u32| {
        let low = corners[0][axis].min(corners[1][axis]) - reach;
        let high = corners[0][axis].max(corners[1][axis]) + reach;
        // `as` holds at 0 and at the largest what lies beyond.
        (low.floor().max(0.0) as u32)..((high.ceil().max(0.0) as u32).saturating_add(1).min(side))
    };
    for y in range(1, picture.height()) {
        for x in range(0, picture.width()) {
            let off = distance([f64::from(x), f64::from(y)]);
            let share =
                ink.opacity * (ink.width_px / 2.0 + 0.5 - off).clamp(0.0, ink.width_px.min(1.0));
            if share > 0.0 {
                let Rgb(under) = *picture.get_pixel(x, y);
                let over = |i: usize| {
                    f64::from(under[i]) + share * (f64::from(ink.colour[i]) - f64::from(under[i]))
                };
                picture.put_pixel(x, y, Rgb(std::array::from_fn(|i| over(i).round() as u8)));
            }
        }
    }
}
