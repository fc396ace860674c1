//! Further markers on the segments, so that a take can have any number of them: rigid clusters.

use super::body::SITES;
use super::geometry::{V3, cross, dot, offset, scale, sin_cos, sub, unit};
use super::rng::Rng;

/// A segment that carries markers.
struct Segment {
    name: &'static str,
    /// Its ends, as indices into the sites.
    ends: (usize, usize),
    /// Whether the shoulder line, not the hip line, says which way it is turned.
    follows_chest: bool,
    /// How far markers sit from the line between the ends, metres.
    radius_m: f64,
}

const fn segment(
    name: &'static str,
    ends: (usize, usize),
    follows_chest: bool,
    radius_m: f64,
) -> Segment {
    Segment { name, ends, follows_chest, radius_m }
}

/// Radii are those of an adult's limbs to the nearest half centimetre; they only place markers.
const SEGMENTS: [Segment; 10] = [
    segment("trunk", (2, 1), true, 0.130),
    segment("l_thigh", (9, 10), false, 0.075),
    segment("r_thigh", (12, 13), false, 0.075),
    segment("l_shank", (10, 11), false, 0.055),
    segment("r_shank", (13, 14), false, 0.055),
    segment("l_upper_arm", (3, 4), true, 0.045),
    segment("r_upper_arm", (6, 7), true, 0.045),
    segment("l_forearm", (4, 5), true, 0.035),
    segment("r_forearm", (7, 8), true, 0.035),
    segment("head", (1, 0), true, 0.090),
];

/// One marker stuck to a segment.
#[derive(Debug, Clone)]
pub(super) struct Stuck {
    pub(super) label: String,
    pub(super) ends: (usize, usize),
    follows_chest: bool,
    /// Metres along the segment, to its left and across both.
    at: V3,
    /// Part of the segment's length at which it sits.
    along: f64,
}

/// So many markers beyond the sites, dealt to the segments in turn.
pub(super) fn stick(n: usize, seed: u64) -> Vec<Stuck> {
    (0..n)
        .map(|i| {
            let segment = &SEGMENTS[i % SEGMENTS.len()];
            let mut rng = Rng::stream(seed, 0x1_0000 + i as u64);
            let (sin, cos) = sin_cos(rng.between(-std::f64::consts::PI, std::f64::consts::PI));
            let radius = segment.radius_m * rng.between(0.85, 1.1);
            Stuck {
                label: format!("{}_{}", segment.name, i / SEGMENTS.len() + 1),
                ends: segment.ends,
                follows_chest: segment.follows_chest,
                at: [0.0, radius * sin, radius * cos],
                along: rng.between(0.12, 0.88),
            }
        })
        .collect()
}

/// Where a marker is, from the sites and the lateral axes (hips, chest).
pub(super) fn place(stuck: &Stuck, sites: &[V3; SITES.len()], lateral: &[V3; 2]) -> V3 {
    let (from, to) = (sites[stuck.ends.0], sites[stuck.ends.1]);
    let bone = sub(to, from);
    let along = unit(bone);
    let left = lateral[usize::from(stuck.follows_chest)];
    let left = unit(sub(left, scale(along, dot(left, along))));
    let at = [stuck.at[0], stuck.at[1], stuck.at[2]];
    let base = offset(from, [bone, left, along], [stuck.along, 0.0, at[0]]);
    offset(base, [left, cross(along, left), along], [at[1], at[2], 0.0])
}
