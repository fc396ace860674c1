//! Whether a photograph's colours can be trusted.

/// What the colours of a photograph are good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Colours, in light that is near enough to white.
    Natural,
    /// Colours, in light that is not: skin may have any hue.
    Cast,
    /// No colours, or shades of a single one (sepia).
    Grey,
}

/// Standard deviation of chroma, once what follows from luma is taken off, below which there is no colour. Chroma
/// subsampling of a grey JPEG leaves about 0.5; sepia follows luma; the dullest photograph of a face has above 4.
const CHROMA_DEVIATION_MIN: f64 = 1.5;
/// Distance of the light's r, g chromaticities from white's, (1/3, 1/3), that is a cast: a lamp of 2856 K, taken with
/// daylight's white balance, is about 0.1 away; skin that fills the picture 0.05.
const CAST_MIN: f64 = 0.08;
/// Norm of the illuminant's estimate (Finlayson and Trezzi 2004, shades of grey).
const NORM: i32 = 6;
/// Pixels that are looked at; evenly taken.
const SAMPLES_MAX: usize = 1 << 16;

impl Colour {
    /// Of a picture's pixels.
    pub(super) fn of(pixels: &[[u8; 3]]) -> Self {
        let step = pixels.len().div_ceil(SAMPLES_MAX).max(1);
        let samples = || pixels.iter().step_by(step).map(|pixel| pixel.map(f64::from));
        if chroma_deviation(samples()) < CHROMA_DEVIATION_MIN {
            return Self::Grey;
        }
        let light = illuminant(samples());
        let sum: f64 = light.iter().sum();
        let [red, green, _] = light.map(|channel| channel / sum.max(1e-9) - 1.0 / 3.0);
        if red.hypot(green) > CAST_MIN { Self::Cast } else { Self::Natural }
    }
}

/// The light's colour, each channel 0 to 255: the 6-norm of what is neither black nor burnt out.
fn illuminant(samples: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let mut sums = [0.0; 3];
    let mut count = 0.0;
    for sample in samples.filter(|sample| sample.iter().all(|&channel| channel < 250.0)) {
        count += 1.0;
        for (sum, channel) in sums.iter_mut().zip(sample) {
            *sum += (channel / 255.0).powi(NORM);
        }
    }
    if count == 0.0 {
        return [255.0; 3];
    }
    sums.map(|sum| 255.0 * (sum / count).powf(1.0 / f64::from(NORM)))
}

/// Root of the mean square of Cb and Cr once their regressions on luma are taken off.
fn chroma_deviation(samples: impl Iterator<Item = [f64; 3]>) -> f64 {
    // Sums of 1, y, y^2, and for each chroma c: c, c y, c^2.
    let (mut n, mut y1, mut y2) = (0.0, 0.0, 0.0);
    let mut chroma = [[0.0; 3]; 2];
    for [red, green, blue] in samples {
        let y = 0.299 * red + 0.587 * green + 0.114 * blue;
        n += 1.0;
        y1 += y;
        y2 += y * y;
        for (sums, c) in chroma.iter_mut().zip([0.564 * (blue - y), 0.713 * (red - y)]) {
            sums[0] += c;
            sums[1] += c * y;
            sums[2] += c * c;
        }
    }
    if n == 0.0 {
        return 0.0;
    }
    let variance_y = y2 / n - (y1 / n).powi(2);
    let residual = chroma.iter().map(|[c1, cy, c2]| {
        let covariance = cy / n - c1 * y1 / (n * n);
        let explained = if variance_y > 1e-9 { covariance.powi(2) / variance_y } else { 0.0 };
        (c2 / n - (c1 / n).powi(2) - explained).max(0.0)
    });
    residual.sum::<f64>().sqrt()
}
