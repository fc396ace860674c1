//! One size of the pyramid, on which the eyes of a face are [`EYE_DISTANCE`] apart, or up to 1.4 times as far.

use super::Plane;

/// Pixels between the middles of the eyes, at the least: an iris has 2.6 then, and a lid line one.
pub(super) const EYE_DISTANCE: f32 = 12.0;
/// From one size to the next, smaller one.
pub(super) const STEP: f32 = std::f32::consts::SQRT_2;
/// Width of what brightness and contrast are taken off by: half the distance of the eyes.
const LOCAL_PX: f32 = 7.0;
/// Contrast, in grey levels, that is noise: added before it is divided by.
const CONTRAST_FLOOR: f32 = 4.0;

/// A size of the pyramid.
#[derive(Debug)]
pub(super) struct Level {
    /// A pixel of this level, in pixels of the photograph.
    pub(super) scale: [f32; 2],
    /// Brightness less that of around, divided by the contrast of around.
    pub(super) local: Plane,
    /// How much darker a spot of an eye's size is than what is around it, in the same measure.
    pub(super) spots: Plane,
}

impl Level {
    /// Of a grey photograph at `width` by `height` pixels.
    pub(super) fn new(grey: &Plane, width: usize, height: usize) -> Self {
        let small = grey.resized(width, height);
        let local = localised(&small);
        let spots = local.blurred(3.2).zip(&local.blurred(1.2), |around, centre| around - centre);
        let scale = [
            grey.width() as f32 / small.width() as f32,
            grey.height() as f32 / small.height() as f32,
        ];
        Self { scale, local, spots }
    }

    /// A place on this level, on the photograph.
    pub(super) fn on_photo(&self, [x, y]: [f32; 2]) -> [f64; 2] {
        let out = |at: f32, scale: f32| f64::from((at + 0.5) * scale - 0.5);
        [out(x, self.scale[0]), out(y, self.scale[1])]
    }
}

/// Brightness less that of around, divided by the contrast of around: light from one side goes.
pub(super) fn localised(plane: &Plane) -> Plane {
    let rest = plane.zip(&wide_blur(plane), |value, around| value - around);
    let contrast = wide_blur(&rest.map(|value| value * value));
    rest.zip(&contrast, |value, square| value / (square.max(0.0).sqrt() + CONTRAST_FLOOR))
}

/// A blur of [`LOCAL_PX`], on a third of the pixels: nothing finer is left of it.
fn wide_blur(plane: &Plane) -> Plane {
    let (width, height) = (plane.width().div_ceil(3), plane.height().div_ceil(3));
    let small = plane.resized(width, height).blurred(LOCAL_PX / 3.0);
    let (kx, ky) = (width as f32 / plane.width() as f32, height as f32 / plane.height() as f32);
    let mut out = plane.clone();
    let columns: Vec<(usize, f32)> = (0..plane.width())
        .map(|x| {
            let at = ((x as f32 + 0.5) * kx - 0.5).clamp(0.0, (width - 1) as f32);
            (at as usize, at.fract())
        })
        .collect();
    let mut mixed = vec![0.0; width];
    for (y, row) in out.values_mut().chunks_exact_mut(plane.width()).enumerate() {
        let at = ((y as f32 + 0.5) * ky - 0.5).clamp(0.0, (height - 1) as f32);
        let (upper, lower) = (small.row(at as usize), small.row((at as usize + 1).min(height - 1)));
        for ((mix, above), below) in mixed.iter_mut().zip(upper).zip(lower) {
            *mix = above + (below - above) * at.fract();
        }
        for (value, &(left, share)) in row.iter_mut().zip(&columns) {
            let a = mixed.get(left).copied().unwrap_or_default();
            let b = mixed.get(left + 1).copied().unwrap_or(a);
            *value = a + (b - a) * share;
        }
    }
    out
}
