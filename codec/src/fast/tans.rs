//! Table-driven asymmetric numeral systems (Duda, arXiv 1311.2540), in the table layout of FSE.
//!
//! The encoder codes the symbols from the last to the first and appends bits; the decoder reads the same bits from the
//! end to the start. Plain bit fields share the stream.

use std::{cmp::Ordering, sync::LazyLock};

use super::{
    model::{
        Axes, GOLOMB, LOW_BITS, PLACES, STATE_BITS, STATES, SYMBOLS, TABLES, axes, axis_code,
        frequency, table_at,
    },
    walk::PaddedPoint,
};
use crate::{CodecError, Result, ensure};

/// A decoder's table entry. Bits 0-5: symbol. Bit 6: more bits follow for the row. Bits 8-9: how many of its axes are
/// +-1. Bits 16-25: base of the next state. Bits 26-31: 63 less the number of bits to read.
///
/// The fields that the next entry depends on take one instruction each to extract.
pub(super) type Entry = u32;

/// Bit 6 of an entry.
pub(super) const MORE: Entry = 1 << 6;
/// Bits 8 and 9: the row's magnitude in the unit of [`Activity`](super::model::Activity), where no more bits follow.
pub(super) const MAGNITUDE: Entry = 3 << 8;
/// Lowest bit of the base of the next state.
const BASE_AT: u32 = 16;
/// Lowest bit of 63 less the number of bits to read.
const SHIFT_AT: u32 = 26;

/// How an encoder codes one symbol of one table.
#[derive(Debug, Clone, Copy, Default)]
struct Transition {
    /// `(state + bits) >> 16` is the number of bits to write.
    bits: u32,
    /// Added to the state without these bits, gives the index of the next state among those of all tables.
    offset: i32,
}

/// All tables of the model, for both directions.
#[derive(Debug)]
pub(super) struct Tables {
    /// By [place](super::model::table_at).
    entries: Box<[Entry; PLACES * STATES]>,
    transitions: Box<[Transition; TABLES * SYMBOLS]>,
    /// Next states of the encoder, from [`STATES`] to `2 * STATES - 1`.
    states: Box<[u16; TABLES * STATES]>,
    /// By row symbol: its residual, with 0 for larger axes; and the kinds of its axes.
    pub(super) residuals: [PaddedPoint; SYMBOLS],
    pub(super) axes: [Axes; SYMBOLS],
    /// Orders of the Exp-Golomb codes and numbers of low bits, by place.
    pub(super) golomb: [u32; PLACES],
    pub(super) low_bits: [u32; PLACES],
}

const _: () = assert!((TABLES * STATES).is_power_of_two() && (TABLES * SYMBOLS).is_power_of_two());

/// Spacing of a symbol's states. Odd, so that every state is visited once; near 5/8 of the states, as in FSE, so that
/// the states of a symbol are far apart.
const STRIDE: usize = STATES / 2 + STATES / 8 + 3;

pub(super) static TABLES_OF_MODEL: LazyLock<Tables> = LazyLock::new(Tables::build);

impl Tables {
    fn build() -> Self {
        let residual = |symbol| {
            let [x, y, z] = [0, 1, 2].map(|axis| [0.0, 1.0, -1.0, 0.0][axis_code(symbol, axis)]);
            [x, y, z, 0.0]
        };
        let by_place = |of: [u32; TABLES]| {
            std::array::from_fn(|place| table_at(place).map_or(0, |table| of[table]))
        };
        let mut tables = Self {
            entries: Box::new([0; PLACES * STATES]),
            transitions: Box::new([Transition::default(); TABLES * SYMBOLS]),
            states: Box::new([0; TABLES * STATES]),
            residuals: std::array::from_fn(residual),
            axes: std::array::from_fn(axes),
            golomb: by_place(GOLOMB),
            low_bits: by_place(LOW_BITS),
        };
        for table in 0..TABLES {
            tables.fill(table);
        }
        tables
    }

    fn fill(&mut self, table: usize) {
        let at = table * STATES;
        let counts: [usize; SYMBOLS] =
            std::array::from_fn(|symbol| frequency(table, symbol).into());
        let mut spread = [0; STATES];
        let mut place = 0;
        let mut start = [0; SYMBOLS];
        let mut sum = 0;
        for (symbol, &count) in counts.iter().enumerate() {
            for _ in 0..count {
                spread[place] = symbol;
                place = (place + STRIDE) % STATES;
            }
            start[symbol] = sum;
            sum += count;
            if count > 0 {
                let most = STATE_BITS - (count - 1).checked_ilog2().unwrap_or(0);
                self.transitions[table * SYMBOLS + symbol] = Transition {
                    bits: (most << 16).wrapping_sub((count << most) as u32),
                    offset: (at + start[symbol]) as i32 - count as i32,
                };
            }
        }
        let mut next = counts;
        for (state, &symbol) in spread.iter().enumerate() {
            let x = next[symbol];
            next[symbol] += 1;
            let bits = STATE_BITS - x.ilog2();
            let base = (x << bits) - STATES;
            let Axes { ones, larger } = self.axes[symbol];
            let more = larger != 0 || LOW_BITS[table] > 0;
            let row = u32::from(ones) << 8 | if more { MORE } else { 0 };
            let entry = (63 - bits) << SHIFT_AT | (base as u32) << BASE_AT | row | symbol as u32;
            for place in (0..PLACES).filter(|&place| table_at(place) == Some(table)) {
                self.entries[place * STATES + state] = entry;
            }
            self.states[at + start[symbol] + x - counts[symbol]] = (STATES + state) as u16;
        }
    }
}

