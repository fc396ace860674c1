//! Time lines to bytes.

use mocapd_codec::range::RangeEncoder;

use super::{
    Timeline,
    pace::{Pace, Period},
    state::{Anchor, State},
};
use crate::varint;

/// Steps of arrivals that the writer chooses from, as powers of two of 10 us: 160, 320 and 640 us. The
/// longest that is not above a sixteenth of the period: batches and frames held back show, and half a
/// step is below what a serial or USB line leaves of the true time anyway.
const SHIFTS: [u8; 3] = [6, 5, 4];

/// Codes the time lines of a take's stretches, in order.
#[derive(Debug)]
pub struct TimelineEncoder {
    tick_hz: u64,
    nominal: Period,
    /// Of the arrivals' step.
    pub(super) shift: u8,
    state: State,
    /// First and last recorded row since the last key stretch, and their ticks.
    measured: Option<((u64, u64), (u64, u64))>,
    coded: Vec<u8>,
}

impl TimelineEncoder {
    /// For a device with so many ticks (0 counts as 1) and rows a second.
    #[must_use]
    pub fn new(tick_hz: u64, rate_hz: f64) -> Self {
        let longest = |shift: &u8| (1 << shift) as f64 * rate_hz * 16.0 <= 100_000.0;
        Self {
            tick_hz,
            nominal: Period::of_rate(tick_hz, rate_hz),
            shift: SHIFTS.into_iter().find(longest).unwrap_or(SHIFTS[2]),
            state: State::nothing_known(tick_hz),
            measured: None,
            coded: Vec::new(),
        }
    }

    /// Makes room for stretches of so many recorded rows, so that coding need not:
    /// 16 bytes are more than clocks and arrivals take that are not noise of hours.
    pub fn reserve(&mut self, n_rows: usize) {
        self.coded.reserve(n_rows.saturating_mul(16));
    }

    /// Appends the anchor of a key stretch, the length of the coded times, and these; nothing without a
    /// recorded row.
    pub(crate) fn encode(&mut self, timeline: &Timeline, key: bool, out: &mut Vec<u8>) {
        if key {
            self.state = State::nothing_known(self.tick_hz);
        }
        let Some((row, time)) = timeline.recorded().next() else { return };
        if key {
            let anchor = Anchor {
                shift: self.shift,
                period: self.period(timeline),
                ticks: time.device_ticks,
                arrival_10us: time.arrival_10us,
            };
            self.measured = None;
            if let Some(state) = State::at(&anchor, row, self.tick_hz) {
                self.state = state;
            }
            anchor.put(out);
        }
        self.coded.clear();
        let mut coder = RangeEncoder::new(&mut self.coded, usize::MAX);
        self.state.rows(&mut coder, key, timeline.recorded(), |_| {});
        // Never over a limit that is none.
        let _fits = coder.finish();
        varint::put(out, self.coded.len() as u64);
        out.extend_from_slice(&self.coded);
        let first = self.measured.map_or((row, time.device_ticks), |measured| measured.0);
        let last = timeline.recorded().last().map(|(row, time)| (row, time.device_ticks));
        self.measured = last.map(|last| (first, last));
    }

    /// Of what the device's rate says, and what was measured since the last key stretch and over this one,
    /// the period that is wrong in the fewest rows.
    fn period(&self, timeline: &Timeline) -> Period {
        let ends = timeline.recorded().next().zip(timeline.recorded().last());
        let here = ends.and_then(|(first, last)| {
            Period::between((first.0, first.1.device_ticks), (last.0, last.1.device_ticks))
        });
        let before = self.measured.and_then(|(first, last)| Period::between(first, last));
        let wrong = |period: &Period| {
            let mut rows = timeline.recorded();
            let (Some(first), mut n_wrong) = (rows.next(), 0) else { return 0 };
            let Some(mut pace) = Pace::new(*period, first.1.device_ticks) else {
                return usize::MAX;
            };
            let mut last_row = first.0;
            for (row, time) in rows {
                let predicted = pace.predict(row - std::mem::replace(&mut last_row, row));
                let error = time.device_ticks.wrapping_sub(predicted).cast_signed();
                n_wrong += usize::from(error != 0);
                pace.correct(error);
            }
            n_wrong
        };
        // The first of equals.
        let candidates = [Some(self.nominal), before, here];
        candidates.into_iter().flatten().min_by_key(wrong).unwrap_or(self.nominal)
    }
}
