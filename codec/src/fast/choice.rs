//! The encoder's choices for a run: target points, residuals in steps, and the operations that write them.

use super::{
    MAX_STEPS,
    model::{ANCHOR, Activity, GOLOMB, LOW_BITS, QUIET, QUIET_ROWS, WAKE},
    tans::{Field, Op, Ops},
    walk::{self, LANES, LevelRows, PaddedPoint, Planes, RunCodec, SPAN, scatter, split},
};
use crate::{
    Position, Result,
    block::{squared_distance, widen},
};

/// 1.5 * 2^23. Adding and subtracting it rounds values within 2^22 to the nearest integer, and the bits of the sum
/// exceed its bits by that integer.
const ROUND: f32 = 12_582_912.0;

/// Flag of a symbol: an axis is larger than +-1, so that more bits follow.
pub(super) const LARGER: u8 = 1 << 7;

/// The quantiser of residuals for one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quantiser {
    /// The step in millimetres, and its reciprocal.
    step: f32,
    inverse: f32,
    /// Square of the radius of the tolerance ball, in mm^2.
    ball: f32,
    /// Square of the largest distance that can be coded, in mm^2.
    reach: f32,
}

impl Quantiser {
    #[inline(always)]
    pub(super) fn new(tolerance_mm: f64, step: f32) -> Self {
        Self {
            step,
            inverse: step.recip(),
            // Smaller than the squared tolerance by more than the rounding of a squared distance in f32.
            ball: (tolerance_mm * tolerance_mm * (1.0 - 1e-5)) as f32,
            reach: (f64::from(step) * f64::from(MAX_STEPS)).powi(2) as f32,
        }
    }

    /// The steps of a row, and whether they can be coded. On the `FINEST` level, from which no row is predicted, one
    /// axis of +-1 becomes 0 where that stays inside the ball. Without branches, so that it vectorises over rows.
    #[inline(always)]
    fn row<const FINEST: bool>(self, target: [f32; 3], prediction: [f32; 3]) -> ([i32; 3], bool) {
        let off = [0, 1, 2].map(|axis| target[axis] - prediction[axis]);
        let square = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        // False for NaN.
        let in_reach = square <= self.reach;
        let scale = if square <= self.ball { 0.0 } else { self.inverse };
        let mut steps = off.map(|off| (off * scale + ROUND) - ROUND);
        if FINEST {
            steps = self.shorten(off, steps);
        }
        let integer = |steps: f32| (steps + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32;
        (steps.map(integer), in_reach)
    }

    /// Sets to 0 the axis of +-1 whose omission adds the least error, where the result stays inside the ball. Without
    /// branches, so that it vectorises over rows.
    #[inline(always)]
    fn shorten(self, off: [f32; 3], steps: [f32; 3]) -> [f32; 3] {
        let rest = [0, 1, 2].map(|axis| off[axis] - steps[axis] * self.step);
        let error = rest[0] * rest[0] + rest[1] * rest[1] + rest[2] * rest[2];
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let more = off[axis] * off[axis] - rest[axis] * rest[axis];
            if steps[axis].abs() == 1.0 { more } else { f32::INFINITY }
        });
        // Compared one by one: an index of the smallest would become a branch.
        let y_before_x = y < x;
        let least = if y_before_x { y } else { x };
        let z_first = z < least;
        let least = if z_first { z } else { least };
        let worth = error + least <= self.ball;
        let without = [!y_before_x & !z_first, y_before_x & !z_first, z_first];
        [0, 1, 2].map(|axis| if worth & without[axis] { 0.0 } else { steps[axis] })
    }
}

/// The symbol of a row in a table without low bits, with [`LARGER`] where more bits follow; and the sum of its
/// magnitudes, clamped to a byte. `steps` must be small enough to be coded.
#[inline(always)]
fn describe(steps: [i32; 3]) -> (u8, u8) {
    let magnitudes = steps.map(i32::unsigned_abs);
    let [x, y, z] = [0, 1, 2].map(|axis| {
        let small = magnitudes[axis].wrapping_add(steps[axis] as u32 >> 31);
        if magnitudes[axis] > 1 { 3 } else { small }
    });
    let [a, b, c] = magnitudes;
    let larger = if a.max(b).max(c) > 1 { u32::from(LARGER) } else { 0 };
    let sum = a.wrapping_add(b).wrapping_add(c).min(255);
    ((x << 4 | y << 2 | z | larger) as u8, sum as u8)
}