const CUT_SHORT: CodecError = CodecError::Truncated("the coded residuals");

/// Symbols that can be read after a refill of 56 bits, at [`STATE_BITS`] each.
pub(super) const SYMBOLS_FILLED: usize = 56 / STATE_BITS as usize;

/// Bytes of padding before the payload, so that eight bytes can be read at every valid position.
pub(super) const PAD: usize = 16;

/// Reads bits from the end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader<'a> {
    padded: &'a [u8],
    /// Bytes that are not in `word` yet.
    bytes: usize,
    /// The next bits, from bit 63 down.
    word: u64,
    /// Number of valid bits in `word`.
    filled: u32,
    /// Bytes before the bit string: padding, modes and raw samples.
    floor: usize,
    state: usize,
}

impl<'a> Reader<'a> {
    /// Copies the payload after padding.
    pub(super) fn pad(payload: &[u8], padded: &mut Vec<u8>) {
        padded.clear();
        padded.extend_from_slice(&[0; PAD]);
        padded.extend_from_slice(payload);
    }

    /// Starts at the end mark of `padded`, the result of [`pad`](Self::pad).
    pub(super) fn new(padded: &'a [u8]) -> Result<Self> {
        let last = padded.get(PAD..).and_then(<[u8]>::last).ok_or(CUT_SHORT)?;
        ensure(*last != 0, "residuals without an end mark")?;
        let bytes = padded.len();
        let mut reader = Self { padded, bytes, word: 0, filled: 0, floor: PAD, state: 0 };
        reader.refill()?;
        reader.skip(1 + last.leading_zeros());
        Ok(reader)
    }

    /// Fills `word` with at least 56 bits.
    #[inline(always)]
    pub(super) fn refill(&mut self) -> Result<()> {
        let bytes = self.padded.get(self.bytes.wrapping_sub(8)..self.bytes).ok_or(CUT_SHORT)?;
        let next = bytes.first_chunk::<8>().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        // The bits below the valid ones are already the next ones; setting them twice is harmless.
        self.word |= next >> self.filled;
        self.bytes -= ((63 - self.filled) / 8) as usize;
        self.filled |= 56;
        Ok(())
    }

    /// At least 56 of the next bits, from bit 63 down.
    #[inline(always)]
    pub(super) fn peek(&mut self) -> Result<u64> {
        self.refill()?;
        Ok(self.word)
    }

    /// Consumes peeked bits.
    #[inline(always)]
    pub(super) fn skip(&mut self, width: u32) {
        self.word <<= width;
        self.filled -= width;
    }

    /// Excludes `bytes` bytes at the start of the payload from the bit string.
    pub(super) fn set_floor(&mut self, bytes: usize) {
        self.floor += bytes;
    }

    pub(super) fn flag(&mut self) -> Result<bool> {
        let word = self.peek()?;
        self.skip(1);
        Ok(word >> 63 == 1)
    }

    pub(super) fn read_state(&mut self) -> Result<()> {
        self.state = (self.peek()? >> (64 - STATE_BITS)) as usize;
        self.skip(STATE_BITS);
        Ok(())
    }

    /// Reads the next symbol of the table at a place: at most [`STATE_BITS`] bits, which must be in `word`.
    #[inline(always)]
    pub(super) fn entry(&mut self, tables: &Tables, place: usize) -> Result<Entry> {
        // Not masked to the table's size, which would delay the next entry.
        let at = place * STATES + self.state;
        let entry = *tables.entries.get(at).ok_or(CodecError::Corrupt("a state out of range"))?;
        let shift = entry >> SHIFT_AT;
        let base = entry >> BASE_AT & (STATES as u32 - 1);
        // In two shifts: a shift by 64 would overflow.
        self.state = (u64::from(base) + (self.word >> 1 >> shift)) as usize;
        self.skip(63 - shift);
        Ok(entry)
    }

    /// Checks that all bits were read and the state is that with which the encoder began.
    pub(super) fn finish(self) -> Result<()> {
        match (8 * self.bytes + self.filled as usize).cmp(&(8 * self.floor)) {
            Ordering::Less => Err(CUT_SHORT),
            Ordering::Equal if self.state == 0 => Ok(()),
            _ => Err(CodecError::Corrupt("residuals left over")),
        }
    }
}

/// One operation of the writer: a symbol followed by plain bits, or plain bits alone.
///
/// Bits 0-39: the plain bits. Bits 40-45: their number. Bits 46-55: table and symbol. Bit 63: no symbol.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Op(u64);

