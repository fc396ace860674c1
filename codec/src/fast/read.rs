//! One channel of one block: from bits to points.

use super::{
    isa::Kernel,
    levels::LEAD,
    model::{Activity, QUIET, QUIET_ROWS, WAKE},
    planes::Planes,
    reader::Reader,
    residual::{RESIDUALS, residual},
    tans::{MORE, Tables},
    walk::{self, Channel, Grid, Point, Rows, Side},
};
use crate::{CodecError, DecodedRows, Position, block};

/// One channel of one block.
pub(super) struct Decoding<'a, 'p> {
    pub(super) tables: &'static Tables,
    pub(super) reader: &'a mut Reader<'p>,
    pub(super) channel: &'a mut Channel,
    pub(super) rows: &'a mut DecodedRows,
    pub(super) grid: &'a mut Grid,
    pub(super) steps: &'a mut [Point],
    pub(super) step: f32,
    pub(super) cap: f32,
}

impl Kernel for Decoding<'_, '_> {
    type Output = Result<(), CodecError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { tables, reader, channel, rows, grid, steps, step, cap } = self;
        let DecodedRows { positions, present, kept, .. } = rows;
        let mut end = 0;
        for run in block::runs(present) {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let origin = usize::from(channel.known == 0);
            let n = run.len();
            let kept = &mut kept[run.clone()];
            let mut side = Reading { tables, reader, steps, kept, at: 0, step, origin };
            walk::run(&mut side, channel, grid, n, cap)?;
            let [x, y, z] = grid.known.axes(LEAD + 1 - origin);
            if gather(x, y, z, &mut positions[run]) {
                return Err(CodecError::Corrupt("a position beyond every coordinate"));
            }
        }
        if end != present.len() {
            channel.known = 0;
        }
        Ok(())
    }
}

/// Puts the axes together; says whether any is not finite.
#[inline(always)]
fn gather(x: &[f32], y: &[f32], z: &[f32], positions: &mut [Position]) -> bool {
    let n = positions.len();
    let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
    for (i, position) in positions.iter_mut().enumerate() {
        *position = [x[i], y[i], z[i]];
    }
    let mut not_finite = false;
    for i in 0..n {
        not_finite |= !x[i].is_finite() | !y[i].is_finite() | !z[i].is_finite();
    }
    not_finite
}

/// Adds residuals to what was expected.
#[inline(always)]
fn settle(steps: &[Point], step: f32, x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    let n = steps.len();
    let (x, y, z) = (&mut x[..n], &mut y[..n], &mut z[..n]);
    for (i, steps) in steps.iter().enumerate() {
        x[i] += steps[0] * step;
        y[i] += steps[1] * step;
        z[i] += steps[2] * step;
    }
}

struct Reading<'a, 'p> {
    tables: &'static Tables,
    reader: &'a mut Reader<'p>,
    /// Residuals of the level, in steps.
    steps: &'a mut [Point],
    kept: &'a mut [bool],
    at: usize,
    step: f32,
    /// 1 where row 0 is a row of the run.
    origin: usize,
}

impl Side for Reading<'_, '_> {
    #[inline(always)]
    fn enter(
        &mut self,
        _level: usize,
        rows: Rows,
        activity: &mut Activity,
    ) -> Result<(), CodecError> {
        self.at = 0;
        // In registers while the level is read.
        let mut reader = *self.reader;
        let mut recent = *activity;
        let steps = &mut self.steps[..rows.count];
        steps.fill(Point::default());
        let mut i = 0;
        while i < steps.len() {
            let mut table = recent.class();
            if recent.is_quiet() {
                let zeros = reader.entry(self.tables, QUIET)? as usize % 64;
                i = (i + zeros).min(steps.len());
                if zeros == QUIET_ROWS {
                    continue;
                }
                table = WAKE;
            }
            let slot = steps.get_mut(i).ok_or(CodecError::Corrupt("a row beyond its level"))?;
            let entry = reader.entry(self.tables, table)?;
            let symbol = entry as usize % 64;
            *slot = RESIDUALS[symbol];
            // Not looked up: what is read next waits for it.
            let mut magnitude = entry >> 6 & 3;
            if entry & MORE != 0 {
                magnitude = residual(&mut reader, symbol, table, slot)?;
            }
            recent.push(magnitude);
            // The last anchor may lie beyond the samples.
            if let Some(kept) = self.kept.get_mut(rows.row(i) + self.origin - 1) {
                *kept = magnitude != 0;
            }
            i += 1;
        }
        *self.reader = reader;
        *activity = recent;
        Ok(())
    }

    #[inline(always)]
    fn settle(&mut self, _row: usize, prediction: Point) -> Point {
        let steps = self.steps[self.at];
        self.at += 1;
        std::array::from_fn(|i| prediction[i] + steps[i] * self.step)
    }

    #[inline(always)]
    fn settle_level(&mut self, _level: usize, count: usize, rows: &mut Planes) {
        let [x, y, z] = &mut rows.0;
        settle(&self.steps[..count], self.step, x, y, z);
    }

    #[inline(always)]
    fn leave(&mut self, _level: usize, _rows: Rows, _activity: &mut Activity) {}
}
