//! From a body scan to a skeleton (Yu et al. 2008, and past it).

mod joint;
mod mesh;

pub use joint::{Estimate, Joint, Joints, Side};
pub use mesh::Mesh;
