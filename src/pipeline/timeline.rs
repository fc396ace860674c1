//! The time line's group: one TIMELINE payload a stretch.

use mocapd_take::timeline::Timeline;

use super::{
    PipelineConfig,
    messages::StretchEnd,
    ring::{RingOut, TimelineItem},
};

/// Takes items up to the end of a stretch and codes them.
#[derive(Debug)]
pub(super) struct TimelineCoder {
    ring: RingOut<TimelineItem>,
    timeline: Timeline,
    next_row: u64,
    tick_hz: u64,
    rate_hz: f64,
}

impl TimelineCoder {
    pub(super) fn new(
        ring: RingOut<TimelineItem>,
        config: &PipelineConfig,
        items_max: usize,
    ) -> Self {
        let mut timeline = Timeline::default();
        timeline.runs.reserve(items_max);
        timeline.times.reserve(items_max);
        Self { ring, timeline, next_row: 0, tick_hz: config.tick_hz, rate_hz: config.rate_hz }
    }

    /// Nothing when no row was recorded or lost since the last one.
    pub(super) fn encode(&mut self, end: &StretchEnd, out: &mut Vec<u8>) {
        let end_row = end.span.first_row + u64::from(end.span.n_rows);
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
            self.timeline.encode(self.tick_hz, self.rate_hz, out);
        }
    }
}
