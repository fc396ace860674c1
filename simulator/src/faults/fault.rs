//! One fault, as scripts write it.

use serde::Deserialize;

use super::kinds::Kind;

/// One fault. `docs/faults.md` says what each does.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[expect(missing_docs, reason = "docs/faults.md has a line for every key, and a test compares")]
pub enum Fault {
    BitFlips {
        rate: f64,
    },
    DroppedBytes {
        rate: f64,
    },
    DoubledBytes {
        rate: f64,
    },
    LostFrames {
        rate: f64,
        #[serde(default = "one")]
        run: u64,
    },
    DoubledFrames {
        rate: f64,
    },
    LateFrames {
        rate: f64,
        by: u32,
    },
    Bursts {
        period_ms: u64,
    },
    Stall {
        at_s: f64,
        for_s: f64,
    },
    ClockDrift {
        ppm: f64,
    },
    ClockJump {
        at_s: f64,
        by_s: f64,
    },
    Unplug {
        at_s: f64,
        for_s: f64,
    },
    PowerLoss {
        at_s: f64,
        for_s: f64,
        #[serde(default)]
        keeps_port: bool,
    },
    Swaps {
        every_s: f64,
        for_s: f64,
    },
    Ghosts {
        count: u16,
    },
    OcclusionStorm {
        part: f64,
        gap_s: f64,
    },
    CounterJump {
        at_s: f64,
        by: i32,
    },
    CounterRepeat {
        rate: f64,
    },
    Garbage {
        bytes: usize,
        #[serde(default = "one")]
        times: u64,
    },
}

fn one() -> u64 {
    1
}

impl Fault {
    /// Its kind.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::BitFlips { .. } => Kind::BitFlips,
            Self::DroppedBytes { .. } => Kind::DroppedBytes,
            Self::DoubledBytes { .. } => Kind::DoubledBytes,
            Self::LostFrames { .. } => Kind::LostFrames,
            Self::DoubledFrames { .. } => Kind::DoubledFrames,
            Self::LateFrames { .. } => Kind::LateFrames,
            Self::Bursts { .. } => Kind::Bursts,
            Self::Stall { .. } => Kind::Stall,
            Self::ClockDrift { .. } => Kind::ClockDrift,
            Self::ClockJump { .. } => Kind::ClockJump,
            Self::Unplug { .. } => Kind::Unplug,
            Self::PowerLoss { .. } => Kind::PowerLoss,
            Self::Swaps { .. } => Kind::Swaps,
            Self::Ghosts { .. } => Kind::Ghosts,
            Self::OcclusionStorm { .. } => Kind::OcclusionStorm,
            Self::CounterJump { .. } => Kind::CounterJump,
            Self::CounterRepeat { .. } => Kind::CounterRepeat,
            Self::Garbage { .. } => Kind::Garbage,
        }
    }
}
