//! The ends of a body: head, hands and feet.

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
