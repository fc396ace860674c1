//! The head of a channel in a block: its scale, the events that may occur, and its cells.

use super::{
    cells::{CellForm, Cells, PALETTE_MAX},
    predictor::REFERENCES,
};
use crate::{
    Result,
    coding::range::{BinaryCoder, Bit},
    ensure,
};

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
