//! The kinds of faults.

use super::keys::KINDS;

/// A kind of fault, by its place in [`KINDS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Kind {
    /// One bit of a byte is the other way round.
    BitFlips,
    /// Bytes do not arrive.
    DroppedBytes,
    /// Bytes arrive twice.
    DoubledBytes,
    /// Frames do not arrive.
    LostFrames,
    /// Frames arrive twice.
    DoubledFrames,
    /// Frames arrive behind later ones.
    LateFrames,
    /// What waits is handed over once in a while only.
    Bursts,
    /// Nothing is handed over for a while.
    Stall,
    /// The device's clock runs slow or fast.
    ClockDrift,
    /// The device's clock leaps.
    ClockJump,
    /// The cable is pulled and put in again; the device goes on.
    Unplug,
    /// The device is switched off and on: counter and clock begin anew.
    PowerLoss,
    /// Two markers change places.
    Swaps,
    /// Markers that are not there.
    Ghosts,
    /// Many markers are hidden at once.
    OcclusionStorm,
    /// The frame counter leaps, though no frame is missing.
    CounterJump,
    /// The frame counter stands still, though a frame was produced.
    CounterRepeat,
    /// Bytes that mean nothing before the device says who it is.
    Garbage,
}

impl Kind {
    /// As scripts and logs write it.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.get(self as usize).map_or("", |kind| kind.name)
    }
}

/// A few kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Kinds(u32);

const _: () = assert!(KINDS.len() <= 32);

impl Kinds {
    /// Just this one.
    #[must_use]
    pub fn of(kind: Kind) -> Self {
        Self(1 << kind as u8)
    }

    /// These and those.
    pub fn add(&mut self, more: Self) {
        self.0 |= more.0;
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Each of them.
    pub fn iter(self) -> impl Iterator<Item = Kind> {
        KINDS.iter().map(|keys| keys.kind).filter(move |kind| self.0 >> *kind as u8 & 1 == 1)
    }

    /// Their names, with `+` in between.
    #[must_use]
    pub fn names(self) -> String {
        self.iter().map(Kind::name).collect::<Vec<_>>().join("+")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_stand_at_their_places() {
        for (index, keys) in KINDS.iter().enumerate() {
            assert_eq!(keys.kind as usize, index, "{}", keys.name);
            assert_eq!(keys.kind.name(), keys.name);
        }
        let mut kinds = Kinds::of(Kind::Unplug);
        kinds.add(Kinds::of(Kind::BitFlips));
        assert_eq!(kinds.names(), "bit-flips+unplug");
    }
}
