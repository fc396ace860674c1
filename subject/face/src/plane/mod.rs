//! Rasters of numbers and of booleans, the basis of all image processing here.
//!
//! Coordinates are those of [`Photo`](super::Photo): integers are the centres of pixels, x right, y down. Beyond the
//! border the border repeats. `Point` and the functions on it are the geometry of such coordinates.

#[cfg(test)]
mod tests;

/// Largest standard deviation of a Gaussian: a kernel is never longer than 2 x 3 x 64 + 1.
const SIGMA_MAX_PX: f32 = 64.0;

/// One value per pixel, row by row from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster<T> {
    width: usize,
    height: usize,
    values: Vec<T>,
}

/// One number per pixel.
pub type Plane = Raster<f32>;

/// The gradient per pixel, and its magnitude.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// Derivative in x.
    pub x: Plane,
    /// Derivative in y.
    pub y: Plane,
    /// Magnitude.
    pub magnitude: Plane,
}

impl<T: Copy + Default> Raster<T> {
    /// A raster filled with `value`. It has at least one pixel.
    #[must_use]
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self { width, height, values: vec![value; width * height] }
    }

    /// A raster from rows of `values`; missing ones are the default, surplus ones are dropped.
    #[must_use]
    pub fn from_values(width: usize, height: usize, mut values: Vec<T>) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        values.resize(width * height, T::default());
        Self { width, height, values }
    }

    /// A raster computed from x and y.
    #[must_use]
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> T) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Self { width, height, values }
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    #[must_use]
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, mutable.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Row `y`; empty outside.
    #[must_use]
    pub fn row(&self, y: usize) -> &[T] {
        self.values.get(y * self.width..(y + 1) * self.width).unwrap_or_default()
    }

    /// Value of a pixel; the border repeats outside.
    #[must_use]
    pub fn get(&self, x: isize, y: isize) -> T {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values.get(y * self.width + x).copied().unwrap_or_default()
    }

    /// Applies `change` to every value.
    #[must_use]
    pub fn map<U>(&self, change: impl Fn(T) -> U) -> Raster<U> {
        let values = self.values.iter().map(|&value| change(value)).collect();
        Raster { width: self.width, height: self.height, values }
    }
}

