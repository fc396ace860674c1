//! `lossless`: bit-exact float32. The samples of a channel are three columns of integers, as packed differences.
//!
//! The resampler writes every channel in this form, and all other kinds but `dense` their raw channels. The integers are
//! the float32 bit patterns, mapped so that they have the order of the numbers.
//!
//! One head byte: bits 0-1, 2-3 and 4-5 are the difference order (0, 1 or 2) of x, y and z. Then per
//! column: while fewer earlier values are known than the order needs, a zigzag varint of the difference of
//! the highest order possible; then groups of zigzag differences, each group at the width of its widest
//! member: one byte of width (0 to 64), then `len * width` bits, least significant bit first.

use crate::{
    BlockReport, CodecError, DecodedRows, Position, Result, Rows,
    coding::{Bytes, varint_len, write_varint},
    ensure,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
};

/// Encoder and decoder of one group. Its state is the last bit patterns of each channel.
#[derive(Debug, Default)]
pub(crate) struct Lossless {
    histories: Vec<Histories>,
    raw: Raw,
}

impl Lossless {
    fn grow(&mut self, n_channels: usize) {
        if self.histories.len() < n_channels {
            self.histories.resize(n_channels, Histories::default());
        }
    }
}

/// Empty blocks keep the histories: a marker usually reappears close to where it was lost.
impl Payload for Lossless {
    const EXACT: bool = true;

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels);
        self.raw.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.histories.fill(Histories::default());
    }
}

impl PayloadEncoder for Lossless {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * Raw::max_bytes(n_rows)
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        self.grow(channels.len());
        let channels = channels.iter().zip(&mut self.histories).zip(reports);
        for ((rows, history), report) in channels.filter(|(_, report)| report.samples > 0) {
            self.raw.write(*rows, history, out);
            report.keep_all(*rows, kept_rows);
        }
        Ok(())
    }
}

impl PayloadDecoder for Lossless {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        self.grow(channels.len());
        let mut input = Bytes::new(payload);
        for (rows, history) in channels.iter_mut().zip(&mut self.histories) {
            if rows.has_samples() {
                self.raw.read(&mut input, history, rows)?;
            }
        }
        input.finish()
    }
}

/// The last bit patterns of a channel, by axis.
pub(crate) type Histories = [History; 3];

/// Writes and reads the samples of one channel of one block. A column that is written starts with the [`MAX_ORDER`]
/// values before the block.
#[derive(Debug, Default)]
pub(crate) struct Raw {
    columns: [Vec<i64>; 3],
}

/// Maps a float to an integer, preserving order, so that neighbouring floats are neighbouring integers, also across
/// zero.
fn to_ordered(value: f32) -> i64 {
    let bits = value.to_bits() as i32;
    i64::from(bits ^ (bits >> 31 & i32::MAX))
}

/// Inverts [`to_ordered`]; `None` for integers of no finite float.
fn from_ordered(ordered: i64) -> Option<f32> {
    let bits = i32::try_from(ordered).ok()?;
    let value = f32::from_bits((bits ^ (bits >> 31 & i32::MAX)) as u32);
    value.is_finite().then_some(value)
}

impl Raw {
    /// Maximum number of bytes of `samples` samples.
    pub(crate) fn max_bytes(samples: usize) -> usize {
        // Order 0 takes no varints and at most 32 bits per value, and the order with the fewest bytes is chosen.
        1 + 3 * (4 * samples + samples.div_ceil(GROUP_LEN))
    }

    /// Allocates memory for `n_rows` samples.
    pub(crate) fn reserve(&mut self, n_rows: usize) {
        for column in &mut self.columns {
            column.reserve((MAX_ORDER + n_rows).saturating_sub(column.len()));
        }
    }

