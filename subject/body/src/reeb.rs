//! The Reeb graph of the level-set curves, and the five segments of a body (Yu et al. 2008, section 6).
//! A Reeb graph whose branches are known.

use std::collections::BTreeMap;

use crate::{
    Mesh, Refusal,
    extremity::Extremities,
    geodesic::{Adjacency, Graph, NONE, Workspace, distances},
    level::{Rings, Spans, cut, even_levels},
    mesh::find_root,
};

/// n of algorithm 2, which the paper does not give.
const LEVEL_COUNT: u32 = 100;

/// A connected piece of the surface between two neighbouring levels. It is a node of the Reeb graph unless it has
/// exactly one curve below and one above.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Band {
    /// The curves that bound it below; none at a minimum.
    pub below: Vec<u32>,
    /// The curves that bound it above; none at a maximum, several at a fork.
    pub above: Vec<u32>,
}

/// The Reeb graph of a function, at the resolution of its levels.
#[derive(Debug, Clone)]
pub struct Reeb {
    /// The pieces between levels.
    pub bands: Vec<Band>,
    /// For each curve, the bands below and above it.
    pub sides: Vec<[u32; 2]>,
    /// For each tip, the band that contains it.
    tips: Vec<Option<u32>>,
}

impl Reeb {
    /// Builds the graph of the curves of `mesh`; `tips` are the vertices that [`Self::down`] may start from.
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
            // A curve crosses its triangle, so the triangle has a part in both bands.
            sides.push([below.unwrap_or(u32::MAX), above.unwrap_or(u32::MAX)]);
        }
        let tips = tips.iter().map(|tip| {
            let triangle = mesh.triangles.iter().position(|corners| corners.contains(tip))? as u32;
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

    /// The curves from a tip down to the source of the function, highest first. Where several lead down, as around a
    /// handle, the longest counts.
    #[must_use]
    pub fn down(&self, tip: usize, cut: &Rings) -> Vec<u32> {
        let mut path = Vec::new();
        let mut band = self.tips.get(tip).copied().flatten();
        // Each step descends one level, so the loop ends.
        while let Some(at) = band.and_then(|band| self.bands.get(band as usize)) {
            let length = |ring: &u32| cut.rings[*ring as usize].perimeter;
            let longest = |one: &&u32, other: &&u32| length(one).total_cmp(&length(other));
            let Some(ring) = at.below.iter().max_by(longest) else { break };
            path.push(*ring);
            band = Some(self.sides[*ring as usize][0]);
        }
        path
    }

    /// All pairs of curves joined by a band: the arcs of the graph, drawn between centroids.
    pub fn arcs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.bands.iter().flat_map(|band| {
            band.below.iter().flat_map(move |low| band.above.iter().map(move |high| [*low, *high]))
        })
    }
}

/// Connectivity of triangles between neighbouring levels.
///
/// A triangle that spans several bands has a part in each. Parts of neighbouring triangles are united if their common
/// edge reaches into the band.
struct Parts {
    /// The first part and the lowest band of each triangle; none if it is unreachable.
    starts: Vec<Option<(u32, u32)>>,
    joined: Vec<u32>,
}

impl Parts {
    fn new(mesh: &Mesh, adjacency: &Adjacency, spans: &Spans) -> Self {
        let mut count = 0;
        let mut starts = Vec::with_capacity(mesh.triangles.len());
        for corners in &mesh.triangles {
            let bands = spans.bands(corners);
            starts.push(bands.map(|[lowest, _]| (count, lowest)));
            count += bands.map_or(0, |[lowest, highest]| highest - lowest + 1);
        }
        let mut parts = Self { starts, joined: (0..count).collect() };
        for edge in adjacency.edges() {
            let [one, other] = edge.triangles;
            let Some([lowest, highest]) = spans.bands(&edge.vertices) else { continue };
            if one == NONE || other == NONE {
                continue;
            }
            for band in lowest..=highest {
                if let (Some(a), Some(b)) = (parts.root(one, band), parts.root(other, band)) {
                    // The lower index becomes the representative, so the order of edges does not matter.
                    parts.joined[a.max(b) as usize] = a.min(b);
                }
            }
        }
        parts
    }

