//! The distances from the five ends of a body.

/// Where the head stands among five ends.
pub const HEAD: usize = 0;
/// Where the hands stand.
pub const HAND: [usize; 2] = [1, 2];
/// Where the feet stand.
pub const FOOT: [usize; 2] = [3, 4];

/// The ends of a body, and how far along the surface every vertex is from each: head, two hands, two feet, the first
/// hand on the side of the first foot.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a> {
    /// The vertex at each end.
    pub ends: [u32; 5],
    /// One distance a vertex, in the mesh's unit; infinite where there is no way.
    pub distances: [&'a [f64]; 5],
    /// The distances from the head's top as it was first found, where it was moved since. The neck is looked for by these.
    pub first_head: Option<&'a [f64]>,
    /// How much earlier than on a whole body the surface ends there, in the mesh's unit: 0 where nothing is missing. All
    /// distances from such an end are longer by it, as if they led to where the limb would end.
    pub missing: [f64; 5],
}

impl Fields<'_> {
    /// How far `vertex` is from an end; infinite if there is no such vertex.
    pub(super) fn at(&self, end: usize, vertex: usize) -> f64 {
        self.distances
            .get(end)
            .and_then(|field| field.get(vertex))
            .map_or(f64::INFINITY, |distance| distance + self.missing.get(end).unwrap_or(&0.0))
    }

    /// How far two ends are from each other. Nothing if there is no way, or an end that is no vertex.
    pub(super) fn between(&self, one: usize, other: usize) -> Option<f64> {
        let vertex = *self.ends.get(other)? as usize;
        let distance = self.at(one, vertex) + self.missing.get(other)?;
        Some(distance).filter(|distance| distance.is_finite())
    }
}
