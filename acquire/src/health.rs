//! How a take is, in one word: the same in `info`, the service's list, its checks and the dashboard.

use mocapd_take::{
    TakeEnds,
    record::{EndingKind, Ledger, TakeEnding},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What is known of a take's content.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum TakeHealth {
    /// Nothing is missing from it.
    Complete,
    /// The file is whole, and frames are missing: its last ledger says so, or the device went away.
    Lossy,
    /// Bytes of it are wrong, or it contradicts itself.
    Damaged,
    /// Its end is missing: `mocapd recover` makes a whole take of it.
    #[serde(rename = "cut off")]
    CutOff,
    /// It cannot be read.
    Unreadable,
    /// Not looked at.
    #[default]
    #[serde(other)]
    Unknown,
}

impl TakeHealth {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Unknown, Self::Complete, Self::Lossy, Self::Damaged, Self::CutOff, Self::Unreadable];

    /// As it is written in documents.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Lossy => "lossy",
            Self::Damaged => "damaged",
            Self::CutOff => "cut off",
            Self::Unreadable => "unreadable",
            Self::Unknown => "unknown",
        }
    }

    /// Of a take that was closed and is not damaged.
    #[must_use]
    pub fn of_closed(ledger: &Ledger, ending: Option<&TakeEnding>) -> Self {
        // What a device that is gone did not send any more, and what stood behind a cut, nobody can count.
        let is_cut_short = ending.is_some_and(|ending| {
            matches!(
                ending.kind,
                EndingKind::DeviceGone | EndingKind::CutOff | EndingKind::Truncated
            )
        });
        let is_whole = ledger.closes() && !ledger.lost_anything() && !is_cut_short;
        if is_whole { Self::Complete } else { Self::Lossy }
    }

    /// As far as the two ends of a take tell: what is damaged between them they do not.
    #[must_use]
    pub fn of_ends(ends: &TakeEnds) -> Self {
        match &ends.end {
            None => Self::CutOff,
            Some(end) => match &end.ledger {
                Some(ledger) => Self::of_closed(ledger, end.ending.as_ref()),
                None => Self::Damaged,
            },
        }
    }
}
