//! ORDER: the source's order of the markers of an import whose encoder coded them in another one.
//!
//! The channel table of such a take is in coding order, and so is everything in it that belongs to markers by their
//! row. Readers put both back into the order of the source: docs/take-format.md, "ORDER".

use std::ops::Range;

use mocapd_codec::GROUP_CHANNELS;

use crate::{
    TakeError,
    record::{Channel, Header, section_content},
    statistics::TakeStatistics,
    stretch::CHANNELS_MAX,
    varint,
};

const NAME: &str = "order";

/// The only version of the chunk, and of the section of SUMMARY.
const VERSION: u16 = 1;

/// Why a chunk or section is no order of the markers of a take.
const NO_ORDER: &str = "it is no order of the markers of the header";

/// Places of the rows of a channel table in the order of the source. A group of channels has the same markers in both
/// orders; rows behind those that are listed have the same place in both.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChannelOrder {
    /// By row of the table: the column in the source.
    columns: Vec<u16>,
    /// By column in the source: the row of the table.
    rows: Vec<u16>,
}

impl ChannelOrder {
    /// The order of a table whose rows have these columns in the source; `None` unless every group of channels has the
    /// same markers in both orders.
    #[must_use]
    pub fn from_columns(columns: Vec<u16>) -> Option<Self> {
        const NONE: u16 = u16::MAX;
        let mut rows = vec![NONE; columns.len()];
        for (row, &column) in columns.iter().enumerate() {
            let column = usize::from(column);
            let place = rows.get_mut(column).filter(|place| **place == NONE)?;
            if column / GROUP_CHANNELS != row / GROUP_CHANNELS {
                return None;
            }
            *place = u16::try_from(row).ok().filter(|&row| row != NONE)?;
        }
        Some(Self { columns, rows })
    }

    /// Number of rows that are listed.
    #[must_use]
    pub fn n_channels(&self) -> usize {
        self.columns.len()
    }

    /// The order of a table of `n_channels` channels; further ones have the same place in both orders.
    #[must_use]
    pub(crate) fn extended(&self, n_channels: usize) -> Self {
        let further =
            (self.columns.len()..n_channels).filter_map(|place| u16::try_from(place).ok());
        let extended = |places: &[u16]| places.iter().copied().chain(further.clone()).collect();
        Self { columns: extended(&self.columns), rows: extended(&self.rows) }
    }

    /// Whether the table is in the order of the source.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        self.columns.iter().zip(0..).all(|(&column, row): (_, u16)| column == row)
    }

    /// The row of the table with this column of the source.
    #[must_use]
    pub fn row_of(&self, column: usize) -> usize {
        self.rows.get(column).map_or(column, |&row| row.into())
    }

    /// The column in the source of this row of the table.
    #[must_use]
    pub fn column_of(&self, row: usize) -> usize {
        self.columns.get(row).map_or(row, |&column| column.into())
    }

    /// The order from the source to the table.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { columns: self.rows.clone(), rows: self.columns.clone() }
    }

    /// Puts what a table has by row into the order of the source.
    pub fn restore<T: Clone>(&self, of_rows: &mut [T]) {
        permute(of_rows, &self.rows);
    }

    /// Puts what the source has by column into the order of the table.
    pub fn apply<T: Clone>(&self, of_columns: &mut [T]) {
        permute(of_columns, &self.columns);
    }

    /// Puts a channel table into the order of the source. Marker ids stay at their places: those of an import are the
    /// numbers of its columns.
    pub fn restore_table(&self, table: &mut [Channel]) {
        keep_ids(table, |table| self.restore(table));
    }

    /// Puts the channels of the source into the order of the table, as [`restore_table`](Self::restore_table) reads it.
    pub fn apply_to_table(&self, channels: &mut [Channel]) {
        keep_ids(channels, |channels| self.apply(channels));
    }

    /// Puts the figures of channels into the order of the source.
    pub(crate) fn restore_statistics(&self, statistics: &mut TakeStatistics) {
        self.restore(&mut statistics.channels);
    }

    /// Checks whether it can be that of a take with this header.
    ///
    /// # Errors
    /// `Corrupt` for another number of markers, and for a recording.
    pub(crate) fn check(&self, header: &Header, offset: u64) -> Result<(), TakeError> {
        if header.device.is_none() && header.channels.len() == self.columns.len() {
            return Ok(());
        }
        Err(TakeError::corrupt(NAME, offset, NO_ORDER))
    }

    /// The payload of its chunk, and the content of its section.
    #[must_use]
    pub fn to_payload(&self) -> Vec<u8> {
        let mut out = VERSION.to_le_bytes().to_vec();
        varint::put(&mut out, self.columns.len() as u64);
        let mut bits = BitWriter::default();
        for (group, columns) in self.columns.chunks(GROUP_CHANNELS).enumerate() {
            let first = group * GROUP_CHANNELS;
            let mut places = Places::new(first..first + columns.len());
            for &column in columns {
                let column = usize::from(column);
                if places.next_is_left() {
                    let is_next = column == places.next;
                    bits.put(usize::from(is_next), 1, &mut out);
                    if is_next {
                        places.take(column);
                        continue;
                    }
                }
                let others = places.others();
                let number = others.iter().position(|&other| other == column).unwrap_or_default();
                bits.put(number, width(others.len()), &mut out);
                places.take(column);
            }
        }
        bits.finish(&mut out);
        out
    }

    /// Decodes the payload of the chunk, or the content of the section, in the chunk at file offset `offset`.
    ///
    /// # Errors
    /// `Unsupported` for another version, `Corrupt`.
    pub(crate) fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let content = section_content(payload, NAME, VERSION, offset)?;
        decode(content).ok_or_else(|| TakeError::corrupt(NAME, offset, NO_ORDER))
    }
}

