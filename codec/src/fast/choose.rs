//! What an encoder chooses for a row, and what it writes for it.

use super::{
    model::{Activity, GOLOMB, LOW_BITS, QUIET, QUIET_ROWS, WAKE},
    walk::{self, Point, Rows, Side},
    writer::Op,
};
use crate::CodecError;

/// Adding this and taking it off again rounds to the nearest integer, for values within 2^22.
const ROUND: f32 = 12_582_912.0;

/// Sets the target of the last anchor, which may lie up to 15 rows beyond the samples: on a line.
#[inline(always)]
pub(super) fn ahead(targets: &mut [Point], n: usize, origin: usize) {
    let end = walk::extent(n);
    let window = (n + origin).saturating_sub(1).min(4);
    if n == 0 || end == n {
        return;
    }
    let last = targets[n];
    let before = targets[n - window.min(n)];
    let factor = if window == 0 { 0.0 } else { ((end - n) as f32 / window as f32).min(4.0) };
    targets[end] = std::array::from_fn(|i| last[i] + (last[i] - before[i]) * factor);
}

pub(super) struct Choosing<'a> {
    /// By row of the run.
    pub(super) targets: &'a [Point],
    /// Residuals of the level, in steps.
    pub(super) steps: &'a mut [Point],
    pub(super) ops: &'a mut [Op],
    pub(super) n_ops: usize,
    pub(super) n: usize,
    pub(super) at: usize,
    pub(super) finest: bool,
    pub(super) step: f32,
    pub(super) inverse: f32,
    /// Square of the tolerance.
    pub(super) ball: f32,
    /// Square of the largest distance that can be coded.
    pub(super) reach: f32,
    /// Whether all residuals so far can be coded.
    pub(super) in_reach: bool,
    pub(super) kept: u32,
}

impl Choosing<'_> {
    /// The residual of a row on which nothing depends: one step of +-1 less, where that stays inside
    /// the ball.
    #[inline(always)]
    fn shorten(&self, off: Point, mut steps: Point) -> Point {
        let mut error = 0.0;
        let (mut least, mut pick) = (f32::INFINITY, 0);
        for axis in 0..3 {
            let rest = off[axis] - steps[axis] * self.step;
            error += rest * rest;
            let more = off[axis] * off[axis] - rest * rest;
            let more = if steps[axis].abs() == 1.0 { more } else { f32::INFINITY };
            (least, pick) = if more < least { (more, axis) } else { (least, pick) };
        }
        let worth = error + least <= self.ball;
        for (axis, steps) in steps.iter_mut().enumerate() {
            *steps = if worth && axis == pick { 0.0 } else { *steps };
        }
        steps
    }

    /// Codes a row; gives the sum of its magnitudes.
    #[inline(always)]
    fn row(&mut self, table: usize, steps: Point) -> u32 {
        let order = GOLOMB[table];
        let low_bits = LOW_BITS[table];
        let half = (1 << low_bits) >> 1;
        let (mut symbol, mut sum, mut low) = (0, 0, 0);
        let mut fields = [Op::default(); 3];
        for (field, &steps) in fields.iter_mut().zip(&steps[..3]) {
            let value = steps as i32;
            sum += value.unsigned_abs();
            let high = (value + half) >> low_bits;
            low = low << low_bits | ((value + half) & ((1 << low_bits) - 1)) as u32;
            let magnitude = high.unsigned_abs();
            let larger = magnitude > 1;
            let code = magnitude.wrapping_sub(2).wrapping_add(1 << order);
            let width = if larger { 64 - 2 * code.leading_zeros() - order } else { 0 };
            let code = if larger { code << 1 | u32::from(high < 0) } else { 0 };
            *field = Op::bits(code, width);
            let axis = if larger { 3 } else { magnitude as usize + usize::from(high < 0) };
            symbol = symbol << 2 | axis;
        }
        let has_larger = symbol & symbol >> 1 & 0b01_01_01 != 0;
        if low_bits > 0 {
            // Before the fields: these alone have a symbol right before them.
            self.push(Op::symbol(table, symbol, false));
            self.push(Op::bits(low, 3 * low_bits));
            for field in fields {
                self.push(field);
            }
            return sum;
        }
        self.push(Op::symbol(table, symbol, has_larger));
        if has_larger {
            for field in fields {
                self.push(field);
            }
        }
        sum
    }

    #[inline(always)]
    fn push(&mut self, op: Op) {
        if let Some(slot) = self.ops.get_mut(self.n_ops) {
            *slot = op;
            self.n_ops += 1;
        }
    }
}

impl Side for Choosing<'_> {
    #[inline(always)]
    fn enter(
        &mut self,
        level: usize,
        _rows: Rows,
        _activity: &mut Activity,
    ) -> Result<(), CodecError> {
        self.at = 0;
        self.finest = level == 0;
        Ok(())
    }

    #[inline(always)]
    fn settle(&mut self, row: usize, prediction: Point) -> Point {
        let target = self.targets[row];
        let off: Point = std::array::from_fn(|i| target[i] - prediction[i]);
        let square = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        // Not so where it is not a number.
        self.in_reach &= square <= self.reach;
        let inside = square <= self.ball;
        let scale = if inside { 0.0 } else { self.inverse };
        let mut steps: Point = std::array::from_fn(|i| (off[i] * scale + ROUND) - ROUND);
        if self.finest && !inside {
            steps = self.shorten(off, steps);
        }
        self.steps[self.at] = steps;
        self.at += 1;
        std::array::from_fn(|i| prediction[i] + steps[i] * self.step)
    }

    #[inline(always)]
    fn leave(&mut self, _level: usize, rows: Rows, activity: &mut Activity) {
        if !self.in_reach {
            // The channel will be stored raw.
            return;
        }
        let n = self.at;
        let mut i = 0;
        while i < n {
            let mut table = activity.class();
            if activity.is_quiet() {
                let most = (n - i).min(QUIET_ROWS);
                let zeros = self.steps[i..i + most]
                    .iter()
                    .position(|steps| *steps != [0.0; 4])
                    .unwrap_or(QUIET_ROWS);
                self.push(Op::symbol(QUIET, zeros, false));
                i += zeros.min(most);
                if zeros == QUIET_ROWS {
                    continue;
                }
                table = WAKE;
            }
            let sum = self.row(table, self.steps[i]);
            activity.push(sum);
            // The last anchor may lie beyond the samples.
            self.kept += u32::from(sum > 0 && rows.row(i) <= self.n);
            i += 1;
        }
    }
}
