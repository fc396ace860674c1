//! Level sets of a function on the surface: rings about the limbs (Yu et al. 2008, section 6).

mod cut;
mod ring;
mod spans;
mod walk;

#[cfg(test)]
mod tests;

pub use cut::{Rings, cut, even_levels};
pub use ring::Ring;
pub(crate) use spans::Spans;
