//! From how a face looks in a rough frame to where its eyes and its mouth are: linear regressions, one after the other,
//! each learned on what the one before it leaves (Xiong and De la Torre 2013).

use super::align_first;
use super::align_second;
use super::frame::Frame;
use super::look::{LOOK, Look, mirrored};

/// One regression: x and y of the left eye, the right one, the mouth, in shares of the frame's distance of the eyes.
pub(super) struct Step {
    /// What is added.
    pub(super) added: [f32; 6],
    /// For each byte of a look, how it moves the same six, in units of [`UNIT`].
    pub(super) weights: [[i16; 6]; LOOK],
}

/// The first sees the frame of the template, the second what the first has made of it.
pub(super) static STEPS: [&Step; 2] = [&align_first::STEP, &align_second::STEP];

/// Weights are told in these: shares of the distance of the eyes for a byte.
const UNIT: f32 = 1e-6;

/// A point is moved by at most this much, in distances of the eyes: what is farther off was no face.
const FAR: f32 = 0.6;

/// The frame with its eyes and its mouth where they look to be; turned as before.
pub(super) fn aligned(frame: &Frame, look: &Look, step: &Step) -> Frame {
    let own = told(look, step);
    let [ax, ay, bx, by, mx, my] = told(&mirrored(look), step);
    // In the mirror the eyes change sides.
    let other = [-bx, by, -ax, ay, -mx, my];
    let moves = own.iter().zip(other).map(|(own, other)| ((own + other) / 2.0).clamp(-FAR, FAR));
    let mut six = [0.0; 6];
    for (to, by) in six.iter_mut().zip(moves) {
        *to = by;
    }
    let [ax, ay, bx, by, mx, my] = six;
    // Seen turned, the middle of the mouth is beside the middle of the eyes.
    let aside = frame.turn / (4.0 * Frame::MOUTH);
    let at = |x: f32, y: f32| {
        let [ox, oy] = frame.origin;
        let (x, y) = (x - aside * y, y);
        [ox + x * frame.across[0] + y * frame.down[0], oy + x * frame.across[1] + y * frame.down[1]]
    };
    let (left, right) = (at(ax - 0.5, ay), at(bx + 0.5, by));
    let mouth = at(mx, my + Frame::MOUTH);
    let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
    let across = [right[0] - left[0], right[1] - left[1]];
    let along = |i: usize| {
        let of = |point: &[f32; 2]| point.get(i).copied().unwrap_or_default();
        (of(&mouth) - of(&origin) + frame.turn / 4.0 * of(&across)) / Frame::MOUTH
    };
    Frame { origin, across, down: [along(0), along(1)], turn: frame.turn }
}

/// How far eyes and mouth are from the frame's, in its own coordinates.
fn told(look: &Look, step: &Step) -> [f32; 6] {
    let mut sums = [0_i32; 6];
    for (&byte, weights) in look.iter().zip(&step.weights) {
        for (sum, &weight) in sums.iter_mut().zip(weights) {
            *sum += i32::from(byte) * i32::from(weight);
        }
    }
    let mut out = step.added;
    for (out, sum) in out.iter_mut().zip(sums) {
        *out += UNIT * sum as f32;
    }
    out
}
