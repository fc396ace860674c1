//! Rows into the rings, and stretches closed.

use std::sync::atomic::Ordering;

use mocapd_take::{
    stretch::{NUMBERS, Span},
    timeline::RowTime,
};

use super::Intake;
use crate::pipeline::{
    messages::StretchEnd,
    plan::RUNS_MAX,
    ring::{RingIn, Sample, TimelineItem},
};

impl Intake {
    /// Closes the open stretch when the rows lost before this frame do not fit into it.
    pub(super) fn make_way(&mut self) {
        let left = u64::from(self.open_limit - self.open_rows);
        if self.open_rows > 0 && self.pending.rows() >= left {
            self.close_stretch();
        }
    }

    /// Whether this frame, and the lost rows before it that belong into the open stretch, fit.
    pub(super) fn has_room(&mut self) -> bool {
        self.has_room_for(1 + if self.open_rows > 0 { self.pending.rows() as usize } else { 0 })
    }

    /// Whether so many rows fit.
    pub(super) fn has_room_for(&mut self, rows: usize) -> bool {
        if self.room < rows {
            let active = &self.rings[..self.n_channels];
            self.room = active.iter().map(RingIn::room).min().unwrap_or(usize::MAX);
        }
        // What is pending, this row, and what may be pending at the end.
        self.room >= rows && self.timeline.room() > 2 * RUNS_MAX
    }

    pub(super) fn push_row(&mut self, time: RowTime) {
        if self.open_rows > 0 {
            for _ in 0..self.pending.rows() {
                self.push_samples(|_| Sample::default());
                self.open_rows += 1;
            }
        }
        self.push_pending();
        if self.open_rows == 0 {
            self.open_first_row = self.next_row;
        }
        let mut present = 0;
        self.push_samples(|sample| {
            present += u64::from(sample.present);
            std::mem::take(sample)
        });
        self.timeline.push(TimelineItem::Recorded(time));
        self.open_rows += 1;
        self.next_row += 1;
        self.counts.recorded += 1;
        self.counts.samples_announced += self.n_channels as u64;
        self.counts.samples_present += present;
        self.progress.frames.store(self.counts.recorded, Ordering::Relaxed);
    }

    fn push_samples(&mut self, mut take: impl FnMut(&mut Sample) -> Sample) {
        for (ring, sample) in self.rings[..self.n_channels].iter_mut().zip(&mut self.row) {
            ring.push(take(sample));
        }
        self.room = self.room.saturating_sub(1);
    }

    pub(super) fn push_pending(&mut self) {
        self.next_row += self.pending.rows();
        for (rows, causes) in self.pending.drain() {
            self.timeline.push(TimelineItem::Lost { rows, causes });
        }
        self.progress.lost.store(self.counts.lost(), Ordering::Relaxed);
    }

    pub(super) fn close_stretch(&mut self) {
        if self.open_rows > 0 {
            self.end_stretch(self.open_rows, false);
            self.open_rows = 0;
            self.open_limit = self.stretch_rows;
        }
    }

    /// Rows that were lost since the last recorded one, as a stretch of their own: they are the account's of whatever
    /// take ends here.
    pub(super) fn close_pending(&mut self) {
        if self.pending.rows() == 0
            || self.counts.recorded == 0
            || self.timeline.room() <= 3 * RUNS_MAX
        {
            return;
        }
        self.push_pending();
        let span = Span { first_row: self.next_row, n_rows: 0, key: false, number: 0 };
        self.send(self.end_of(span, 0, false));
    }

    pub(super) fn end_stretch(&mut self, n_rows: u32, last: bool) {
        let first_row = if n_rows > 0 { self.open_first_row } else { self.next_row };
        // The next stretch would begin too late.
        let key = first_row.saturating_add(u64::from(self.stretch_rows)) > self.next_key_row;
        if key {
            self.next_key_row = first_row.saturating_add(self.key_every);
        }
        let number = (self.feed.next_stretch() % u64::from(NUMBERS)) as u8;
        let span = Span { first_row, n_rows, key, number };
        self.send(self.end_of(span, 0, last));
    }

    /// A boundary between two stretches, sent the way that they go.
    pub(super) fn end_boundary(&mut self, boundary: u64) {
        let span = Span { first_row: self.next_row, n_rows: 0, key: false, number: 0 };
        self.send(self.end_of(span, boundary, false));
    }

    fn end_of(&self, span: Span, boundary: u64, last: bool) -> StretchEnd {
        StretchEnd {
            span,
            first: self.open_first,
            last_arrival_ns: self.last_arrival_ns,
            boundary,
            n_channels: self.n_channels,
            last,
        }
    }

    fn send(&mut self, end: StretchEnd) {
        let fill = |ring: &RingIn<Sample>| ring.fill_permille();
        let fullest = self.rings[..self.n_channels].iter().map(fill).max().unwrap_or(0);
        self.progress.ring_fill_permille.store(fullest, Ordering::Relaxed);
        if !self.feed.end_stretch(end, self.counts()) {
            self.progress.failed.store(true, Ordering::Relaxed);
        }
    }
}
