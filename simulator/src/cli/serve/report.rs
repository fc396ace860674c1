//! What `serve` reports, as JSON (docs/json.md) and as text.

use mocapd_simulator::device::{Fate, FaultTotals, SentLog};
use mocapd_simulator::faults::KINDS;
use serde::Serialize;

use super::DeviceProtocol;

/// The first document: what a host opens.
#[derive(Debug, Serialize)]
pub(super) struct LineReport<'a> {
    /// A path, or the URI of a USB device.
    pub(super) path: &'a str,
}

/// The last document: what was sent.
#[derive(Debug, Serialize)]
pub(super) struct SentReport {
    runs: u64,
    bytes_sent: u64,
    /// `None` for a log, whose frames are not decoded.
    frames: Option<FrameTotals>,
    faults: Option<FaultReport>,
    #[serde(skip)]
    faults_text: Option<String>,
}

#[derive(Debug, Serialize)]
struct FrameTotals {
    produced: u64,
    sent: u64,
    dropped: u64,
    not_sent: u64,
    unasked: u64,
}

#[derive(Debug, Serialize)]
struct FaultReport {
    whole: u64,
    damaged: u64,
    lost: u64,
    late: u64,
    duplicated: u64,
    unasked: u64,
    dropped: u64,
    discarded: u64,
    waiting: u64,
    kinds: Vec<KindReport>,
}

/// A kind of fault that had an effect.
#[derive(Debug, Serialize)]
struct KindReport {
    kind: &'static str,
    /// Damaged and lost frames that it touched.
    frames: u64,
    /// Frames that it affected, or occurrences.
    effects: u64,
}

impl SentReport {
    pub(super) fn new(sent: &SentLog, has_frames: bool) -> Self {
        let frames = FrameTotals {
            produced: sent.total.frames_produced,
            sent: sent.frames_sent,
            dropped: sent.total.frames_dropped,
            not_sent: sent.frames_waiting + sent.frames_discarded,
            unasked: sent.total.frames_unasked,
        };
        Self {
            runs: sent.starts,
            bytes_sent: sent.bytes_sent,
            frames: has_frames.then_some(frames),
            faults: sent.faults.as_ref().map(FaultReport::new),
            faults_text: sent.faults.as_ref().map(FaultTotals::summary),
        }
    }

    /// One line; with faults, two.
    pub(super) fn text(&self, protocol: DeviceProtocol) -> String {
        let runs = format!("{} {}", self.runs, if self.runs == 1 { "run" } else { "runs" });
        let Some(frames) = &self.frames else {
            return format!("{runs}: {} bytes of the log sent", self.bytes_sent);
        };
        let FrameTotals { produced, sent, dropped, not_sent, unasked } = frames;
        let why = match protocol {
            DeviceProtocol::Dvmc => "queue full",
            DeviceProtocol::Ndi => "not fetched before the next",
            DeviceProtocol::Qtm | DeviceProtocol::Lsl => "client too slow",
            DeviceProtocol::Natnet => "too large, or too many wait",
        };
        let mut text = format!(
            "{runs}: {produced} frames produced, {sent} sent in {} bytes, {dropped} dropped by the device ({why}), \
             {not_sent} not sent",
            self.bytes_sent
        );
        if protocol == DeviceProtocol::Ndi {
            text.push_str(&format!(", {unasked} after the last request (unknown to any recorder)"));
        }
        let is_on_network =
            matches!(protocol, DeviceProtocol::Qtm | DeviceProtocol::Natnet | DeviceProtocol::Lsl);
        if is_on_network {
            text.push_str(&format!(", {unasked} that no client requested"));
        }
        if let Some(faults) = &self.faults_text {
            text = format!("{text}\n{faults}");
        }
        text
    }
}

impl FaultReport {
    fn new(totals: &FaultTotals) -> Self {
        let kinds = KINDS.iter().zip(totals.by_kind).map(|(keys, frames)| KindReport {
            kind: keys.name,
            frames,
            effects: totals.counts.of(keys.kind),
        });
        Self {
            whole: totals.of(Fate::Whole),
            damaged: totals.of(Fate::Damaged),
            lost: totals.of(Fate::Lost),
            late: totals.of(Fate::Late),
            duplicated: totals.again,
            unasked: totals.of(Fate::Unasked),
            dropped: totals.of(Fate::Dropped),
            discarded: totals.of(Fate::Discarded),
            waiting: totals.of(Fate::Waiting),
            kinds: kinds.filter(|kind| kind.frames > 0 || kind.effects > 0).collect(),
        }
    }
}
