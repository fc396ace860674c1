//! A body in five: trunk with head, arms, legs.

use super::Reeb;
use crate::extremity::Extremities;
use crate::level::Rings;
use crate::{Mesh, Refusal};

/// From the end of a hand to the armpit, as a part of the way from there to the head.
const ARM_REACH: f64 = 0.61;
/// From the end of a foot to the crotch, as a part of the same.
const LEG_REACH: f64 = 0.52;

/// The five segments of a body, as rings of the distance from the head, each a centre line from the trunk outwards.
///
/// The Reeb graph has more ends than a body has limbs: ears, fingers, toes, and what noise and coarse triangles add. Here
/// those are no arcs at all: an arc counts only if it leads down from one of the four chosen ends.
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
    /// Cuts the graph where limbs leave the trunk; the tips of `reeb` are hands and feet, in this order.
    ///
    /// # Errors
    ///
    /// [`Refusal::Contact`]: a hand hangs together with a leg or the other arm before it does with the trunk.
    pub fn new(reeb: &Reeb, cut: &Rings) -> Result<Self, Refusal> {
        let [one, other, left, right] = [0, 1, 2, 3].map(|tip| upwards(reeb, cut, tip));
        let (trunk_count, legs) = split(&left, &right);
        let trunk = left[..trunk_count].to_vec();
        let arm = |way: &[u32]| split(way, &left).0.min(split(way, &right).0);
        let starts = [arm(&one), arm(&other)];
        let between_hands = split(&one, &other).0;
        let fused = starts.iter().any(|start| *start >= trunk_count || *start < between_hands);
        let short = [&one[starts[0]..], &other[starts[1]..], &legs[0], &legs[1], &trunk];
        if fused || short.iter().any(|way| way.is_empty()) {
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
}

impl Segments {
    /// The rings on the ways from the head to the tips, where limbs touch and the graph says not where they begin: a limb
    /// is what lies so near to its tip as limbs are long. `fields` are the distances from hands and feet, in this order.
    #[must_use]
    pub(crate) fn within_reach(
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
            let mut way = upwards(reeb, cut, tip);
            let near = |ring: &u32| {
                let triangle = cut.rings[*ring as usize].triangle;
                let corners = mesh.triangles.get(triangle as usize);
                corners.is_some_and(|[vertex, ..]| far(tip, *vertex) <= reach)
            };
            let count = way.iter().rev().take_while(|ring| near(ring)).count();
            let rest = way.split_off(way.len() - count);
            (way, rest)
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

/// The rings from the head to a tip.
fn upwards(reeb: &Reeb, cut: &Rings, tip: usize) -> Vec<u32> {
    let mut way = reeb.down(tip, cut);
    way.reverse();
    way
}

/// How many rings two ways have in common from the head on, and what they have apart.
fn split(one: &[u32], other: &[u32]) -> (usize, [Vec<u32>; 2]) {
    let common = one.iter().zip(other).take_while(|(a, b)| a == b).count();
    (common, [one[common..].to_vec(), other[common..].to_vec()])
}