    /// The representative of the part of `triangle` in `band`.
    fn root(&mut self, triangle: u32, band: u32) -> Option<u32> {
        let (start, lowest) = (*self.starts.get(triangle as usize)?)?;
        let part = start + band.checked_sub(lowest)?;
        self.joined.get(part as usize)?;
        Some(find_root(&mut self.joined, part))
    }
}

/// Distance from the fingertips to the armpit, as a fraction of the distance to the head.
const ARM_REACH: f64 = 0.61;
/// Distance from the toes to the crotch, as a fraction of the distance to the head.
const LEG_REACH: f64 = 0.52;

/// The five segments of a body: curves of the distance from the head, each list a centre line from the trunk outwards.
///
/// The Reeb graph has more ends than a body has limbs: ears, fingers, toes, noise. An arc counts only if it leads down
/// from one of the four chosen tips.
#[derive(Debug, Clone, PartialEq)]
pub struct Segments {
    /// From the head to where the legs part.
    pub trunk: Vec<u32>,
    /// From the armpits to the hands, in the order of the hands.
    pub arms: [Vec<u32>; 2],
    /// From the crotch to the feet, in the order of the feet.
    pub legs: [Vec<u32>; 2],
    /// The values at which the arms leave the trunk.
    pub armpits: [f64; 2],
    /// The value at which the legs part.
    pub crotch: f64,
}

impl Segments {
    /// Splits the graph where limbs leave the trunk. The tips of `reeb` must be hands and feet, in this order.
    ///
    /// # Errors
    ///
    /// [`Refusal::Contact`]: a hand joins a leg or the other arm before the trunk.
    pub fn new(reeb: &Reeb, cut: &Rings) -> Result<Self, Refusal> {
        let [one, other, left, right] = [0, 1, 2, 3].map(|tip| upwards(reeb, cut, tip));
        let (trunk_count, legs) = split(&left, &right);
        let trunk = left[..trunk_count].to_vec();
        let arm = |path: &[u32]| split(path, &left).0.min(split(path, &right).0);
        let starts = [arm(&one), arm(&other)];
        let between_hands = split(&one, &other).0;
        let fused = starts.iter().any(|start| *start >= trunk_count || *start < between_hands);
        let short = [&one[starts[0]..], &other[starts[1]..], &legs[0], &legs[1], &trunk];
        if fused || short.iter().any(|path| path.is_empty()) {
            return Err(Refusal::Contact { handles: 0 });
        }
        let value = |ring: u32| cut.values[cut.rings[ring as usize].level as usize];
        Ok(Self {
            armpits: [value(one[starts[0]]), value(other[starts[1]])],
            crotch: value(legs[0][0]),
            arms: [one[starts[0]..].to_vec(), other[starts[1]..].to_vec()],
            legs,
            trunk,
        })
    }

    /// Segments by length, for bodies whose limbs touch: a limb is what lies within its usual length of its tip.
    /// `fields` are the distances from hands and feet, in this order.
    #[must_use]
    fn within_reach(
        mesh: &Mesh,
        reeb: &Reeb,
        cut: &Rings,
        extremities: &Extremities,
        fields: &[Vec<f64>; 4],
    ) -> Self {
        let far = |tip: usize, vertex: u32| {
            fields[tip].get(vertex as usize).copied().unwrap_or(f64::INFINITY)
        };
        let limb = |tip: usize| {
            let part = if tip < 2 { ARM_REACH } else { LEG_REACH };
            let reach = part * far(tip, extremities.head);
            let mut path = upwards(reeb, cut, tip);
            let near = |ring: &u32| {
                let triangle = cut.rings[*ring as usize].triangle;
                let corners = mesh.triangles.get(triangle as usize);
                corners.is_some_and(|[vertex, ..]| far(tip, *vertex) <= reach)
            };
            let count = path.iter().rev().take_while(|ring| near(ring)).count();
            let rest = path.split_off(path.len() - count);
            (path, rest)
        };
        let [(_, one), (_, other), (trunk, left), (_, right)] = [0, 1, 2, 3].map(limb);
        let begins = |limb: &[u32]| {
            let first = limb.first().and_then(|ring| cut.rings.get(*ring as usize));
            first.and_then(|ring| cut.values.get(ring.level as usize)).copied().unwrap_or(0.0)
        };
        Self {
            armpits: [begins(&one), begins(&other)],
            crotch: begins(&left),
            arms: [one, other],
            legs: [left, right],
            trunk,
        }
    }
}

