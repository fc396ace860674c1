//! Extremities of a body: head, hands and feet, and which is which.
//!
//! Extremities are the maxima of the mean geodesic distance to a few widely spread vertices, in any pose; how far each
//! protrudes is its persistence. Head, hands and feet are assigned by the ten geodesic distances between five of them,
//! whose ratios hardly differ from person to person.

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

/// The extremities of a body, as vertices of the mesh.
///
/// `hands[0]` and `feet[0]` are on one side of the body, `hands[1]` and `feet[1]` on the other. Geodesic distances
/// cannot determine which side is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extremities {
    /// Top of the head.
    pub head: u32,
    /// Tips of the hands.
    pub hands: [u32; 2],
    /// Tips of the feet: heel or toes, whichever is farther.
    pub feet: [u32; 2],
}

impl Extremities {
    /// Head, hands, feet: the order of distance fields.
    #[must_use]
    pub fn all(&self) -> [u32; 5] {
        let ([a, b], [c, d]) = (self.hands, self.feet);
        [self.head, a, b, c, d]
    }
}

/// How the extremities were identified, from the most to the least certain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum NamingMode {
    /// By distances along the surface of a body whose limbs are free.
    FreeLimbs,
    /// By distances along the surface of a body from which part of a limb is missing.
    CutLimb,
    /// By distances along the surface, some of which are too short because they cross from a hand into what it touches.
    InContact,
    /// By distances through the interior, with a layer removed so that touching limbs separate.
    Interior,
}

/// A vertex far from others.
#[derive(Debug, Clone)]
pub struct FarPoint {
    /// The vertex.
    pub vertex: u32,
    /// Geodesic distances from it to every vertex, in the mesh's unit.
    pub distances: Vec<f64>,
}

/// The identified extremities, and what was measured on the way.
#[derive(Debug, Clone)]
pub struct Ends {
    /// The vertices.
    pub extremities: Extremities,
    /// Geodesic distances from each of [`Extremities::all`] to every vertex, in the mesh's unit.
    pub fields: [Vec<f64>; 5],
    /// Widely spread vertices. Fingertips and toes are often among them, so their distances need not be computed again.
    pub spread: Vec<FarPoint>,
    /// Persistence of each of [`Extremities::all`], as a fraction of the longest distance.
    pub persistence: [f64; 5],
    /// How they were identified.
    pub mode: NamingMode,
    /// Deviation of their distances from those of a body.
    pub misfit: Misfit,
    /// Margin to the misfit of the second best assignment; infinite if there is none.
    pub margin: f64,
}

impl Ends {
    /// Confidence in the assignment, 0 to 1: falls with the misfit, and with the fit of the second best assignment.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let fit = (1.0 - self.misfit.rms / self.misfit.limit).clamp(0.0, 1.0).sqrt();
        fit * (1.0 - (-self.margin / MARGIN_MIN).exp())
    }
}
