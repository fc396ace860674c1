//! One row's residual: from its symbol, and from the bits behind it.

use super::{
    MAX_ZEROS,
    model::{GOLOMB, LOW_BITS, TABLES},
    places::{PLACES, table_at},
    reader::Reader,
    walk::Point,
};
use crate::CodecError;

/// Residual of the axes of a symbol; a larger one stands as 0.
const fn residuals() -> [Point; 64] {
    let mut table = [[0.0; 4]; 64];
    let mut symbol = 0;
    while symbol < 64 {
        let mut axis = 0;
        while axis < 3 {
            table[symbol][axis] = match symbol >> (4 - 2 * axis) & 3 {
                1 => 1.0,
                2 => -1.0,
                _ => 0.0,
            };
            axis += 1;
        }
        symbol += 1;
    }
    table
}

/// How many axes of a symbol are +-1, and a bit for each that is larger, x lowest.
const fn axes() -> ([u8; 64], [u8; 64]) {
    let (mut ones, mut larger) = ([0; 64], [0; 64]);
    let mut symbol = 0;
    while symbol < 64 {
        let mut axis = 0;
        while axis < 3 {
            match symbol >> (4 - 2 * axis) & 3 {
                0 => {}
                3 => larger[symbol] |= 1 << axis,
                _ => ones[symbol] += 1,
            }
            axis += 1;
        }
        symbol += 1;
    }
    (ones, larger)
}

/// What holds for each table, by its place.
const fn by_place(of: [u32; TABLES]) -> [u32; PLACES] {
    let mut by_place = [0; PLACES];
    let mut place = 0;
    while place < PLACES {
        if let Some(table) = table_at(place) {
            by_place[place] = of[table];
        }
        place += 1;
    }
    by_place
}

static GOLOMB_AT: [u32; PLACES] = by_place(GOLOMB);
static LOW_BITS_AT: [u32; PLACES] = by_place(LOW_BITS);
pub(super) static RESIDUALS: [Point; 64] = residuals();
pub(super) static ONES: [u8; 64] = axes().0;
pub(super) static LARGER: [u8; 64] = axes().1;

/// One magnitude of 2 and more, with its sign.
#[inline(always)]
fn larger(reader: &mut Reader<'_>, order: u32) -> Result<i32, CodecError> {
    let word = reader.peek()?;
    let zeros = word.leading_zeros();
    if zeros > MAX_ZEROS {
        return Err(CodecError::Corrupt("a residual too large"));
    }
    let width = zeros + 1 + order;
    let value = (word << zeros >> (63 - width)) as u32;
    reader.skip(zeros + width + 1);
    let magnitude = ((value >> 1) - (1 << order) + 2) as i32;
    Ok(if value & 1 == 0 { magnitude } else { -magnitude })
}

/// Puts what is behind a symbol of the table at a place, which there is, into the residual that it has without; gives
/// the sum of the magnitudes.
#[inline(always)]
pub(super) fn residual(
    reader: &mut Reader<'_>,
    symbol: usize,
    place: usize,
    steps: &mut Point,
) -> Result<u32, CodecError> {
    if LOW_BITS_AT[place % PLACES] > 0 {
        return wide_residual(reader, symbol, place, steps);
    }
    let mut magnitude = u32::from(ONES[symbol % 64]);
    let mut axes = LARGER[symbol % 64];
    while axes != 0 {
        let axis = axes.trailing_zeros() as usize % 4;
        axes &= axes - 1;
        let value = larger(reader, GOLOMB_AT[place % PLACES])?;
        steps[axis] = value as f32;
        magnitude += value.unsigned_abs();
    }
    Ok(magnitude)
}

/// The same with low bits, which stand before the larger magnitudes.
#[inline(always)]
fn wide_residual(
    reader: &mut Reader<'_>,
    symbol: usize,
    place: usize,
    steps: &mut Point,
) -> Result<u32, CodecError> {
    let low_bits = LOW_BITS_AT[place % PLACES];
    let low = (reader.peek()? >> (64 - 3 * low_bits)) as i32;
    reader.skip(3 * low_bits);
    let mut magnitude = 0;
    for (axis, steps) in steps[..3].iter_mut().enumerate() {
        let high = match symbol >> (4 - 2 * axis) & 3 {
            0 => 0,
            1 => 1,
            2 => -1,
            _ => larger(reader, GOLOMB_AT[place % PLACES])?,
        };
        let low = low >> (low_bits * (2 - axis as u32)) & ((1 << low_bits) - 1);
        let value = high * (1 << low_bits) + low - (1 << (low_bits - 1));
        *steps = value as f32;
        magnitude += value.unsigned_abs();
    }
    Ok(magnitude)
}