/// The curves from the head to a tip.
fn upwards(reeb: &Reeb, cut: &Rings, tip: usize) -> Vec<u32> {
    let mut path = reeb.down(tip, cut);
    path.reverse();
    path
}

/// Number of curves that two paths share from the head on, and their separate parts.
fn split(one: &[u32], other: &[u32]) -> (usize, [Vec<u32>; 2]) {
    let common = one.iter().zip(other).take_while(|(a, b)| a == b).count();
    (common, [one[common..].to_vec(), other[common..].to_vec()])
}

/// Level sets and Reeb graph of the distance from the head (Yu et al. 2008, section 6), split into trunk and limbs.
#[derive(Debug, Clone)]
pub struct Levels {
    /// The level-set curves.
    pub rings: Rings,
    /// Their connectivity.
    pub reeb: Reeb,
    /// Trunk, arms and legs.
    pub segments: Segments,
}

impl Levels {
    /// Computes the levels of a mesh with known extremities. If the graph lacks the five segments of a body because
    /// limbs touch, limbs are delimited by their length. None if the mesh is not a surface.
    #[must_use]
    pub fn new(mesh: &Mesh, extremities: &Extremities) -> Option<Self> {
        let adjacency = Adjacency::new(mesh).ok()?;
        let graph = Graph::along_edges(mesh, &adjacency);
        let mut workspace = Workspace::default();
        let field = distances(&graph, extremities.head, &mut workspace);
        let (rings, reeb) = rings_and_graph(mesh, &adjacency, &field, extremities);
        let segments = Segments::new(&reeb, &rings).unwrap_or_else(|_| {
            let [_, tips @ ..] = extremities.all();
            let fields = tips.map(|tip| distances(&graph, tip, &mut workspace));
            Segments::within_reach(mesh, &reeb, &rings, extremities, &fields)
        });
        Some(Self { rings, reeb, segments })
    }

    /// Computes the levels of `field`, the distances from the head.
    ///
    /// # Errors
    ///
    /// [`Refusal::Contact`]: the graph does not have the five segments of a body.
    pub(crate) fn of_free_limbs(
        mesh: &Mesh,
        adjacency: &Adjacency,
        field: &[f64],
        extremities: &Extremities,
    ) -> Result<Self, Refusal> {
        let (rings, reeb) = rings_and_graph(mesh, adjacency, field, extremities);
        let segments = Segments::new(&reeb, &rings)?;
        Ok(Self { rings, reeb, segments })
    }
}