impl Op {
    const WIDTH_AT: u32 = 40;
    const SYMBOL_AT: u32 = 46;
    const PLAIN: u64 = 1 << 63;

    #[inline(always)]
    pub(super) fn symbol(table: usize, symbol: usize) -> Self {
        Self(((table * SYMBOLS + symbol) as u64) << Self::SYMBOL_AT)
    }

    #[inline(always)]
    fn bits(Field { value, width }: Field) -> Self {
        Self(Self::PLAIN | u64::from(width) << Self::WIDTH_AT | u64::from(value))
    }

    /// Maximum number of bytes of one operation: 40 plain bits and a symbol's, or 48 plain bits.
    const MAX_BYTES: usize = (Self::WIDTH_AT + STATE_BITS).div_ceil(8) as usize;
}

/// A value in `width` bits, at most 48.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Field {
    pub(super) value: u32,
    pub(super) width: u32,
}

/// The operations of one channel, in reading order.
#[derive(Debug, Default)]
pub(super) struct Ops {
    list: Vec<Op>,
    n: usize,
}

impl Ops {
    /// Maximum number of operations per row: a count of zero rows, a symbol, low bits and three larger magnitudes.
    const PER_ROW: usize = 6;

    /// Allocates memory for `n_rows` rows.
    pub(super) fn grow(&mut self, n_rows: usize) {
        self.list.resize(self.list.len().max(Self::PER_ROW * n_rows), Op::default());
    }

    /// Maximum number of bytes that all operations take.
    pub(super) fn max_bytes(&self) -> usize {
        self.list.len() * Op::MAX_BYTES
    }

    pub(super) fn clear(&mut self) {
        self.n = 0;
    }

    #[inline(always)]
    pub(super) fn push(&mut self, op: Op) {
        if let Some(slot) = self.list.get_mut(self.n) {
            *slot = op;
            self.n += 1;
        }
    }

    /// Appends a symbol and the fields after it.
    #[inline(always)]
    pub(super) fn push_row(&mut self, symbol: Op, fields: [Field; 4]) {
        let width = fields.iter().map(|field| field.width).sum::<u32>();
        if width <= Op::WIDTH_AT {
            let bits =
                fields.iter().fold(0, |bits, field| bits << field.width | u64::from(field.value));
            self.push(Op(symbol.0 | u64::from(width) << Op::WIDTH_AT | bits));
            return;
        }
        self.push(symbol);
        fields.into_iter().for_each(|field| self.push(Op::bits(field)));
    }
}

/// Writes bits that are read from the end. A copy saves the position to return to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Writer {
    /// Bits that do not yet fill a byte.
    word: u64,
    filled: u32,
    state: u32,
}

impl Writer {
    pub(super) const NEW: Self = Self { word: 0, filled: 0, state: STATES as u32 };

    /// Writes the operations, last first, and returns the number of bytes. `bytes` has [`Ops::max_bytes`] and 8 more.
    #[inline(always)]
    pub(super) fn ops(&mut self, tables: &Tables, ops: &Ops, bytes: &mut [u8]) -> usize {
        let mut this = *self;
        let mut at = 0;
        for op in ops.list[..ops.n].iter().rev() {
            let value = op.0 & ((1 << Op::WIDTH_AT) - 1);
            let width = (op.0 >> Op::WIDTH_AT) as u32 % 64;
            this.word |= value << this.filled;
            this.filled += width;
            if op.0 & Op::PLAIN == 0 {
                let symbol = (op.0 >> Op::SYMBOL_AT) as usize % (TABLES * SYMBOLS);
                let Transition { bits, offset } = tables.transitions[symbol];
                let width = this.state.wrapping_add(bits) >> 16;
                this.word |= u64::from(this.state & ((1 << width) - 1)) << this.filled;
                this.filled += width;
                let next = (this.state >> width) as i32 + offset;
                this.state = tables.states[next as usize % (TABLES * STATES)].into();
            }
            at = this.flush(bytes, at);
        }
        *self = this;
        at
    }

    /// Writes the whole bytes of up to 63 bits at `at`, and returns the position of the next byte.
    #[inline(always)]
    fn flush(&mut self, bytes: &mut [u8], at: usize) -> usize {
        if let Some(next) = bytes.get_mut(at..at + 8) {
            next.copy_from_slice(&self.word.to_le_bytes());
        }
        self.word >>= self.filled & !7;
        let full = self.filled / 8;
        self.filled %= 8;
        at + full as usize
    }

    /// Appends the state, if any channel was coded, then the flag and the end mark.
    pub(super) fn finish(mut self, coded: bool, flag: bool, out: &mut Vec<u8>) {
        let mut bytes = [0; 12];
        if coded {
            self.word |= u64::from(self.state - STATES as u32) << self.filled;
            self.filled += STATE_BITS;
        }
        self.word |= (0b10 | u64::from(flag)) << self.filled;
        self.filled += 2;
        let mut at = self.flush(&mut bytes, 0);
        at += usize::from(self.filled > 0);
        out.extend_from_slice(&bytes[..at]);
    }
}
