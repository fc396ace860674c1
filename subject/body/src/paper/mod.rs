//! The method of (Yu et al. 2008) as it is printed, to compare with: what it does, and what it does not.
//!
//! Distances are Dijkstra's along edges, ends are those of algorithm 1, the head is told by symmetry alone, and joints are
//! where rings of the distance from the head are least round. Where the paper leaves something open, it is read as plainly
//! as it can be, and the reading is said.

mod ends;
mod joints;
mod minima;
mod reason;

#[cfg(test)]
mod tests;

pub use ends::{StopRule, extremity_points, head_by_symmetry};
pub(crate) use joints::LEVEL_COUNT;
pub use joints::{Paper, joints};
pub(crate) use reason::reason;