fn rings_and_graph(
    mesh: &Mesh,
    adjacency: &Adjacency,
    field: &[f64],
    extremities: &Extremities,
) -> (Rings, Reeb) {
    let rings = cut(mesh, adjacency, field, even_levels(field, LEVEL_COUNT));
    let [_, tips @ ..] = extremities.all();
    let reeb = Reeb::new(mesh, adjacency, &rings, &tips);
    (rings, reeb)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Mesh,
        geodesic::Adjacency,
        level::{Rings, cut},
        tests::cubes,
    };

    /// A body of cubes, head down at 0: neck and trunk up to 6, arms that branch off at 2 and rise to 5, legs from 6 to 10.
    fn body() -> Vec<[i32; 3]> {
        let mut places = Vec::new();
        for up in 0..6 {
            places.push([0, 0, up]);
        }
        for side in [-1, 1] {
            for out in 1..4 {
                places.push([side * out, 0, 2]);
            }
            places.extend((2..5).map(|up| [side * 3, 0, up]));
            places.push([side, 0, 5]);
            places.extend((6..10).map(|up| [side, 0, up]));
        }
        places.sort_unstable();
        places.dedup();
        places
    }

    fn top_at(mesh: &Mesh, near: [f64; 3]) -> u32 {
        let far = |at: &[f64; 3]| (0..3).map(|axis| (at[axis] - near[axis]).powi(2)).sum::<f64>();
        let nearest =
            mesh.positions.iter().enumerate().min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
        nearest.unwrap().0 as u32
    }

    fn linked(mesh: &Mesh, tips: &[[f64; 3]]) -> (Rings, Reeb) {
        let adjacency = Adjacency::new(mesh).unwrap();
        let heights: Vec<f64> = mesh.positions.iter().map(|at| at[2]).collect();
        let levels = (0..20).map(|level| 0.25 + 0.5 * f64::from(level)).collect();
        let rings = cut(mesh, &adjacency, &heights, levels);
        let tips: Vec<u32> = tips.iter().map(|near| top_at(mesh, *near)).collect();
        let reeb = Reeb::new(mesh, &adjacency, &rings, &tips);
        (rings, reeb)
    }

    const TIPS: [[f64; 3]; 4] =
        [[-3.0, 0.0, 5.0], [4.0, 0.0, 5.0], [-1.0, 0.0, 10.0], [2.0, 0.0, 10.0]];

    #[test]
    fn a_tree_has_its_ends_and_forks() {
        let (_, reeb) = linked(&cubes(&body()), &TIPS);
        let ends = reeb.bands.iter().filter(|band| band.above.is_empty()).count();
        let forks = reeb.bands.iter().filter(|band| band.above.len() > 1).count();
        let starts = reeb.bands.iter().filter(|band| band.below.is_empty()).count();
        assert_eq!((starts, forks, ends), (1, 2, 4), "{:?}", reeb.bands);
        // A tree has one arc fewer than nodes, each ring being an arc between its two bands.
        assert_eq!(reeb.sides.len() + 1, reeb.bands.len());
        // All rings but the lowest have one below them.
        assert_eq!(reeb.arcs().count(), reeb.sides.len() - 1);
    }

    #[test]
    fn a_body_splits_into_five_parts() {
        let (rings, reeb) = linked(&cubes(&body()), &TIPS);
        let body = Segments::new(&reeb, &rings).unwrap();
        assert_eq!((body.armpits, body.crotch), ([3.25, 3.25], 6.25));
        assert_eq!(body.arms.each_ref().map(Vec::len), [4, 4]);
        assert_eq!(body.legs.each_ref().map(Vec::len), [8, 8]);
        assert_eq!(body.trunk.len(), 12);
        let x = |ring: u32| rings.rings[ring as usize].centroid[0];
        assert!(body.arms[0].iter().all(|ring| x(*ring) < -2.0));
        assert!(body.legs[1].iter().all(|ring| x(*ring) > 0.5));
        assert!(body.trunk.iter().all(|ring| (x(*ring) - 0.5).abs() < 0.01));
    }

    #[test]
    fn a_handle_is_not_a_tree() {
        let mut places = body();
        places.extend([[0, 0, 9]]);
        let (_, reeb) = linked(&cubes(&places), &TIPS);
        assert!(reeb.bands.iter().any(|band| band.below.len() > 1));
    }

    #[test]
    fn a_hand_on_a_leg_is_contact() {
        let mut places = body();
        // The arm continues into the leg and no longer has an end of its own.
        places.extend([[-3, 0, 5], [-3, 0, 6], [-2, 0, 6]]);
        let (rings, reeb) = linked(&cubes(&places), &[TIPS[2], TIPS[1], TIPS[2], TIPS[3]]);
        let refusal = Segments::new(&reeb, &rings).unwrap_err();
        assert_eq!(refusal.code(), "contact");
    }
}
