//! What an encoder chooses: where the rows of a run should be, their residuals in steps, and what is to be
//! written for these.

use super::{
    MAX_STEPS,
    model::{ANCHOR, Activity, GOLOMB, LOW_BITS, QUIET, QUIET_ROWS, WAKE},
    planes::{LANES, Planes, Point, scatter, split, whole},
    tans::{Op, Ops},
    walk::{self, Rows, SPAN, Side},
};
use crate::{
    CodecError, Position,
    bound::{squared_distance, widen},
};

/// Adding this and taking it off again rounds to the nearest integer, for values within 2^22; and its bits are then
/// that integer more.
const ROUND: f32 = 12_582_912.0;

/// Of a symbol: an axis is larger than +-1, and more must be written than the symbol.
pub(super) const LARGER: u8 = 1 << 7;

/// What residuals are chosen by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    step: f32,
    inverse: f32,
    /// Square of the tolerance.
    ball: f32,
    /// Square of the largest distance that can be coded.
    reach: f32,
}

/// One row.
pub(super) struct Chosen {
    pub(super) point: [f32; 3],
    pub(super) steps: [i32; 3],
    /// As without low bits; [`LARGER`] is set where it is not all.
    pub(super) symbol: u8,
    /// Of the magnitudes, cut to a byte.
    pub(super) sum: u8,
    /// A residual cannot be coded.
    pub(super) out_of_reach: bool,
}

impl Rule {
    #[inline(always)]
    pub(super) fn new(tolerance_mm: f64, step: f32) -> Self {
        Self {
            step,
            inverse: step.recip(),
            // Less than the tolerance by more than the rounding of the distance in f32.
            ball: (tolerance_mm * tolerance_mm * (1.0 - 1e-5)) as f32,
            reach: (f64::from(step) * f64::from(MAX_STEPS)).powi(2) as f32,
        }
    }

    /// Chooses for a row. Those of the `FINEST` level, on which nothing depends, have one step of +-1 less where that
    /// stays inside the ball. There is no branch: it is done to rows side by side.
    #[inline(always)]
    pub(super) fn row<const FINEST: bool>(self, target: [f32; 3], prediction: [f32; 3]) -> Chosen {
        let off = [0, 1, 2].map(|axis| target[axis] - prediction[axis]);
        let square = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        // Not so where it is not a number.
        let in_reach = square <= self.reach;
        let scale = if square <= self.ball { 0.0 } else { self.inverse };
        let mut steps = off.map(|off| (off * scale + ROUND) - ROUND);
        if FINEST {
            steps = self.shorten(off, steps);
        }
        let values =
            steps.map(|steps| (steps + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32);
        let magnitudes = values.map(i32::unsigned_abs);
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let small = magnitudes[axis].wrapping_add(values[axis] as u32 >> 31);
            if magnitudes[axis] > 1 { 3 } else { small }
        });
        let [a, b, c] = magnitudes;
        let larger = if a.max(b).max(c) > 1 { u32::from(LARGER) } else { 0 };
        Chosen {
            point: [0, 1, 2].map(|axis| prediction[axis] + steps[axis] * self.step),
            steps: values,
            symbol: (x << 4 | y << 2 | z | larger) as u8,
            // Beyond what can be coded, these and the symbol are not looked at.
            sum: a.wrapping_add(b).wrapping_add(c).min(255) as u8,
            out_of_reach: !in_reach,
        }
    }

    /// Leaves out the step of +-1 that is missed least, where all else is inside the ball without it. Without a
    /// branch: it is done to rows side by side.
    #[inline(always)]
    fn shorten(self, off: [f32; 3], steps: [f32; 3]) -> [f32; 3] {
        let rest = [0, 1, 2].map(|axis| off[axis] - steps[axis] * self.step);
        let error = rest[0] * rest[0] + rest[1] * rest[1] + rest[2] * rest[2];
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let more = off[axis] * off[axis] - rest[axis] * rest[axis];
            if steps[axis].abs() == 1.0 { more } else { f32::INFINITY }
        });
        // Compared one by one: which of three it is would become a branch.
        let y_before_x = y < x;
        let least = if y_before_x { y } else { x };
        let z_first = z < least;
        let least = if z_first { z } else { least };
        let worth = error + least <= self.ball;
        let without = [!y_before_x & !z_first, y_before_x & !z_first, z_first];
        [0, 1, 2].map(|axis| if worth & without[axis] { 0.0 } else { steps[axis] })
    }
}

/// The square of an error in float64, as errors are stated, as bits: what is not a number is largest of all.
#[inline(always)]
fn squared_error(target: [f32; 3], point: [f32; 3]) -> u64 {
    // Without the sign that what is not a number may have.
    squared_distance(widen(target), widen(point)).abs().to_bits()
}

/// Where the rows of a run should be.
#[derive(Debug, Default)]
pub(super) struct Targets {
    /// All rows at first, row 0 foremost; then every 32nd.
    anchors: Planes,
    /// The rows of the strides, one behind another.
    pub(super) levels: Planes,
    /// Where each stride's begin.
    pub(super) starts: [usize; ANCHOR],
    last: Point,
    end: usize,
}

