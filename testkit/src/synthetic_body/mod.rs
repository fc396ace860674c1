//! Bodies out of a seed: a surface around capsules, and the joints that they were hung on, exactly.
//!
//! Tests and benches need no scans with them, and no scan has joints that are known to the last digit.

mod cut;
mod field;
mod figure;
mod polygonise;
mod pose;
mod random;
#[cfg(test)]
mod tests;

pub use cut::{Cut, Part, cut_limb};
pub use pose::Pose;

use self::figure::Figure;
use self::random::Random;
use mocapd_body::{Estimate, Joints, Mesh};

/// A place or a direction.
type Point = nalgebra::Vector3<f64>;

/// Of length one.
fn unit(direction: Point) -> Point {
    direction * (1.0 / direction.norm())
}

/// How a body is made, beside its seed and pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Faces that the surface shall have, within a tenth. Fewer than 2000 let limbs grow together.
    pub n_faces: usize,
    /// Turned and moved at random. Otherwise x is the subject's left, y is up, z is forward, and the soles are near y = 0.
    pub turned: bool,
}

impl Default for Options {
    /// As the scans of Yu et al. 2008: 5000 faces, and somehow turned.
    fn default() -> Self {
        Self { n_faces: 5000, turned: true }
    }
}

/// A body in metres: a closed surface without handles, and its 15 joints, sides told and without uncertainty. The head is
/// the top of the head, on the surface; all others lie within.
///
/// The seed gives stature (1.5 to 1.95 m), proportions and girths, which are the same in every pose; and how it is turned.
#[must_use]
pub fn body(seed: u64, pose: Pose, options: Options) -> (Mesh, Joints) {
    let figure = Figure::new(&mut Random::new(seed), pose);
    let mut mesh = polygonise::surface(&figure.field, options.n_faces);
    let mut joints = Joints { estimates: figure.joints, sides_told: true, size_sigma: 0.0 };
    if options.turned {
        let turn = Turn::random(&mut Random::new(seed ^ 0x7475_726e));
        mesh.positions.iter_mut().for_each(|at| *at = turn.of(*at));
        joints.estimates.values_mut().for_each(|e: &mut Estimate| e.position = turn.of(e.position));
    }
    (mesh, joints)
}

/// A rotation, then a step.
struct Turn {
    axes: [Point; 3],
    step: Point,
}

impl Turn {
    /// Every rotation is as likely as any other: two directions that are, made square.
    fn random(random: &mut Random) -> Self {
        let x = random.direction();
        let z = unit(x.cross(&random.direction()));
        Self { axes: [x, z.cross(&x), z], step: random.direction() * 3.0 }
    }

    fn of(&self, at: [f64; 3]) -> [f64; 3] {
        let turned = Point::from(self.axes.map(|axis| axis.dot(&Point::from(at))));
        (turned + self.step).into()
    }
}