fn decode(content: &[u8]) -> Option<ChannelOrder> {
    let mut cursor = varint::Cursor::new(content);
    let n_channels = cursor.varint().filter(|&n| n <= CHANNELS_MAX as u64)? as usize;
    let mut bits = BitReader { bytes: cursor.rest(), at: 0 };
    let mut columns = Vec::new();
    for first in (0..n_channels).step_by(GROUP_CHANNELS) {
        let mut places = Places::new(first..n_channels.min(first + GROUP_CHANNELS));
        while !places.left.is_empty() {
            let column = if places.next_is_left() && bits.get(1)? == 1 {
                places.next
            } else {
                let others = places.others();
                *others.get(bits.get(width(others.len()))?)?
            };
            places.take(column);
            columns.push(u16::try_from(column).ok()?);
        }
    }
    bits.is_at_end().then_some(())?;
    ChannelOrder::from_columns(columns)
}

/// The places of a group that its next row can have.
struct Places {
    /// In ascending order.
    left: Vec<usize>,
    /// The place behind that of the row before: most rows have it.
    next: usize,
}

impl Places {
    fn new(all: Range<usize>) -> Self {
        Self { next: all.start, left: all.collect() }
    }

    /// Whether the row can have the next place, and another.
    fn next_is_left(&self) -> bool {
        self.left.len() > 1 && self.left.binary_search(&self.next).is_ok()
    }

    /// The places of a row that has not the next one, unless it is the only one.
    fn others(&self) -> Vec<usize> {
        let is_other = |place: &usize| *place != self.next || self.left.len() == 1;
        self.left.iter().copied().filter(is_other).collect()
    }

    fn take(&mut self, place: usize) {
        self.left.retain(|other| *other != place);
        self.next = place + 1;
    }
}

/// Moves `items[from[i]]` to place `i`; items behind those that are listed stay, as do all where some are missing.
fn permute<T: Clone>(items: &mut [T], from: &[u16]) {
    let Some(items) = items.get_mut(..from.len()) else { return };
    let old = items.to_vec();
    for (item, &from) in items.iter_mut().zip(from) {
        if let Some(old) = old.get(usize::from(from)) {
            item.clone_from(old);
        }
    }
}

/// Moves entries of a channel table, except their marker ids.
fn keep_ids(table: &mut [Channel], move_entries: impl FnOnce(&mut [Channel])) {
    let ids: Vec<u16> = table.iter().map(|channel| channel.marker_id).collect();
    move_entries(table);
    table.iter_mut().zip(ids).for_each(|(channel, id)| channel.marker_id = id);
}

/// Bits that hold every number below `n`.
fn width(n: usize) -> u32 {
    n.saturating_sub(1).checked_ilog2().map_or(0, |log| log + 1)
}

/// Appends numbers of some bits to bytes, highest bit first.
#[derive(Default)]
struct BitWriter {
    byte: u8,
    n_bits: u32,
}

impl BitWriter {
    fn put(&mut self, number: usize, width: u32, out: &mut Vec<u8>) {
        for bit in (0..width).rev() {
            self.byte = self.byte << 1 | (number >> bit & 1) as u8;
            self.n_bits += 1;
            if self.n_bits == u8::BITS {
                out.push(std::mem::take(&mut self.byte));
                self.n_bits = 0;
            }
        }
    }

    /// Fills the last byte up with zeros.
    fn finish(self, out: &mut Vec<u8>) {
        if self.n_bits > 0 {
            out.push(self.byte << (u8::BITS - self.n_bits));
        }
    }
}

