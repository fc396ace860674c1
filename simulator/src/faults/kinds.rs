//! Every kind of fault with its keys: what scripts are checked against, and what `docs/faults.md` tells.

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

const fn windowed(kind: Kind, name: &'static str, keys: &'static [Key]) -> KindKeys {
    KindKeys { kind, name, keys, windowed: true }
}

const fn at_once(kind: Kind, name: &'static str, keys: &'static [Key]) -> KindKeys {
    KindKeys { kind, name, keys, windowed: false }
}

/// The keys of a windowed kind.
pub const WINDOW: &[Key] =
    &[optional("from_s", "s", 0.0, TIME_MAX_S), optional("to_s", "s", 0.0, TIME_MAX_S)];

const PER_BYTE: &[Key] = &[key("rate", "per byte", 0.0, BYTE_RATE_MAX)];
const PER_FRAME: &[Key] = &[key("rate", "per frame", 0.0, 1.0)];
const LOST: &[Key] = &[PER_FRAME[0], optional("run", "frames", 1.0, 1000.0)];
const LATE: &[Key] = &[PER_FRAME[0], key("by", "frames", 1.0, LATE_FRAMES_MAX)];
const BURSTS: &[Key] = &[key("period_ms", "ms", 1.0, 1000.0)];
const AT: Key = key("at_s", "s", 0.0, TIME_MAX_S);
const FOR: Key = key("for_s", "s", 0.001, TIME_MAX_S);
const OUTAGE: &[Key] = &[AT, FOR];
const DRIFT: &[Key] = &[key("ppm", "ppm", -100_000.0, 100_000.0)];
const CLOCK_JUMP: &[Key] = &[AT, key("by_s", "s", -TIME_MAX_S, TIME_MAX_S)];
const POWER: &[Key] = &[AT, FOR, optional("keeps_port", "bool", 0.0, 1.0)];
const SWAPS: &[Key] = &[key("every_s", "s", 0.01, TIME_MAX_S), FOR];
const GHOSTS: &[Key] = &[key("count", "markers", 1.0, 1000.0)];
const STORM: &[Key] =
    &[key("part", "of all markers", 0.0, 1.0), key("gap_s", "s", 0.001, TIME_MAX_S)];
const COUNTER: &[Key] = &[AT, key("by", "frames", -2_147_483_648.0, 2_147_483_647.0)];
const GARBAGE: &[Key] =
    &[key("bytes", "bytes", 1.0, 65_536.0), optional("times", "greetings", 1.0, 1000.0)];

/// Every kind, in the order of [`Kind`].
pub const KINDS: &[KindKeys] = &[
    windowed(Kind::BitFlips, "bit-flips", PER_BYTE),
    windowed(Kind::DroppedBytes, "dropped-bytes", PER_BYTE),
    windowed(Kind::DoubledBytes, "doubled-bytes", PER_BYTE),
    windowed(Kind::LostFrames, "lost-frames", LOST),
    windowed(Kind::DoubledFrames, "doubled-frames", PER_FRAME),
    windowed(Kind::LateFrames, "late-frames", LATE),
    windowed(Kind::Bursts, "bursts", BURSTS),
    at_once(Kind::Stall, "stall", OUTAGE),
    windowed(Kind::ClockDrift, "clock-drift", DRIFT),
    at_once(Kind::ClockJump, "clock-jump", CLOCK_JUMP),
    at_once(Kind::Unplug, "unplug", OUTAGE),
    at_once(Kind::PowerLoss, "power-loss", POWER),
    windowed(Kind::Swaps, "swaps", SWAPS),
    windowed(Kind::Ghosts, "ghosts", GHOSTS),
    windowed(Kind::OcclusionStorm, "occlusion-storm", STORM),
    at_once(Kind::CounterJump, "counter-jump", COUNTER),
    windowed(Kind::CounterRepeat, "counter-repeat", PER_FRAME),
    at_once(Kind::Garbage, "garbage", GARBAGE),
];

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

/// The known word that is meant, when one is near: at most two letters away, or a third of a long word.
#[must_use]
pub(super) fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|name| (distance(word, name), name))
        .filter(|(away, name)| *away <= 2.max(name.len() / 3))
        .min_by_key(|(away, _)| *away)
        .map(|(_, name)| name)
}

/// Letters to change, add or leave out (Levenshtein 1965).
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut before = i;
        row[0] = i + 1;
        for (j, y) in b.chars().enumerate() {
            let changed = before + usize::from(x != y);
            before = row[j + 1];
            row[j + 1] = changed.min(before + 1).min(row[j] + 1);
        }
    }
    row.last().copied().unwrap_or(0)
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

    #[test]
    fn the_nearest_word() {
        assert_eq!(distance("kitten", "sitting"), 3);
        assert_eq!(nearest("rat", ["rate", "run"].into_iter()), Some("rate"));
        assert_eq!(nearest("bitflips", KINDS.iter().map(|k| k.name)), Some("bit-flips"));
        assert_eq!(nearest("seconds", ["rate", "run"].into_iter()), None);
    }
}
