//! The Reeb graph: rings, and the pieces of surface between them.

use std::collections::BTreeMap;

use super::bands::Parts;
use crate::Mesh;
use crate::geodesic::Adjacency;
use crate::level::Rings;

/// A piece of the surface between two neighbouring levels: a node of the Reeb graph if it has other than one ring below
/// and one above.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Band {
    /// The rings that it begins with; none if a minimum lies in it.
    pub below: Vec<u32>,
    /// The rings that it ends with; none if a maximum lies in it, several if the surface forks.
    pub above: Vec<u32>,
}

/// The Reeb graph of a function, as fine as the levels that it was cut at.
#[derive(Debug, Clone)]
pub struct Reeb {
    /// The pieces between levels.
    pub bands: Vec<Band>,
    /// For each ring the bands below and above it.
    pub sides: Vec<[u32; 2]>,
    /// For each vertex that was asked for the band that it lies in.
    tips: Vec<Option<u32>>,
}

impl Reeb {
    /// Links the rings of `mesh`; `tips` are vertices that [`Self::down`] will be asked for.
    #[must_use]
    pub fn new(mesh: &Mesh, adjacency: &Adjacency, cut: &Rings, tips: &[u32]) -> Self {
        let mut parts = Parts::new(mesh, adjacency, &cut.spans);
        let mut bands = Vec::new();
        let mut known = BTreeMap::new();
        let mut band_of = |triangle: u32, rank: u32| {
            let root = parts.root(triangle, rank)?;
            Some(*known.entry(root).or_insert_with(|| {
                bands.push(Band::default());
                bands.len() as u32 - 1
            }))
        };
        let mut sides = Vec::with_capacity(cut.rings.len());
        for ring in &cut.rings {
            let [below, above] =
                [ring.level, ring.level + 1].map(|rank| band_of(ring.triangle, rank));
            // A ring crosses its triangle, which so reaches into both bands.
            sides.push([below.unwrap_or(u32::MAX), above.unwrap_or(u32::MAX)]);
        }
        let first_triangle =
            |tip: u32| mesh.triangles.iter().position(|corners| corners.contains(&tip));
        let tips = tips.iter().map(|tip| {
            let triangle = first_triangle(*tip)? as u32;
            band_of(triangle, cut.spans.rank(*tip)?)
        });
        let tips = tips.collect();
        for (ring, [below, above]) in (0_u32..).zip(&sides) {
            if let Some(band) = bands.get_mut(*below as usize) {
                band.above.push(ring);
            }
            if let Some(band) = bands.get_mut(*above as usize) {
                band.below.push(ring);
            }
        }
        Self { bands, sides, tips }
    }

    /// The rings from the tip down to the source of the function, highest first; where several lead down, as about a
    /// handle, the longest.
    #[must_use]
    pub fn down(&self, tip: usize, cut: &Rings) -> Vec<u32> {
        let mut way = Vec::new();
        let mut band = self.tips.get(tip).copied().flatten();
        // Each step goes one level lower, so there are no more than levels.
        while let Some(at) = band.and_then(|band| self.bands.get(band as usize)) {
            let length = |ring: &u32| cut.rings[*ring as usize].perimeter;
            let longest = |one: &&u32, other: &&u32| length(one).total_cmp(&length(other));
            let Some(ring) = at.below.iter().max_by(longest) else { break };
            way.push(*ring);
            band = Some(self.sides[*ring as usize][0]);
        }
        way
    }

    /// Every two rings that a band joins: the arcs of the graph, to be drawn between centroids.
    pub fn arcs(&self) -> impl Iterator<Item = [u32; 2]> {
        let pairs = |band: &Band| {
            let above = band.above.clone();
            band.below
                .clone()
                .into_iter()
                .flat_map(move |low| above.clone().into_iter().map(move |high| [low, high]))
        };
        self.bands.iter().flat_map(pairs)
    }
}
