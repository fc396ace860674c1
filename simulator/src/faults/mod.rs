//! Scripted fault injection between a device and a recorder: the kinds of faults, and the keys that scripts give them. A
//! script has a seed, so a run can be repeated exactly.
//!
//! Three layers, all sans-io: `source` changes motion, counter and clock before frames are encoded, `wire` damages the
//! encoded bytes, and `device` stalls or cuts the link. `fates` tracks what became of every frame.
//! `docs/faults.md` lists all keys.

mod device;
mod fates;
mod script;
mod source;
mod wire;

#[cfg(test)]
mod tests;

use serde::Deserialize;

pub use crate::device::{BatchFate, Fate, FaultCounts, FaultTotals, FrameFate};
pub use device::FaultyDevice;
pub(crate) use device::{ConnectionFaults, ConnectionState};
pub use script::{
    ExpectedRecording, FAULTS_MAX, LedgerMatch, SCRIPT_BYTES_MAX, ScheduledFault, Script,
    ScriptError,
};
pub(crate) use source::{SourceFaults, stream};

/// One key of a fault table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeySpec {
    /// Its name in scripts.
    pub name: &'static str,
    /// Unit of its value.
    pub unit: &'static str,
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// Whether scripts may omit it.
    pub optional: bool,
}

/// A kind of fault and its keys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KindSpec {
    /// The kind.
    pub kind: Kind,
    /// Its name in scripts and logs.
    pub name: &'static str,
    /// Its keys, without `kind` and the window.
    pub keys: &'static [KeySpec],
    /// Whether it has a window, `from_s` to `to_s`.
    pub windowed: bool,
}

/// The latest time in a script, seconds: one day.
pub const TIME_MAX_S: f64 = 86_400.0;

/// Highest fault rate per byte. Beyond a tenth no message arrives whole, which `unplug` simulates better.
const BYTE_RATE_MAX: f64 = 0.1;

/// Maximum number of frames by which a frame can be late: beyond 64 a recorder assumes that the counter restarted.
const LATE_FRAMES_MAX: f64 = 60.0;

const fn key(name: &'static str, unit: &'static str, min: f64, max: f64) -> KeySpec {
    KeySpec { name, unit, min, max, optional: false }
}

const fn optional(name: &'static str, unit: &'static str, min: f64, max: f64) -> KeySpec {
    KeySpec { optional: true, ..key(name, unit, min, max) }
}

/// The window keys that windowed kinds have in addition to their own.
pub const WINDOW: &[KeySpec] =
    &[optional("from_s", "s", 0.0, TIME_MAX_S), optional("to_s", "s", 0.0, TIME_MAX_S)];

const PER_BYTE: KeySpec = key("rate", "per byte", 0.0, BYTE_RATE_MAX);
const PER_FRAME: KeySpec = key("rate", "per frame", 0.0, 1.0);
const AT: KeySpec = key("at_s", "s", 0.0, TIME_MAX_S);
const FOR: KeySpec = key("for_s", "s", 0.001, TIME_MAX_S);

