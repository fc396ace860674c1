//! How the rings of a function hang together, and the five segments of a body (Yu et al. 2008, section 6).

mod bands;
mod graph;
mod segments;

#[cfg(test)]
mod tests;

pub use graph::{Band, Reeb};
pub use segments::Segments;
