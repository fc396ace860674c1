//! Bytes to time lines.

use mocapd_codec::range::RangeDecoder;

use super::{
    RowTime, Timeline,
    state::{Anchor, State},
};
use crate::varint;

/// Reads the time lines of a take's stretches, in order.
#[derive(Debug)]
pub(crate) struct TimelineDecoder {
    tick_hz: u64,
    state: State,
}

impl TimelineDecoder {
    pub(crate) fn new(tick_hz: u64) -> Self {
        Self { tick_hz, state: State::nothing_known(tick_hz) }
    }

    /// Fills the times of `timeline`, whose runs are known. Unless `key`, the stretch before must have been
    /// decoded. `None` when the bytes cannot be such times.
    pub(crate) fn decode(
        &mut self,
        timeline: &mut Timeline,
        key: bool,
        times: &[u8],
    ) -> Option<()> {
        if key {
            self.state = State::nothing_known(self.tick_hz);
        }
        let n = timeline.n_recorded();
        if n == 0 {
            return times.is_empty().then_some(());
        }
        let mut cursor = varint::Cursor::new(times);
        timeline.times.resize(usize::try_from(n).ok()?, RowTime::default());
        if key {
            let anchor = Anchor::take(&mut cursor)?;
            self.state = State::at(&anchor, first_row(timeline), self.tick_hz)?;
            timeline.times[0].device_ticks = anchor.ticks;
            timeline.times[0].arrival_10us = anchor.arrival_10us;
        }
        let mut coder = RangeDecoder::new(cursor.varint().and_then(|n| cursor.take(n))?);
        let mut decoded = Vec::with_capacity(timeline.times.len());
        self.state.rows(&mut coder, key, timeline.recorded(), |time| decoded.push(time));
        timeline.times = decoded;
        (coder.finish().is_ok() && cursor.is_empty()).then_some(())
    }
}

fn first_row(timeline: &Timeline) -> u64 {
    timeline.recorded().next().map_or(timeline.first_row, |(row, _)| row)
}
