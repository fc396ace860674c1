//! Poses of a synthetic body, as joint angles of the limbs.

/// Pose of a synthetic body. No limb touches another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pose {
    /// Arms and legs spread halfway.
    A,
    /// Arms out to the sides.
    T,
    /// Arms at the sides, a hand's breadth from the trunk.
    Down,
    /// In stride: one arm and the other leg forward.
    Walk,
    /// Knees deeply bent, arms forward.
    Squat,
    /// Seated, as on a chair, with the forearms forward.
    Sit,
    /// Arms overhead.
    Up,
}

/// Joint angles of one limb, degrees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    /// Flexion of the upper segment, from down towards forward.
    pub(super) swing: f64,
    /// Abduction of the upper segment, from down to the side.
    pub(super) spread: f64,
    /// Flexion of elbow (forward) or knee (backward).
    pub(super) bend: f64,
}

const fn limb(swing: f64, spread: f64, bend: f64) -> Limb {
    Limb { swing, spread, bend }
}

impl Pose {
    /// All poses.
    pub const ALL: [Self; 7] =
        [Self::A, Self::T, Self::Down, Self::Walk, Self::Squat, Self::Sit, Self::Up];

    /// Angles of the left and right arm.
    pub(super) fn arms(self) -> [Limb; 2] {
        match self {
            Self::A => [limb(0.0, 45.0, 12.0); 2],
            Self::T => [limb(0.0, 88.0, 6.0); 2],
            Self::Down => [limb(2.0, 20.0, 8.0); 2],
            Self::Walk => [limb(32.0, 22.0, 35.0), limb(-28.0, 22.0, 18.0)],
            Self::Squat => [limb(80.0, 18.0, 15.0); 2],
            Self::Sit => [limb(12.0, 28.0, 85.0); 2],
            Self::Up => [limb(0.0, 150.0, 12.0); 2],
        }
    }

    /// Angles of the left and right leg.
    pub(super) fn legs(self) -> [Limb; 2] {
        match self {
            Self::A => [limb(0.0, 12.0, 4.0); 2],
            Self::T | Self::Down | Self::Up => [limb(2.0, 8.0, 5.0); 2],
            Self::Walk => [limb(-18.0, 6.0, 22.0), limb(26.0, 6.0, 10.0)],
            Self::Squat => [limb(88.0, 28.0, 100.0); 2],
            Self::Sit => [limb(85.0, 12.0, 85.0); 2],
        }
    }
}
