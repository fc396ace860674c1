//! What runs on from row to row, and how each is coded: docs/take-format.md, "The time line".

use mocapd_codec::range::BinaryCoder;

use super::{
    RowTime,
    line::{Line, SHIFT_MAX},
    number::Number,
    pace::{Pace, Period},
    timecode::Timecodes,
};
use crate::varint;

/// What runs on from row to row, over stretches, up to the next key stretch.
#[derive(Debug)]
pub(super) struct State {
    last_row: u64,
    pace: Pace,
    line: Line,
    errors: Number,
    timecodes: Timecodes,
}

/// What a key stretch states of its first recorded row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchor {
    pub(super) shift: u8,
    pub(super) period: Period,
    pub(super) ticks: u64,
    pub(super) arrival_10us: u64,
}

impl State {
    /// Before any row: everything is an error from zero.
    pub(super) fn nothing_known(tick_hz: u64) -> Self {
        Self {
            last_row: 0,
            pace: Pace::still(),
            line: Line::new(tick_hz, 0, 0, 0),
            errors: Number::new(4),
            timecodes: Timecodes::new(),
        }
    }

    pub(super) fn at(anchor: &Anchor, row: u64, tick_hz: u64) -> Option<Self> {
        if anchor.shift > SHIFT_MAX {
            return None;
        }
        Some(Self {
            last_row: row,
            pace: Pace::new(anchor.period, anchor.ticks)?,
            line: Line::new(tick_hz, anchor.shift, anchor.ticks, anchor.arrival_10us),
            ..Self::nothing_known(tick_hz)
        })
    }

    /// Encodes the time of `row` and gives it back as a decoder will have it, or gives the decoded one.
    fn row(&mut self, coder: &mut impl BinaryCoder, row: u64, time: RowTime) -> RowTime {
        let rows = row.wrapping_sub(std::mem::replace(&mut self.last_row, row));
        let predicted = self.pace.predict(rows);
        let error = time.device_ticks.wrapping_sub(predicted).cast_signed();
        let error = self.errors.code(coder, error);
        self.pace.correct(error);
        let device_ticks = predicted.wrapping_add_signed(error);
        let arrival_10us = self.line.code(coder, rows, device_ticks, time.arrival_10us);
        RowTime { device_ticks, arrival_10us, timecode: self.timecodes.code(coder, time.timecode) }
    }

    /// All rows of a stretch. The times of the anchored row are those of the anchor.
    pub(super) fn rows(
        &mut self,
        coder: &mut impl BinaryCoder,
        anchored: bool,
        rows: impl Iterator<Item = (u64, RowTime)>,
        mut give: impl FnMut(RowTime),
    ) {
        for (i, (row, time)) in rows.enumerate() {
            give(if anchored && i == 0 {
                RowTime { timecode: self.timecodes.code(coder, time.timecode), ..time }
            } else {
                self.row(coder, row, time)
            });
        }
    }
}

impl Anchor {
    pub(super) fn put(&self, out: &mut Vec<u8>) {
        out.push(self.shift);
        varint::put(out, self.period.rows);
        varint::put(out, self.period.ticks);
        varint::put(out, self.ticks);
        varint::put(out, self.arrival_10us);
    }

    pub(super) fn take(cursor: &mut varint::Cursor<'_>) -> Option<Self> {
        let shift = cursor.byte()?;
        let (rows, period_ticks) = (cursor.varint()?, cursor.varint()?);
        let (ticks, arrival_10us) = (cursor.varint()?, cursor.varint()?);
        Some(Self { shift, period: Period { ticks: period_ticks, rows }, ticks, arrival_10us })
    }

    /// Bytes of the anchor and the coded times at the front of `cursor`, passed over.
    fn pass(cursor: &mut varint::Cursor<'_>, key: bool) -> Option<()> {
        if key {
            Self::take(cursor)?;
        }
        cursor.varint().and_then(|n| cursor.take(n)).map(drop)
    }
}

/// What [`TimelineEncoder::encode`] wrote, cut off the front of `cursor`.
pub(crate) fn take_times<'a>(cursor: &mut varint::Cursor<'a>, key: bool) -> Option<&'a [u8]> {
    let all = cursor.rest();
    Anchor::pass(cursor, key)?;
    all.get(..all.len() - cursor.rest().len())
}
