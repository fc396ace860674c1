//! An upright crop of a face at a fixed size, and the channels in which features are searched. Lengths in `points` are
//! pixels of the crop.

use super::RoughFace;
use crate::photo::Photo;
use crate::plane::{Plane, Point, distance, extent, middle};

/// Width of the crop (pixels): 1.3 outer interocular distances to either side.
pub(crate) const WIDTH: usize = 224;
/// Height of the crop (pixels): from above the brows to below the chin of a long face.
pub(crate) const HEIGHT: usize = 256;
/// Midpoint of the eyes in the crop (pixels).
pub(crate) const EYES: [f64; 2] = [112.0, 92.0];
/// Distance between the eye centres of a frontal face in the crop (pixels).
pub(crate) const EYE_DISTANCE: f64 = 60.0;
/// Outer interocular distance of a frontal face in the crop (pixels): 1.366 eye distances.
pub(crate) const INTEROCULAR: f64 = EYE_DISTANCE * 1.366;
/// Maximum number of samples per side of a [`BlockMeans`] block: larger blocks are sampled sparsely, which the
/// smoothing that follows tolerates.
const SAMPLES_MAX: usize = 4;
/// Added to every channel before the logarithm (of 255): noise in the dark is not contrast.
const FLOOR: f32 = 12.0;
/// Minimum standard deviations of brightness, ln(R/G) and ln(B/G): light varies more over a face than its colour does.
const SKIN_FLOORS: [f32; 3] = [0.20, 0.05, 0.06];
/// Distance from the eyes' midpoint to the mouth, in distances of the eye centres of a frontal face.
const EYES_TO_MOUTH: f64 = 1.13;

/// An upright face of known size, with its transform to the photograph.
#[derive(Debug, Clone)]
pub(crate) struct Crop {
    /// Photograph pixels per crop pixel.
    pub(crate) scale: f64,
    origin: [f64; 2],
    axis: [f64; 2],
    /// Red, green and blue, 0 to 255.
    pub(crate) rgb: [Plane; 3],
}

impl Crop {
    /// Cuts out the face at `rough`. Beyond the photograph its border repeats.
    pub(crate) fn cut(photo: &Photo, rough: &RoughFace) -> Crop {
        let (l, r, m) = (rough.left_eye, rough.right_eye, rough.mouth);
        let mid = middle(l, r);
        let (eyes, down) = (distance(r, l), distance(m, mid));
        // Yaw shortens the eye distance, pitch the distance from eyes to mouth: the larger scale is closer to the
        // truth.
        let scale = (eyes / EYE_DISTANCE).max(down / (EYE_DISTANCE * EYES_TO_MOUTH)).max(1e-3);
        let axis =
            if eyes > 1e-9 { [(r[0] - l[0]) / eyes, (r[1] - l[1]) / eyes] } else { [1.0, 0.0] };
        let blank = || Plane::filled(1, 1, 0.0);
        let mut crop = Crop { scale, origin: mid, axis, rgb: [blank(), blank(), blank()] };
        let corner = |x: usize, y: usize| crop.to_photo([x as f64, y as f64]);
        let corners = [corner(0, 0), corner(WIDTH, 0), corner(0, HEIGHT), corner(WIDTH, HEIGHT)];
        let source = BlockMeans::of(photo, corners, scale);
        let mut channels: [Vec<f32>; 3] =
            std::array::from_fn(|_| Vec::with_capacity(WIDTH * HEIGHT));
        for (y, x) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x))) {
            let value = source.at(crop.to_photo([x as f64, y as f64]));
            for (channel, v) in channels.iter_mut().zip(value) {
                channel.push(v);
            }
        }
        crop.rgb = channels.map(|values| Plane::from_values(WIDTH, HEIGHT, values));
        crop
    }

    /// Maps a point of the crop to the photograph (pixels).
    pub(crate) fn to_photo(&self, p: [f64; 2]) -> [f64; 2] {
        let (u, v) = ((p[0] - EYES[0]) * self.scale, (p[1] - EYES[1]) * self.scale);
        let [c, s] = self.axis;
        [self.origin[0] + c * u - s * v, self.origin[1] + s * u + c * v]
    }

    /// Maps a point of the photograph to the crop (pixels).
    pub(crate) fn in_crop(&self, p: [f64; 2]) -> [f64; 2] {
        let (x, y) = ((p[0] - self.origin[0]) / self.scale, (p[1] - self.origin[1]) / self.scale);
        let [c, s] = self.axis;
        [EYES[0] + c * x + s * y, EYES[1] - s * x + c * y]
    }

    /// Computes a channel from red, green and blue, pixel by pixel.
    pub(crate) fn plane(&self, value: impl Fn([f32; 3]) -> f32) -> Plane {
        let [r, g, b] = &self.rgb;
        let pixels = r.values().iter().zip(g.values()).zip(b.values());
        let values = pixels.map(|((r, g), b)| value([*r, *g, *b]));
        Plane::from_values(WIDTH, HEIGHT, values.collect())
    }
}