/// The squared error in mm^2, computed in f64, as bits, whose order is that of the errors, with NaN above all numbers.
#[inline(always)]
fn squared_error(target: [f32; 3], point: [f32; 3]) -> u64 {
    // Clears the sign, which NaN may have.
    squared_distance(widen(target), widen(point)).abs().to_bits()
}

// Passes over the rows of a level. Every slice that is written is a parameter of its own, so that the compiler knows
// that it overlaps with no other.

/// Chooses the steps of all rows; `false` when one of them cannot be coded.
#[inline(always)]
fn choose<const FINEST: bool>(
    quantiser: Quantiser,
    targets: [&[f32]; 3],
    predictions: [&[f32]; 3],
    steps_x: &mut [i32],
    steps_y: &mut [i32],
    steps_z: &mut [i32],
) -> bool {
    let n = steps_x.len();
    let ([tx, ty, tz], [px, py, pz]) =
        (targets.map(|axis| &axis[..n]), predictions.map(|axis| &axis[..n]));
    let (steps_y, steps_z) = (&mut steps_y[..n], &mut steps_z[..n]);
    let mut in_reach = true;
    for i in 0..n {
        let (steps, can_be) = quantiser.row::<FINEST>([tx[i], ty[i], tz[i]], [px[i], py[i], pz[i]]);
        [steps_x[i], steps_y[i], steps_z[i]] = steps;
        in_reach &= can_be;
    }
    in_reach
}

/// Computes the symbols and the sums of magnitudes of all rows.
#[inline(always)]
fn describe_all(steps: [&[i32]; 3], symbols: &mut [u8], sums: &mut [u8]) {
    let n = symbols.len();
    let ([x, y, z], sums) = (steps.map(|axis| &axis[..n]), &mut sums[..n]);
    for i in 0..n {
        (symbols[i], sums[i]) = describe([x[i], y[i], z[i]]);
    }
}

/// Adds the residuals to the predictions of all rows; returns the largest squared error, as bits.
#[inline(always)]
fn reconstruct_rows(
    targets: [&[f32]; 3],
    steps: [&[i32]; 3],
    step: f32,
    x: &mut [f32],
    y: &mut [f32],
    z: &mut [f32],
) -> u64 {
    let n = x.len();
    let ([a, b, c], [steps_x, steps_y, steps_z]) =
        (targets.map(|axis| &axis[..n]), steps.map(|axis| &axis[..n]));
    let (y, z) = (&mut y[..n], &mut z[..n]);
    let mut worst = 0;
    for i in 0..n {
        x[i] += steps_x[i] as f32 * step;
        y[i] += steps_y[i] as f32 * step;
        z[i] += steps_z[i] as f32 * step;
        worst = worst.max(squared_error([a[i], b[i], c[i]], [x[i], y[i], z[i]]) as i64);
    }
    worst as u64
}

/// The target points of the rows of a run: its samples.
#[derive(Debug, Default)]
pub(super) struct Targets {
    /// All rows from row 0 on while laid out; then every 32nd.
    anchors: Planes,
    /// The rows of the strides, one stride after another.
    pub(super) levels: Planes,
    /// Index of the first row of each stride in `levels`.
    pub(super) starts: [usize; ANCHOR],
    last: PaddedPoint,
    end: usize,
}

impl Targets {
    pub(super) fn grow(&mut self, padded_len: usize) {
        self.anchors.grow(padded_len);
        self.levels.grow(padded_len + ANCHOR * LANES);
    }

    /// Sorts the samples of a run by level. The arguments are those of [`RunEncoder::begin`].
    #[inline(always)]
    fn lay_out(&mut self, samples: &[Position], origin: usize) {
        let n = samples.len() - origin;
        let end = walk::extent(n);
        let [x, y, z] = self.anchors.0.each_mut().map(|axis| &mut axis[1 - origin..]);
        scatter(samples, x, y, z);
        self.last = last_anchor_target(samples, end - n);
        self.end = end;
        let mut start = 0;
        for (level, at) in self.starts.iter_mut().enumerate() {
            let n = end >> (level + 1);
            for (rows, levels) in self.anchors.0.iter_mut().zip(&mut self.levels.0) {
                split(rows, &mut levels[start..], n);
            }
            *at = start;
            start += (n + 1).next_multiple_of(LANES);
        }
    }

