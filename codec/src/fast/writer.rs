//! The bits of a payload, written from the last to the first.

use super::{
    model::{STATE_BITS, STATES, SYMBOLS, TABLES},
    tans::{Tables, Transition},
};

/// One thing to code.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Op(u32);

impl Op {
    const SYMBOL: u32 = 1 << 31;
    const LARGER: u32 = 1 << 30;

    /// With `larger`, three fields of bits follow.
    #[inline(always)]
    pub(super) fn symbol(table: usize, symbol: usize, larger: bool) -> Self {
        let larger = u32::from(larger) * Self::LARGER;
        Self(Self::SYMBOL | larger | (table * SYMBOLS + symbol) as u32)
    }

    /// `value` below 2^24 in `width` bits, at most 48.
    #[inline(always)]
    pub(super) fn bits(value: u32, width: u32) -> Self {
        Self(width << 24 | value)
    }

    /// Most bytes of one op.
    pub(super) const MAX_BYTES: usize = 6;
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

    /// Writes the ops, last first; gives the number of bytes. `bytes` has [`Op::MAX_BYTES`] an op, and 8.
    #[inline(always)]
    pub(super) fn ops(&mut self, tables: &Tables, ops: &[Op], bytes: &mut [u8]) -> usize {
        let mut this = *self;
        let mut at = 0;
        let mut end = ops.len();
        while end > 0 {
            end -= 1;
            let mut op = ops[end].0;
            if op & Op::SYMBOL == 0 {
                at = this.put(op & 0xff_ffff, op >> 24, bytes, at);
                // Fields come in threes behind their symbol, or one by one.
                if end >= 3 && ops[end - 3].0 & Op::LARGER != 0 {
                    for field in [ops[end - 1].0, ops[end - 2].0] {
                        at = this.put(field & 0xff_ffff, field >> 24, bytes, at);
                    }
                    end -= 3;
                    op = ops[end].0;
                } else {
                    continue;
                }
            }
            let symbol = (op & !(Op::SYMBOL | Op::LARGER)) as usize % (TABLES * SYMBOLS);
            let Transition { bits, offset } = tables.transitions[symbol];
            let width = this.state.wrapping_add(bits) >> 16;
            at = this.put(this.state & ((1 << width) - 1), width, bytes, at);
            let table = symbol / SYMBOLS * STATES;
            let next = (this.state >> width) as i32 + offset;
            this.state = tables.states[(table + next as usize) % (TABLES * STATES)].into();
        }
        *self = this;
        at
    }

    /// At most 56 bits; gives where the next byte goes.
    #[inline(always)]
    fn put(&mut self, value: u32, width: u32, bytes: &mut [u8], at: usize) -> usize {
        self.word |= u64::from(value) << self.filled;
        self.filled += width;
        if let Some(room) = bytes.get_mut(at..at + 8) {
            room.copy_from_slice(&self.word.to_le_bytes());
        }
        let full = self.filled / 8;
        // In two steps: a shift by 64 is none.
        self.word = self.word >> (4 * full) >> (4 * full);
        self.filled %= 8;
        at + full as usize
    }

    /// Appends the state, if anything was coded, then a flag and the bit that marks the end.
    pub(super) fn finish(mut self, coded: bool, flag: bool, out: &mut Vec<u8>) {
        let mut bytes = [0; 12];
        let mut at = 0;
        if coded {
            at = self.put(self.state - STATES as u32, STATE_BITS, &mut bytes, at);
        }
        at = self.put(0b10 | u32::from(flag), 2, &mut bytes, at);
        at += usize::from(self.filled > 0);
        out.extend_from_slice(&bytes[..at]);
    }
}
