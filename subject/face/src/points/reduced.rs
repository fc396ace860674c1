//! The part of a photograph that the crop is cut from, in blocks of as many pixels as one of the crop's is large: so that
//! a large photograph costs little more than a small one, and no pixel of it falls between two samples.

use crate::Photo;

/// Pixels a side that a block is the mean of, at most: larger blocks are sampled more sparsely, which the smoothing that
/// follows forgives.
const SAMPLES_MAX: usize = 4;

/// Means of blocks.
pub(super) struct Reduced {
    /// Pixels of the photograph a block, each way.
    block: usize,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    means: Vec<[f32; 3]>,
}

impl Reduced {
    /// What lies between the four corners (pixels of the photograph), with blocks of `scale` pixels.
    pub(super) fn of(photo: &Photo, corners: [[f64; 2]; 4], scale: f64) -> Self {
        let (w, h) = (photo.width(), photo.height());
        // A block is never larger than the photograph; `as` holds what is not finite.
        let block = (scale.round() as usize).clamp(1, w.min(h).max(1));
        let span = |axis: usize, size: usize| {
            let values = corners.map(|c| c[axis]);
            let low = values.into_iter().fold(f64::INFINITY, f64::min) - block as f64;
            let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max) + 2.0 * block as f64;
            let low = (low.max(0.0) as usize).min(size.saturating_sub(block));
            let high = (high.max(0.0) as usize).clamp(low + block, size.max(low + block));
            (low, (high - low) / block)
        };
        let ((left, width), (top, height)) = (span(0, w), span(1, h));
        let stride = block.div_ceil(SAMPLES_MAX);
        let samples = block.div_ceil(stride);
        let share = 1.0 / (samples * samples) as f32;
        let mut means = Vec::with_capacity(width * height);
        let mut sums = vec![[0_u32; 3]; width];
        for by in 0..height {
            sums.fill([0; 3]);
            for y in (0..block).step_by(stride) {
                let from = (top + by * block + y).min(h - 1) * w + left;
                let row = photo.pixels().get(from..).unwrap_or(&[]);
                for (sum, pixels) in sums.iter_mut().zip(row.chunks_exact(block)) {
                    for pixel in pixels.iter().step_by(stride) {
                        sum.iter_mut().zip(pixel).for_each(|(s, p)| *s += u32::from(*p));
                    }
                }
            }
            means.extend(sums.iter().map(|sum| sum.map(|s| s as f32 * share)));
        }
        Self { block, left, top, width, height, means }
    }

    /// The colour at a place of the photograph, bilinear between blocks; beyond their border that of the border.
    pub(super) fn at(&self, p: [f64; 2]) -> [f32; 3] {
        let size = self.block as f64;
        // The middle of the first block is half a block less half a pixel from the first pixel's.
        let local = |v: f64, from: usize, count: usize| {
            let v = (v - from as f64 + 0.5) / size - 0.5;
            let v = v.max(0.0).min((count - 1) as f64);
            (v as usize, (v - v.floor()) as f32)
        };
        let (x, fx) = local(p[0], self.left, self.width);
        let (y, fy) = local(p[1], self.top, self.height);
        let right = usize::from(x + 1 < self.width);
        let below = if y + 1 < self.height { self.width } else { 0 };
        let from = y * self.width + x;
        let block = |i: usize| self.means.get(i).copied().unwrap_or_default();
        let (a, b) = (block(from), block(from + right));
        let (c, d) = (block(from + below), block(from + below + right));
        std::array::from_fn(|i| {
            let above = a[i] + (b[i] - a[i]) * fx;
            let under = c[i] + (d[i] - c[i]) * fx;
            above + (under - above) * fy
        })
    }
}
