//! What scripts may say of each kind of fault, as a table.

use super::kinds::Kind;

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
