//! EVENT: what happened beside the motion.

use bincode::{Decode, Encode};

use super::Record;
use crate::chunk::types;

/// What kind of thing happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum EventKind {
    /// The operator marked a moment.
    Mark,
    /// A trigger input of the device.
    Trigger,
    /// A sync pulse of the device.
    SyncPulse,
    /// The device said something.
    Device,
    /// The host noticed something: disconnected, reconnected, a counter that jumped.
    Host,
}

impl EventKind {
    /// In words.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Mark => "mark",
            Self::Trigger => "trigger",
            Self::SyncPulse => "sync pulse",
            Self::Device => "device",
            Self::Host => "host",
        }
    }

    /// By its word.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        let all = [Self::Mark, Self::Trigger, Self::SyncPulse, Self::Device, Self::Host];
        all.into_iter().find(|kind| kind.word() == word)
    }
}

/// One event.
#[derive(Debug, Clone, PartialEq, Eq, Encode, Decode)]
pub struct Event {
    /// What kind.
    pub kind: EventKind,
    /// The row being recorded then.
    pub row: u64,
    /// Device clock, in ticks; 0 when the device did not say.
    pub device_ticks: u64,
    /// Host monotonic clock, in nanoseconds.
    pub host_ns: u64,
    /// Which input.
    pub input: u8,
    /// In words.
    pub text: String,
}

impl Record for Event {
    const NAME: &'static str = "event";
    const KIND: u8 = types::EVENT;
    const VERSION: u16 = 1;
}
