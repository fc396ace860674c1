//! A solid as a field: below zero within, above zero outside, near the distance in between.

use crate::geometry::{Point, add, distance, dot, scale, sub, unit};

/// A ball that grows or shrinks on its way from one end to the other, and that may be flattened.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capsule {
    pub(super) ends: [Point; 2],
    pub(super) radii: [f64; 2],
    /// Of its depth (z) to its width; 1 is round.
    pub(super) depth: f64,
}

impl Capsule {
    pub(super) fn round(ends: [Point; 2], radii: [f64; 2]) -> Self {
        Self { ends, radii, depth: 1.0 }
    }

    /// Outside the ball around it, no more than the value; within, below everything.
    fn at_least(&self, p: Point) -> f64 {
        let [from, to] = self.ends;
        let middle = scale(add(from, to), 0.5);
        let reach = distance(from, middle) + self.radii[0].max(self.radii[1]);
        let beyond = distance(p, middle) - reach;
        if beyond > 0.0 { self.depth.min(1.0) * beyond } else { f64::NEG_INFINITY }
    }

    fn at(&self, p: Point) -> f64 {
        let squeeze = |q: Point| [q[0], q[1], q[2] / self.depth];
        let [from, to] = self.ends.map(squeeze);
        self.depth.min(1.0) * round_cone(squeeze(p), from, to, self.radii)
    }
}

/// Distance to the hull of two balls.
fn round_cone(p: Point, from: Point, to: Point, [r_from, r_to]: [f64; 2]) -> f64 {
    let axis = sub(to, from);
    let length_sq = dot(axis, axis);
    let taper = r_from - r_to;
    let reach = sub(p, from);
    let along = dot(reach, axis);
    let beyond = along - length_sq;
    let across = sub(scale(reach, length_sq), scale(axis, along));
    let across_sq = dot(across, across);
    let slant_sq = length_sq - taper * taper;
    let bound = taper.signum() * taper * taper * across_sq;
    if beyond.signum() * slant_sq * beyond * beyond * length_sq > bound {
        return (across_sq + beyond * beyond * length_sq).sqrt() / length_sq - r_to;
    }
    if along.signum() * slant_sq * along * along * length_sq < bound {
        return (across_sq + along * along * length_sq).sqrt() / length_sq - r_from;
    }
    ((across_sq * slant_sq / length_sq).sqrt() + along * taper) / length_sq - r_from
}

/// Capsules that flow into each other where they meet.
#[derive(Debug, Clone)]
pub(super) struct Field {
    pub(super) capsules: Vec<Capsule>,
    /// Width over which two of them blend.
    pub(super) blend: f64,
}

impl Field {
    pub(super) fn at(&self, p: Point) -> f64 {
        let mut nearest = f64::INFINITY;
        for capsule in &self.capsules {
            // Most capsules are too far to matter.
            if capsule.at_least(p) < nearest + self.blend {
                let other = capsule.at(p);
                let overlap = (self.blend - (nearest - other).abs()).max(0.0);
                nearest = nearest.min(other) - overlap * overlap / (4.0 * self.blend);
            }
        }
        nearest
    }

    /// The outermost point at either end of each capsule, where no other capsule covers it, with the radius there.
    pub(super) fn tips(&self) -> impl Iterator<Item = (Point, f64)> {
        let of = |capsule: &Capsule| {
            let [from, to] = capsule.ends;
            let along = unit(sub(to, from));
            let [back, front] = capsule.radii;
            [(add(from, scale(along, -back)), back), (add(to, scale(along, front)), front)]
        };
        let ends = self.capsules.iter().flat_map(of);
        // Blending moves the surface out by a quarter of the blend at most: what lies deeper is covered.
        ends.filter(|(tip, _)| self.at(*tip) > -self.blend / 2.0)
    }

    /// Two corners of a box that holds it, with the width of a blend to spare.
    pub(super) fn bounds(&self) -> [Point; 2] {
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for capsule in &self.capsules {
            for (end, radius) in capsule.ends.into_iter().zip(capsule.radii) {
                let reach = [radius + self.blend; 3];
                let (low, high) = (sub(end, reach), add(end, reach));
                for axis in 0..3 {
                    bounds[0][axis] = bounds[0][axis].min(low[axis]);
                    bounds[1][axis] = bounds[1][axis].max(high[axis]);
                }
            }
        }
        bounds
    }
}
