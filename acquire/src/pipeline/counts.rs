//! The reader's counters, and the ledger made from them.

use mocapd_drivers::device::{LinkCounters, Status};
use mocapd_take::record::Ledger;

use crate::clock::ClockStatus;

/// The reader's counters. `Copy`: a snapshot travels with every stretch, so that the ledger of a killed take is true
/// for the content of the take.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Counts {
    /// Frames in the rings.
    pub recorded: u64,
    /// Rows skipped by the device's counter.
    pub not_received: u64,
    /// Frames that arrived when a ring was full.
    pub ring_full: u64,
    /// Rows missing while the device was disconnected: by its counter, or by the host's clock if the counter started
    /// again.
    pub lost_in_outages: u64,
    /// Disconnections with missing rows.
    pub outages: u32,
    /// Frames received twice, or older than the last one.
    pub duplicates: u64,
    /// Samples of announced markers in recorded frames, present or not.
    pub samples_announced: u64,
    /// Samples with a position.
    pub samples_present: u64,
    /// Samples received as NaN or infinity.
    pub samples_not_finite: u64,
    /// Markers that were not announced at the start, and got a channel when they appeared.
    pub markers_appeared: u64,
    /// Samples of markers beyond the channel pool.
    pub markers_dropped: u64,
    /// Jumps of the device's counter that no loss explains: too far, or further than its own clock allows.
    pub counter_jumps: u64,
    /// Times that the device's clock went back.
    pub clock_jumps: u64,
    /// Events that found the writer's queue full.
    pub events_dropped: u64,
    /// Batches of sampled channels that were not announced at the start, or that do not fit their announcement.
    pub batches_refused: u64,
    /// Counters of the link decoder.
    pub link: LinkCounters,
    /// The device's last status report, extended to all its frames, including those before an outage.
    pub status: Option<Status>,
    /// Frames that the device's reports do not include: those counted before it was last started, and those that were
    /// due in a silence and not produced.
    pub reports_offset: u64,
    /// Rows missing before the first frame after an outage that the new reports include as well, because the device was
    /// already running.
    pub reported_twice: u64,
    /// Frames that the device dropped before it was last started, by its own account.
    pub dropped_before: u64,
    /// For a take that began while the device ran: frames missing before it that no report had mentioned by then, so
    /// that a later report may.
    pub dropped_late_max: u64,
    /// Whether `status` is the device's final report, after a stop.
    pub ended: bool,
    /// Whether no more frames will be accepted.
    pub closed: bool,
    /// A number of produced frames that no device can have reached.
    pub impossible_produced: Option<u64>,
    /// The state of the clocks.
    pub clock: ClockStatus,
    /// Lost frames whose rows come with the next recorded one.
    pub pending: PendingRows,
}

/// Rows lost since the last recorded one, by counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PendingRows {
    /// Included in [`Counts::not_received`].
    pub not_received: u64,
    /// Included in [`Counts::ring_full`].
    pub ring_full: u64,
    /// Included in [`Counts::lost_in_outages`].
    pub in_outages: u64,
}

impl Counts {
    /// Frames produced according to the device's counter.
    #[must_use]
    pub fn seen(&self) -> u64 {
        self.recorded + self.lost()
    }

