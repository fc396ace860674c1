//! From how a face looks in a rough frame to where its eyes and its mouth are: linear regressions, one after the other,
//! each learned on what the one before it leaves (Xiong and De la Torre 2013).

use super::frame::Frame;
use super::features::{FEATURE_COUNT, FeatureVector, mirrored};
use crate::table::{f32s, i16s};

/// One regression: x and y of the left eye, the right one, the mouth, in shares of the frame's distance of the eyes.
pub(super) struct AlignmentStep {
    /// What is added.
    intercept: [f32; 6],
    /// For each byte of a look, how it moves the same six, in units of [`WEIGHT_UNIT`].
    weights: [[i16; 6]; FEATURE_COUNT],
}

/// The first sees the frame of the template, the second what the first has made of it: ridge regressions, learned by
/// `benches/subject/find_align.py`.
pub(super) static STEPS: [AlignmentStep; 2] = [
    AlignmentStep::read(include_bytes!("../../data/face-align-first.bin")),
    AlignmentStep::read(include_bytes!("../../data/face-align-second.bin")),
];

/// Weights are told in these: shares of the distance of the eyes for a byte.
const WEIGHT_UNIT: f32 = 1e-6;
/// A point is moved by at most this much, in distances of the eyes: what is farther off was no face.
const FAR: f32 = 0.6;

impl AlignmentStep {
    const fn read(table: &[u8; 6 * (size_of::<f32>() + FEATURE_COUNT * size_of::<i16>())]) -> Self {
        let mut weights = [[0; 6]; FEATURE_COUNT];
        let mut i = 0;
        while i < FEATURE_COUNT {
            weights[i] = i16s(table, 6 * (size_of::<f32>() + i * size_of::<i16>()));
            i += 1;
        }
        Self { intercept: f32s(table, 0), weights }
    }

    /// The frame with its eyes and its mouth where they look to be; turned as before.
    pub(super) fn aligned(&self, frame: &Frame, features: &FeatureVector) -> Frame {
        let own = self.offsets(features);
        let [ax, ay, bx, by, mx, my] = self.offsets(&mirrored(features));
        // In the mirror the eyes change sides.
        let other = [-bx, by, -ax, ay, -mx, my];
        let [ax, ay, bx, by, mx, my] =
            std::array::from_fn(|i| ((own[i] + other[i]) / 2.0).clamp(-FAR, FAR));
        // Seen turned, the middle of the mouth is beside the middle of the eyes.
        let aside = frame.turn / (4.0 * Frame::MOUTH);
        let at = |x: f32, y: f32| {
            let x = x - aside * y;
            [0, 1].map(|i| frame.origin[i] + x * frame.across[i] + y * frame.down[i])
        };
        let eyes = [at(ax - 0.5, ay), at(bx + 0.5, by)];
        Frame::through(eyes, at(mx, my + Frame::MOUTH), frame.turn)
    }

    /// How far eyes and mouth are from the frame's, in its own coordinates.
    fn offsets(&self, features: &FeatureVector) -> [f32; 6] {
        let mut sums = [0_i32; 6];
        for (&byte, weights) in features.iter().zip(&self.weights) {
            for (sum, &weight) in sums.iter_mut().zip(weights) {
                *sum += i32::from(byte) * i32::from(weight);
            }
        }
        let mut out = self.intercept;
        for (out, sum) in out.iter_mut().zip(sums) {
            *out += WEIGHT_UNIT * sum as f32;
        }
        out
    }
}
