//! Rasterises triangles with a depth buffer.

use image::{Rgb, RgbImage};

use crate::random::Random;

/// Samples per pixel along each axis, averaged.
pub(super) const OVERSAMPLING: u32 = 2;

/// Linear colour, 0 to 1.
pub(super) type Colour = [f64; 3];

/// Colours and depths of all samples, [`OVERSAMPLING`] times as fine as the picture.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    colours: Vec<[f32; 3]>,
    depths: Vec<f32>,
}

/// A corner of a triangle, with the attributes that are interpolated.
#[derive(Clone, Copy)]
pub(super) struct Vertex {
    /// Position in the picture, pixels, and depth.
    pub(super) projected: [f64; 3],
    /// Normal, in the camera's frame.
    pub(super) normal: [f64; 3],
    /// Position on the average face, which selects the paint.
    pub(super) place: [f64; 3],
}

/// The interpolated attributes of one sample.
pub(super) struct Fragment {
    /// Unit normal, in the camera's frame.
    pub(super) normal: [f64; 3],
    /// Interpolated [`Vertex::place`].
    pub(super) place: [f64; 3],
}

impl Canvas {
    pub(super) fn new(width_px: u32, height_px: u32) -> Self {
        let (width, height) =
            ((width_px * OVERSAMPLING) as usize, (height_px * OVERSAMPLING) as usize);
        let colours = vec![[0.0; 3]; width * height];
        Self { width, height, colours, depths: vec![f32::NEG_INFINITY; width * height] }
    }

    /// Clears the depth buffer: everything drawn so far is behind everything that follows.
    pub(super) fn clear_depth(&mut self) {
        self.depths.fill(f32::NEG_INFINITY);
    }

    /// The size of the picture, pixels.
    pub(super) fn size_px(&self) -> [f64; 2] {
        [self.width, self.height].map(|side| side as f64 / f64::from(OVERSAMPLING))
    }

    /// Repaints every sample as a function of its position and colour.
    pub(super) fn paint(&mut self, paint: impl Fn([f64; 2], Colour) -> Colour) {
        for (index, colour) in self.colours.iter_mut().enumerate() {
            let at = [index % self.width, index / self.width].map(|v| picture(v as f64));
            *colour = paint(at, colour.map(f64::from)).map(|c| c as f32);
        }
    }

    /// Draws a triangle where it is in front of earlier ones.
    pub(super) fn triangle(&mut self, corners: &[Vertex; 3], paint: impl Fn(&Fragment) -> Colour) {
        let p = corners.map(|c| [fine(c.projected[0]), fine(c.projected[1]), c.projected[2]]);
        let (u, v) =
            ([p[1][0] - p[0][0], p[1][1] - p[0][1]], [p[2][0] - p[0][0], p[2][1] - p[0][1]]);
        let area = u[0] * v[1] - u[1] * v[0];
        if area.abs() < 1e-9 || !area.is_finite() {
            return;
        }
        // `as` clamps to the picture's borders.
        let range = |axis: usize, side: usize| {
            let low =
                p.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min).ceil().max(0.0) as usize;
            let high = p.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max).floor() + 1.0;
            low..(high.max(0.0) as usize).min(side)
        };
        for y in range(1, self.height) {
            for x in range(0, self.width) {
                let d = [x as f64 - p[0][0], y as f64 - p[0][1]];
                let second = (d[0] * v[1] - d[1] * v[0]) / area;
                let third = (u[0] * d[1] - u[1] * d[0]) / area;
                let shares = [1.0 - second - third, second, third];
                if shares.iter().any(|s| *s < 0.0) {
                    continue;
                }
                let mix = |pick: fn(&Vertex) -> [f64; 3]| -> [f64; 3] {
                    std::array::from_fn(|axis| {
                        (0..3).map(|i| shares[i] * pick(&corners[i])[axis]).sum()
                    })
                };
                let depth = mix(|c| c.projected)[2] as f32;
                let index = y * self.width + x;
                if depth > self.depths[index] {
                    let (normal, place) = (unit(mix(|c| c.normal)), mix(|c| c.place));
                    self.depths[index] = depth;
                    self.colours[index] = paint(&Fragment { normal, place }).map(|c| c as f32);
                }
            }
        }
    }

    /// The picture: samples averaged, gamma-encoded (1 / 2.2), with noise added.
    pub(super) fn to_image(&self, noise: f64, random: &mut Random) -> RgbImage {
        let n = OVERSAMPLING as usize;
        RgbImage::from_fn((self.width / n) as u32, (self.height / n) as u32, |x, y| {
            let mut sum = [0.0; 3];
            for (dx, dy) in (0..n).flat_map(|dx| (0..n).map(move |dy| (dx, dy))) {
                let colour = self.colours[(y as usize * n + dy) * self.width + x as usize * n + dx];
                for channel in 0..3 {
                    sum[channel] += f64::from(colour[channel]);
                }
            }
            Rgb(sum.map(|s| {
                let linear = s / (n * n) as f64;
                let shown = 255.0 * linear.max(0.0).powf(1.0 / 2.2) + noise * random.normal();
                shown.round().clamp(0.0, 255.0) as u8
            }))
        })
    }
}

/// Converts from pixels to samples: the centre of a pixel is the centre of its samples.
fn fine(at: f64) -> f64 {
    let n = f64::from(OVERSAMPLING);
    n * at + (n - 1.0) / 2.0
}

/// The inverse of [`fine`].
fn picture(at: f64) -> f64 {
    let n = f64::from(OVERSAMPLING);
    (at - (n - 1.0) / 2.0) / n
}

pub(super) fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
    v.map(|x| x / length)
}
