//! Table-driven asymmetric numeral systems (Duda, arXiv 1311.2540), in the table layout of FSE.
//!
//! The encoder goes through the symbols from the last to the first and appends bits; the decoder reads
//! the same bits from the end to the start. Plain bit fields go through the same stream.

use std::{cmp::Ordering, sync::LazyLock};

use super::{
    model::{
        Axes, GOLOMB, LOW_BITS, PLACES, STATE_BITS, STATES, SYMBOLS, TABLES, axes, axis_code,
        frequency, table_at,
    },
    planes::Point,
};
use crate::{CodecError, Result, ensure};

/// A decoder's state: symbol in bits 0-5, how many of its axes are +-1 in 8-9, base of the next state in 16-25, 63 less
/// the bits to read in 26-31; bit 6 is set where there is more to read for the row.
///
/// What the next entry waits for is taken out in one step each.
pub(super) type Entry = u32;

/// Bit 6 of an entry.
pub(super) const MORE: Entry = 1 << 6;
/// Bits 8 and 9: a row's magnitude, as [`Activity`](super::model::Activity) counts, where there is no more to read.
pub(super) const MAGNITUDE: Entry = 3 << 8;
/// Where the base of the next state is.
const BASE_AT: u32 = 16;
/// Where 63 less the bits to read are.
const SHIFT_AT: u32 = 26;

/// How an encoder codes one symbol of one table.
#[derive(Debug, Clone, Copy, Default)]
struct Transition {
    /// `(state + bits) >> 16` is the number of bits to write.
    bits: u32,
    /// Added to the state without these bits: the index of the next state, among those of all tables.
    offset: i32,
}

/// All tables of the model, for both directions.
#[derive(Debug)]
pub(super) struct Tables {
    /// By [place](super::model::table_at).
    entries: Box<[Entry; PLACES * STATES]>,
    transitions: Box<[Transition; TABLES * SYMBOLS]>,
    /// Next states of the encoder, [`STATES`] to `2 * STATES - 1`.
    states: Box<[u16; TABLES * STATES]>,
    /// By row symbol: the residual of its axes, of which a larger one stands as 0; and which these are.
    pub(super) residuals: [Point; SYMBOLS],
    pub(super) axes: [Axes; SYMBOLS],
    /// What holds for each table, by its place.
    pub(super) golomb: [u32; PLACES],
    pub(super) low_bits: [u32; PLACES],
}

const _: () = assert!((TABLES * STATES).is_power_of_two() && (TABLES * SYMBOLS).is_power_of_two());

/// Odd and near 5/8 of the states: every state is visited once, a symbol's are far apart.
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

/// Symbols that can be read after a refill: [`STATE_BITS`] each, of 56.
pub(super) const SYMBOLS_FILLED: usize = 56 / STATE_BITS as usize;

/// Bytes before the payload, so that eight can be read at any place that is not beyond the start.
pub(super) const PAD: usize = 16;

/// Reads bits from the end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader<'a> {
    padded: &'a [u8],
    /// Bytes that are not in `word` yet.
    bytes: usize,
    /// The next bits, from bit 63 down.
    word: u64,
    /// How many of them are there.
    filled: u32,
    /// What comes before the bits, padding and others' bytes.
    floor: usize,
    state: usize,
}

impl<'a> Reader<'a> {
    /// Copies the payload behind padding.
    pub(super) fn pad(payload: &[u8], padded: &mut Vec<u8>) {
        padded.clear();
        padded.extend_from_slice(&[0; PAD]);
        padded.extend_from_slice(payload);
    }

    /// `padded` comes from [`pad`](Self::pad).
    pub(super) fn new(padded: &'a [u8]) -> Result<Self> {
        let last = padded.get(PAD..).and_then(<[u8]>::last).ok_or(CUT_SHORT)?;
        ensure(*last != 0, "residuals without an end mark")?;
        let bytes = padded.len();
        let mut reader = Self { padded, bytes, word: 0, filled: 0, floor: PAD, state: 0 };
        reader.refill()?;
        reader.skip(1 + last.leading_zeros());
        Ok(reader)
    }

