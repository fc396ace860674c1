//! Table-driven asymmetric numeral systems (Duda, arXiv 1311.2540), in the table layout of FSE.
//!
//! The encoder goes through the symbols from the last to the first and appends bits; the decoder reads
//! the same bits from the end to the start. Plain bit fields go through the same stream.

use std::sync::LazyLock;

use super::{
    model::{self, LOW_BITS, QUIET, STATE_BITS, STATES, SYMBOLS, TABLES},
    places::{PLACES, table_at},
    residual::{LARGER, ONES},
};

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
pub(super) const BASE_AT: u32 = 16;
/// Where 63 less the bits to read are.
pub(super) const SHIFT_AT: u32 = 26;

/// How an encoder codes one symbol of one table.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Transition {
    /// `(state + bits) >> 16` is the number of bits to write.
    pub(super) bits: u32,
    /// Added to the state without these bits: the index of the next state, among those of all tables.
    pub(super) offset: i32,
}

/// All tables of the model, for both directions.
#[derive(Debug)]
pub(super) struct Tables {
    /// By [place](super::places::table_at).
    pub(super) entries: Box<[Entry; PLACES * STATES]>,
    pub(super) transitions: Box<[Transition; TABLES * SYMBOLS]>,
    /// Next states of the encoder, [`STATES`] to `2 * STATES - 1`.
    pub(super) states: Box<[u16; TABLES * STATES]>,
}

const _: () = assert!((TABLES * STATES).is_power_of_two() && (TABLES * SYMBOLS).is_power_of_two());

/// Odd and near 5/8 of the states: every state is visited once, a symbol's are far apart.
const STRIDE: usize = STATES / 2 + STATES / 8 + 3;

static TABLES_OF_MODEL: LazyLock<Tables> = LazyLock::new(Tables::build);

impl Tables {
    pub(super) fn get() -> &'static Self {
        &TABLES_OF_MODEL
    }

    fn build() -> Self {
        let mut tables = Self {
            entries: Box::new([0; PLACES * STATES]),
            transitions: Box::new([Transition::default(); TABLES * SYMBOLS]),
            states: Box::new([0; TABLES * STATES]),
        };
        for table in 0..TABLES {
            tables.fill(table);
        }
        tables
    }

    fn fill(&mut self, table: usize) {
        let at = table * STATES;
        let counts: [usize; SYMBOLS] =
            std::array::from_fn(|symbol| model::frequency(table, symbol).into());
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
            let (ones, more) = match table {
                QUIET => (0, false),
                _ => (ONES[symbol], LARGER[symbol] != 0 || LOW_BITS[table] > 0),
            };
            let row = u32::from(ones) << 8 | if more { MORE } else { 0 };
            let entry = (63 - bits) << SHIFT_AT | (base as u32) << BASE_AT | row | symbol as u32;
            for place in (0..PLACES).filter(|&place| table_at(place) == Some(table)) {
                self.entries[place * STATES + state] = entry;
            }
            self.states[at + start[symbol] + x - counts[symbol]] = (STATES + state) as u16;
        }
    }
}
