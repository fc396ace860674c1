//! The joints that a scan gives, and how sure each is.

use std::collections::BTreeMap;

use crate::mesh::Point;

/// Which of a pair. Where left and right could not be told ([`Joints::sides_told`]), all of one side's joints are still on
/// one side of the body, and nobody knows which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

impl Side {
    /// Both of them.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// The 15 sites of Shi et al. 2012 (doi 10.3969/j.issn.0372-2112.2012.01.021).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Joint {
    /// The top of the head.
    Head,
    /// The base of the neck.
    Throat,
    /// The middle of the hips.
    Pelvis,
    /// Glenohumeral.
    Shoulder(Side),
    /// Between upper arm and forearm.
    Elbow(Side),
    /// Between forearm and hand.
    Wrist(Side),
    /// Femoral head.
    Hip(Side),
    /// Between thigh and shank.
    Knee(Side),
    /// Between shank and foot.
    Ankle(Side),
}

/// Where a joint is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// x, y, z in the mesh's own frame and unit.
    pub position: [f64; 3],
    /// Standard deviation that is expected of the distance to the true centre, in the mesh's unit.
    pub sigma: f64,
}

/// The joints of one scan, in the mesh's own frame and unit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Joints {
    /// Those that were found.
    pub estimates: BTreeMap<Joint, Estimate>,
    /// Whether left is left. If not, the sides may be the wrong way round as a whole.
    pub sides_told: bool,
    /// Relative standard deviation of all lengths together, beside what each joint's own says: 0 where nothing doubts the
    /// body's size.
    pub size_sigma: f64,
}

impl Joints {
    /// Where a joint is.
    pub(crate) fn point(&self, joint: Joint) -> Option<Point> {
        self.estimates.get(&joint).map(|estimate| estimate.position.into())
    }
}
