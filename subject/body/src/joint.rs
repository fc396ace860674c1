//! Joint centres of a scan, with their standard deviations.

use std::collections::BTreeMap;

use crate::mesh::Point;

/// A side of the body. If left and right could not be determined ([`Joints::sides_told`]), one value still stands for
/// one side throughout, but which one is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

impl Side {
    /// Both sides.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// The 15 sites of Shi et al. 2012 (doi 10.3969/j.issn.0372-2112.2012.01.021).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Joint {
    /// Top of the head.
    Head,
    /// Base of the neck.
    Throat,
    /// Midway between the hips.
    Pelvis,
    /// Glenohumeral joint.
    Shoulder(Side),
    /// Elbow, between upper arm and forearm.
    Elbow(Side),
    /// Wrist, between forearm and hand.
    Wrist(Side),
    /// Hip: centre of the femoral head.
    Hip(Side),
    /// Knee, between thigh and shank.
    Knee(Side),
    /// Ankle, between shank and foot.
    Ankle(Side),
}

/// The estimated position of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// x, y, z in the mesh's frame and unit.
    pub position: [f64; 3],
    /// Expected standard deviation of the distance to the true centre, in the mesh's unit.
    pub sigma: f64,
}

/// The joints of one scan, in the mesh's frame and unit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Joints {
    /// The joints that were found.
    pub estimates: BTreeMap<Joint, Estimate>,
    /// Whether `Side::Left` is the subject's left. If false, the sides may be exchanged as a whole.
    pub sides_told: bool,
    /// Relative standard deviation common to all lengths, on top of each joint's own; 0 if the size of the body is not
    /// in doubt.
    pub size_sigma: f64,
}

impl Joints {
    /// The position of a joint.
    pub(crate) fn point(&self, joint: Joint) -> Option<Point> {
        self.estimates.get(&joint).map(|estimate| estimate.position.into())
    }
}
