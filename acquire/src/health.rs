//! The health of a take as a single word, shown by `info`, the service's list, its checks and the dashboard.

use mocapd_take::{
    TakeEnds,
    record::{EndingKind, Ledger, SampleLedger, TakeEnding},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The state of a take's content.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum TakeHealth {
    /// The file is intact and no frame is missing.
    Complete,
    /// The file is intact, but frames are missing: its last ledger says so, or the device was disconnected.
    Lossy,
    /// Some bytes are wrong, or the take contradicts itself.
    Damaged,
    /// The end is missing: `mocapd recover` turns it into a complete take.
    #[serde(rename = "cut off")]
    CutOff,
    /// It cannot be read.
    Unreadable,
    /// Not checked.
    #[default]
    #[serde(other)]
    Unknown,
}

impl TakeHealth {
    /// All states.
    pub const ALL: [Self; 6] =
        [Self::Unknown, Self::Complete, Self::Lossy, Self::Damaged, Self::CutOff, Self::Unreadable];

    /// The name of the state in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Lossy => "lossy",
            Self::Damaged => "damaged",
            Self::CutOff => "cut off",
            Self::Unreadable => "unreadable",
            Self::Unknown => "unknown",
        }
    }

    /// The health of a take that was closed and is not damaged.
    #[must_use]
    pub fn of_closed(
        ledger: &Ledger,
        samples: Option<&SampleLedger>,
        ending: Option<&TakeEnding>,
    ) -> Self {
        // What a disconnected device did not send, or what followed a cut, cannot be counted.
        let cut_short = [EndingKind::DeviceGone, EndingKind::CutOff, EndingKind::Truncated];
        let is_cut_short = ending.is_some_and(|ending| cut_short.contains(&ending.kind));
        let lacks_samples = samples.is_some_and(SampleLedger::lost_anything);
        let is_whole =
            ledger.closes() && !ledger.lost_anything() && !lacks_samples && !is_cut_short;
        if is_whole { Self::Complete } else { Self::Lossy }
    }

    /// The health according to the beginning and the end of a take. Damage in between is not seen.
    #[must_use]
    pub fn of_ends(ends: &TakeEnds) -> Self {
        let Some(end) = &ends.end else { return Self::CutOff };
        let (samples, ending) = (end.sample_ledger.as_ref(), end.ending.as_ref());
        end.ledger.as_ref().map_or(Self::Damaged, |l| Self::of_closed(l, samples, ending))
    }
}
