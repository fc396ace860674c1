//! From the scan's frame, however it is turned, to a sheet of paper.

use super::Drawing;
use crate::geometry::{Point, cross, dot, mean, norm, scale, sub, unit};
use crate::{Joint, Joints, Side};

/// Axes of the body: left, up, forward; of length one.
#[derive(Debug)]
pub(super) struct Upright {
    axes: [Point; 3],
    middle: Point,
}

impl Upright {
    /// From trunk and hips; where these are not known, from the mesh's own axes.
    pub(super) fn of(drawing: &Drawing<'_>) -> Self {
        let positions = drawing.mesh.map_or(&[][..], |mesh| &mesh.positions);
        let middle = mean(positions.iter().copied()).unwrap_or_default();
        let axes = axes(&drawing.joints);
        Self { axes: axes.unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), middle }
    }

    /// Seen from the front: right on the paper, up, towards the viewer. The subject's left is on the right.
    pub(super) fn front(&self, p: Point) -> Point {
        let p = sub(p, self.middle);
        self.axes.map(|axis| dot(axis, p))
    }

    /// Seen from the subject's right: forward is on the right.
    pub(super) fn side(&self, p: Point) -> Point {
        let [left, up, forward] = self.front(p);
        [forward, up, -left]
    }
}

fn axes(joints: &Joints) -> Option<[Point; 3]> {
    let at = |joint: Joint| joints.estimates.get(&joint).map(|estimate| estimate.position);
    let across =
        |joint: fn(Side) -> Joint| Some(sub(at(joint(Side::Left))?, at(joint(Side::Right))?));
    let pelvis = at(Joint::Pelvis)
        .or_else(|| mean([at(Joint::Hip(Side::Left))?, at(Joint::Hip(Side::Right))?]))?;
    let top = at(Joint::Throat).or_else(|| at(Joint::Head))?;
    let up = unit(sub(top, pelvis));
    let wide = across(Joint::Shoulder).or_else(|| across(Joint::Hip))?;
    let left = unit(sub(wide, scale(up, dot(wide, up))));
    (norm(up) > 0.5 && norm(left) > 0.5).then(|| [left, up, cross(left, up)])
}

/// How much of the paper a length is, and where the origin lies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) per_unit: f64,
    pub(super) origin: [f64; 2],
}

impl Fit {
    /// A point on the paper, y down.
    pub(super) fn at(&self, p: Point) -> [f64; 2] {
        [self.origin[0] + self.per_unit * p[0], self.origin[1] - self.per_unit * p[1]]
    }
}

/// Lowest and highest of the first two coordinates.
pub(super) fn bounds(points: impl Iterator<Item = Point>) -> [[f64; 2]; 2] {
    let all = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    points.fold(all, |[low, high], p| {
        [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
    })
}