    /// At least 56 bits are there afterwards.
    #[inline(always)]
    pub(super) fn refill(&mut self) -> Result<()> {
        let bytes = self.padded.get(self.bytes.wrapping_sub(8)..self.bytes).ok_or(CUT_SHORT)?;
        let next = bytes.first_chunk::<8>().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        // What is below the filled bits is what comes next: to set it twice does no harm.
        self.word |= next >> self.filled;
        self.bytes -= ((63 - self.filled) / 8) as usize;
        self.filled |= 56;
        Ok(())
    }

    /// The next bits from bit 63 down; at least 56 of them.
    #[inline(always)]
    pub(super) fn peek(&mut self) -> Result<u64> {
        self.refill()?;
        Ok(self.word)
    }

    /// Passes bits that were peeked at.
    #[inline(always)]
    pub(super) fn skip(&mut self, width: u32) {
        self.word <<= width;
        self.filled -= width;
    }

    /// So many bytes of the payload, from its start, belong to another.
    pub(super) fn leave(&mut self, bytes: usize) {
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

    /// The entry of the next symbol of the table at a place. At most [`STATE_BITS`] are read, which must be there.
    #[inline(always)]
    pub(super) fn entry(&mut self, tables: &Tables, place: usize) -> Result<Entry> {
        // Not cut to the table's size: the next entry would wait for that.
        let at = place * STATES + self.state;
        let entry = *tables.entries.get(at).ok_or(CodecError::Corrupt("a state beyond all"))?;
        let shift = entry >> SHIFT_AT;
        let base = entry >> BASE_AT & (STATES as u32 - 1);
        // In two steps: a shift by 64 is none.
        self.state = (u64::from(base) + (self.word >> 1 >> shift)) as usize;
        self.skip(63 - shift);
        Ok(entry)
    }

    /// All must have been read, down to the state that the encoder began with.
    pub(super) fn finish(self) -> Result<()> {
        match (8 * self.bytes + self.filled as usize).cmp(&(8 * self.floor)) {
            Ordering::Less => Err(CUT_SHORT),
            Ordering::Equal if self.state == 0 => Ok(()),
            _ => Err(CodecError::Corrupt("residuals left over")),
        }
    }
}

/// One thing to code: a symbol with the bits behind it, or bits.
///
/// Bits 0-39 are these bits, 40-45 how many they are, 46-55 the symbol of a table; bit 63 is set where there is none.
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

    /// Most bytes of one op: 40 bits and those of a symbol, or 48.
    const MAX_BYTES: usize = (Self::WIDTH_AT + STATE_BITS).div_ceil(8) as usize;
}

/// A value in so many bits, at most 48.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Field {
    pub(super) value: u32,
    pub(super) width: u32,
}

/// What is to be written.
#[derive(Debug, Default)]
pub(super) struct Ops {
    list: Vec<Op>,
    n: usize,
}

impl Ops {
    /// A count of zeros, a symbol, low bits and three larger magnitudes.
    const PER_ROW: usize = 6;

    /// Room for so many rows.
    pub(super) fn grow(&mut self, n_rows: usize) {
        self.list.resize(self.list.len().max(Self::PER_ROW * n_rows), Op::default());
    }

    /// Most bytes of all of them.
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

    /// A symbol, and what is behind it.
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

/// Writes bits that are read from the end. A copy is a mark to go back to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Writer {
    /// Bits that do not fill a byte yet.
    word: u64,
    filled: u32,
    state: u32,
}

impl Writer {
    pub(super) const NEW: Self = Self { word: 0, filled: 0, state: STATES as u32 };

    /// Writes the ops, last first; gives the number of bytes. `bytes` has [`Ops::max_bytes`], and 8.
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

    /// Writes whole bytes, of 63 bits at most; gives where the next one goes.
    #[inline(always)]
    fn flush(&mut self, bytes: &mut [u8], at: usize) -> usize {
        if let Some(room) = bytes.get_mut(at..at + 8) {
            room.copy_from_slice(&self.word.to_le_bytes());
        }
        self.word >>= self.filled & !7;
        let full = self.filled / 8;
        self.filled %= 8;
        at + full as usize
    }

    /// Appends the state, if anything was coded, then a flag and the bit that marks the end.
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