    /// Appends the samples of a channel as differences, which continue those last written with this history.
    pub(crate) fn write(&mut self, rows: Rows<'_>, history: &mut Histories, out: &mut Vec<u8>) {
        let all_present = rows.present().iter().all(|&present| present);
        for (axis, (column, history)) in self.columns.iter_mut().zip(&*history).enumerate() {
            column.clear();
            column.extend([history.before, history.last]);
            let value = |position: &Position| to_ordered(position[axis]);
            if all_present {
                column.extend(rows.positions().iter().map(value));
            } else {
                let samples = rows.positions().iter().zip(rows.present());
                column.extend(samples.filter(|(_, present)| **present).map(|(at, _)| value(at)));
            }
        }
        let orders: [usize; 3] =
            std::array::from_fn(|axis| smallest_order(&self.columns[axis], history[axis]));
        out.push((orders[0] | orders[1] << 2 | orders[2] << 4) as u8);
        for ((column, history), order) in self.columns.iter().zip(history).zip(orders) {
            write_column(column, history, order, out);
        }
    }

    /// Reads what [`write`](Self::write) wrote into the present rows, and marks all of them as kept.
    ///
    /// Allocates no memory for values that `input` does not hold.
    pub(crate) fn read(
        &mut self,
        input: &mut Bytes<'_>,
        history: &mut Histories,
        rows: &mut DecodedRows,
    ) -> Result<()> {
        let n = rows.present.iter().filter(|&&p| p).count();
        let head = input.byte("the head of the columns")?;
        ensure(head >> 6 == 0, "unknown column flags")?;
        for (axis, (column, history)) in self.columns.iter_mut().zip(history).enumerate() {
            let order = usize::from(head >> (2 * axis) & 3);
            ensure(order <= MAX_ORDER, "a difference order of 3")?;
            read_column(input, n, history, order, column)?;
        }
        let present = rows.positions.iter_mut().zip(&rows.present).filter(|(_, p)| **p);
        for (at, (position, _)) in present.enumerate() {
            for (value, column) in position.iter_mut().zip(&self.columns) {
                *value =
                    from_ordered(column[at]).ok_or(CodecError::Corrupt("a non-finite value"))?;
            }
        }
        rows.kept.copy_from_slice(&rows.present);
        Ok(())
    }
}

/// Highest difference order.
const MAX_ORDER: usize = 2;

/// The last values of a column, which predict the next one.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct History {
    last: i64,
    before: i64,
    known: usize,
}

impl History {
    fn push(&mut self, value: i64) {
        *self = Self { last: value, before: self.last, known: (self.known + 1).min(MAX_ORDER) };
    }

    /// The prediction of the next value; `order` must not exceed the number of known values.
    fn predict(&self, order: usize) -> i64 {
        predict(self.before, self.last, order)
    }

    /// Appends a value and returns its zigzag difference.
    fn code(&mut self, value: i64, order: usize) -> u64 {
        let code = zigzag(value.wrapping_sub(self.predict(order)));
        self.push(value);
        code
    }

    /// Appends the value with a zigzag difference and returns it.
    fn value(&mut self, code: u64, order: usize) -> i64 {
        let value = self.predict(order).wrapping_add(unzigzag(code));
        self.push(value);
        value
    }

    /// How many of the next `n` values precede the groups.
    fn first_values(&self, order: usize, n: usize) -> usize {
        order.saturating_sub(self.known).min(n)
    }
}

fn predict(before: i64, last: i64, order: usize) -> i64 {
    match order {
        0 => 0,
        1 => last,
        _ => last.wrapping_mul(2).wrapping_sub(before),
    }
}

/// The difference order with the fewest bytes; the lowest of equals, because it suffers least from a gap.
fn smallest_order(column: &[i64], history: History) -> usize {
    let bytes = column_bytes(column, history);
    (0..=MAX_ORDER).min_by_key(|&order| bytes[order]).unwrap_or(0)
}

/// The groups of a column, each with the [`MAX_ORDER`] values before it.
fn groups(column: &[i64]) -> impl Iterator<Item = &[i64]> {
    let n_values = column.len() - MAX_ORDER;
    let starts = (0..n_values).step_by(GROUP_LEN);
    starts.map(move |at| &column[at..MAX_ORDER + n_values.min(at + GROUP_LEN)])
}

