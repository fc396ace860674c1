//! Three columns of integers as packed differences: a channel of `lossless`, and a raw one of any kind.
//!
//! One head byte: bits 0-1, 2-3 and 4-5 are the difference order (0, 1 or 2) of x, y and z. Then per
//! column: while fewer earlier values are known than the order asks for, a zigzag varint of the
//! difference of the highest order possible; then groups ([`bitpack`](super::bitpack)) of zigzag
//! differences.

use super::{bitpack, bytes, zigzag};
use crate::CodecError;

/// Highest difference order.
const MAX_ORDER: usize = 2;

/// The last values of a column, from which the next is predicted.
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

    /// Prediction of the next value; `order` must not be above what is known.
    fn predict(&self, order: usize) -> i64 {
        match order {
            0 => 0,
            1 => self.last,
            _ => self.last.wrapping_mul(2).wrapping_sub(self.before),
        }
    }
}

/// Most bytes of three columns of `n` values, each of which fits 32 bits.
pub(crate) fn max_bytes_32(n: usize) -> usize {
    // Order 0 needs no varints and at most 32 bits a value, and the smallest order is taken.
    1 + 3 * (4 * n + n.div_ceil(bitpack::GROUP_LEN))
}

/// Appends three columns.
pub(crate) fn write(columns: &[Vec<i64>; 3], history: &mut [History; 3], out: &mut Vec<u8>) {
    let orders: [usize; 3] =
        std::array::from_fn(|axis| smallest_order(&columns[axis], history[axis]));
    out.push((orders[0] | orders[1] << 2 | orders[2] << 4) as u8);
    for axis in 0..3 {
        write_column(&columns[axis], &mut history[axis], orders[axis], out);
    }
}

/// Reads three columns of `n` values into `columns`.
///
/// Nothing is allocated for values that `input` does not hold.
pub(crate) fn read(
    input: &mut bytes::Bytes<'_>,
    n: usize,
    history: &mut [History; 3],
    columns: &mut [Vec<i64>; 3],
) -> Result<(), CodecError> {
    let head = input.byte("the head of the columns")?;
    if head >> 6 != 0 {
        return Err(CodecError::Corrupt("unknown flags of columns"));
    }
    for (axis, (column, history)) in columns.iter_mut().zip(history).enumerate() {
        let order = usize::from(head >> (2 * axis) & 3);
        if order > MAX_ORDER {
            return Err(CodecError::Corrupt("a difference of order 3"));
        }
        read_column(input, n, history, order, column)?;
    }
    Ok(())
}

/// The lowest of equals, because it suffers least from a gap.
fn smallest_order(column: &[i64], history: History) -> usize {
    (0..=MAX_ORDER).min_by_key(|&order| column_bytes(column, history, order)).unwrap_or(0)
}

/// Bytes that [`write_column`] appends.
fn column_bytes(column: &[i64], mut history: History, order: usize) -> usize {
    let (head, rest) = column.split_at(order.saturating_sub(history.known).min(column.len()));
    let mut size = 0;
    for &value in head {
        let residual = value.wrapping_sub(history.predict(history.known.min(order)));
        size += bytes::varint_len(zigzag::encode(residual));
        history.push(value);
    }
    for group in rest.chunks(bitpack::GROUP_LEN) {
        let mut union = 0;
        for &value in group {
            union |= zigzag::encode(value.wrapping_sub(history.predict(order)));
            history.push(value);
        }
        size += bitpack::group_bytes(group.len(), bitpack::width_of(union));
    }
    size
}

fn write_column(column: &[i64], history: &mut History, order: usize, out: &mut Vec<u8>) {
    let (head, rest) = column.split_at(order.saturating_sub(history.known).min(column.len()));
    for &value in head {
        let residual = value.wrapping_sub(history.predict(history.known.min(order)));
        bytes::write_varint(zigzag::encode(residual), out);
        history.push(value);
    }
    for group in rest.chunks(bitpack::GROUP_LEN) {
        let mut codes = [0; bitpack::GROUP_LEN];
        let mut union = 0;
        for (code, &value) in codes.iter_mut().zip(group) {
            *code = zigzag::encode(value.wrapping_sub(history.predict(order)));
            union |= *code;
            history.push(value);
        }
        bitpack::pack(&codes[..group.len()], bitpack::width_of(union), out);
    }
}

fn read_column(
    input: &mut bytes::Bytes<'_>,
    n: usize,
    history: &mut History,
    order: usize,
    column: &mut Vec<i64>,
) -> Result<(), CodecError> {
    column.clear();
    let head = order.saturating_sub(history.known).min(n);
    for _ in 0..head {
        let residual = zigzag::decode(input.varint("a first value")?);
        let value = history.predict(history.known.min(order)).wrapping_add(residual);
        history.push(value);
        column.push(value);
    }
    let mut left = n - head;
    while left > 0 {
        let len = left.min(bitpack::GROUP_LEN);
        let mut codes = [0; bitpack::GROUP_LEN];
        bitpack::unpack(input, &mut codes[..len])?;
        for &code in &codes[..len] {
            let value = history.predict(order).wrapping_add(zigzag::decode(code));
            history.push(value);
            column.push(value);
        }
        left -= len;
    }
    Ok(())
}
