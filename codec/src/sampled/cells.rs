//! The values that a channel takes, and their numbers: the *cells* of a representation.
//!
//! A cell is the interval of real numbers that is nearer to its value than to any other. Numbers are in the order of
//! values, so that a probability of an interval of numbers is the difference of two values of a distribution function.

use crate::Result;

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
pub(super) const DECIMALS_MAX: u32 = 9;

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
        crate::ensure(is_valid, "an invalid representation of the samples")
    }
}
