//! Alignment of eyes and mouth: a cascade of linear regressions from the feature vector of a rough frame, each stage
//! learned on the residuals of the one before (Xiong and De la Torre 2013).

use super::features::{FEATURE_COUNT, FeatureVector, mirrored};
use super::frame::Frame;
use crate::table::{f32s, i16s};

/// One stage: regression of x and y of left eye, right eye and mouth, as fractions of the frame's eye distance.
pub(super) struct AlignmentStep {
    /// Intercepts.
    intercept: [f32; 6],
    /// Weights of each feature byte for the same six numbers, in units of [`WEIGHT_UNIT`].
    weights: [[i16; 6]; FEATURE_COUNT],
}

/// The first stage uses the template's frame, the second the first one's result: ridge regressions, learned by
/// `benches/subject/find_align.py`.
pub(super) static STEPS: [AlignmentStep; 2] = [
    AlignmentStep::read(include_bytes!("../../data/face-align-first.bin")),
    AlignmentStep::read(include_bytes!("../../data/face-align-second.bin")),
];

/// Unit of the weights: fractions of the eye distance per byte.
const WEIGHT_UNIT: f32 = 1e-6;
/// Largest displacement, in eye distances: a candidate that is farther off is no face.
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

    /// The frame with aligned eyes and mouth; its turn is kept.
    pub(super) fn aligned(&self, frame: &Frame, features: &FeatureVector) -> Frame {
        let own = self.offsets(features);
        let [ax, ay, bx, by, mx, my] = self.offsets(&mirrored(features));
        // In the mirror image the eyes change sides.
        let other = [-bx, by, -ax, ay, -mx, my];
        let [ax, ay, bx, by, mx, my] =
            std::array::from_fn(|i| ((own[i] + other[i]) / 2.0).clamp(-FAR, FAR));
        // In a turned face the middle of the mouth is beside the midpoint of the eyes.
        let aside = frame.turn / (4.0 * Frame::MOUTH);
        let at = |x: f32, y: f32| {
            let x = x - aside * y;
            [0, 1].map(|i| frame.origin[i] + x * frame.across[i] + y * frame.down[i])
        };
        let eyes = [at(ax - 0.5, ay), at(bx + 0.5, by)];
        Frame::through(eyes, at(mx, my + Frame::MOUTH), frame.turn)
    }

    /// Offsets of eyes and mouth from the frame's, in its own coordinates.
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
