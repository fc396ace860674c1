//! Triangle meshes and their measures.

use nalgebra::Vector3;

/// A position or a direction.
pub(crate) type Point = Vector3<f64>;

/// A triangle mesh.
///
/// Positions are in the file's unit; the geometry does not depend on it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// One position per vertex.
    pub positions: Vec<[f64; 3]>,
    /// Three indices into `positions` per triangle, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The position of a vertex; the origin if there is no such vertex.
    pub(crate) fn point(&self, vertex: u32) -> Point {
        self.positions.get(vertex as usize).copied().unwrap_or_default().into()
    }

    pub(crate) fn corners(&self, triangle: [u32; 3]) -> [Point; 3] {
        triangle.map(|vertex| self.point(vertex))
    }

    pub(crate) fn area_of(&self, triangle: [u32; 3]) -> f64 {
        normal(self.corners(triangle)).norm() / 2.0
    }

    /// Surface area.
    pub(crate) fn area(&self) -> f64 {
        self.triangles.iter().map(|triangle| self.area_of(*triangle)).sum()
    }

    /// Centroid of the surface, weighted by area.
    pub(crate) fn area_centroid(&self) -> Point {
        let (mut sum, mut total) = (Point::zeros(), 0.0);
        for triangle in &self.triangles {
            let [a, b, c] = self.corners(*triangle);
            let area = self.area_of(*triangle);
            sum += (a + b + c) * area / 3.0;
            total += area;
        }
        if total > 0.0 { sum / total } else { Point::zeros() }
    }

    /// Keeps the triangles whose index satisfies `kept`; vertices stay.
    pub(crate) fn keep_triangles(&mut self, kept: impl Fn(usize) -> bool) {
        let mut index = 0..;
        self.triangles.retain(|_| index.next().is_some_and(&kept));
    }

    /// Enclosed volume of a closed surface; negative if it faces inwards.
    pub(crate) fn volume(&self) -> f64 {
        let origin = self.point(0);
        let of = |triangle: &[u32; 3]| {
            let [a, b, c] = self.corners(*triangle).map(|corner| corner - origin);
            a.dot(&b.cross(&c)) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }

    /// Distance from the vertex farthest from the mean to the vertex farthest from that one: invariant under rotation,
    /// and at least half the largest distance.
    pub(crate) fn extent(&self) -> f64 {
        let points = || self.positions.iter().map(|at| Point::from(*at));
        let farthest = |from: Point| {
            points().fold((from, 0.0), |best, point| {
                let far = distance(from, point);
                if far > best.1 { (point, far) } else { best }
            })
        };
        let Some(middle) = mean(points()) else { return 0.0 };
        farthest(farthest(middle).0).1
    }
}

/// The outward normal; its length is twice the area.
pub(crate) fn normal([a, b, c]: [Point; 3]) -> Point {
    (b - a).cross(&(c - a))
}

pub(crate) fn distance(a: impl Into<Point>, b: impl Into<Point>) -> f64 {
    (a.into() - b.into()).norm()
}

/// The unit vector; zero if `direction` is zero.
pub(crate) fn unit(direction: Point) -> Point {
    let length = direction.norm();
    if length > 0.0 { direction * (1.0 / length) } else { Point::zeros() }
}

/// Orthonormal axes (left, up, forward): `up` is kept, left is `across` made perpendicular to it. None if the two
/// vectors do not span a plane.
pub(crate) fn axes(up: Point, across: Point) -> Option<[Point; 3]> {
    let up = unit(up);
    let left = unit(across - up * across.dot(&up));
    (up.norm() > 0.5 && left.norm() > 0.5).then(|| [left, up, left.cross(&up)])
}

/// Mean of the points; none if there are none.
pub(crate) fn mean(points: impl IntoIterator<Item = Point>) -> Option<Point> {
    let (sum, n) = points.into_iter().fold((Point::zeros(), 0.0), |(sum, n), p| (sum + p, n + 1.0));
    (n > 0.0).then(|| sum * (1.0 / n))
}
