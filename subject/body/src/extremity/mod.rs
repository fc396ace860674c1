//! The ends of a body: head, hands and feet, and which is which.
//!
//! Ends stand out of the surface wherever the limbs are: they are the maxima of the mean distance along the surface to
//! a few far-spread vertices, and how far each stands out is its persistence. Which is which follows from the ten
//! distances between five of them, whose ratios hardly differ from person to person.

mod candidates;
mod cap;
mod choice;
mod find;
mod inside;
mod naming;
mod peaks;
mod roles;
mod spread;

#[cfg(test)]
mod tests;

pub(crate) use find::start;
pub use find::{Ends, Told, find};
pub use peaks::Peak;
pub use roles::{MISFIT_IN_CONTACT_MAX, MISFIT_MAX, Misfit};

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
