//! Boolean masks, their morphology, and connected components with moments.

use super::Raster;

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
