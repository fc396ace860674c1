//! The bits of a payload, written from the last to the first.

use super::{
    model::{STATE_BITS, STATES, SYMBOLS, TABLES},
    tans::{Tables, Transition},
};

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

    /// A value of 32 bits in so many, at most 48.
    #[inline(always)]
    fn bits((value, width): (u32, u32)) -> Self {
        Self(Self::PLAIN | u64::from(width) << Self::WIDTH_AT | u64::from(value))
    }

    /// Most bytes of one op: 40 bits and those of a symbol, or 48.
    pub(super) const MAX_BYTES: usize = (Self::WIDTH_AT + STATE_BITS).div_ceil(8) as usize;
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

    /// A symbol, and behind it bits and fields of so many bits.
    #[inline(always)]
    pub(super) fn push_row(&mut self, symbol: Op, low: (u32, u32), fields: [(u32, u32); 3]) {
        let all = [low, fields[0], fields[1], fields[2]];
        let width = low.1 + fields[0].1 + fields[1].1 + fields[2].1;
        if width <= Op::WIDTH_AT {
            let bits = all.iter().fold(0, |bits, &(value, width)| bits << width | u64::from(value));
            self.push(Op(symbol.0 | u64::from(width) << Op::WIDTH_AT | bits));
            return;
        }
        self.push(symbol);
        all.into_iter().for_each(|bits| self.push(Op::bits(bits)));
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