    /// Frames produced that are not in the take.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.not_received + self.ring_full + self.lost_in_outages
    }

    /// Accepts a status report. `early`: before the first frame after an outage, which alone connects its numbers to
    /// the earlier ones.
    ///
    /// Returns whether the rows contain all frames that it reports as produced.
    pub(super) fn status(&mut self, status: Status, early: bool) -> bool {
        let reports_offset = if early { self.seen() } else { self.reports_offset };
        let mut frames_produced = status.frames_produced.saturating_add(reports_offset);
        if !early {
            // What it produced beyond the frames seen was lost before the first of them, or just now: the smallest
            // excess in any report was lost before.
            self.reported_twice =
                self.reported_twice.min(frames_produced.saturating_sub(self.seen()));
            frames_produced -= self.reported_twice;
        }
        self.status = Some(Status {
            frames_produced,
            frames_dropped: status.frames_dropped.saturating_add(self.dropped_before),
            ..status
        });
        frames_produced <= self.seen()
    }

    /// Counts rows missing because the device was disconnected. How many of them its reports include is not known yet.
    pub(super) fn lost_to_outage(&mut self, rows: u64) {
        self.lost_to_silence(rows);
        self.reported_twice = rows;
    }

    /// Counts rows that were due in a continuing silence, by the host's clock.
    pub(super) fn lost_to_silence(&mut self, rows: u64) {
        self.lost_in_outages += rows;
        self.outages += u32::from(rows > 0);
    }

    /// Counts rows of a silence that were never produced: the device's reports leave them out.
    pub(super) fn not_produced(&mut self, rows: u64) {
        self.reports_offset += rows;
    }

    /// Starts a new series of reports: the device is started again after an outage.
    pub(super) fn rejoin(&mut self) {
        self.dropped_before = self.status.map_or(self.dropped_before, |s| s.frames_dropped);
        // Frames that it reported and that never arrived are missing when its counter continues.
        self.status = None;
    }

    /// The counters of the rows up to the last recorded one: those of a take that ends here. A take that begins here
    /// has the rest.
    pub(super) fn in_rows(&self) -> Self {
        let PendingRows { not_received, ring_full, in_outages } = self.pending;
        Self {
            not_received: self.not_received.saturating_sub(not_received),
            ring_full: self.ring_full.saturating_sub(ring_full),
            lost_in_outages: self.lost_in_outages.saturating_sub(in_outages),
            outages: self.outages.saturating_sub(u32::from(in_outages > 0)),
            pending: PendingRows::default(),
            ..*self
        }
    }

    /// The counters since `base`, the counters at the beginning of a take.
    pub(super) fn since(&self, base: &Self) -> Self {
        let dropped_base = base.status.map_or(base.dropped_before, |status| status.frames_dropped);
        let status = self.status.map(|status| Status {
            frames_produced: status.frames_produced.saturating_sub(base.seen()),
            frames_dropped: status.frames_dropped.saturating_sub(dropped_base),
            ..status
        });
        let (link, link_base) = (self.link, base.link);
        let missing_base = base.not_received + base.lost_in_outages;
        Self {
            recorded: self.recorded - base.recorded,
            not_received: self.not_received - base.not_received,
            ring_full: self.ring_full - base.ring_full,
            lost_in_outages: self.lost_in_outages - base.lost_in_outages,
            outages: self.outages - base.outages,
            duplicates: self.duplicates - base.duplicates,
            samples_announced: self.samples_announced - base.samples_announced,
            samples_present: self.samples_present - base.samples_present,
            samples_not_finite: self.samples_not_finite - base.samples_not_finite,
            markers_appeared: self.markers_appeared - base.markers_appeared,
            markers_dropped: self.markers_dropped - base.markers_dropped,
            counter_jumps: self.counter_jumps - base.counter_jumps,
            clock_jumps: self.clock_jumps - base.clock_jumps,
            events_dropped: self.events_dropped - base.events_dropped,
            batches_refused: self.batches_refused - base.batches_refused,
            link: LinkCounters {
                bytes: link.bytes - link_base.bytes,
                bytes_skipped: link.bytes_skipped - link_base.bytes_skipped,
                messages: link.messages - link_base.messages,
                messages_damaged: link.messages_damaged - link_base.messages_damaged,
                messages_unknown: link.messages_unknown - link_base.messages_unknown,
                samples_not_finite: link.samples_not_finite - link_base.samples_not_finite,
            },
            status,
            reports_offset: self.reports_offset.saturating_sub(base.seen()),
            reported_twice: self.reported_twice,
            dropped_before: self.dropped_before.saturating_sub(dropped_base),
            dropped_late_max: missing_base.saturating_sub(dropped_base),
            ended: self.ended,
            closed: self.closed,
            impossible_produced: self.impossible_produced,
            clock: self.clock,
            pending: self.pending,
        }
    }

    /// The ledger of these counters. It closes, or states why not.
    #[must_use]
    pub fn ledger(&self, finished: bool) -> Ledger {
        let mut contradictions = Vec::new();
        let seen = self.seen();
        // A report is older than the frames after it: only the final one is compared with the counter.
        let reported = self.status.map_or(0, |status| status.frames_produced);
        if self.ended && self.status.is_some() && reported < seen {
            contradictions.push(format!(
                "the device reports {reported} frames produced, but its frame counter shows {seen}"
            ));
        }
        if let Some(produced) = self.impossible_produced {
            contradictions.push(format!("the device reports {produced} frames produced"));
        }
        let unseen = if self.closed { reported.saturating_sub(seen) } else { 0 };
        let frames_sent = seen + unseen;
        // Without a final report it is unknown whether they were sent, lost or dropped.
        let unknown_after_disconnect = self.lost_in_outages + if self.ended { 0 } else { unseen };
        let missing = frames_sent - self.recorded - self.ring_full - unknown_after_disconnect;
        let dropped = self.status.map_or(self.dropped_before, |status| status.frames_dropped);
        // It is unknown how many frames of an outage the device dropped.
        let may_be = missing.saturating_add(self.lost_in_outages);
        if self.ended && dropped > may_be.saturating_add(self.dropped_late_max) {
            contradictions.push(format!(
                "the device reports {dropped} frames dropped, but only {missing} are missing"
            ));
        }
        if self.counter_jumps > 0 {
            contradictions.push(format!(
                "the device's frame counter jumped {}, which lost frames do not explain",
                count_text(self.counter_jumps)
            ));
        }
        if self.clock_jumps > 0 {
            let times = count_text(self.clock_jumps);
            contradictions.push(format!("the device's clock went back {times}"));
        }
        let n = self.events_dropped;
        if n > 0 {
            let events = if n == 1 { "1 event is".to_owned() } else { format!("{n} events are") };
            contradictions.push(format!("{events} missing from the take: the disk stalled, or more than a thousand came at once"));
        }
        let dropped_by_device = dropped.min(missing);
        Ledger {
            finished,
            frames_sent,
            recorded: self.recorded,
            lost_on_link: missing - dropped_by_device,
            dropped_by_device,
            lost_ring_full: self.ring_full,
            lost_other: 0,
            duplicates: self.duplicates,
            unknown_after_disconnect,
            samples_announced: self.samples_announced,
            samples_present: self.samples_present,
            samples_occluded: self.samples_announced - self.samples_present,
            samples_not_finite: self.samples_not_finite + self.link.samples_not_finite,
            markers_dropped: self.markers_dropped,
            link_bytes: self.link.bytes,
            link_bytes_skipped: self.link.bytes_skipped,
            link_messages: self.link.messages,
            link_messages_damaged: self.link.messages_damaged,
            link_messages_unknown: self.link.messages_unknown,
            contradictions,
            clock: self.clock.ledger(),
        }
    }
}

fn count_text(n: u64) -> String {
    if n == 1 { "once".to_owned() } else { format!("{n} times") }
}
