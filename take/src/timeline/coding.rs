//! The bytes of a time line: docs/take-format.md, TIMELINE.

use super::{Causes, RowTime, Run, Timeline};
use crate::{TakeError, varint};

const TIMECODES_LISTED: u8 = 1;

/// Most recorded rows of one chunk: ten times half a second at 10 kHz, a megabyte and a half in memory.
const RECORDED_MAX: u64 = 1 << 16;

/// Most rows of one run: days at 10 kHz.
const RUN_ROWS_MAX: u64 = 1 << 32;

impl Timeline {
    /// Appends the payload of its chunk. `tick_hz` is the device's; 0 counts as 1.
    pub fn encode(&self, tick_hz: u64, rate_hz: f64, out: &mut Vec<u8>) {
        let tick_hz = tick_hz.max(1);
        let period = (tick_hz as f64 / rate_hz).round() as u64;
        let times = || self.recorded().zip(self.recorded().skip(1));
        let tick_error = |(a, b): ((u64, RowTime), (u64, RowTime))| {
            let expected = a.1.device_ticks.wrapping_add(period.wrapping_mul(b.0 - a.0));
            b.1.device_ticks.wrapping_sub(expected) as i64
        };
        let timecodes = self.times.iter().any(|time| time.timecode.is_some());

        varint::put(out, self.first_row);
        out.push(u8::from(timecodes) * TIMECODES_LISTED);
        varint::put(out, self.runs.len() as u64);
        for run in &self.runs {
            varint::put(out, (run.rows << 1) | u64::from(run.lost.is_some()));
            out.extend(run.lost.map(|causes| causes.0));
        }
        let Some(first) = self.times.first() else { return };
        varint::put(out, period);
        varint::put(out, first.device_ticks);
        pack(times().map(|pair| varint::zigzag(tick_error(pair))), out);
        varint::put(out, first.arrival_10us);
        let lateness = |time: &RowTime| {
            let late = time.arrival_10us.wrapping_sub(predict(first, time.device_ticks, tick_hz));
            varint::zigzag(late as i64)
        };
        pack(self.times[1..].iter().map(lateness), out);
        if timecodes {
            out.extend(self.times.iter().flat_map(|time| time.timecode.unwrap_or_default()));
        }
    }

    /// From the payload of a chunk at file offset `offset`.
    ///
    /// # Errors
    /// `Corrupt`.
    pub fn decode(payload: &[u8], tick_hz: u64, offset: u64) -> Result<Self, TakeError> {
        Self::parse(payload, tick_hz.max(1)).ok_or_else(|| TakeError::Corrupt {
            what: "timeline",
            offset,
            message: "its rows do not fill it".into(),
        })
    }

    fn parse(payload: &[u8], tick_hz: u64) -> Option<Self> {
        let mut cursor = varint::Cursor::new(payload);
        let mut timeline = Self { first_row: cursor.varint()?, ..Self::default() };
        let flags = cursor.byte()?;
        for _ in 0..cursor.varint()? {
            let head = cursor.varint()?;
            let lost = if head & 1 == 1 { Some(Causes(cursor.byte()?)) } else { None };
            timeline.runs.push(Run { rows: head >> 1, lost });
        }
        if timeline.runs.iter().any(|run| run.rows > RUN_ROWS_MAX) {
            return None;
        }
        timeline.first_row.checked_add(timeline.n_rows())?;
        let recorded = timeline.runs.iter().filter(|run| run.lost.is_none());
        let n = recorded.fold(0_u64, |sum, run| sum.saturating_add(run.rows));
        if n > RECORDED_MAX {
            return None;
        }
        if n > 0 {
            timeline.parse_times(&mut cursor, flags, n as usize, tick_hz)?;
        }
        cursor.is_empty().then_some(timeline)
    }

    fn parse_times(
        &mut self,
        cursor: &mut varint::Cursor<'_>,
        flags: u8,
        n: usize,
        tick_hz: u64,
    ) -> Option<()> {
        let period = cursor.varint()?;
        let mut ticks = cursor.varint()?;
        self.times.resize(n, RowTime::default());
        let rows: Vec<u64> = self.recorded().map(|(row, _)| row).collect();
        self.times[0].device_ticks = ticks;
        let errors = Packed::take(cursor, n - 1)?;
        for (i, pair) in rows.windows(2).enumerate() {
            let error = varint::unzigzag(errors.get(i)) as u64;
            ticks = ticks.wrapping_add(period.wrapping_mul(pair[1] - pair[0])).wrapping_add(error);
            self.times[i + 1].device_ticks = ticks;
        }
        self.times[0].arrival_10us = cursor.varint()?;
        let arrivals = Packed::take(cursor, n - 1)?;
        let first = self.times[0];
        for (i, time) in self.times[1..].iter_mut().enumerate() {
            let late = varint::unzigzag(arrivals.get(i)) as u64;
            time.arrival_10us = predict(&first, time.device_ticks, tick_hz).wrapping_add(late);
        }
        if flags & TIMECODES_LISTED != 0 {
            for time in &mut self.times {
                time.timecode = Some(*cursor.take(4)?.first_chunk()?);
            }
        }
        Some(())
    }
}

/// When a row with these ticks would arrive if the line were as quick as for the first one.
fn predict(first: &RowTime, ticks: u64, tick_hz: u64) -> u64 {
    let passed = i128::from(ticks.wrapping_sub(first.device_ticks) as i64) * 100_000;
    first.arrival_10us.wrapping_add(passed.div_euclid(i128::from(tick_hz)) as u64)
}

/// Appends the width of the widest value in bits, then the values, lowest bit first.
fn pack(values: impl Iterator<Item = u64> + Clone, out: &mut Vec<u8>) {
    let width = 64 - values.clone().fold(0, |a, b| a | b).leading_zeros();
    out.push(width as u8);
    let (mut held, mut n_held) = (0_u128, 0);
    for value in values {
        held |= u128::from(value) << n_held;
        n_held += width;
        while n_held >= 8 {
            out.push(held as u8);
            held >>= 8;
            n_held -= 8;
        }
    }
    if n_held > 0 {
        out.push(held as u8);
    }
}

/// Values as [`pack`] left them.
struct Packed<'a> {
    bytes: &'a [u8],
    width: u32,
}

impl<'a> Packed<'a> {
    fn take(cursor: &mut varint::Cursor<'a>, n: usize) -> Option<Self> {
        let width = u32::from(cursor.byte()?);
        if width > 64 {
            return None;
        }
        Some(Self { bytes: cursor.take((n as u64 * u64::from(width)).div_ceil(8))?, width })
    }

    /// Below the number that it was taken for.
    fn get(&self, index: usize) -> u64 {
        let from = index * self.width as usize;
        let mut value = 0_u128;
        for (i, &byte) in self.bytes[from / 8..].iter().take(9).enumerate() {
            value |= u128::from(byte) << (8 * i);
        }
        let mask = if self.width == 64 { u64::MAX } else { (1 << self.width) - 1 };
        (value >> (from % 8)) as u64 & mask
    }
}
