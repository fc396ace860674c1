//! The kinds of faults, and what scripts may say of each.

use serde::Deserialize;

/// A key of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key {
    /// As scripts write it.
    pub name: &'static str,
    /// What its number counts.
    pub unit: &'static str,
    /// The least value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// Whether a script may leave it out.
    pub optional: bool,
}

/// What scripts may say of a kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KindKeys {
    /// The kind.
    pub kind: Kind,
    /// As scripts and logs write it.
    pub name: &'static str,
    /// Its own keys.
    pub keys: &'static [Key],
    /// Whether it lasts from `from_s` to `to_s`.
    pub windowed: bool,
}

/// A day: no script is longer.
pub const TIME_MAX_S: f64 = 86_400.0;

/// The most that anything happens per byte: beyond a tenth no message is whole, and more is a line that is cut.
const BYTE_RATE_MAX: f64 = 0.1;

/// Frames that a late one may be behind: beyond 64 recorders take it for a counter that began anew.
const LATE_FRAMES_MAX: f64 = 60.0;

const fn key(name: &'static str, unit: &'static str, min: f64, max: f64) -> Key {
    Key { name, unit, min, max, optional: false }
}

const fn optional(name: &'static str, unit: &'static str, min: f64, max: f64) -> Key {
    Key { optional: true, ..key(name, unit, min, max) }
}

/// The keys of a windowed kind.
pub const WINDOW: &[Key] =
    &[optional("from_s", "s", 0.0, TIME_MAX_S), optional("to_s", "s", 0.0, TIME_MAX_S)];

const PER_BYTE: Key = key("rate", "per byte", 0.0, BYTE_RATE_MAX);
const PER_FRAME: Key = key("rate", "per frame", 0.0, 1.0);
const AT: Key = key("at_s", "s", 0.0, TIME_MAX_S);
const FOR: Key = key("for_s", "s", 0.001, TIME_MAX_S);

/// Out of one row a kind: a variant of [`Kind`], one of [`Fault`] with a field a key, and a row of [`KINDS`].
macro_rules! kinds {
    ($(
        #[doc = $doc:literal]
        $kind:ident = $name:literal, windowed: $windowed:literal, {
            $($(#[$attribute:meta])? $field:ident: $type:ty = $key:expr),+
        }
    )+) => {
        /// A kind of fault, by its place in [`KINDS`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum Kind {
            $(#[doc = $doc] $kind,)+
        }

        /// One fault, as scripts write it. `docs/faults.md` says what each does.
        #[derive(Debug, Clone, PartialEq, Deserialize)]
        #[serde(tag = "kind", rename_all = "kebab-case")]
        #[expect(missing_docs, reason = "docs/faults.md has a line for every key, and a test compares")]
        pub enum Fault {
            $(#[doc = $doc] $kind { $($(#[$attribute])? $field: $type,)+ },)+
        }

        impl Fault {
            /// Its kind.
            #[must_use]
            pub fn kind(&self) -> Kind {
                match self {
                    $(Self::$kind { .. } => Kind::$kind,)+
                }
            }
        }

        /// Every kind, in the order of [`Kind`].
        pub const KINDS: &[KindKeys] = &[$(
            KindKeys { kind: Kind::$kind, name: $name, keys: &[$($key),+], windowed: $windowed },
        )+];
    };
}

kinds! {
    /// One bit of a byte is the other way round.
    BitFlips = "bit-flips", windowed: true, { rate: f64 = PER_BYTE }
    /// Bytes do not arrive.
    DroppedBytes = "dropped-bytes", windowed: true, { rate: f64 = PER_BYTE }
    /// Bytes arrive twice.
    DoubledBytes = "doubled-bytes", windowed: true, { rate: f64 = PER_BYTE }
    /// Frames do not arrive.
    LostFrames = "lost-frames", windowed: true, {
        rate: f64 = PER_FRAME,
        #[serde(default = "one")] run: u64 = optional("run", "frames", 1.0, 1000.0)
    }
    /// Frames arrive twice.
    DoubledFrames = "doubled-frames", windowed: true, { rate: f64 = PER_FRAME }
    /// Frames arrive behind later ones.
    LateFrames = "late-frames", windowed: true, {
        rate: f64 = PER_FRAME,
        by: u32 = key("by", "frames", 1.0, LATE_FRAMES_MAX)
    }
    /// What waits is handed over once in a while only.
    Bursts = "bursts", windowed: true, { period_ms: u64 = key("period_ms", "ms", 1.0, 1000.0) }
    /// Nothing is handed over for a while.
    Stall = "stall", windowed: false, { at_s: f64 = AT, for_s: f64 = FOR }
    /// The device's clock runs slow or fast.
    ClockDrift = "clock-drift", windowed: true, {
        ppm: f64 = key("ppm", "ppm", -100_000.0, 100_000.0)
    }
    /// The device's clock leaps.
    ClockJump = "clock-jump", windowed: false, {
        at_s: f64 = AT,
        by_s: f64 = key("by_s", "s", -TIME_MAX_S, TIME_MAX_S)
    }
    /// The cable is pulled and put in again; the device goes on.
    Unplug = "unplug", windowed: false, { at_s: f64 = AT, for_s: f64 = FOR }
    /// The device is switched off and on: counter and clock begin anew.
    PowerLoss = "power-loss", windowed: false, {
        at_s: f64 = AT,
        for_s: f64 = FOR,
        #[serde(default)] keeps_port: bool = optional("keeps_port", "bool", 0.0, 1.0)
    }
    /// Two markers change places.
    Swaps = "swaps", windowed: true, {
        every_s: f64 = key("every_s", "s", 0.01, TIME_MAX_S),
        for_s: f64 = FOR
    }
    /// Markers that are not there.
    Ghosts = "ghosts", windowed: true, { count: u16 = key("count", "markers", 1.0, 1000.0) }
    /// Many markers are hidden at once.
    OcclusionStorm = "occlusion-storm", windowed: true, {
        part: f64 = key("part", "of all markers", 0.0, 1.0),
        gap_s: f64 = key("gap_s", "s", 0.001, TIME_MAX_S)
    }
    /// The frame counter leaps, though no frame is missing.
    CounterJump = "counter-jump", windowed: false, {
        at_s: f64 = AT,
        by: i32 = key("by", "frames", -2_147_483_648.0, 2_147_483_647.0)
    }
    /// The frame counter stands still, though a frame was produced.
    CounterRepeat = "counter-repeat", windowed: true, { rate: f64 = PER_FRAME }
    /// Bytes that mean nothing before the device says who it is.
    Garbage = "garbage", windowed: false, {
        bytes: usize = key("bytes", "bytes", 1.0, 65_536.0),
        #[serde(default = "one")] times: u64 = optional("times", "greetings", 1.0, 1000.0)
    }
}

fn one() -> u64 {
    1
}

impl Kind {
    /// As scripts and logs write it.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.get(self as usize).map_or("", |kind| kind.name)
    }

    /// Whether it is counted by how often it happened, and not by frames.
    pub(crate) fn is_of_a_moment(self) -> bool {
        KINDS.get(self as usize).is_some_and(|kind| !kind.windowed)
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
