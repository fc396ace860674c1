//! A surface of triangles.

/// A surface of triangles, as the methods of this module take it.
///
/// Positions are in the unit of whoever made it; nothing in the geometry depends on the unit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// One position a vertex.
    pub positions: Vec<[f64; 3]>,
    /// Three indices into `positions` a triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}
