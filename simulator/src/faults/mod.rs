//! Scripted fault injection between a device and a recorder. A script has a seed, so a run can be repeated exactly.
//!
//! Three layers, all sans-io: `source` changes motion, counter and clock before frames are encoded, `wire` damages the
//! encoded bytes, and `device` stalls or cuts the link. `fates` tracks what became of every frame.
//! `docs/faults.md` lists all keys.

mod device;
mod fates;
mod kinds;
mod script;
mod source;
mod wire;

#[cfg(test)]
mod tests;

pub use crate::device::{BatchFate, Fate, FaultCounts, FaultTotals, FrameFate};
pub use device::FaultyDevice;
pub(crate) use device::{ConnectionFaults, ConnectionState};
pub use kinds::{Fault, KINDS, KeySpec, Kind, KindSpec, Kinds, TIME_MAX_S, WINDOW};
pub use script::{
    ExpectedRecording, FAULTS_MAX, LedgerMatch, SCRIPT_BYTES_MAX, ScheduledFault, Script,
    ScriptError,
};
pub(crate) use source::{SourceFaults, stream};