impl Targets {
    pub(super) fn grow(&mut self, room: usize) {
        self.anchors.grow(room);
        self.levels.grow(room + ANCHOR * LANES);
    }

    /// Lays out the samples of a run, as [`Choosing::begin`] takes them.
    #[inline(always)]
    fn take(&mut self, samples: &[Position], origin: usize) {
        let n = samples.len() - origin;
        let end = walk::extent(n);
        let [x, y, z] = self.anchors.axes_mut(1 - origin);
        scatter(samples, x, y, z);
        self.last = ahead(samples, end - n);
        self.end = end;
        let mut start = 0;
        for (level, at) in self.starts.iter_mut().enumerate() {
            let n = end >> (level + 1);
            for (rows, levels) in self.anchors.0.iter_mut().zip(&mut self.levels.0) {
                split(rows, &mut levels[start..], n);
            }
            *at = start;
            start += whole(n + 1);
        }
    }

    /// Of the origin or an anchor.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> Point {
        if row > 0 && row == self.end { self.last } else { self.anchors.get(row / SPAN) }
    }
}

/// The target of the last anchor, which may lie up to 15 rows beyond the samples: on a line.
#[inline(always)]
fn ahead(samples: &[Position], beyond: usize) -> Point {
    let point = |back: usize| {
        let [x, y, z] = samples[samples.len() - 1 - back];
        [x, y, z, 0.0]
    };
    let last = point(0);
    let window = (samples.len() - 1).min(4);
    if beyond == 0 || window == 0 {
        return last;
    }
    let before = point(window);
    let factor = (beyond as f32 / window as f32).min(4.0);
    std::array::from_fn(|i| last[i] + (last[i] - before[i]) * factor)
}

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
    rule: Rule,
    targets: &'a mut Targets,
    residuals: &'a mut Residuals,
    ops: &'a mut Ops,
    /// Rows of the run behind row 0.
    n: usize,
    at: usize,
    /// Whether a residual cannot be coded.
    pub(super) out_of_reach: bool,
    pub(super) kept: u32,
    /// The square of the largest error, as bits.
    worst: u64,
}

impl<'a> Choosing<'a> {
    pub(super) fn new(
        rule: Rule,
        targets: &'a mut Targets,
        residuals: &'a mut Residuals,
        ops: &'a mut Ops,
    ) -> Self {
        Self { rule, targets, residuals, ops, n: 0, at: 0, out_of_reach: false, kept: 0, worst: 0 }
    }

    /// Takes the samples of a run, of which the first is row 0 where it is the `origin`, or else row 1.
    #[inline(always)]
    pub(super) fn begin(&mut self, samples: &[Position], origin: usize) {
        self.targets.take(samples, origin);
        self.n = samples.len() - origin;
    }

    /// The largest error so far.
    pub(super) fn max_error_mm(&self) -> f64 {
        f64::from_bits(self.worst).sqrt()
    }

    #[inline(always)]
    fn choose_level<const FINEST: bool>(&mut self, start: usize, count: usize, rows: &mut Planes) {
        let full = count / LANES * LANES;
        for first in (0..full).step_by(LANES) {
            self.choose::<FINEST, LANES>(start, first, rows);
        }
        for row in full..count {
            self.choose::<FINEST, 1>(start, row, rows);
        }
    }

    /// Chooses for some rows of a level, side by side.
    #[inline(always)]
    fn choose<const FINEST: bool, const N: usize>(
        &mut self,
        start: usize,
        first: usize,
        rows: &mut Planes,
    ) {
        let targets: [[f32; N]; 3] = self.targets.levels.rows(start + first);
        let predictions: [[f32; N]; 3] = rows.rows(first);
        let mut points = predictions;
        let (mut steps, mut symbols, mut sums) = ([[0; N]; 3], [0; N], [0; N]);
        let (mut worst, mut out_of_reach) = ([0; N], [false; N]);
        for i in 0..N {
            let target = targets.map(|axis| axis[i]);
            let chosen = self.rule.row::<FINEST>(target, predictions.map(|axis| axis[i]));
            for axis in 0..3 {
                points[axis][i] = chosen.point[axis];
                steps[axis][i] = chosen.steps[axis];
            }
            symbols[i] = chosen.symbol;
            sums[i] = chosen.sum;
            out_of_reach[i] = chosen.out_of_reach;
            worst[i] = squared_error(target, chosen.point) as i64;
        }
        rows.put(first, points);
        let residuals = &mut *self.residuals;
        for (plane, steps) in residuals.steps.iter_mut().zip(steps) {
            plane[first..first + N].copy_from_slice(&steps);
        }
        residuals.symbols[first..first + N].copy_from_slice(&symbols);
        residuals.sums[first..first + N].copy_from_slice(&sums);
        self.out_of_reach |= out_of_reach.contains(&true);
        self.worst = worst.into_iter().fold(self.worst as i64, i64::max) as u64;
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
            self.worst = self.worst.max(squared_error(target, chosen.point));
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