/// Expands one row per kind into a variant of [`Kind`], a variant of [`Fault`] with a field per key, and a row of
/// [`KINDS`].
macro_rules! kinds {
    ($(
        #[doc = $doc:literal]
        $kind:ident = $name:literal, windowed: $windowed:literal, {
            $($(#[$attribute:meta])? $field:ident: $type:ty = $key:expr),+
        }
    )+) => {
        /// A kind of fault; its discriminant is its index in [`KINDS`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum Kind {
            $(#[doc = $doc] $kind,)+
        }

        /// One fault of a script. `docs/faults.md` describes each.
        #[derive(Debug, Clone, PartialEq, Deserialize)]
        #[serde(tag = "kind", rename_all = "kebab-case")]
        #[expect(missing_docs, reason = "docs/faults.md has a line for every key, and a test compares")]
        pub enum Fault {
            $(#[doc = $doc] $kind { $($(#[$attribute])? $field: $type,)+ },)+
        }

        impl Fault {
            /// The kind of this fault.
            #[must_use]
            pub fn kind(&self) -> Kind {
                match self {
                    $(Self::$kind { .. } => Kind::$kind,)+
                }
            }
        }

        /// Every kind, in the order of [`Kind`].
        pub const KINDS: &[KindSpec] = &[$(
            KindSpec { kind: Kind::$kind, name: $name, keys: &[$($key),+], windowed: $windowed },
        )+];
    };
}

kinds! {
    /// One bit of a byte is inverted.
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
    /// Frames arrive after later ones.
    LateFrames = "late-frames", windowed: true, {
        rate: f64 = PER_FRAME,
        by: u32 = key("by", "frames", 1.0, LATE_FRAMES_MAX)
    }
    /// Waiting bytes are handed over once per period only.
    Bursts = "bursts", windowed: true, { period_ms: u64 = key("period_ms", "ms", 1.0, 1000.0) }
    /// Nothing is handed over for a while.
    Stall = "stall", windowed: false, { at_s: f64 = AT, for_s: f64 = FOR }
    /// The device's clock runs slow or fast.
    ClockDrift = "clock-drift", windowed: true, {
        ppm: f64 = key("ppm", "ppm", -100_000.0, 100_000.0)
    }
    /// The device's clock jumps.
    ClockJump = "clock-jump", windowed: false, {
        at_s: f64 = AT,
        by_s: f64 = key("by_s", "s", -TIME_MAX_S, TIME_MAX_S)
    }
    /// Time stamps of frames are early, each by another time.
    StampJitter = "stamp-jitter", windowed: true, { ms: u64 = key("ms", "ms", 0.0, 1000.0) }
    /// The cable is pulled and plugged in again; the device keeps running.
    Unplug = "unplug", windowed: false, { at_s: f64 = AT, for_s: f64 = FOR }
    /// The device loses its power: counter and clock restart.
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
    /// Unlabelled markers appear where there are none.
    Ghosts = "ghosts", windowed: true, { count: u16 = key("count", "markers", 1.0, 1000.0) }
    /// Many markers are hidden at once.
    OcclusionStorm = "occlusion-storm", windowed: true, {
        part: f64 = key("part", "of all markers", 0.0, 1.0),
        gap_s: f64 = key("gap_s", "s", 0.001, TIME_MAX_S)
    }
    /// The frame counter jumps although no frame is missing.
    CounterJump = "counter-jump", windowed: false, {
        at_s: f64 = AT,
        by: i32 = key("by", "frames", -2_147_483_648.0, 2_147_483_647.0)
    }
    /// The frame counter repeats a number although a frame was produced.
    CounterRepeat = "counter-repeat", windowed: true, { rate: f64 = PER_FRAME }
    /// NatNet: definitions are not sent for a while. QTM: the last label is missing for a while.
    LateModel = "late-model", windowed: false, { for_s: f64 = FOR }
    /// NatNet and QTM: the last labelled marker gets another name.
    ModelChange = "model-change", windowed: false, { at_s: f64 = AT }
    /// NatNet: frames and definitions change to another bitstream.
    BitstreamChange = "bitstream-change", windowed: false, {
        at_s: f64 = AT,
        major: u8 = key("major", "version", 2.0, 4.0),
        minor: u8 = key("minor", "version", 0.0, 11.0)
    }
    /// NatNet: frames arrive in front of the reply to a client's first message.
    EarlyFrames = "early-frames", windowed: false, {
        count: u32 = key("count", "frames", 1.0, 1000.0)
    }
    /// QTM: a packet states a false size, and nothing follows until the client connects again.
    BrokenPacket = "broken-packet", windowed: false, { at_s: f64 = AT }
    /// Random bytes arrive before the device's Hello.
    Garbage = "garbage", windowed: false, {
        bytes: usize = key("bytes", "bytes", 1.0, 65_536.0),
        #[serde(default = "one")] times: u64 = optional("times", "Hellos", 1.0, 1000.0)
    }
}

fn one() -> u64 {
    1
}

impl Kind {
    /// Its name in scripts and logs.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.get(self as usize).map_or("", |kind| kind.name)
    }

    /// Whether only NatNet has it.
    #[must_use]
    pub fn is_of_natnet(self) -> bool {
        matches!(self, Self::BitstreamChange | Self::EarlyFrames)
    }

    /// Whether only systems on the network have it.
    #[must_use]
    pub fn is_of_network(self) -> bool {
        self.is_of_natnet()
            || matches!(self, Self::LateModel | Self::ModelChange | Self::BrokenPacket)
    }

    /// Whether its occurrences are counted, not the frames that it affected.
    pub(crate) fn is_counted_by_occurrence(self) -> bool {
        KINDS.get(self as usize).is_some_and(|kind| !kind.windowed)
    }
}

/// A set of kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Kinds(u32);

const _: () = assert!(KINDS.len() <= 32);

impl Kinds {
    /// The set of one kind.
    #[must_use]
    pub fn of(kind: Kind) -> Self {
        Self(1 << kind as u8)
    }

    /// Adds all kinds of another set.
    pub fn add(&mut self, more: Self) {
        self.0 |= more.0;
    }

    /// Whether the set is empty.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The kinds in the set, in the order of [`KINDS`].
    pub fn iter(self) -> impl Iterator<Item = Kind> {
        KINDS.iter().map(|keys| keys.kind).filter(move |kind| self.0 >> *kind as u8 & 1 == 1)
    }

    /// Their names, joined by `+`.
    #[must_use]
    pub fn names(self) -> String {
        self.iter().map(Kind::name).collect::<Vec<_>>().join("+")
    }
}
