//! The representation of a channel: the values that it takes, with their numbers, and the head that states it in a block.
//!
//! A cell is the interval of real numbers that is nearer to its value than to any other. Numbers are in the order of
//! values, so that a probability of an interval of numbers is the difference of two values of a distribution function.

use super::prediction::REFERENCES;
use crate::{
    Result,
    coding::range::{BinaryCoder, Bit},
    ensure,
};

/// The bits of the largest finite float32.
const FLOAT_MAX: i64 = 0x7f7f_ffff;

/// Numbers of lattice cells are within plus and minus this. A float32 has 24 bits, so it cannot represent a
/// lattice of more cells.
pub(super) const LATTICE_MAX: i64 = 1 << 26;

/// Largest number of values in a palette.
pub(super) const PALETTE_MAX: usize = 4096;

/// The integer of a float32 in the order of values, -0.0 next to 0.0; NaN lie beyond the infinities.
#[inline(always)]
pub(super) fn ordered(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { bits ^ i32::MAX } else { bits }
}

/// The inverse of [`ordered`].
#[inline(always)]
pub(super) fn from_ordered(ordered: i32) -> f32 {
    let bits = if ordered < 0 { ordered ^ i32::MAX } else { ordered };
    f32::from_bits(bits as u32)
}

/// The float32 with a number: its bits without the sign, and the sign of the number. There is no -0.0.
#[inline(always)]
fn from_magnitude(number: i64) -> f32 {
    let magnitude = f32::from_bits(number.unsigned_abs() as u32);
    if number < 0 { -magnitude } else { magnitude }
}

/// How the cells of a channel are numbered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum CellForm {
    /// Every float32 whose lowest bits, as many as stated, are zero.
    Float { zeros: u32 },
    /// `k * quantum + offset`, computed in f64 and rounded to f32.
    Lattice { quantum: f64, offset: f64 },
    /// A sorted list of values.
    Palette,
    /// No cells: samples are stored bit by bit.
    Stored,
}

/// Maximum number of decimals that values can be rounded to.
const DECIMALS_MAX: u32 = 9;

/// Powers of ten by exponent.
const TENS: [f64; DECIMALS_MAX as usize + 1] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];

/// The representation of a channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cells {
    pub(super) form: CellForm,
    /// Values were rounded to this number of decimals, if to any: they were once stored as text.
    pub(super) decimals: Option<u32>,
    /// The values of [`CellForm::Palette`], ascending as [`ordered`].
    pub(super) palette: Vec<i32>,
}

impl Default for Cells {
    fn default() -> Self {
        Self { form: CellForm::Float { zeros: 0 }, decimals: None, palette: Vec::new() }
    }
}

impl Cells {
    /// Resets to all float32; keeps the memory.
    pub(super) fn clear(&mut self) {
        (self.form, self.decimals) = (CellForm::Float { zeros: 0 }, None);
        self.palette.clear();
    }

    /// The smallest and the largest number of a cell.
    #[inline(always)]
    pub(super) fn bounds(&self) -> (i64, i64) {
        match self.form {
            CellForm::Float { zeros } => (-(FLOAT_MAX >> zeros), FLOAT_MAX >> zeros),
            CellForm::Stored => (0, 0),
            CellForm::Lattice { .. } => (-LATTICE_MAX, LATTICE_MAX),
            CellForm::Palette => (0, self.palette.len() as i64 - 1),
        }
    }

    /// The exact number that the value of a cell is rounded from.
    #[inline(always)]
    pub(super) fn position(&self, cell: i64) -> f64 {
        match self.form {
            CellForm::Float { zeros } => f64::from(from_magnitude(cell << zeros)),
            CellForm::Lattice { quantum, offset } => cell as f64 * quantum + offset,
            CellForm::Palette => {
                from_ordered(self.palette.get(cell as usize).copied().unwrap_or_default()).into()
            }
            CellForm::Stored => 0.0,
        }
    }