/// Reads numbers of some bits, highest bit first.
struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl BitReader<'_> {
    fn get(&mut self, width: u32) -> Option<usize> {
        let mut number = 0;
        for _ in 0..width {
            let byte = self.bytes.get(self.at / 8)?;
            number = number << 1 | usize::from(byte >> (7 - self.at % 8) & 1);
            self.at += 1;
        }
        Some(number)
    }

    /// Whether nothing follows but the zeros of the last byte.
    fn is_at_end(&self) -> bool {
        let rest = self.bytes.get(self.at.div_ceil(8)..);
        let is_padded = self.at.is_multiple_of(8)
            || self.bytes.get(self.at / 8).is_some_and(|byte| byte << (self.at % 8) == 0);
        rest.is_some_and(<[u8]>::is_empty) && is_padded
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    /// An order of `n` channels, by chance.
    fn shuffled(n: usize, random: &mut Random) -> ChannelOrder {
        let mut columns: Vec<u16> = (0..n as u16).collect();
        for group in columns.chunks_mut(GROUP_CHANNELS) {
            for end in (1..group.len()).rev() {
                group.swap(end, random.below(end + 1));
            }
        }
        ChannelOrder::from_columns(columns).unwrap()
    }

    #[test]
    fn every_order_comes_back_and_undoes_itself() {
        let mut random = Random::new(9);
        for n in [0, 1, 2, 3, 15, 63, 64, 65, 159, 1000] {
            for _ in 0..20 {
                let order = shuffled(n, &mut random);
                let payload = order.to_payload();
                assert_eq!(ChannelOrder::from_payload(&payload, 0).unwrap(), order);
                let mut items: Vec<usize> = (0..n + 3).collect();
                order.apply(&mut items);
                assert!((0..n).all(|row| items[row] == order.column_of(row)));
                order.restore(&mut items);
                assert_eq!(items, (0..n + 3).collect::<Vec<_>>());
                assert!((0..n + 3).all(|column| order.column_of(order.row_of(column)) == column));
                let extended = order.extended(n + 3);
                assert_eq!(ChannelOrder::from_columns(extended.columns.clone()), Some(extended));
            }
        }
    }

    #[test]
    fn the_bytes_are_those_of_the_document() {
        // Not 0, but 1 of 1 2; 0 of 0 1; nothing for the last one.
        let order = ChannelOrder::from_columns(vec![2, 0, 1]).unwrap();
        assert_eq!(order.to_payload(), [1, 0, 3, 0b0100_0000]);
        let document = include_str!("../../docs/take-format.md");
        assert!(document.contains("    01 00    version 1\n    03       3 markers\n    40       "));
    }

    #[test]
    fn what_is_no_permutation_is_refused_and_costs_no_memory() {
        assert_eq!(ChannelOrder::from_columns(vec![0, 0]), None);
        assert_eq!(ChannelOrder::from_columns(vec![1, 2]), None);
        let mut across: Vec<u16> = (0..65).collect();
        across.swap(0, 64);
        assert_eq!(ChannelOrder::from_columns(across), None);
        let refused = |payload: &[u8]| {
            let error = ChannelOrder::from_payload(payload, 7).unwrap_err();
            matches!(error, TakeError::Corrupt { .. })
        };
        let order = ChannelOrder::from_columns(vec![2, 0, 1]).unwrap().to_payload();
        // Too few and too many bytes, a bit in the padding, an index that is too large, more markers than a take has.
        assert!((2..order.len()).all(|cut| refused(&order[..cut])) && refused(&order[..1]));
        assert!(refused(&[&order[..], &[0]].concat()) && refused(&[1, 0, 0, 0]));
        assert!(refused(&[1, 0, 3, 0b0101_0000]) && refused(&[1, 0, 4, 0b0110_0000]));
        assert!(refused(&[1, 0, 0x80, 0x80, 4, 0]) && refused(&[1, 0, 0x81, 0x80, 4]));
        let later = ChannelOrder::from_payload(&[2, 0, 9], 0).unwrap_err();
        assert!(matches!(later, TakeError::Unsupported { .. }));
    }

    #[test]
    fn marker_ids_stay_at_their_places() {
        let channel =
            |marker_id, label: &str| Channel { marker_id, label: label.to_owned(), labelled: true };
        let source = [channel(0, "a"), channel(1, "b"), channel(2, "c")];
        let order = ChannelOrder::from_columns(vec![2, 0, 1]).unwrap();
        let mut table = source.clone();
        order.apply_to_table(&mut table);
        assert_eq!(table, [channel(0, "c"), channel(1, "a"), channel(2, "b")]);
        order.restore_table(&mut table);
        assert_eq!(table, source);
    }
}
