//! The map of a closed take from its end alone, for a take of which only a window is read, over a network.

use std::{
    io::{Read, Seek, SeekFrom},
    ops::Range,
};

use super::{TakeMap, open::ChunkCursor};
use crate::{
    TakeError,
    chunk::types,
    record::{Ledger, Record, SummaryRecord},
};

/// What the end of a closed take states: the header and the channels, the key stretches, the last ledger.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeTail {
    /// The take, without what is stated elsewhere: events, subject, clock lines, foreign parts.
    pub map: TakeMap,
    /// File offset after the last stretch.
    stretches_end: u64,
}

impl TakeTail {
    /// Reads the end of a take: some kilobytes of most takes. `None` for a take that was cut off, or whose end states
    /// neither header nor channels, as in takes of earlier versions: [`TakeMap::open`] reads those.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when this build cannot use the header, `Io`.
    pub fn read(input: &mut (impl Read + Seek)) -> Result<Option<Self>, TakeError> {
        let file_bytes = input.seek(SeekFrom::End(0))?;
        let mut chunks = ChunkCursor::new(input);
        let Some((footer, keys)) = chunks.end(file_bytes)? else { return Ok(None) };
        if footer.ledger_offset >= footer.index_offset {
            return Ok(None);
        }
        chunks.go_to(footer.ledger_offset)?;
        let Some(ledger) = chunks.record(types::LEDGER)? else { return Ok(None) };
        let Ok(ledger) = Ledger::from_payload(&ledger, footer.ledger_offset) else {
            return Ok(None);
        };
        let Some(summary) = chunks.record(types::SUMMARY)? else { return Ok(None) };
        let Ok(summary) = SummaryRecord::from_payload(&summary, footer.ledger_offset) else {
            return Ok(None);
        };
        let Some(header) = summary.header else { return Ok(None) };
        header.check()?;
        let order = summary.order.unwrap_or_default();
        // The header has the markers that appeared later, too.
        if order.n_channels() > header.channels.len() {
            return Ok(None);
        }
        let mut map = TakeMap {
            channels: header.channels.clone(),
            header: *header,
            n_rows: footer.n_rows,
            keys,
            ledger: Some(ledger),
            ending: summary.ending,
            statistics: summary.statistics,
            finished: true,
            order,
            ..TakeMap::default()
        };
        map.restore_order();
        let tail = Self { map, stretches_end: footer.ledger_offset };
        Ok(tail.is_sound().then_some(tail))
    }

    /// Whether the parts agree with each other.
    fn is_sound(&self) -> bool {
        let keys = &self.map.keys;
        let in_order = keys.is_sorted_by(|a, b| a.first_row < b.first_row && a.offset < b.offset);
        in_order
            && self.map.has_plausible_rows()
            && keys.last().is_none_or(|last| last.offset < self.stretches_end)
    }

    /// The bytes of the file that hold `rows`: first those that are likely to be enough, then the others up to the next
    /// key stretch. Where within its key stretches a row is stored is known only by reading them; a reader stops when it
    /// has the rows.
    #[must_use]
    pub fn window(&self, rows: &Range<u64>) -> [Range<u64>; 2] {
        let keys = &self.map.keys;
        let key_of = |row: u64| keys.partition_point(|key| key.first_row <= row).saturating_sub(1);
        // Whatever is asked for, and whatever a damaged take states, the window is of rows that there are.
        let last_row = rows.end.min(self.map.n_rows).saturating_sub(1).max(rows.start);
        let (first, last) = (key_of(rows.start), key_of(last_row));
        let (Some(first), Some(key)) = (keys.get(first), keys.get(last)) else {
            return [0..0, 0..0];
        };
        let next = keys.get(last + 1);
        let end = next.map_or(self.stretches_end, |next| next.offset);
        let end_row = next.map_or(self.map.n_rows, |next| next.first_row);
        let held = end_row.saturating_sub(key.first_row).max(1);
        // Rows are read up to the end of their stretch; a key stretch has about twice the bytes of another one.
        let stretch_rows = u64::from(self.map.header.stretch_rows).max(1);
        let needed =
            last_row.saturating_add(1).saturating_sub(key.first_row).div_ceil(stretch_rows);
        let needed = needed.saturating_add(1).saturating_mul(stretch_rows).min(held);
        let share = needed as f64 / held as f64 * LIKELY_FACTOR;
        let likely = (end.saturating_sub(key.offset) as f64 * share.min(1.0)).ceil() as u64;
        let likely = key.offset.saturating_add(likely).min(end);
        [first.offset..likely, likely..end]
    }
}

/// By how much the bytes of a window may exceed those of an average one of its rows before a second range is needed.
const LIKELY_FACTOR: f64 = 1.15;

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    const TAKE: &[u8] = include_bytes!("../../tests/golden/v6/fast-1mm.mtake");

    #[test]
    fn the_end_of_a_take_states_the_order_of_its_markers() {
        let take = include_bytes!("../../tests/golden/v6/dense-order.mtake");
        let map = TakeMap::open(&mut Cursor::new(take)).unwrap();
        let tail = TakeTail::read(&mut Cursor::new(take)).unwrap().map(|tail| tail.map);
        let stated =
            |map: &TakeMap| (map.order.clone(), map.channels.clone(), map.statistics.clone());
        assert!(!map.order.is_identity());
        assert_eq!(tail.as_ref().map(stated), Some(stated(&map)));
    }

    #[test]
    fn a_window_of_any_rows_is_in_the_take() {
        let Some(mut tail) = TakeTail::read(&mut Cursor::new(TAKE)).unwrap() else {
            panic!("the take has no summary")
        };
        let n_rows = tail.map.n_rows;
        let rows = [0, 1, n_rows - 1, n_rows, n_rows + 1, u64::MAX - 1, u64::MAX];
        for stretch_rows in [0, 1, tail.map.header.stretch_rows, u32::MAX] {
            tail.map.header.stretch_rows = stretch_rows;
            for (first, end) in rows.iter().flat_map(|&first| rows.map(|end| (first, end))) {
                let [likely, rest] = tail.window(&(first..end));
                assert!(likely.start <= likely.end && likely.end <= rest.end, "{first}..{end}");
                assert!(rest.end <= TAKE.len() as u64, "{first}..{end}: {rest:?}");
            }
        }
    }
}
