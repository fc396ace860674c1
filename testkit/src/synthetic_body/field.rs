//! A solid as an implicit field: negative inside, positive outside, and close to the distance near the surface.

use super::{Point, unit};

/// A tapered capsule (the hull of two spheres), which may be flattened.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capsule {
    pub(super) ends: [Point; 2],
    pub(super) radii: [f64; 2],
    /// Ratio of depth (z) to width; 1 is round.
    pub(super) depth: f64,
}

impl Capsule {
    pub(super) fn round(ends: [Point; 2], radii: [f64; 2]) -> Self {
        Self { ends, radii, depth: 1.0 }
    }

    /// A cheap lower bound of the field: valid outside the bounding sphere, minus infinity inside.
    fn lower_bound(&self, p: Point) -> f64 {
        let [from, to] = self.ends;
        let middle = (from + to) * 0.5;
        let reach = (from - middle).norm() + self.radii[0].max(self.radii[1]);
        let beyond = (p - middle).norm() - reach;
        if beyond > 0.0 { self.depth.min(1.0) * beyond } else { f64::NEG_INFINITY }
    }

    fn at(&self, p: Point) -> f64 {
        let squeeze = |q: Point| Point::new(q.x, q.y, q.z / self.depth);
        let [from, to] = self.ends.map(squeeze);
        self.depth.min(1.0) * round_cone(squeeze(p), from, to, self.radii)
    }
}

/// Distance to the hull of two spheres.
fn round_cone(p: Point, from: Point, to: Point, [r_from, r_to]: [f64; 2]) -> f64 {
    let axis = to - from;
    let length_sq = axis.norm_squared();
    let taper = r_from - r_to;
    let reach = p - from;
    let along = reach.dot(&axis);
    let beyond = along - length_sq;
    let across_sq = (reach * length_sq - axis * along).norm_squared();
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

/// The smooth union of capsules.
#[derive(Debug, Clone)]
pub(super) struct Field {
    pub(super) capsules: Vec<Capsule>,
    /// Width over which two capsules blend.
    pub(super) blend: f64,
}

impl Field {
    pub(super) fn at(&self, p: Point) -> f64 {
        let mut nearest = f64::INFINITY;
        for capsule in &self.capsules {
            // Most capsules are too far away to contribute.
            if capsule.lower_bound(p) < nearest + self.blend {
                let other = capsule.at(p);
                let overlap = (self.blend - (nearest - other).abs()).max(0.0);
                nearest = nearest.min(other) - overlap * overlap / (4.0 * self.blend);
            }
        }
        nearest
    }

    /// The outermost point at either end of each capsule, unless another capsule covers it, with the radius there.
    pub(super) fn tips(&self) -> impl Iterator<Item = (Point, f64)> {
        let of = |capsule: &Capsule| {
            let [from, to] = capsule.ends;
            let along = unit(to - from);
            let [back, front] = capsule.radii;
            [(from + along * -back, back), (to + along * front, front)]
        };
        let ends = self.capsules.iter().flat_map(of);
        // Blending moves the surface outwards by at most a quarter of the blend: a deeper tip is covered.
        ends.filter(|(tip, _)| self.at(*tip) > -self.blend / 2.0)
    }

    /// Lower and upper corner of a bounding box, with a margin of one blend width.
    pub(super) fn bounds(&self) -> [Point; 2] {
        let mut bounds = [f64::INFINITY, f64::NEG_INFINITY].map(Point::repeat);
        for capsule in &self.capsules {
            for (end, radius) in capsule.ends.into_iter().zip(capsule.radii) {
                let reach = Point::repeat(radius + self.blend);
                bounds = [bounds[0].inf(&(end - reach)), bounds[1].sup(&(end + reach))];
            }
        }
        bounds
    }
}