/// The number of bytes that [`write_column`] appends with each order.
fn column_bytes(column: &[i64], history: History) -> [usize; MAX_ORDER + 1] {
    if history.known < MAX_ORDER {
        return std::array::from_fn(|order| first_column_bytes(column, history, order));
    }
    // All orders have the same groups, so one pass serves all.
    let mut bytes = [0; MAX_ORDER + 1];
    for group in groups(column) {
        let mut unions = [0; MAX_ORDER + 1];
        for &[before, last, value] in group.array_windows() {
            for (order, union) in unions.iter_mut().enumerate() {
                *union |= zigzag(value.wrapping_sub(predict(before, last, order)));
            }
        }
        for (bytes, union) in bytes.iter_mut().zip(unions) {
            *bytes += group_bytes(group.len() - MAX_ORDER, width_of(union));
        }
    }
    bytes
}

/// The number of bytes with one order where fewer earlier values are known than the highest order needs.
fn first_column_bytes(column: &[i64], mut history: History, order: usize) -> usize {
    let n_first = history.first_values(order, column.len() - MAX_ORDER);
    let (first, rest) = column[MAX_ORDER..].split_at(n_first);
    let mut size = 0;
    for &value in first {
        size += varint_len(history.code(value, order.min(history.known)));
    }
    for group in rest.chunks(GROUP_LEN) {
        let union = group.iter().fold(0, |union, &value| union | history.code(value, order));
        size += group_bytes(group.len(), width_of(union));
    }
    size
}

fn write_column(column: &[i64], history: &mut History, order: usize, out: &mut Vec<u8>) {
    let known = (history.known + column.len() - MAX_ORDER).min(MAX_ORDER);
    let n_first = history.first_values(order, column.len() - MAX_ORDER);
    for &value in &column[MAX_ORDER..MAX_ORDER + n_first] {
        write_varint(history.code(value, order.min(history.known)), out);
    }
    for group in groups(&column[n_first..]) {
        let mut codes = [0; GROUP_LEN];
        let mut union = 0;
        for (code, &[before, last, value]) in codes.iter_mut().zip(group.array_windows()) {
            *code = zigzag(value.wrapping_sub(predict(before, last, order)));
            union |= *code;
        }
        pack(&codes[..group.len() - MAX_ORDER], width_of(union), out);
    }
    if let [.., before, last] = *column {
        *history = History { last, before, known };
    }
}

fn read_column(
    input: &mut Bytes<'_>,
    n: usize,
    history: &mut History,
    order: usize,
    column: &mut Vec<i64>,
) -> Result<()> {
    column.clear();
    for _ in 0..history.first_values(order, n) {
        column.push(history.value(input.varint("a first value")?, order.min(history.known)));
    }
    while column.len() < n {
        let mut codes = [0; GROUP_LEN];
        let codes = &mut codes[..GROUP_LEN.min(n - column.len())];
        unpack(input, codes)?;
        match order {
            0 => column.extend(codes.iter().map(|&code| history.value(code, 0))),
            1 => column.extend(codes.iter().map(|&code| history.value(code, 1))),
            _ => column.extend(codes.iter().map(|&code| history.value(code, MAX_ORDER))),
        }
    }
    Ok(())
}

/// Maps signed to unsigned integers, small magnitudes first: 0, -1, 1, -2, 2, ...
const fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

const fn unzigzag(code: u64) -> i64 {
    (code >> 1) as i64 ^ -((code & 1) as i64)
}

/// Number of values of a group; the last group of a column may be shorter.
const GROUP_LEN: usize = 32;

/// The number of bits of the widest member, from the bitwise OR of all members.
const fn width_of(union: u64) -> u32 {
    64 - union.leading_zeros()
}

/// The number of bytes of a group, its width byte included.
const fn group_bytes(len: usize, width: u32) -> usize {
    1 + (len * width as usize).div_ceil(8)
}

/// Appends one group of at most [`GROUP_LEN`] values, none wider than `width` bits.
fn pack(values: &[u64], width: u32, out: &mut Vec<u8>) {
    out.push(width as u8);
    let mut packed = [0_u8; GROUP_LEN * 8 + 8];
    let (mut word, mut filled, mut at) = (0_u128, 0, 0);
    for &value in values {
        word |= u128::from(value) << filled;
        filled += width;
        if filled >= 64 {
            packed[at..at + 8].copy_from_slice(&(word as u64).to_le_bytes());
            word >>= 64;
            filled -= 64;
            at += 8;
        }
    }
    packed[at..at + 8].copy_from_slice(&(word as u64).to_le_bytes());
    out.extend_from_slice(&packed[..(values.len() * width as usize).div_ceil(8)]);
}