    /// The target of the origin or an anchor.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> PaddedPoint {
        if row > 0 && row == self.end { self.last } else { self.anchors.get(row / SPAN) }
    }
}

/// The target of the last anchor, which may lie up to 15 rows beyond the samples: extrapolated along the line through
/// the last sample and the fourth before it.
#[inline(always)]
fn last_anchor_target(samples: &[Position], beyond: usize) -> PaddedPoint {
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

/// The residuals of a level: steps by axis, symbols, and sums of magnitudes.
#[derive(Debug, Default)]
pub(super) struct Residuals {
    steps: [Vec<i32>; 3],
    symbols: Vec<u8>,
    sums: Vec<u8>,
}

impl Residuals {
    pub(super) fn grow(&mut self, padded_len: usize) {
        // Zero rows are counted in blocks of this length.
        let padded_len = padded_len + QUIET_ROWS;
        self.steps.iter_mut().for_each(|steps| steps.resize(steps.len().max(padded_len), 0));
        for bytes in [&mut self.symbols, &mut self.sums] {
            bytes.resize(bytes.len().max(padded_len), 0);
        }
    }
}

/// The encoder of the runs of one channel.
pub(super) struct RunEncoder<'a> {
    quantiser: Quantiser,
    targets: &'a mut Targets,
    residuals: &'a mut Residuals,
    ops: &'a mut Ops,
    /// By row of the block: whether its sample is kept.
    kept_rows: &'a mut [bool],
    /// The row of the block that follows row 0 of the run.
    after_zero: usize,
    /// Number of rows of the run after row 0.
    n: usize,
    at: usize,
    /// Whether a residual is too large to be coded.
    pub(super) out_of_range: bool,
    pub(super) kept: u32,
    /// The largest squared error in mm^2, as bits.
    worst: u64,
}

impl<'a> RunEncoder<'a> {
    pub(super) fn new(
        quantiser: Quantiser,
        targets: &'a mut Targets,
        residuals: &'a mut Residuals,
        ops: &'a mut Ops,
        kept_rows: &'a mut [bool],
    ) -> Self {
        Self {
            quantiser,
            targets,
            residuals,
            ops,
            kept_rows,
            after_zero: 0,
            n: 0,
            at: 0,
            out_of_range: false,
            kept: 0,
            worst: 0,
        }
    }

    /// Begins the run from row `start` of the block on. Its first sample is row 0 where `origin` is 1, else row 1.
    #[inline(always)]
    pub(super) fn begin(&mut self, start: usize, samples: &[Position], origin: usize) {
        self.targets.lay_out(samples, origin);
        self.n = samples.len() - origin;
        self.after_zero = start + origin;
    }

    /// Counts and marks the kept rows among the first `n` of a level. Without branches, which would be mispredicted.
    #[inline(always)]
    fn count_kept(&mut self, rows: LevelRows, n: usize) {
        let Some(last) = n.checked_sub(1) else { return };
        let sums = &self.residuals.sums[..n];
        self.kept += sums.iter().map(|sum| u32::from(*sum != 0)).sum::<u32>();
        let mut mark = |row: usize, sum: u8| {
            if let Some(is_kept) = self.kept_rows.get_mut(self.after_zero + row - 1) {
                *is_kept = sum != 0;
            }
        };
        for (i, sum) in sums[..last].iter().enumerate() {
            mark(rows.first + i * rows.step, *sum);
        }
        // The last anchor of a run is nearer to the one before it.
        mark(rows.row(last), sums[last]);
    }

    /// The largest error so far, in millimetres.
    pub(super) fn max_error_mm(&self) -> f64 {
        f64::from_bits(self.worst).sqrt()
    }