impl Plane {
    /// Bilinear interpolation; 0 if `x` or `y` is NaN.
    #[must_use]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        // NaN fails both comparisons of `clamp` and would pass through.
        if x.is_nan() || y.is_nan() {
            return 0.0;
        }
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let right = (left + 1).min(self.width - 1);
        let (fx, fy) = (x - left as f32, y - top as f32);
        let upper = self.row(top);
        let lower = self.row((top + 1).min(self.height - 1));
        let mix = |row: &[f32]| match (row.get(left), row.get(right)) {
            (Some(a), Some(b)) => a + (b - a) * fx,
            _ => 0.0,
        };
        let (above, below) = (mix(upper), mix(lower));
        above + (below - above) * fy
    }

    /// Combines values at the same places; those without a partner in `other` stay.
    #[must_use]
    pub fn zip(&self, other: &Self, join: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self.clone();
        for (value, &with) in out.values.iter_mut().zip(&other.values) {
            *value = join(*value, with);
        }
        out
    }

    /// Gaussian blur of standard deviation `sigma_px`, truncated at three.
    #[must_use]
    pub fn blurred(&self, sigma_px: f32) -> Self {
        if sigma_px.is_nan() || sigma_px <= 0.05 {
            return self.clone();
        }
        let sigma = sigma_px.min(SIGMA_MAX_PX);
        let radius = (3.0 * sigma).ceil() as usize;
        let weights: Vec<f32> =
            (0..=2 * radius).map(|i| (i as f32 - radius as f32) / sigma).map(gauss).collect();
        let sum: f32 = weights.iter().sum();
        let weights: Vec<f32> = weights.iter().map(|weight| weight / sum).collect();
        let mut out = Self::filled(self.width, self.height, 0.0);
        // A row padded with its border values, so that the inner loop needs no checks.
        let mut padded = Vec::with_capacity(self.width + 2 * radius);
        for (from, to) in
            self.values.chunks_exact(self.width).zip(out.values.chunks_exact_mut(self.width))
        {
            let (Some(&first), Some(&last)) = (from.first(), from.last()) else { continue };
            padded.clear();
            padded.extend(std::iter::repeat_n(first, radius));
            padded.extend_from_slice(from);
            padded.extend(std::iter::repeat_n(last, radius));
            for (shift, &weight) in weights.iter().enumerate() {
                let Some(shifted) = padded.get(shift..) else { continue };
                for (sum, value) in to.iter_mut().zip(shifted) {
                    *sum += weight * value;
                }
            }
        }
        let across = std::mem::replace(&mut out, Self::filled(self.width, self.height, 0.0));
        for (y, to) in out.values.chunks_exact_mut(self.width).enumerate() {
            for (shift, &weight) in weights.iter().enumerate() {
                let from = (y + shift).saturating_sub(radius).min(self.height - 1);
                for (sum, value) in to.iter_mut().zip(across.row(from)) {
                    *sum += weight * value;
                }
            }
        }
        out
    }

    /// Sobel gradient, in values per pixel (weights 1 2 1 across, divided by 8).
    #[must_use]
    pub fn gradient(&self) -> Gradient {
        let mut x = Self::filled(self.width, self.height, 0.0);
        let mut y = x.clone();
        for row in 0..self.height {
            let above = self.row(row.saturating_sub(1));
            let here = self.row(row);
            let below = self.row((row + 1).min(self.height - 1));
            let outs = x.values.iter_mut().zip(&mut y.values).skip(row * self.width);
            for (column, (dx, dy)) in outs.take(self.width).enumerate() {
                let left = column.saturating_sub(1);
                let right = (column + 1).min(self.width - 1);
                let at = |row: &[f32], column: usize| row.get(column).copied().unwrap_or_default();
                let rise = |row| at(row, right) - at(row, left);
                let step = |column| at(below, column) - at(above, column);
                *dx = (rise(above) + 2.0 * rise(here) + rise(below)) / 8.0;
                *dy = (step(left) + 2.0 * step(column) + step(right)) / 8.0;
            }
        }
        let magnitude = x.zip(&y, f32::hypot);
        Gradient { x, y, magnitude }
    }

    /// Half the size, each pixel the mean of four; an odd last row or column is dropped.
    #[must_use]
    pub fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut out = Self::filled(width, height, 0.0);
        for (y, to) in out.values.chunks_exact_mut(width).enumerate() {
            let (upper, lower) = (self.row(2 * y), self.row((2 * y + 1).min(self.height - 1)));
            let pairs = upper.chunks(2).zip(lower.chunks(2));
            for (value, (above, below)) in to.iter_mut().zip(pairs) {
                let count = above.len() + below.len();
                *value = above.iter().chain(below).sum::<f32>() / count as f32;
            }
        }
        out
    }

    /// Resizes to `width` by `height` pixels (at least 1). Reduction averages the covered area, without aliasing;
    /// enlargement repeats pixels with mixed borders. A point `x` of this plane lies at `(x + 0.5) * width /
    /// self.width() - 0.5` of the new one.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let columns = shares(self.width, width);
        let rows = shares(self.height, height);
        let mut out = Self::filled(width, height, 0.0);
        let mut tall = vec![0.0; self.width];
        for (to, (first, weights)) in out.values.chunks_exact_mut(width).zip(&rows) {
            tall.fill(0.0);
            for (i, &weight) in weights.iter().enumerate() {
                for (sum, value) in tall.iter_mut().zip(self.row(first + i)) {
                    *sum += weight * value;
                }
            }
            for (value, (first, weights)) in to.iter_mut().zip(&columns) {
                let from = tall.get(*first..).unwrap_or_default();
                *value = from.iter().zip(weights).map(|(value, weight)| value * weight).sum();
            }
        }
        out
    }
}

/// For each new pixel, the first old one that it covers and the shares of it and its successors; shares sum to 1.
fn shares(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let step = from as f64 / to as f64;
    let cover = |i: usize| {
        let (start, end) = (i as f64 * step, (i + 1) as f64 * step);
        let first = (start as usize).min(from - 1);
        let last = (end.ceil() as usize).clamp(first + 1, from);
        let share = |old: usize| (end.min((old + 1) as f64) - start.max(old as f64)).max(0.0);
        let weights: Vec<f64> = (first..last).map(share).collect();
        let sum: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        (first, weights.iter().map(|weight| (weight / sum) as f32).collect())
    };
    (0..to).map(cover).collect()
}

fn gauss(t: f32) -> f32 {
    (-0.5 * t * t).exp()
}

/// Image pyramid: a plane at full size, half, a quarter, and so on.
#[derive(Debug)]
pub(crate) struct Pyramid(Vec<Plane>);

impl Pyramid {
    /// Builds levels down to a few pixels.
    pub(crate) fn new(plane: Plane) -> Self {
        let mut planes = vec![plane];
        while let Some(last) = planes.last().filter(|last| last.width().min(last.height()) >= 32) {
            planes.push(last.halved());
        }
        Self(planes)
    }

