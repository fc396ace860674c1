//! What goes wrong between a rig and a recorder, by a script: seeded, so that it goes wrong in the same way again.
//!
//! Three layers, all sans-io: `source` changes what the device says before it is bytes, `wire` the bytes, and
//! `connection` says when there is none. `account` knows what became of every frame. `docs/faults.md` has all
//! keys.

mod account;
mod connection;
mod device;
mod kinds;
mod script;
mod source;
mod wire;

#[cfg(test)]
mod tests;

pub use crate::device::{Fate, FaultTotals, FrameFate, Parts};
pub use device::FaultyDevice;
pub use kinds::{Fault, KINDS, Key, Kind, KindKeys, Kinds, TIME_MAX_S, WINDOW};
pub use script::{Agreement, Expect, FAULTS_MAX, SCRIPT_BYTES_MAX, Script, ScriptError, Windowed};
pub(crate) use source::SourceFaults;
