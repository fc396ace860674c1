//! The time line's group: one front a stretch, with the times of its rows.

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::{
    record::Header,
    stretch::FrontWriter,
    timeline::{Timeline, TimelineEncoder},
};

use super::{
    messages::StretchEnd,
    ring::{RingOut, TimelineItem},
};

/// Takes items up to the end of a stretch and codes them.
#[derive(Debug)]
pub(super) struct TimelineCoder {
    ring: RingOut<TimelineItem>,
    timeline: Timeline,
    next_row: u64,
    front: FrontWriter,
}

impl TimelineCoder {
    pub(super) fn new(ring: RingOut<TimelineItem>, header: &Header, items_max: usize) -> Self {
        // A reader has the header and nothing else.
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz);
        let mut times = TimelineEncoder::new(tick_hz, header.rate_hz);
        times.reserve(items_max);
        let mut timeline = Timeline::default();
        timeline.runs.reserve(items_max);
        timeline.times.reserve(items_max);
        let front = FrontWriter::with_times(header.stretch_rows, times);
        Self { ring, timeline, next_row: 0, front }
    }

    /// Nothing when no row was recorded or lost since the last one.
    pub(super) fn encode(&mut self, end: &StretchEnd, out: &mut Vec<u8>) {
        let end_row = end.span.end_row();
        self.timeline.restart(self.next_row);
        while self.next_row < end_row {
            let Some(item) = self.ring.pop() else { break };
            match item {
                TimelineItem::Recorded(time) => {
                    self.timeline.push(time);
                    self.next_row += 1;
                }
                TimelineItem::Lost { rows, causes } => {
                    self.timeline.push_lost(rows, causes);
                    self.next_row += rows;
                }
            }
        }
        if self.timeline.n_rows() > 0 {
            let alone = end.n_channels <= GROUP_CHANNELS;
            self.front.put(end.span, &self.timeline, &[], alone, out);
        }
    }
}