    /// The value of a cell within the bounds.
    #[inline(always)]
    pub(super) fn value(&self, cell: i64) -> f32 {
        let position = self.position(cell);
        let Some(decimals) = self.decimals else { return position as f32 };
        let ten = TENS[decimals as usize % TENS.len()];
        ((position * ten).round_ties_even() / ten) as f32
    }

    /// The cell, within the bounds, of a value; either of the nearest two for a value halfway between them.
    #[inline(always)]
    pub(super) fn nearest(&self, value: f64) -> i64 {
        let (first, last) = self.bounds();
        let cell = match self.form {
            CellForm::Float { zeros } => {
                let half = (1_i64 << zeros) >> 1;
                let single = value as f32;
                let magnitude = (i64::from(single.to_bits() & 0x7fff_ffff) + half) >> zeros;
                if single < 0.0 { -magnitude } else { magnitude }
            }
            CellForm::Lattice { quantum, offset } => {
                let cell = (value - offset) / quantum;
                (cell + if cell < 0.0 { -0.5 } else { 0.5 }) as i64
            }
            CellForm::Palette => {
                let above =
                    self.palette.partition_point(|&entry| f64::from(from_ordered(entry)) < value);
                let (low, high) = (above.saturating_sub(1) as i64, (above as i64).min(last));
                let middle = (self.position(low) + self.position(high)) / 2.0;
                if value < middle { low } else { high }
            }
            CellForm::Stored => 0,
        };
        cell.clamp(first, last)
    }

    /// Whether a finite float32, as [`ordered`], is the value of a cell.
    pub(super) fn has(&self, value: i32) -> bool {
        let value = from_ordered(value);
        self.value(self.nearest(value.into())).to_bits() == value.to_bits()
    }

    /// The border between a cell and the next.
    #[inline(always)]
    pub(super) fn border(&self, cell: i64) -> f64 {
        (self.position(cell) + self.position(cell + 1)) / 2.0
    }

    /// Whether all cells from one to another have the same width, or their width is irrelevant.
    #[inline(always)]
    pub(super) fn is_even(&self, first: i64, last: i64) -> bool {
        match self.form {
            CellForm::Float { zeros } => {
                let exponent = |cell: i64| (cell << zeros) >> 23;
                exponent(first) == exponent(last)
            }
            CellForm::Lattice { .. } | CellForm::Palette | CellForm::Stored => true,
        }
    }

    /// Validates decoded numbers.
    pub(super) fn check(&self) -> Result<()> {
        let is_valid = match self.form {
            CellForm::Float { zeros } => zeros < 31,
            CellForm::Lattice { quantum, offset } => {
                // All values are finite, and differ in f64.
                let is_finite = quantum > 1e-45 && LATTICE_MAX as f64 * quantum < 3e38;
                is_finite && offset >= -quantum && offset <= quantum
            }
            CellForm::Palette => {
                let finite = |&entry: &i32| from_ordered(entry).is_finite();
                !self.palette.is_empty()
                    && self.palette.iter().all(finite)
                    && self.palette.is_sorted_by(|a, b| a < b)
            }
            CellForm::Stored => true,
        };
        let is_valid = is_valid && self.decimals.is_none_or(|decimals| decimals <= DECIMALS_MAX);
        ensure(is_valid, "an invalid representation of the samples")
    }
}

/// The earlier samples that prediction uses.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum Past {
    #[default]
    All,
    /// Samples that are not events, for a channel whose samples are held.
    Cells,
    /// Samples that are events, for a channel whose every second sample is interpolated.
    Events,
}

