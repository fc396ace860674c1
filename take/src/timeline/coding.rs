//! The bytes of a time line: docs/take-format.md, TIMELINE.

use super::{Causes, RowTime, Run, Timeline};
use crate::{TakeError, stretch::ROWS_MAX, varint};

const TICKS_LISTED: u8 = 1;
const TIMECODES_LISTED: u8 = 2;

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
        let listed = times().any(|pair| tick_error(pair) != 0);
        let timecodes = self.times.iter().any(|time| time.timecode.is_some());

        varint::put(out, self.first_row);
        out.push((u8::from(listed) * TICKS_LISTED) | (u8::from(timecodes) * TIMECODES_LISTED));
        varint::put(out, self.runs.len() as u64);
        for run in &self.runs {
            varint::put(out, run.rows << 1 | u64::from(run.lost.is_some()));
            out.extend(run.lost.map(|causes| causes.0));
        }
        let Some(first) = self.times.first() else { return };
        varint::put(out, period);
        varint::put(out, first.device_ticks);
        if listed {
            for pair in times() {
                varint::put(out, varint::zigzag(tick_error(pair)));
            }
        }
        varint::put(out, first.arrival_10us);
        let lateness = |time: &RowTime| {
            let late = time.arrival_10us.wrapping_sub(predict(first, time.device_ticks, tick_hz));
            varint::zigzag(late as i64)
        };
        let width = 64 - self.times[1..].iter().map(lateness).fold(0, |a, b| a | b).leading_zeros();
        out.push(width as u8);
        pack(self.times[1..].iter().map(lateness), width, out);
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
        timeline.first_row.checked_add(timeline.n_rows())?;
        let recorded = timeline.runs.iter().filter(|run| run.lost.is_none());
        let n = recorded.fold(0_u64, |sum, run| sum.saturating_add(run.rows));
        if n > ROWS_MAX {
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
        for (i, pair) in rows.windows(2).enumerate() {
            ticks = ticks.wrapping_add(period.wrapping_mul(pair[1] - pair[0]));
            if flags & TICKS_LISTED != 0 {
                ticks = ticks.wrapping_add(varint::unzigzag(cursor.varint()?) as u64);
            }
            self.times[i + 1].device_ticks = ticks;
        }
        self.times[0].arrival_10us = cursor.varint()?;
        let width = u32::from(cursor.byte()?);
        if width > 64 {
            return None;
        }
        let bytes = cursor.take(((n - 1) as u64 * u64::from(width)).div_ceil(8))?;
        let first = self.times[0];
        for (i, time) in self.times[1..].iter_mut().enumerate() {
            let late = varint::unzigzag(unpack(bytes, i, width)) as u64;
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

/// Packs values of `width` bits, lowest first.
fn pack(values: impl Iterator<Item = u64>, width: u32, out: &mut Vec<u8>) {
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

/// Value `index` of those packed; `bytes` was sized for it.
fn unpack(bytes: &[u8], index: usize, width: u32) -> u64 {
    let from = index * width as usize;
    let mut value = 0_u128;
    for (i, &byte) in bytes[from / 8..].iter().take(9).enumerate() {
        value |= u128::from(byte) << (8 * i);
    }
    let mask = if width == 64 { u64::MAX } else { (1 << width) - 1 };
    (value >> (from % 8)) as u64 & mask
}
