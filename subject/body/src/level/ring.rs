//! One curve of a level set.

use std::f64::consts::PI;

/// One curve of a level set: points on edges of the mesh, in order, with the higher part of the surface on one side.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    /// Which level it is of.
    pub level: u32,
    /// Where it crosses edges. The last is joined to the first, through the hole if it runs into one.
    pub points: Vec<[f64; 3]>,
    /// A triangle that it crosses.
    pub triangle: u32,
    /// Whether it comes back to where it began, without a hole in between.
    pub closed: bool,
    /// The mean of the curve, each piece weighted by its length: what (4) is without its bias to where edges are dense.
    pub centroid: [f64; 3],
    /// Its length, in the mesh's unit.
    pub perimeter: f64,
    /// Half the sum of `(p[k] - c) x (p[k + 1] - c)`: its length is the area of a flat ring, its direction the normal.
    pub vector_area: [f64; 3],
}

impl Ring {
    pub(super) fn new(level: u32, points: Vec<[f64; 3]>, triangle: u32, closed: bool) -> Self {
        let pieces = || points.iter().zip(points.iter().cycle().skip(1));
        let mut perimeter = 0.0;
        let mut sum = [0.0; 3];
        for (from, to) in pieces() {
            let length = norm(minus(*to, *from));
            perimeter += length;
            for axis in 0..3 {
                sum[axis] += length * (from[axis] + to[axis]) / 2.0;
            }
        }
        let mean = mean_of(&points);
        let centroid = if perimeter > 0.0 { sum.map(|sum| sum / perimeter) } else { mean };
        let mut vector_area = [0.0; 3];
        for (from, to) in pieces() {
            let (u, v) = (minus(*from, centroid), minus(*to, centroid));
            vector_area[0] += (u[1] * v[2] - u[2] * v[1]) / 2.0;
            vector_area[1] += (u[2] * v[0] - u[0] * v[2]) / 2.0;
            vector_area[2] += (u[0] * v[1] - u[1] * v[0]) / 2.0;
        }
        Self { level, points, triangle, closed, centroid, perimeter, vector_area }
    }

    /// The mean of its points, (4) and (7) of (Yu et al. 2008).
    #[must_use]
    pub fn mean_point(&self) -> [f64; 3] {
        mean_of(&self.points)
    }

    /// 4 pi s / c^2, (5) of (Yu et al. 2008), with the length of the vector area for s: 1 for a circle, less for all else.
    #[must_use]
    pub fn circularity(&self) -> f64 {
        if self.perimeter > 0.0 {
            4.0 * PI * norm(self.vector_area) / (self.perimeter * self.perimeter)
        } else {
            0.0
        }
    }
}

fn mean_of(points: &[[f64; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for point in points {
        for axis in 0..3 {
            sum[axis] += point[axis] / points.len() as f64;
        }
    }
    sum
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn norm(a: [f64; 3]) -> f64 {
    a.iter().map(|part| part * part).sum::<f64>().sqrt()
}
