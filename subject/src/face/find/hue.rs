//! The scores that need colours.

use super::Photo;
use super::frame::Frame;
use super::level::Level;
use super::scores::{COLOUR_SCORES, ColourScores};
use crate::face::photo::illuminant;

/// Added to channels before their ratios are taken: what is black has no hue.
const BLACK: f32 = 6.0;
/// Pixels that the light's colour is told from; evenly taken.
const SAMPLES_MAX: usize = 1 << 14;
/// Skin in ln(R/G), ln(B/G) once the light is taken off: mean, and the inverse of its covariance (xx, xy, yy).
const SKIN: ([f32; 2], [f32; 3]) = ([0.32, -0.18], [30.0, 12.0, 30.0]);

/// Ratios of the colours of a photograph: a light's colour adds to them, and a light's brightness does nothing.
#[derive(Debug)]
pub(super) struct Hues<'a> {
    photo: &'a Photo,
    /// What the light adds to ln(R/G), ln(B/G).
    light: [f32; 2],
}

impl<'a> Hues<'a> {
    /// Of a photograph.
    pub(super) fn new(photo: &'a Photo) -> Self {
        let every = photo.pixels().len().div_ceil(SAMPLES_MAX).max(1);
        let samples = photo.pixels().iter().step_by(every);
        let light = illuminant(samples.map(|rgb| rgb.map(f64::from))).map(|c| c as f32);
        Self { photo, light: ratios(light) }
    }

    /// Around a place of the photograph.
    fn at(&self, [x, y]: [f64; 2], reach: isize) -> [f32; 2] {
        let (x, y) = (x.round() as isize, y.round() as isize);
        let step = (reach / 2).max(1);
        let (mut sums, mut count) = ([0.0_f32; 3], 0.0_f32);
        let mut dy = -reach;
        while dy <= reach {
            let mut dx = -reach;
            while dx <= reach {
                let rgb = self.photo.rgb(x + dx, y + dy).map(f32::from);
                sums = std::array::from_fn(|i| {
                    sums.get(i).copied().unwrap_or_default()
                        + rgb.get(i).copied().unwrap_or_default()
                });
                count += 1.0;
                dx += step;
            }
            dy += step;
        }
        ratios(sums.map(|sum| sum / count.max(1.0)))
    }

    /// Of a frame on a level.
    pub(super) fn scores(&self, level: &Level, frame: &Frame) -> ColourScores {
        let reach = (0.7 * level.shrink()).round() as isize;
        let at = |x: f32, y: f32| self.at(level.on_photo(frame.at(x, y)), reach);
        let mean = |points: &[[f32; 2]]| {
            let sum = points.iter().fold([0.0, 0.0], |[r, b], &[x, y]| {
                let [red, blue] = at(x, y);
                [r + red, b + blue]
            });
            sum.map(|sum| sum / points.len().max(1) as f32)
        };
        let skin: Vec<[f32; 2]> = SKIN_POINTS.iter().map(|&[x, y]| at(x, y)).collect();
        let likely = skin.iter().map(|&hue| self.skin(hue)).sum::<f32>() / skin.len() as f32;
        let centre = mean(&SKIN_POINTS);
        let spread = skin.iter().map(|[r, b]| (r - centre[0]).powi(2) + (b - centre[1]).powi(2));
        let spread = (spread.sum::<f32>() / skin.len() as f32).sqrt();
        let mouth = mean(&[[-0.2, 1.1], [0.0, 1.05], [0.0, 1.17], [0.2, 1.1]]);
        let eyes = mean(&[[-0.6, 0.0], [-0.4, 0.0], [0.4, 0.0], [0.6, 0.0]]);
        let around = mean(&[[-1.5, -1.0], [1.5, -1.0], [-1.7, 0.3], [1.7, 0.3], [0.0, -1.8]]);
        let apart = (around[0] - centre[0]).hypot(around[1] - centre[1]);
        [
            likely,
            -(spread + 0.01).ln(),
            (mouth[0] - centre[0]).clamp(-0.3, 0.3),
            (centre[0] - eyes[0]).clamp(-0.3, 0.3),
            apart.min(0.5),
            self.skin(centre),
        ]
    }

    /// How likely a hue is skin's, 0 to 1.
    fn skin(&self, [red, blue]: [f32; 2]) -> f32 {
        let (mean, [xx, xy, yy]) = SKIN;
        // Half of the light's estimate is taken off: the other half is what was photographed.
        let x = red - 0.5 * self.light[0] - mean[0];
        let y = blue - 0.5 * self.light[1] - mean[1];
        (-0.5 * (xx * x * x + 2.0 * xy * x * y + yy * y * y)).exp()
    }
}

/// ln(R/G), ln(B/G).
fn ratios([red, green, blue]: [f32; 3]) -> [f32; 2] {
    let ratio = |a: f32, b: f32| ((a + BLACK) / (b + BLACK)).ln();
    [ratio(red, green), ratio(blue, green)]
}

/// Where a face is skin, whoever's: forehead, cheeks, nose, chin.
const SKIN_POINTS: [[f32; 2]; 15] = [
    [-0.3, -0.6],
    [0.0, -0.6],
    [0.3, -0.6],
    [0.0, 0.0],
    [-0.6, 0.4],
    [-0.4, 0.4],
    [0.4, 0.4],
    [0.6, 0.4],
    [-0.55, 0.65],
    [0.55, 0.65],
    [0.0, 0.3],
    [0.0, 0.55],
    [-0.15, 0.45],
    [0.15, 0.45],
    [0.0, 1.5],
];
const _: () = assert!(COLOUR_SCORES == 6);
