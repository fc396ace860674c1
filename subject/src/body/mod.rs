//! From a body scan to a skeleton (Yu et al. 2008, and past it).

mod mesh;

pub use mesh::Mesh;
