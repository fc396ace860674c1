//! A body in five: trunk with head, arms, legs.

use super::Reeb;
use crate::body::Refusal;
use crate::body::level::Rings;

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