/// Reads one group into all of `values`, which is at most [`GROUP_LEN`] long.
fn unpack(input: &mut Bytes<'_>, values: &mut [u64]) -> Result<()> {
    let width = u32::from(input.byte("the width of a group")?);
    ensure(width <= 64, "a group wider than 64 bits")?;
    let bits = input.take((values.len() * width as usize).div_ceil(8), "a group of values")?;
    // Sixteen spare bytes, so that every window of sixteen bytes lies within the array.
    let mut padded = [0_u8; GROUP_LEN * 8 + 16];
    padded[..bits.len()].copy_from_slice(bits);
    let mask = if width == 64 { u64::MAX } else { (1 << width) - 1 };
    for (i, value) in values.iter_mut().enumerate() {
        let at = i * width as usize;
        let window = padded[at / 8..].first_chunk().map_or(0, |bits| u128::from_le_bytes(*bits));
        *value = (window >> (at % 8)) as u64 & mask;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    #[test]
    fn zigzag_round_trips_in_order_of_magnitude() {
        for (code, value) in [0, -1, 1, -2, 2].into_iter().enumerate() {
            assert_eq!(zigzag(value), code as u64);
        }
        for value in [i64::MIN, i64::MIN + 1, -77, 0, 1 << 40, i64::MAX] {
            assert_eq!(unzigzag(zigzag(value)), value);
        }
    }

    #[test]
    fn every_width_and_length_round_trips() {
        let mut random = Random::new(1);
        for width in 0..=64 {
            for len in [1, 2, 31, 32] {
                let values: Vec<u64> = (0..len)
                    .map(|_| if width == 0 { 0 } else { random.next_u64() >> (64 - width) })
                    .collect();
                let mut out = Vec::new();
                pack(&values, width, &mut out);
                assert_eq!(out.len(), group_bytes(len, width));
                let mut input = Bytes::new(&out);
                let mut back = vec![0; len];
                unpack(&mut input, &mut back).unwrap();
                assert_eq!(back, values, "width {width}");
                assert!(input.is_empty());
            }
        }
    }

    #[test]
    fn columns_of_few_values_continue_each_other() {
        let mut random = Random::new(2);
        for order in 0..=MAX_ORDER {
            let (mut writer, mut reader) = (History::default(), History::default());
            for len in [1, 1, 1, 2, 0, 1, 33] {
                let mut column = vec![writer.before, writer.last];
                column.extend((0..len).map(|_| i64::from(random.next_u64() as i32)));
                let mut out = Vec::new();
                let bytes = first_column_bytes(&column, writer, order);
                write_column(&column, &mut writer, order, &mut out);
                assert_eq!(out.len(), bytes);
                let (mut input, mut back) = (Bytes::new(&out), Vec::new());
                read_column(&mut input, len, &mut reader, order, &mut back).unwrap();
                assert_eq!(back, column[MAX_ORDER..], "order {order}, {len} values");
                assert!(input.is_empty());
            }
        }
    }

    #[test]
    fn a_width_of_65_is_corrupt() {
        let mut back = [0; 4];
        assert!(matches!(
            unpack(&mut Bytes::new(&[65, 0]), &mut back),
            Err(CodecError::Corrupt(_))
        ));
    }

    #[test]
    fn the_map_keeps_order_and_every_bit() {
        let values = [f32::MIN, -1.0, -f32::MIN_POSITIVE, -1e-45, -0.0, 0.0, 1e-45, 1.0, f32::MAX];
        for pair in values.windows(2) {
            assert!(to_ordered(pair[0]) < to_ordered(pair[1]), "{pair:?}");
        }
        assert_eq!(to_ordered(-0.0) + 1, to_ordered(0.0));
        for value in values {
            assert_eq!(from_ordered(to_ordered(value)).unwrap().to_bits(), value.to_bits());
        }
        for value in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert_eq!(from_ordered(to_ordered(value)), None);
        }
        assert_eq!(from_ordered(1 << 40), None);
    }
}
