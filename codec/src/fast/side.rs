//! An encoder's side of the walk: chooses rows by levels, and lists what is to be written for them.

use super::{
    choose::{LARGER, Rule, choose, square, worst},
    model::{Activity, GOLOMB, LOW_BITS, QUIET, QUIET_ROWS, WAKE},
    planes::Planes,
    targets::Targets,
    walk::{Point, Rows, Side},
    writer::{Op, Ops},
};
use crate::CodecError;

/// The residuals of a level.
#[derive(Debug, Default)]
pub(super) struct Residuals {
    steps: [Vec<i32>; 3],
    symbols: Vec<u8>,
    sums: Vec<u8>,
}

impl Residuals {
    pub(super) fn grow(&mut self, room: usize) {
        // Zero rows are looked for in so many at once.
        let room = room + QUIET_ROWS;
        self.steps.iter_mut().for_each(|steps| steps.resize(steps.len().max(room), 0));
        for bytes in [&mut self.symbols, &mut self.sums] {
            bytes.resize(bytes.len().max(room), 0);
        }
    }
}

pub(super) struct Choosing<'a> {
    pub(super) rule: Rule,
    pub(super) targets: &'a mut Targets,
    pub(super) residuals: &'a mut Residuals,
    pub(super) ops: &'a mut Ops,
    /// Rows of the run behind row 0.
    pub(super) n: usize,
    pub(super) at: usize,
    /// Whether a residual cannot be coded.
    pub(super) out_of_reach: bool,
    pub(super) kept: u32,
    /// The square of the largest error, as bits.
    pub(super) worst: u64,
}

impl Choosing<'_> {
    #[inline(always)]
    fn choose_level<const FINEST: bool>(&mut self, start: usize, count: usize, rows: &mut Planes) {
        let targets = self.targets.levels.axes(start).map(|plane| &plane[..count]);
        let [x, y, z] = &mut rows.0;
        let Residuals { steps: [steps_x, steps_y, steps_z], symbols, sums } = &mut *self.residuals;
        let sums = &mut sums[..count];
        self.out_of_reach |=
            choose::<FINEST>(self.rule, targets, x, y, z, steps_x, steps_y, steps_z, symbols, sums);
        self.worst = self.worst.max(worst(targets, rows.axes(0)));
    }

    /// Codes a row of which the symbol is not all.
    #[inline(always)]
    fn row(&mut self, table: usize, i: usize) {
        let order = GOLOMB[table];
        let low_bits = LOW_BITS[table];
        let half = (1 << low_bits) >> 1;
        let (mut symbol, mut low) = (0, 0);
        let mut fields = [(0, 0); 3];
        for (field, steps) in fields.iter_mut().zip(&self.residuals.steps) {
            let value = steps[i];
            let high = (value + half) >> low_bits;
            low = low << low_bits | ((value + half) & ((1 << low_bits) - 1)) as u32;
            let magnitude = high.unsigned_abs();
            let larger = magnitude > 1;
            let code = magnitude.wrapping_sub(2).wrapping_add(1 << order);
            let width = if larger { 64 - 2 * code.leading_zeros() - order } else { 0 };
            let code = if larger { code << 1 | u32::from(high < 0) } else { 0 };
            *field = (code, width);
            let axis = if larger { 3 } else { magnitude as usize + usize::from(high < 0) };
            symbol = symbol << 2 | axis;
        }
        self.ops.push_row(Op::symbol(table, symbol), (low, 3 * low_bits), fields);
    }
}

impl Side for Choosing<'_> {
    #[inline(always)]
    fn enter(
        &mut self,
        _level: usize,
        _rows: Rows,
        _activity: &mut Activity,
    ) -> Result<(), CodecError> {
        self.at = 0;
        Ok(())
    }

    #[inline(always)]
    fn settle(&mut self, row: usize, prediction: Point) -> Point {
        let [x, y, z, _] = self.targets.row(row);
        let target = [x, y, z];
        let [x, y, z, _] = prediction;
        let chosen = self.rule.row::<false>(target, [x, y, z]);
        // The last anchor may lie beyond the samples.
        if row <= self.n {
            self.worst = self.worst.max(square(target, chosen.point).to_bits());
        }
        self.out_of_reach |= chosen.out_of_reach;
        let Residuals { steps, symbols, sums } = &mut *self.residuals;
        for (plane, steps) in steps.iter_mut().zip(chosen.steps) {
            plane[self.at] = steps;
        }
        symbols[self.at] = chosen.symbol;
        sums[self.at] = chosen.sum;
        let [x, y, z] = chosen.point;
        self.at += 1;
        [x, y, z, 0.0]
    }

    #[inline(always)]
    fn settle_level(&mut self, level: usize, count: usize, rows: &mut Planes) {
        let start = self.targets.starts[level];
        if level == 0 {
            self.choose_level::<true>(start, count, rows);
        } else {
            self.choose_level::<false>(start, count, rows);
        }
    }

    #[inline(always)]
    fn leave(&mut self, _level: usize, rows: Rows, activity: &mut Activity) {
        if self.out_of_reach {
            // The channel will be stored raw.
            return;
        }
        let n = rows.count;
        let mut recent = *activity;
        let mut i = 0;
        while i < n {
            let mut table = recent.class();
            if recent.is_quiet() {
                let most = (n - i).min(QUIET_ROWS);
                let mut ahead = [0; QUIET_ROWS];
                ahead.copy_from_slice(&self.residuals.sums[i..i + QUIET_ROWS]);
                let zeros = (u128::from_le_bytes(ahead).trailing_zeros() / 8) as usize;
                let zeros = if zeros < most { zeros } else { QUIET_ROWS };
                self.ops.push(Op::symbol(QUIET, zeros));
                i += zeros.min(most);
                if zeros == QUIET_ROWS {
                    continue;
                }
                table = WAKE;
            }
            let symbol = self.residuals.symbols[i];
            if symbol & LARGER == 0 && LOW_BITS[table] == 0 {
                self.ops.push(Op::symbol(table, symbol.into()));
            } else {
                self.row(table, i);
            }
            recent.push(self.residuals.sums[i].into());
            i += 1;
        }
        *activity = recent;
        // The last anchor may lie beyond the samples.
        let n = n - usize::from(n > 0 && rows.row(n - 1) > self.n);
        self.kept += self.residuals.sums[..n].iter().filter(|sum| **sum != 0).count() as u32;
    }
}
