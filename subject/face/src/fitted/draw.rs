//! Lines and dots with smooth edges on a picture.

use std::ops::Range;

use image::{Rgb, RgbImage};

/// What a stroke is painted with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ink {
    pub(super) colour: [u8; 3],
    /// From 0 to 1.
    pub(super) opacity: f64,
    pub(super) width_px: f64,
}

/// Many straight lines with round ends as one stroke: where they meet, ink that is half transparent lies no thicker.
pub(super) fn lines(picture: &mut RgbImage, lines: &[[[f64; 2]; 2]], ink: Ink) {
    let lines = || lines.iter().filter(|line| line.iter().flatten().all(|v| v.is_finite()));
    let ends = || lines().flatten();
    let low = |axis: usize| ends().map(|end| end[axis]).fold(f64::INFINITY, f64::min);
    let high = |axis: usize| ends().map(|end| end[axis]).fold(f64::NEG_INFINITY, f64::max);
    let corners = [[low(0), low(1)], [high(0), high(1)]];
    let Some(whole) = Patch::around(picture, corners, ink) else { return };
    let width = whole.x.len();
    let mut covered = vec![0_u8; width * whole.y.len()];
    for &[from, to] in lines() {
        let Some(patch) = Patch::around(picture, [from, to], ink) else { continue };
        for y in patch.y {
            for x in patch.x.clone() {
                let share = ink.share(off_line([f64::from(x), f64::from(y)], from, to));
                let at = (y - whole.y.start) as usize * width + (x - whole.x.start) as usize;
                if let Some(most) = covered.get_mut(at) {
                    *most = (*most).max((255.0 * share).round() as u8);
                }
            }
        }
    }
    let places = whole.y.flat_map(|y| whole.x.clone().map(move |x| [x, y]));
    for (place, share) in places.zip(covered).filter(|(_, share)| *share > 0) {
        blend(picture, place, ink, f64::from(share) / 255.0);
    }
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
    let Some(patch) = Patch::around(picture, corners, ink) else { return };
    for y in patch.y {
        for x in patch.x.clone() {
            let share = ink.share(distance([f64::from(x), f64::from(y)]));
            if share > 0.0 {
                blend(picture, [x, y], ink, share);
            }
        }
    }
}

/// The pixels that ink can come to.
struct Patch {
    x: Range<u32>,
    y: Range<u32>,
}

impl Patch {
    /// Around two corners; none where they are no numbers.
    fn around(picture: &RgbImage, corners: [[f64; 2]; 2], ink: Ink) -> Option<Self> {
        let reach = ink.width_px / 2.0 + 1.0;
        let range = |axis: usize, side: u32| {
            let low = corners[0][axis].min(corners[1][axis]) - reach;
            let high = corners[0][axis].max(corners[1][axis]) + reach;
            // `as` holds at 0 and at the largest what lies beyond.
            let end = (high.ceil().max(0.0) as u32).saturating_add(1).min(side);
            (low.floor().max(0.0) as u32).min(end)..end
        };
        let finite = corners.iter().flatten().all(|v| v.is_finite());
        finite.then(|| Self { x: range(0, picture.width()), y: range(1, picture.height()) })
    }
}

impl Ink {
    /// How much of a pixel so far from the middle of the stroke is covered, 0 to 1.
    fn share(&self, off: f64) -> f64 {
        (self.width_px / 2.0 + 0.5 - off).clamp(0.0, self.width_px.clamp(0.0, 1.0))
    }
}

fn off_line(at: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length2 = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
    let d = [at[0] - from[0], at[1] - from[1]];
    let t = ((d[0] * along[0] + d[1] * along[1]) / length2).clamp(0.0, 1.0);
    (d[0] - t * along[0]).hypot(d[1] - t * along[1])
}

fn blend(picture: &mut RgbImage, [x, y]: [u32; 2], ink: Ink, share: f64) {
    let Some(Rgb(under)) = picture.get_pixel_mut_checked(x, y) else { return };
    for (under, over) in under.iter_mut().zip(ink.colour) {
        let by = ink.opacity * share * (f64::from(over) - f64::from(*under));
        *under = (f64::from(*under) + by).round() as u8;
    }
}
