//! The ends of a body: head, hands and feet, and which is which.
//!
//! Ends stand out of the surface wherever the limbs are: they are the maxima of the mean distance along the surface to
//! a few far-spread vertices, and how far each stands out is its persistence. Which is which follows from the ten
//! distances between five of them, whose ratios hardly differ from person to person.

mod find;
mod inside;
mod naming;
mod peaks;
#[cfg(test)]
mod tests;

pub use find::find;
pub(crate) use find::start;
use naming::MARGIN_MIN;
pub use naming::{MISFIT_IN_CONTACT_MAX, MISFIT_MAX, Misfit};
pub use peaks::Peak;

/// The ends of a body, as vertices of the mesh.
///
/// `hands[0]` and `feet[0]` are on one side of the body, `hands[1]` and `feet[1]` on the other; which is left, distances
/// along the surface cannot tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extremities {
    /// The top of the head.
    pub head: u32,
    /// The tips of the hands.
    pub hands: [u32; 2],
    /// The tips of the feet: heel or toes, whichever is farther.
    pub feet: [u32; 2],
}

impl Extremities {
    /// Head, hands, feet: the order in which fields of distances stand.
    #[must_use]
    pub fn all(&self) -> [u32; 5] {
        let ([a, b], [c, d]) = (self.hands, self.feet);
        [self.head, a, b, c, d]
    }
}

/// How ends were told, from the surest to the least sure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum NamingMode {
    /// By ways along the surface of a body whose limbs are free.
    FreeLimbs,
    /// The same of a body of which a part of a limb is missing.
    CutLimb,
    /// By ways along the surface, some of which are too short for a body: they lead from a hand into what it touches.
    InContact,
    /// By ways through the inside, with a layer taken off so that limbs that touch come apart.
    Interior,
}

/// A vertex that lies far from others.
#[derive(Debug, Clone)]
pub struct FarPoint {
    /// Which one.
    pub vertex: u32,
    /// The distances from it along the surface to every vertex, in the mesh's unit.
    pub distances: Vec<f64>,
}

/// The named ends of a body, and what was measured on the way.
#[derive(Debug, Clone)]
pub struct Ends {
    /// Which vertices they are.
    pub extremities: Extremities,
    /// The distances along the surface from each of [`Extremities::all`] to every vertex, in the mesh's unit.
    pub fields: [Vec<f64>; 5],
    /// Vertices that lie far from each other: fingertips and toes are often among them, and
    /// what is measured once need not be again.
    pub spread: Vec<FarPoint>,
    /// By how much each of [`Extremities::all`] stands out, as a part of the longest way.
    pub persistence: [f64; 5],
    /// How they were told.
    pub mode: NamingMode,
    /// How far the ways between them are from those of a body.
    pub misfit: Misfit,
    /// By how much the misfit of the second best naming is greater; infinite if there is none.
    pub margin: f64,
}

impl Ends {
    /// How sure the naming is, from 0 to 1: falls with the misfit, and with how well a second naming fits.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let fit = (1.0 - self.misfit.rms / self.misfit.limit).clamp(0.0, 1.0).sqrt();
        fit * (1.0 - (-self.margin / MARGIN_MIN).exp())
    }
}
