//! TIMELINE: when each row was exposed and when it reached the host, or why it is empty.

use crate::{TakeError, stretch::ROWS_MAX, varint};

/// Why rows are empty: a set, because one stretch of loss can have several causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Causes(pub u8);

impl Causes {
    /// Never arrived: lost on the link, or dropped by the device (the ledger tells which).
    pub const NOT_RECEIVED: Self = Self(1);
    /// Arrived when a ring was full.
    pub const RING_FULL: Self = Self(2);
    /// The device was gone.
    pub const DISCONNECTED: Self = Self(4);
    /// Held markers beyond the channel pool only.
    pub const POOL: Self = Self(8);
    /// The device's clock or counter jumped.
    pub const JUMP: Self = Self(16);

    /// Both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Consecutive rows of one fate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// How many rows.
    pub rows: u64,
    /// Why they are empty; `None` when they were recorded.
    pub lost: Option<Causes>,
}

/// When one recorded row happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowTime {
    /// Device clock at exposure.
    pub device_ticks: u64,
    /// Host monotonic clock at arrival, in units of 10 microseconds.
    pub arrival_10us: u64,
    /// Hours, minutes, seconds, frames.
    pub timecode: Option<[u8; 4]>,
}

/// The rows from one chunk to the next.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Timeline {
    /// First row, recorded or lost.
    pub first_row: u64,
    /// What became of the rows, in order.
    pub runs: Vec<Run>,
    /// The recorded ones.
    pub times: Vec<RowTime>,
}

const TICKS_LISTED: u8 = 1;
const TIMECODES_LISTED: u8 = 2;

impl Timeline {
    /// Empties it for reuse.
    pub fn restart(&mut self, first_row: u64) {
        self.first_row = first_row;
        self.runs.clear();
        self.times.clear();
    }

    /// Adds one recorded row.
    pub fn push(&mut self, time: RowTime) {
        self.extend_run(1, None);
        self.times.push(time);
    }

    /// Adds lost rows.
    pub fn push_lost(&mut self, rows: u64, causes: Causes) {
        self.extend_run(rows, Some(causes));
    }

    /// Rows in all.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.runs.iter().fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// The recorded rows with their numbers.
    pub fn recorded(&self) -> impl Iterator<Item = (u64, RowTime)> + '_ {
        let mut at = self.first_row;
        let rows = self.runs.iter().flat_map(move |run| {
            let first = at;
            at = at.saturating_add(run.rows);
            first..if run.lost.is_none() { at } else { first }
        });
        rows.zip(self.times.iter().copied())
    }

    fn extend_run(&mut self, rows: u64, lost: Option<Causes>) {
        match self.runs.last_mut() {
            Some(last) if last.lost == lost => last.rows += rows,
            _ if rows > 0 => self.runs.push(Run { rows, lost }),
            _ => {}
        }
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    fn jittered(n: u64, listed: bool) -> Timeline {
        let mut timeline = Timeline::default();
        timeline.restart(1000);
        for i in 0..n {
            if i % 7 == 3 {
                timeline.push_lost(i, Causes::NOT_RECEIVED);
                timeline.push_lost(2, Causes::RING_FULL);
            }
            let ticks = 5_000 + timeline.n_rows() * 1_000 + u64::from(listed) * (i * i % 5);
            let arrival_10us = 77 + ticks / 10 + i * 37 % 11;
            timeline.push(RowTime { device_ticks: ticks, arrival_10us, timecode: None });
        }
        timeline
    }

    #[test]
    fn comes_back_and_every_cut_is_seen() {
        for (n, listed) in [(0, false), (1, false), (2, true), (50, false), (50, true)] {
            let timeline = jittered(n, listed);
            let mut out = Vec::new();
            timeline.encode(1_000_000, 1_000.0, &mut out);
            assert_eq!(Timeline::decode(&out, 1_000_000, 0).unwrap(), timeline, "{n} {listed}");
            for cut in 0..out.len() {
                assert!(Timeline::decode(&out[..cut], 1_000_000, 0).is_err(), "{n} {cut}");
            }
        }
    }

    #[test]
    fn wild_clocks_come_back() {
        let mut timeline = Timeline::default();
        timeline.restart(u64::MAX - 10);
        for (device_ticks, arrival_10us) in [(u64::MAX, 5), (0, u64::MAX), (1 << 63, 0), (3, 9)] {
            timeline.push(RowTime { device_ticks, arrival_10us, timecode: Some([1, 2, 3, 4]) });
        }
        let mut out = Vec::new();
        timeline.encode(u64::MAX, 0.001, &mut out);
        assert_eq!(Timeline::decode(&out, u64::MAX, 0).unwrap(), timeline);
    }

    #[test]
    fn a_quiet_second_is_small() {
        let mut timeline = Timeline::default();
        for i in 0..60_u64 {
            timeline.push(RowTime {
                device_ticks: i * 1000,
                arrival_10us: i * 100_000 / 60,
                timecode: None,
            });
        }
        let mut out = Vec::new();
        timeline.encode(60_000, 60.0, &mut out);
        assert!(out.len() < 12, "{}", out.len());
    }

    #[test]
    fn mutations_never_panic() {
        let mut out = Vec::new();
        jittered(30, true).encode(1_000_000, 1_000.0, &mut out);
        for at in 0..out.len() {
            for value in 0..=255 {
                let mut damaged = out.clone();
                damaged[at] = value;
                drop(Timeline::decode(&damaged, 1_000_000, 0));
            }
        }
    }
}