/// The parameters of a channel in a block, except its cells.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Head {
    /// The binary exponent of the channel's unit, in which it is predicted. Stated in the first block since a key.
    pub(super) exponent: i8,
    /// The number of references, the earlier channels that predict this one, and their indices. Stated in the first
    /// block since a key.
    pub(super) n_references: u8,
    pub(super) references: [u8; REFERENCES],
    /// Whether repeats of the previous sample are coded as events, in even and in odd rows since the key.
    pub(super) repeats: [bool; 2],
    /// Whether samples on the line through the previous two are coded as events, in even and in odd rows.
    pub(super) lines: [bool; 2],
    /// The earlier samples that prediction uses.
    pub(super) past: Past,
    /// Whether samples may deviate from the values of the cells.
    pub(super) corrects: bool,
    /// The bits of a frequent value that is coded as an event.
    pub(super) mode: Option<u32>,
}

/// A power of two.
#[inline(always)]
fn power(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

impl Head {
    /// The channel's unit.
    #[inline(always)]
    pub(super) fn scale(self) -> f64 {
        power(self.exponent.into())
    }

    /// The inverse of the channel's unit.
    #[inline(always)]
    pub(super) fn per_unit(self) -> f64 {
        power(-i32::from(self.exponent))
    }
}

/// The adaptive probabilities of heads.
#[derive(Debug, Clone)]
pub(super) struct HeadModel {
    flags: [Bit; 16],
    logs: [Bit; 33],
    /// The quantum of the last lattice.
    quantum: f64,
    /// Bits of the index of a channel.
    index_bits: u32,
}

/// Indices of flags.
const SAME: usize = 0;
const FLAGS: usize = 1;
const MODE: usize = 8;
const FORM: usize = 9;
const IS_SINGLE: usize = 12;
const SAME_QUANTUM: usize = 13;
const HAS_OFFSET: usize = 14;
const HAS_DECIMALS: usize = 15;

impl HeadModel {
    /// `index_bits` is the size of a channel's index in its group.
    pub(super) fn new(index_bits: u32) -> Self {
        Self { flags: [Bit::NEW; 16], logs: [Bit::NEW; 33], quantum: 1.0, index_bits }
    }

    /// Resets all probabilities.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.index_bits);
    }

    /// Codes a head and its cells: those of `wanted` in the encoder, those read in the decoder. `state` has the head
    /// and cells of the previous block, and receives those of this one. `is_first`: the channel has had no sample since
    /// the key.
    pub(super) fn code<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        is_first: bool,
        state: (&mut Head, &mut Cells),
        wanted: (Head, &Cells),
    ) -> Result<()> {
        let (known_head, known_cells) = state;
        let (head, cells) = wanted;
        let is_same = !is_first && head == *known_head && *cells == *known_cells;
        if !is_first && coder.bit(&mut self.flags[SAME], is_same) {
            return Ok(());
        }
        if is_first {
            known_head.exponent = coder.plain((head.exponent as u8).into(), 8) as u8 as i8;
            ensure(known_head.exponent > -127, "a unit out of range")?;
            known_head.n_references = coder.plain(head.n_references.into(), 3) as u8;
            ensure(usize::from(known_head.n_references) <= REFERENCES, "too many references")?;
            for i in 0..usize::from(known_head.n_references) {
                known_head.references[i] =
                    coder.plain(head.references[i].into(), self.index_bits) as u8;
            }
        }
        let is_partial = head.past != Past::All;
        let of_events = head.past == Past::Events;
        let ([r0, r1], [l0, l1]) = (head.repeats, head.lines);
        let wanted = [r0, r1, l0, l1, is_partial, of_events, head.corrects];
        let mut flags = [false; 7];
        for (i, flag) in flags.iter_mut().enumerate() {
            *flag = coder.bit(&mut self.flags[FLAGS + i], wanted[i]);
        }
        let [r0, r1, l0, l1, is_partial, of_events, corrects] = flags;
        let (repeats, lines) = ([r0, r1], [l0, l1]);
        let past = match (is_partial, of_events) {
            (false, _) => Past::All,
            (true, false) => Past::Cells,
            (true, true) => Past::Events,
        };
        let mode = coder
            .bit(&mut self.flags[MODE], head.mode.is_some())
            .then(|| coder.plain(head.mode.unwrap_or_default().into(), 32) as u32);
        *known_head = Head { repeats, lines, past, corrects, mode, ..*known_head };
        known_cells.palette.clear();
        known_cells.decimals = coder
            .bit(&mut self.flags[HAS_DECIMALS], cells.decimals.is_some())
            .then(|| coder.plain(cells.decimals.unwrap_or_default().into(), 4) as u32);
        let number = match cells.form {
            CellForm::Float { .. } => 0,
            CellForm::Lattice { .. } => 1,
            CellForm::Palette => 2,
            CellForm::Stored => 3,
        };
        known_cells.form = if !coder.bit(&mut self.flags[FORM], number != 0) {
            let wanted = if let CellForm::Float { zeros } = cells.form { zeros } else { 0 };
            CellForm::Float { zeros: coder.plain(wanted.into(), 5) as u32 }
        } else if !coder.bit(&mut self.flags[FORM + 1], number != 1) {
            self.lattice(coder, cells.form)
        } else if !coder.bit(&mut self.flags[FORM + 2], number != 2) {
            self.palette(coder, &cells.palette, &mut known_cells.palette)?;
            CellForm::Palette
        } else {
            CellForm::Stored
        };
        known_cells.check()
    }

    fn lattice<C: BinaryCoder>(&mut self, coder: &mut C, wanted: CellForm) -> CellForm {
        let (quantum, offset) = match wanted {
            CellForm::Lattice { quantum, offset } => (quantum, offset),
            _ => (1.0, 0.0),
        };
        let is_same = quantum.to_bits() == self.quantum.to_bits();
        if !coder.bit(&mut self.flags[SAME_QUANTUM], is_same) {
            self.quantum = self.number(coder, quantum);
        }
        let has_offset = coder.bit(&mut self.flags[HAS_OFFSET], offset != 0.0);
        let offset = if has_offset { self.number(coder, offset) } else { 0.0 };
        CellForm::Lattice { quantum: self.quantum, offset }
    }

    /// Codes a number in 64 bits, or in the 32 bits of a float32 if they are enough.
    fn number<C: BinaryCoder>(&mut self, coder: &mut C, number: f64) -> f64 {
        let single = number as f32;
        let is_single = f64::from(single).to_bits() == number.to_bits();
        if coder.bit(&mut self.flags[IS_SINGLE], is_single) {
            f32::from_bits(coder.plain(single.to_bits().into(), 32) as u32).into()
        } else {
            f64::from_bits(coder.plain(number.to_bits(), 64))
        }
    }

    /// Codes a palette: its length, its first value, and the gaps between values in Exp-Golomb code.
    fn palette<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        wanted: &[i32],
        palette: &mut Vec<i32>,
    ) -> Result<()> {
        const LENGTH_BITS: u32 = PALETTE_MAX.ilog2();
        let n = coder.plain(wanted.len().saturating_sub(1) as u64, LENGTH_BITS) as usize + 1;
        let mut entry = coder.plain(wanted.first().copied().unwrap_or_default() as u32 as u64, 32)
            as u32 as i32;
        palette.push(entry);
        for i in 1..n {
            let next = wanted.get(i).map_or(1, |&next| i64::from(next) - i64::from(entry));
            let wanted_log = next.max(1).ilog2();
            let mut log = 0;
            while coder.bit(&mut self.logs[log as usize], wanted_log > log) {
                log += 1;
                ensure(log < 32, "a palette out of range")?;
            }
            let gap = 1 << log | coder.plain(next as u64, log) as i64;
            let sum = i64::from(entry) + gap;
            ensure(i32::try_from(sum).is_ok(), "a palette out of range")?;
            entry = sum as i32;
            palette.push(entry);
        }
        Ok(())
    }
}
