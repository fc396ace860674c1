//! Blocks of skin, and the holes in them (Yang et al. 2004, section 2).

use crate::plane::{Blob, Labels, Mask};

/// Holes below this share of the block's area are dropped: the paper's T0, whose value it does not give. An eye has about
/// a hundredth.
const HOLE_SHARE_MIN: f64 = 0.001;
/// The paper's bounds on the number of holes.
const HOLES_MIN: usize = 3;
const HOLES_MAX: usize = 10;
/// Blocks below this share of the photograph are not looked at: with 3 holes and a template there is nothing to see.
const BLOCK_SHARE_MIN: f64 = 0.004;

/// A block of skin with three holes at least.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// The skin, without its holes filled.
    pub(super) skin: Mask,
    /// Its holes, largest first.
    pub(super) holes: Vec<Blob>,
}

/// The blocks of a mask of skin that have holes enough.
pub(super) fn blocks(skin: &Mask) -> Vec<Block> {
    let labels = Labels::of(skin, false);
    let least = BLOCK_SHARE_MIN * (skin.width() * skin.height()) as f64;
    let large = labels.blobs.iter().enumerate().filter(|(_, blob)| blob.area as f64 >= least);
    large
        .filter_map(|(i, blob)| {
            let skin = labels.mask(i);
            let holes = holes(&skin, blob);
            (holes.len() >= HOLES_MIN).then_some(Block { skin, holes })
        })
        .collect()
}

/// What a block encloses: the parts of the rest that do not reach around it.
fn holes(skin: &Mask, blob: &Blob) -> Vec<Blob> {
    let rest = Labels::of(&skin.inverted(), true);
    let within = |hole: &&Blob| {
        hole.left > blob.left
            && hole.top > blob.top
            && hole.right < blob.right
            && hole.bottom < blob.bottom
            && hole.area as f64 >= HOLE_SHARE_MIN * blob.area as f64
    };
    let mut holes: Vec<Blob> = rest.blobs.iter().filter(within).copied().collect();
    holes.sort_by(|a, b| b.area.cmp(&a.area).then(a.top.cmp(&b.top)).then(a.left.cmp(&b.left)));
    holes.truncate(HOLES_MAX);
    holes
}

/// The direction of a face (eq. 3), as the roll of the line of its eyes in radians, -pi/2 to pi/2: the mean of its holes'
/// axes. The paper takes the plain mean, which fails where angles wrap; axes are averaged at twice their angle, weighed
/// by area and eccentricity, for a round hole has no direction.
pub(super) fn direction_rad(holes: &[Blob]) -> f64 {
    let (mut sin, mut cos) = (0.0, 0.0);
    for hole in holes {
        let weight = hole.area as f64 * hole.eccentricity();
        let twice = 2.0 * hole.axis_rad();
        sin += weight * twice.sin();
        cos += weight * twice.cos();
    }
    if sin == 0.0 && cos == 0.0 { 0.0 } else { 0.5 * sin.atan2(cos) }
}