/// A region of a photograph averaged over blocks about as large as one crop pixel: a large photograph costs little more
/// than a small one, and no pixel falls between two samples.
struct BlockMeans {
    /// Pixels of the photograph per block, each way.
    block: usize,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    means: Vec<[f32; 3]>,
}

impl BlockMeans {
    /// Averages the region of the four corners (pixels of the photograph) in blocks of `scale` pixels.
    fn of(photo: &Photo, corners: [[f64; 2]; 4], scale: f64) -> Self {
        let (w, h) = (photo.width(), photo.height());
        // A block is never larger than the photograph; `as` saturates non-finite values.
        let block = (scale.round() as usize).clamp(1, w.min(h).max(1));
        let span = |axis: usize, size: usize| {
            let (low, high) = extent(corners.map(|c| c[axis]));
            let (low, high) = (low - block as f64, high + 2.0 * block as f64);
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

    /// Colour at a point of the photograph, bilinear between blocks; the border repeats.
    fn at(&self, p: [f64; 2]) -> [f32; 3] {
        let size = self.block as f64;
        // The first block's centre is half a block less half a pixel from the first pixel's.
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

/// Logarithmic channels: the difference of two pixels is a contrast, independent of the light.
#[derive(Debug)]
pub(crate) struct Maps {
    /// Brightness, smoothed by 1.2 px.
    pub(crate) fine: Plane,
    /// Brightness, smoothed by 2.5 px.
    pub(crate) coarse: Plane,
    /// Redness ln(R/G), the log odds of the pseudo-hue, smoothed by 1.8 px.
    pub(crate) red: Plane,
    /// Brightness, ln(R/G) and ln(B/G) of every other pixel, unsmoothed.
    pub(crate) raw: [Plane; 3],
}

impl Maps {
    pub(crate) fn of(crop: &Crop) -> Maps {
        let luma = crop.plane(|[r, g, b]| (FLOOR + 0.299 * r + 0.587 * g + 0.114 * b).ln());
        let red = crop.plane(|[r, g, _]| ((FLOOR + r) / (FLOOR + g)).ln());
        let half = |plane: &Plane| {
            Plane::from_fn(WIDTH / 2, HEIGHT / 2, |x, y| plane.get(2 * x as isize, 2 * y as isize))
        };
        let [_, green, blue] = &crop.rgb;
        let blueness = half(blue).zip(&half(green), |b, g| ((FLOOR + b) / (FLOOR + g)).ln());
        Maps {
            fine: luma.blurred(1.2),
            coarse: luma.blurred(2.5),
            red: red.blurred(1.8),
            raw: [half(&luma), half(&red), blueness],
        }
    }

    /// Dissimilarity of each pixel to the skin at some places of this face, such as its cheeks (0 alike, 1 unlike), for
    /// every other pixel of the crop.
    pub(crate) fn unlike_skin(&self, places: &[Point]) -> Plane {
        let stats: [(f32, f32); 3] = std::array::from_fn(|c| {
            let mut v: Vec<f32> = Vec::new();
            for p in places {
                for k in 0..49 {
                    let (dx, dy) = (f64::from(k % 7) - 3.0, f64::from(k / 7) - 3.0);
                    v.push(self.raw[c].sample((p[0] / 2.0 + dx) as f32, (p[1] / 2.0 + dy) as f32));
                }
            }
            v.sort_by(f32::total_cmp);
            let q =
                |s: f32| v.get((s * (v.len().max(1) - 1) as f32) as usize).copied().unwrap_or(0.0);
            (q(0.5), ((q(0.84) - q(0.16)) / 2.0).max(SKIN_FLOORS[c]))
        });
        let [a, b, c] = &self.raw;
        let values = a.values().iter().zip(b.values()).zip(c.values()).map(|((a, b), c)| {
            let [(ma, sa), (mb, sb), (mc, sc)] = stats;
            let (x, y, z) = ((a - ma) / sa, (b - mb) / sb, (c - mc) / sc);
            1.0 - (-(x * x + y * y + z * z) / 12.0).exp()
        });
        Plane::from_values(a.width(), a.height(), values.collect()).blurred(0.75)
    }
}

/// Value at a point of a plane of the crop's size, bilinear; the border repeats.
#[inline]
pub(crate) fn at(plane: &Plane, p: Point) -> f64 {
    // Like [`Plane::sample`], with sizes known at compile time: most of the time is spent here. In this order of `max`
    // and `min`, NaN becomes 0.
    let clamped = |v: f64, size: usize| (v as f32).max(0.0).min((size - 2) as f32);
    let (x, y) = (clamped(p[0], WIDTH), clamped(p[1], HEIGHT));
    let (left, top) = (x as usize, y as usize);
    let (fx, fy) = (x - left as f32, y - top as f32);
    let from = top * WIDTH + left;
    let Some(&[a, b, .., c, d]) = plane.values().get(from..from + WIDTH + 2) else { return 0.0 };
    let (above, below) = (a + (b - a) * fx, c + (d - c) * fx);
    f64::from(above + (below - above) * fy)
}