    /// Width and height of the largest level, in pixels.
    pub(crate) fn size(&self) -> [usize; 2] {
        self.0.first().map_or([1; 2], |plane| [plane.width, plane.height])
    }

    /// The largest level that needs less than a factor of two of further reduction to reach `shrink` photograph pixels
    /// per pixel, and its own reduction.
    pub(crate) fn at(&self, shrink: f32) -> Option<(&Plane, f32)> {
        let level = shrink.max(1.0).log2() as usize;
        let which = level.min(self.0.len().saturating_sub(1));
        self.0.get(which).map(|plane| (plane, (1_u64 << which.min(32)) as f32))
    }
}

/// A point, in pixels or another unit of the picture.
pub(crate) type Point = [f64; 2];

pub(crate) fn middle(a: Point, b: Point) -> Point {
    [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]
}

/// The mean; the origin if there are no points.
pub(crate) fn mean(points: impl IntoIterator<Item = Point>) -> Point {
    let (mut sum, mut n) = ([0.0; 2], 0.0_f64);
    for [x, y] in points {
        sum = [sum[0] + x, sum[1] + y];
        n += 1.0;
    }
    sum.map(|sum| sum / n.max(1.0))
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// `p + k n`.
pub(crate) fn along(p: Point, n: Point, k: f64) -> Point {
    [p[0] + k * n[0], p[1] + k * n[1]]
}

/// Unit vector from `a` to `b`; to the right if they coincide.
pub(crate) fn direction(a: Point, b: Point) -> Point {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let l = (x * x + y * y).sqrt();
    if l > 1e-9 { [x / l, y / l] } else { [1.0, 0.0] }
}

/// The upward normal of a unit vector that points to the right.
pub(crate) fn up(d: Point) -> Point {
    [d[1], -d[0]]
}

/// The point at `t` (0 to 1) of the cubic through four points at equal parameter steps.
#[inline]
pub(crate) fn cubic(p: [Point; 4], t: f64) -> Point {
    let u = 3.0 * t;
    let w = [
        -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        -u * (u - 1.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    ];
    p.iter().zip(w).fold([0.0; 2], |q, (p, w)| [q[0] + w * p[0], q[1] + w * p[1]])
}

/// Minimum and maximum; infinities if there are no values.
pub(crate) fn extent(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    values.into_iter().fold(none, |(low, high), v| (low.min(v), high.max(v)))
}

/// One boolean per pixel.
pub type Mask = Raster<bool>;

impl Mask {
    /// Dilation by a square of `2 * radius + 1` pixels.
    #[must_use]
    pub fn dilated(&self, radius: usize) -> Self {
        self.turned(radius, true)
    }

    /// Erosion by the same square. The border does not erode: the outside counts as set.
    #[must_use]
    pub fn eroded(&self, radius: usize) -> Self {
        self.turned(radius, false)
    }

    /// Opening, erosion then dilation: removes what is thinner than the square.
    #[must_use]
    pub fn opened(&self, radius: usize) -> Self {
        self.eroded(radius).dilated(radius)
    }

    /// Closing, dilation then erosion: fills gaps thinner than the square.
    #[must_use]
    pub fn closed(&self, radius: usize) -> Self {
        self.dilated(radius).eroded(radius)
    }

    /// Sets every pixel within `radius` of one that is `to`: along the rows, then along the columns.
    fn turned(&self, radius: usize, to: bool) -> Self {
        let rows = self.values.chunks_exact(self.width);
        let across: Vec<bool> =
            rows.flat_map(|row| spread(row.iter().copied(), radius, to)).collect();
        let mut out = self.clone();
        for x in 0..self.width {
            let column = spread(across.iter().copied().skip(x).step_by(self.width), radius, to);
            let into = out.values.iter_mut().skip(x).step_by(self.width);
            into.zip(column).for_each(|(into, value)| *into = value);
        }
        out
    }
}

/// Spreads `to` along one line, by prefix counts.
fn spread(line: impl Iterator<Item = bool>, radius: usize, to: bool) -> Vec<bool> {
    let mut counts = vec![0_usize];
    counts.extend(line.scan(0, |count, value| {
        *count += usize::from(value == to);
        Some(*count)
    }));
    let length = counts.len() - 1;
    let is_near =
        |at: usize| counts[(at + radius + 1).min(length)] > counts[at.saturating_sub(radius)];
    (0..length).map(|at| is_near(at) == to).collect()
}

/// Connected components: a label per pixel, 0 outside of the mask, else 1 + the index of its blob.
#[derive(Debug, Clone)]
pub struct Labels {
    width: usize,
    /// Labels, row by row.
    pub labels: Vec<u32>,
    /// Components in the order of their first pixels.
    pub blobs: Vec<Blob>,
}

/// A connected component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blob {
    /// Number of pixels.
    pub area: usize,
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// One past the last column.
    pub right: usize,
    /// One past the last row.
    pub bottom: usize,
    /// Central second moments per pixel: xx, xy, yy.
    pub moments: [f64; 3],
}

impl Blob {
    /// Angle of the major axis from x, clockwise in the picture, -pi/2 to pi/2 (Yang et al. 2004, eq. 3, with the
    /// quadrant kept and the angle taken from x).
    #[must_use]
    pub fn axis_rad(&self) -> f64 {
        let [xx, xy, yy] = self.moments;
        0.5 * (2.0 * xy).atan2(xx - yy)
    }

    /// Eccentricity: 0 for a disc, 1 for a line, 1 - (minor / major)^2.
    #[must_use]
    pub fn eccentricity(&self) -> f64 {
        let [xx, xy, yy] = self.moments;
        let (mean, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        // Standard deviations along the major and the minor axis.
        let [long, short] = [mean + half, mean - half].map(|square| square.max(0.0).sqrt());
        if long > 0.0 { 1.0 - (short / long).powi(2) } else { 0.0 }
    }
}

impl Labels {
    /// Finds the components of a mask; with `diagonal`, corners connect too.
    #[must_use]
    pub fn of(mask: &Mask, diagonal: bool) -> Self {
        let width = mask.width();
        let mut labels = vec![0u32; mask.values().len()];
        let mut blobs = Vec::new();
        let mut open = Vec::new();
        for (start, &inside) in mask.values().iter().enumerate() {
            if !inside || labels.get(start).is_none_or(|&label| label != 0) {
                continue;
            }
            let label = blobs.len() as u32 + 1;
            let mut sums = Sums::default();
            open.push(start);
            set(&mut labels, start, label);
            while let Some(at) = open.pop() {
                let (x, y) = (at % width, at / width);
                sums.add(x, y);
                let (below, above) = (y + 1 < mask.height(), y > 0);
                let (left, right) = (x > 0, x + 1 < width);
                let near = [
                    (left, at.wrapping_sub(1)),
                    (right, at + 1),
                    (above, at.wrapping_sub(width)),
                    (below, at + width),
                    (diagonal && above && left, at.wrapping_sub(width + 1)),
                    (diagonal && above && right, at.wrapping_sub(width).wrapping_add(1)),
                    (diagonal && below && left, (at + width).wrapping_sub(1)),
                    (diagonal && below && right, at + width + 1),
                ];
                for (_, next) in near.into_iter().filter(|&(there, _)| there) {
                    let free = labels.get(next) == Some(&0);
                    if free && mask.values().get(next) == Some(&true) {
                        set(&mut labels, next, label);
                        open.push(next);
                    }
                }
            }
            blobs.push(sums.blob());
        }
        Self { width, labels, blobs }
    }

    /// The pixels of blob `index`.
    #[must_use]
    pub fn mask(&self, index: usize) -> Mask {
        let label = index as u32 + 1;
        let height = self.labels.len() / self.width.max(1);
        let values = self.labels.iter().map(|&other| other == label).collect();
        Mask::from_values(self.width, height, values)
    }
}

fn set(labels: &mut [u32], at: usize, label: u32) {
    if let Some(place) = labels.get_mut(at) {
        *place = label;
    }
}

/// Integer sums over a component's pixels, exact.
#[derive(Default)]
struct Sums {
    area: usize,
    bounds: Option<[usize; 4]>,
    first: [u64; 2],
    second: [u64; 3],
}

impl Sums {
    fn add(&mut self, x: usize, y: usize) {
        self.area += 1;
        let [left, top, right, bottom] = self.bounds.unwrap_or([x, y, x, y]);
        self.bounds = Some([left.min(x), top.min(y), right.max(x), bottom.max(y)]);
        let (x, y) = (x as u64, y as u64);
        self.first = [self.first[0] + x, self.first[1] + y];
        let [xx, xy, yy] = self.second;
        self.second = [xx + x * x, xy + x * y, yy + y * y];
    }

    fn blob(&self) -> Blob {
        let [left, top, right, bottom] = self.bounds.unwrap_or_default();
        let n = self.area.max(1) as f64;
        let [x, y] = self.first.map(|sum| sum as f64 / n);
        let [xx, xy, yy] = self.second.map(|sum| sum as f64 / n);
        Blob {
            area: self.area,
            left,
            top,
            right: right + 1,
            bottom: bottom + 1,
            moments: [xx - x * x, xy - x * y, yy - y * y],
        }
    }
}
