//! What a take states about its completeness: its ledger as a JSON document, in the API and in the output of commands with
//! `--json`, and its health as a single word, shown by `info`, the service's list, its checks and the dashboard.

use mocapd_take::{
    TakeEnds,
    record::{EndingKind, GroupLedger, Ledger, SampleLedger, TakeEnding},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A ledger in numbers; docs/json.md explains each.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[expect(missing_docs, reason = "docs/json.md, The ledger")]
pub struct LedgerDocument {
    pub finished: bool,
    pub closes: bool,
    pub frames_sent: u64,
    pub recorded: u64,
    pub lost_on_link: u64,
    pub dropped_by_device: u64,
    pub lost_ring_full: u64,
    pub lost_other: u64,
    pub duplicates: u64,
    pub unknown_after_disconnect: u64,
    #[serde(default)]
    pub frame_balance: i64,
    pub samples_announced: u64,
    pub samples_present: u64,
    pub samples_occluded: u64,
    pub samples_not_finite: u64,
    #[serde(default)]
    pub sample_balance: i64,
    pub markers_dropped: u64,
    #[serde(default)]
    pub link_bytes: u64,
    #[serde(default)]
    pub link_bytes_skipped: u64,
    #[serde(default)]
    pub link_messages: u64,
    #[serde(default)]
    pub link_messages_damaged: u64,
    #[serde(default)]
    pub link_messages_unknown: u64,
    pub contradictions: Vec<String>,
    #[serde(default)]
    pub clock: Option<ClockDocument>,
}

/// The device's clock relative to the host's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[expect(missing_docs, reason = "docs/json.md, The ledger")]
pub struct ClockDocument {
    pub drift_ppm: f64,
    pub residual_us: f64,
}

impl LedgerDocument {
    /// Frames that the device produced and the take lacks, by cause.
    #[must_use]
    pub fn frames_lost_by_cause(&self) -> [u64; 5] {
        [
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ]
    }

    /// All frames that the device produced and the take lacks, as far as they are known.
    #[must_use]
    pub fn frames_lost(&self) -> u64 {
        self.frames_lost_by_cause().iter().fold(0, |sum, &n| sum.saturating_add(n))
    }
}

impl From<&Ledger> for LedgerDocument {
    fn from(ledger: &Ledger) -> Self {
        let whole = |balance: i128| i64::try_from(balance).unwrap_or(i64::MAX);
        Self {
            finished: ledger.finished,
            closes: ledger.closes(),
            frames_sent: ledger.frames_sent,
            recorded: ledger.recorded,
            lost_on_link: ledger.lost_on_link,
            dropped_by_device: ledger.dropped_by_device,
            lost_ring_full: ledger.lost_ring_full,
            lost_other: ledger.lost_other,
            duplicates: ledger.duplicates,
            unknown_after_disconnect: ledger.unknown_after_disconnect,
            frame_balance: whole(ledger.frame_balance()),
            samples_announced: ledger.samples_announced,
            samples_present: ledger.samples_present,
            samples_occluded: ledger.samples_occluded,
            samples_not_finite: ledger.samples_not_finite,
            sample_balance: whole(ledger.sample_balance()),
            markers_dropped: ledger.markers_dropped,
            link_bytes: ledger.link_bytes,
            link_bytes_skipped: ledger.link_bytes_skipped,
            link_messages: ledger.link_messages,
            link_messages_damaged: ledger.link_messages_damaged,
            link_messages_unknown: ledger.link_messages_unknown,
            contradictions: ledger.contradictions.clone(),
            clock: ledger.clock.map(|clock| ClockDocument {
                drift_ppm: clock.drift_ppm,
                residual_us: clock.residual_us,
            }),
        }
    }
}

/// The ledger of sampled channels in numbers; docs/json.md explains each.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[expect(missing_docs, reason = "docs/json.md, The ledger of sampled channels")]
pub struct SampleLedgerDocument {
    pub finished: bool,
    pub closes: bool,
    pub batches_refused: u64,
    pub groups: Vec<GroupLedgerDocument>,
}

/// The ledger of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[expect(missing_docs, reason = "docs/json.md, The ledger of sampled channels")]
pub struct GroupLedgerDocument {
    pub group: u32,
    pub taken: u64,
    pub stored: u64,
    pub lost_on_link: u64,
    pub dropped_by_device: u64,
    pub lost_ring_full: u64,
    pub lost_other: u64,
    pub unknown_after_disconnect: u64,
    pub duplicates: u64,
    pub jumps: u64,
}

impl From<&SampleLedger> for SampleLedgerDocument {
    fn from(ledger: &SampleLedger) -> Self {
        Self {
            finished: ledger.finished,
            closes: ledger.groups.iter().all(GroupLedger::closes),
            batches_refused: ledger.batches_refused,
            groups: ledger.groups.iter().map(GroupLedgerDocument::from).collect(),
        }
    }
}

impl From<&GroupLedger> for GroupLedgerDocument {
    fn from(group: &GroupLedger) -> Self {
        Self {
            group: group.group,
            taken: group.taken,
            stored: group.stored,
            lost_on_link: group.lost_on_link,
            dropped_by_device: group.dropped_by_device,
            lost_ring_full: group.lost_ring_full,
            lost_other: group.lost_other,
            unknown_after_disconnect: group.unknown_after_disconnect,
            duplicates: group.duplicates,
            jumps: group.jumps,
        }
    }
}

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
