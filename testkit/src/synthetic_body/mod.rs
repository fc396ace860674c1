//! Synthetic bodies, generated from a seed: a surface around capsules, and the exact joint centres inside it.
//!
//! They replace scans in tests and benchmarks, and unlike scans they have exactly known joints.

mod cut;
mod figure;
mod surface;
#[cfg(test)]
mod tests;

pub use cut::{LimbCut, LimbPart, cut_limb};
pub use figure::Pose;

use self::figure::Figure;
use crate::random::Random;
use mocapd_body::{Estimate, Joints, Mesh};

/// A position or a direction.
type Point = nalgebra::Vector3<f64>;

/// Scales to unit length.
fn unit(direction: Point) -> Point {
    direction * (1.0 / direction.norm())
}

/// A uniformly distributed direction, by rejection: a point of the cube that lies in the unit sphere.
fn direction(random: &mut Random) -> Point {
    loop {
        let p = Point::from([0; 3].map(|_| random.between(-1.0, 1.0)));
        if (0.01..1.0).contains(&p.norm()) {
            return unit(p);
        }
    }
}

/// Resolution and orientation of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyOptions {
    /// Number of faces, within 10 %. With fewer than 2000, limbs may merge.
    pub n_faces: usize,
    /// Rotate and move the body at random. Otherwise x is the subject's left, y is up, z is forward, and the soles are
    /// near y = 0.
    pub turned: bool,
}

impl Default for BodyOptions {
    /// Like the scans of Yu et al. 2008: 5000 faces, in a random orientation.
    fn default() -> Self {
        Self { n_faces: 5000, turned: true }
    }
}

/// Generates a body in metres: a closed surface of genus 0, and its 15 joints, with known sides and no uncertainty. The
/// head is the top of the head, on the surface; all other joints lie inside.
///
/// The seed determines stature (1.5 to 1.95 m), proportions and girths, which are the same in every pose, and the
/// orientation.
#[must_use]
pub fn body(seed: u64, pose: Pose, options: BodyOptions) -> (Mesh, Joints) {
    let figure = Figure::new(&mut Random::new(seed), pose);
    let mut mesh = surface::surface(&figure.field, options.n_faces);
    let mut joints = Joints { estimates: figure.joints, sides_told: true, size_sigma: 0.0 };
    if options.turned {
        let motion = RigidMotion::random(&mut Random::new(seed ^ 0x7475_726e));
        mesh.positions.iter_mut().for_each(|at| *at = motion.apply(*at));
        let estimates = joints.estimates.values_mut();
        estimates.for_each(|e: &mut Estimate| e.position = motion.apply(e.position));
    }
    (mesh, joints)
}

/// A rotation followed by a translation.
struct RigidMotion {
    axes: [Point; 3],
    step: Point,
}

impl RigidMotion {
    /// A uniformly distributed rotation, from two random directions made orthogonal, and a translation.
    fn random(random: &mut Random) -> Self {
        let x = direction(random);
        let z = unit(x.cross(&direction(random)));
        Self { axes: [x, z.cross(&x), z], step: direction(random) * 3.0 }
    }

    fn apply(&self, at: [f64; 3]) -> [f64; 3] {
        let turned = Point::from(self.axes.map(|axis| axis.dot(&Point::from(at))));
        (turned + self.step).into()
    }
}
