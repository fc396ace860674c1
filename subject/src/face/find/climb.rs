//! A rough frame is moved until the drawn face fits best.

use super::Plane;
use super::frame::Frame;
use super::schema::{ACROSS, DOWN, Schema, place, standard};

/// How far a pass moves: shares of the eyes' distance, radians, and shares of lengths alike.
const ROUGH_STEPS: [f32; 2] = [0.12, 0.08];
const STEPS: [f32; 3] = [0.08, 0.05, 0.03];
/// What the slopes' likeness counts beside the brightness'.
const SLOPE_SHARE: f32 = 0.4;
/// What frames that are stretched (logarithm, squared) and sheared (squared) lose: heads are rarely turned far.
const STRETCH_LOSS: f32 = 0.5;
const SHEAR_LOSS: f32 = 0.4;
/// What frames lose that were moved (in distances of the eyes, squared), scaled (logarithm, squared) and rolled (squared).
const SHIFT_LOSS: f32 = 1.2;
const SCALE_LOSS: f32 = 0.8;
/// The same for the height alone (logarithm, squared): the mouth stays where the template has it, but for a tenth.
const HEIGHT_LOSS: f32 = 4.0;

/// The frame near `frame` that the drawn face fits best.
pub(super) fn climb(local: &Plane, frame: Frame, schema: &Schema) -> Frame {
    let rough = |moved: &Frame| schema.half.fit(local, moved) - departure(&frame, moved);
    let mut best = (frame, rough(&frame));
    for step in ROUGH_STEPS {
        best = pass(best, step, rough);
    }
    let whole = |moved: &Frame| schema.whole.fit(local, moved) - departure(&frame, moved);
    let mut best = (best.0, whole(&best.0));
    for step in STEPS {
        best = pass(best, step, whole);
    }
    best.0
}

/// What a frame loses for being elsewhere than the template was. That saw more of the face: by themselves a brow is much
/// like an eye, and the base of the nose like a mouth.
fn departure(from: &Frame, to: &Frame) -> f32 {
    let [dx, dy] = [to.origin[0] - from.origin[0], to.origin[1] - from.origin[1]];
    let wide = from.eye_distance().max(1e-3);
    let roll = |frame: &Frame| frame.across[1].atan2(frame.across[0]);
    let height = |frame: &Frame| frame.down[0].hypot(frame.down[1]).max(1e-3);
    let higher = (height(to) / height(from)).ln();
    let scale = (to.eye_distance() / wide).max(1e-3).ln();
    SHIFT_LOSS * (dx * dx + dy * dy) / (wide * wide)
        + HEIGHT_LOSS * higher * higher
        + SCALE_LOSS * (scale * scale + (roll(to) - roll(from)).powi(2))
}

/// Each change once, to whichever side is better.
fn pass(mut best: (Frame, f32), step: f32, fit: impl Fn(&Frame) -> f32) -> (Frame, f32) {
    for change in 0..7_u8 {
        for sign in [-step, step] {
            let moved = moved(&best.0, change, sign);
            let value = fit(&moved);
            if value > best.1 {
                best = (moved, value);
                break;
            }
        }
    }
    best
}

/// What a frame loses for being stretched, sheared and turned.
fn loss(frame: &Frame) -> f32 {
    let [stretch, shear] = frame.stretch_and_shear();
    STRETCH_LOSS * stretch.ln().powi(2) + SHEAR_LOSS * (shear * shear + frame.turn * frame.turn)
}

/// A patch's points, and what is drawn there.
#[derive(Debug)]
pub(super) struct Drawing<const N: usize> {
    /// In the face's frame, row by row.
    points: [[f32; 2]; N],
    /// Brightness, mean 0 and length 1.
    bright: [f32; N],
    /// Slopes downwards, mean 0 and length 1.
    slope: [f32; N],
    /// Points of a row.
    across: usize,
}

/// A whole patch.
pub(super) const WHOLE: usize = ACROSS * DOWN;
/// Every other column of one: half of the work, and good enough for the rough passes.
pub(super) const HALF: usize = ACROSS.div_ceil(2) * DOWN;

impl<const N: usize> Drawing<N> {
    /// Every `step`-th column of a patch: brightness, and its slope downwards.
    pub(super) fn new(bright: &[f32], slope: &[f32], step: usize) -> Self {
        let kept = || (0..WHOLE).filter(|i| (i % ACROSS).is_multiple_of(step));
        let part = |values: &[f32]| {
            let part: Vec<f32> = kept().filter_map(|i| values.get(i).copied()).collect();
            filled(standard(&part))
        };
        Self {
            points: filled(kept().map(place)),
            bright: part(bright),
            slope: part(slope),
            across: ACROSS.div_ceil(step),
        }
    }

    /// How well the drawing fits at a frame.
    fn fit(&self, local: &Plane, frame: &Frame) -> f32 {
        let mut raw = [0.0; N];
        for (value, &[x, y]) in raw.iter_mut().zip(&self.points) {
            let [x, y] = frame.at(x, y);
            *value = local.sample(x, y);
        }
        let mut slopes = [0.0; N];
        let lower = raw.iter().skip(2 * self.across);
        for ((slope, upper), lower) in slopes.iter_mut().skip(self.across).zip(&raw).zip(lower) {
            *slope = lower - upper;
        }
        cosine(&raw, &self.bright) + SLOPE_SHARE * cosine(&slopes, &self.slope) - loss(frame)
    }
}

fn filled<T: Copy + Default, const N: usize>(values: impl IntoIterator<Item = T>) -> [T; N] {
    let mut out = [T::default(); N];
    for (place, value) in out.iter_mut().zip(values) {
        *place = value;
    }
    out
}

/// The cosine of values, less their mean, and a standard patch.
fn cosine<const N: usize>(values: &[f32; N], standard: &[f32; N]) -> f32 {
    let (mut sum, mut squares, mut product) = (0.0, 0.0, 0.0);
    for (value, with) in values.iter().zip(standard) {
        sum += value;
        squares += value * value;
        product += value * with;
    }
    let square = squares - sum * sum / N as f32;
    product / square.max(0.0).sqrt().max(1e-6)
}

fn moved(frame: &Frame, change: u8, by: f32) -> Frame {
    let Frame { origin, across, down, turn } = *frame;
    let along =
        |from: [f32; 2], way: [f32; 2], by: f32| [from[0] + by * way[0], from[1] + by * way[1]];
    let turned = |way: [f32; 2]| {
        let (sin, cos) = by.sin_cos();
        [way[0] * cos - way[1] * sin, way[0] * sin + way[1] * cos]
    };
    match change {
        0 => Frame { origin: along(origin, across, by), ..*frame },
        1 => Frame { origin: along(origin, down, by), ..*frame },
        2 => Frame { across: turned(across), down: turned(down), ..*frame },
        3 => Frame { across: along(across, across, by), down: along(down, down, by), ..*frame },
        6 => Frame { turn: turn + 2.0 * by, ..*frame },
        4 => Frame { down: along(down, down, by), ..*frame },
        _ => Frame { down: along(down, across, by), ..*frame },
    }
}
