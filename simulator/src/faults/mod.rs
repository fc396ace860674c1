//! What goes wrong between a rig and a recorder, by a script: seeded, so that it goes wrong in the same way again.
//!
//! Three layers, all sans-io: `source` changes what the device says before it is bytes, `wire` the bytes, and
//! `connection` says when there is none. `account` knows what became of every frame. `docs/faults.md` has all
//! keys.

mod account;
mod check;
mod connection;
mod device;
mod expect;
mod fate;
mod fault;
mod keys;
mod kinds;
mod nearest;
mod parts;
mod script;
mod source;
mod wire;

#[cfg(test)]
mod tests;

pub use device::FaultyDevice;
pub use expect::{Agreement, Expect};
pub use fate::{Fate, FaultTotals, FrameFate};
pub use fault::Fault;
pub use keys::{KINDS, Key, KindKeys, TIME_MAX_S, WINDOW};
pub use kinds::{Kind, Kinds};
pub use parts::Parts;
pub use script::{FAULTS_MAX, SCRIPT_BYTES_MAX, Script, ScriptError, Windowed};
pub(crate) use source::SourceFaults;
