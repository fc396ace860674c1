//! The phases of a jump, after Shi et al. (2012).

/// A phase of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Phase {
    /// Standing still before the first swing; not one of the paper's phases.
    Standing,
    /// Preparatory swings of the arms.
    Swings,
    /// The last swing back into the crouch, with its pause.
    LastSwing,
    /// From the crouch to leaving the ground.
    TakeOff,
    /// From leaving the ground to touching it.
    Flight,
    /// Absorbing the landing and standing up.
    Settling,
    /// Slow walking.
    Walking,
}

impl Phase {
    /// All phases, in the order of a trial.
    pub const ALL: [Self; 7] = [
        Self::Standing,
        Self::Swings,
        Self::LastSwing,
        Self::TakeOff,
        Self::Flight,
        Self::Settling,
        Self::Walking,
    ];

    /// The name in tables and phase files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Standing => "standing",
            Self::Swings => "swings",
            Self::LastSwing => "last swing",
            Self::TakeOff => "take-off",
            Self::Flight => "flight-landing",
            Self::Settling => "settling",
            Self::Walking => "walking",
        }
    }

    /// The phase with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|phase| phase.name() == name)
    }
}
