//! A place of the photograph, upright and small, on which the eyes of a face are about [`EYE_DISTANCE`] apart.

use super::Plane;
use super::frame::Frame;
use super::octaves::Octaves;

/// Pixels between the middles of the eyes: an iris has 2.6 then, and a lid line one.
pub(super) const EYE_DISTANCE: f32 = 12.0;
/// Four distances of the eyes, and a little more; the eyes are above the middle.
const SIZE_PX: (usize, usize) = (48, 52);
const EYES_AT: [f32; 2] = [23.5, 20.5];
/// Width of what brightness and contrast are taken off by: half the distance of the eyes.
const LOCAL_PX: f32 = 7.0;
/// Contrast, in grey levels, that is noise: added before it is divided by.
const CONTRAST_FLOOR: f32 = 4.0;

/// A place that is looked at closer.
#[derive(Debug)]
pub(super) struct Level {
    /// One pixel to the right, on the photograph; down is square to it.
    step: [f32; 2],
    /// Where [`EYES_AT`] is on the photograph.
    origin: [f32; 2],
    /// Brightness less that of around, divided by the contrast of around.
    pub(super) local: Plane,
}

impl Level {
    /// Around a frame on the photograph, and the frame on it; none where the frame has no size.
    pub(super) fn new(octaves: &Octaves, frame: &Frame) -> Option<(Self, Frame)> {
        let Frame { origin, across, down, turn } = *frame;
        let shrink = down[0].hypot(down[1]) / EYE_DISTANCE;
        let wide = across[0].hypot(across[1]);
        if !(wide > 1e-3 && shrink > 1e-3) {
            return None;
        }
        let step = across.map(|part| part * shrink / wide);
        let (plane, done) = octaves.at(shrink)?;
        let [ex, ey] = EYES_AT;
        let mut small = Plane::filled(SIZE_PX.0, SIZE_PX.1, 0.0);
        for (y, row) in small.values_mut().chunks_exact_mut(SIZE_PX.0).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let [px, py] = on(origin, step, x as f32 - ex, y as f32 - ey);
                *value = plane.sample((px + 0.5) / done - 0.5, (py + 0.5) / done - 0.5);
            }
        }
        let local = localised(&small);
        let square = shrink * shrink;
        let inside = |[x, y]: [f32; 2]| {
            [(x * step[0] + y * step[1]) / square, (y * step[0] - x * step[1]) / square]
        };
        let frame = Frame { origin: EYES_AT, across: inside(across), down: inside(down), turn };
        Some((Self { step, origin, local }, frame))
    }

    /// A frame on this level, on the photograph.
    pub(super) fn frame_on_photo(&self, frame: &Frame) -> Frame {
        let way = |[x, y]: [f32; 2]| on([0.0; 2], self.step, x, y);
        let [x, y] = frame.origin;
        let origin = on(self.origin, self.step, x - EYES_AT[0], y - EYES_AT[1]);
        Frame { origin, across: way(frame.across), down: way(frame.down), turn: frame.turn }
    }
}

fn on(origin: [f32; 2], step: [f32; 2], x: f32, y: f32) -> [f32; 2] {
    [origin[0] + x * step[0] - y * step[1], origin[1] + x * step[1] + y * step[0]]
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