    #[inline(always)]
    fn choose_level<const FINEST: bool>(&mut self, start: usize, count: usize, rows: &mut Planes) {
        let targets = self.targets.levels.axes(start).map(|axis| &axis[..count]);
        let Residuals { steps: [steps_x, steps_y, steps_z], symbols, sums } = &mut *self.residuals;
        let steps_x = &mut steps_x[..count];
        self.out_of_range |=
            !choose::<FINEST>(self.quantiser, targets, rows.axes(0), steps_x, steps_y, steps_z);
        let steps: [&[i32]; 3] = [steps_x, steps_y, steps_z];
        describe_all(steps, &mut symbols[..count], sums);
        let [x, y, z] = &mut rows.0;
        let worst = reconstruct_rows(targets, steps, self.quantiser.step, &mut x[..count], y, z);
        self.worst = self.worst.max(worst);
    }

    /// Codes a row whose symbol is followed by more bits.
    #[inline(always)]
    fn row(&mut self, table: usize, i: usize) {
        let order = GOLOMB[table];
        let low_bits = LOW_BITS[table];
        let half = (1 << low_bits) >> 1;
        let (mut symbol, mut low) = (0, 0);
        let mut fields = [Field::default(); 4];
        for (field, steps) in fields[1..].iter_mut().zip(&self.residuals.steps) {
            let value = steps[i];
            let high = (value + half) >> low_bits;
            low = low << low_bits | ((value + half) & ((1 << low_bits) - 1)) as u32;
            let magnitude = high.unsigned_abs();
            let larger = magnitude > 1;
            let code = magnitude.wrapping_sub(2).wrapping_add(1 << order);
            let width = if larger { 64 - 2 * code.leading_zeros() - order } else { 0 };
            let value = if larger { code << 1 | u32::from(high < 0) } else { 0 };
            *field = Field { value, width };
            let axis = if larger { 3 } else { magnitude as usize + usize::from(high < 0) };
            symbol = symbol << 2 | axis;
        }
        fields[0] = Field { value: low, width: 3 * low_bits };
        self.ops.push_row(Op::symbol(table, symbol), fields);
    }
}

impl RunCodec for RunEncoder<'_> {
    #[inline(always)]
    fn begin_level(&mut self, _rows: LevelRows, _activity: &mut Activity) -> Result<()> {
        self.at = 0;
        Ok(())
    }

    #[inline(always)]
    fn reconstruct(&mut self, row: usize, prediction: PaddedPoint) -> PaddedPoint {
        let [x, y, z, _] = self.targets.row(row);
        let target = [x, y, z];
        let [x, y, z, _] = prediction;
        let (chosen, in_reach) = self.quantiser.row::<false>(target, [x, y, z]);
        self.out_of_range |= !in_reach;
        let mut point = prediction;
        let Residuals { steps, symbols, sums } = &mut *self.residuals;
        for axis in 0..3 {
            point[axis] += chosen[axis] as f32 * self.quantiser.step;
            steps[axis][self.at] = chosen[axis];
        }
        (symbols[self.at], sums[self.at]) = describe(chosen);
        self.at += 1;
        // The last anchor may lie beyond the samples.
        if row <= self.n {
            let [x, y, z, _] = point;
            self.worst = self.worst.max(squared_error(target, [x, y, z]));
        }
        point
    }

    #[inline(always)]
    fn reconstruct_level(&mut self, level: usize, count: usize, rows: &mut Planes) {
        let start = self.targets.starts[level];
        if level == 0 {
            self.choose_level::<true>(start, count, rows);
        } else {
            self.choose_level::<false>(start, count, rows);
        }
    }

    #[inline(always)]
    fn end_level(&mut self, rows: LevelRows, activity: &mut Activity) {
        if self.out_of_range {
            // The channel is stored raw.
            return;
        }
        let n = rows.count;
        let mut recent = *activity;
        let mut i = 0;
        while i < n {
            let mut table = recent.class();
            if recent.is_quiet() {
                let most = (n - i).min(QUIET_ROWS);
                let mut next = [0; QUIET_ROWS];
                next.copy_from_slice(&self.residuals.sums[i..i + QUIET_ROWS]);
                let zeros = (u128::from_le_bytes(next).trailing_zeros() / 8) as usize;
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
        self.count_kept(rows, n);
    }
}
