//! One channel of one block: from bits to points.

use super::{
    isa::Kernel,
    model::{Activity, QUIET, QUIET_ROWS, WAKE},
    reader::Reader,
    residual::residual,
    tans::Tables,
    walk::{self, Channel, Point, Rows, Side},
};
use crate::{CodecError, DecodedRows, block};

/// One channel of one block.
pub(super) struct Decoding<'a, 'p> {
    pub(super) tables: &'static Tables,
    pub(super) reader: &'a mut Reader<'p>,
    pub(super) channel: &'a mut Channel,
    pub(super) rows: &'a mut DecodedRows,
    pub(super) points: &'a mut [Point],
    pub(super) steps: &'a mut [Point],
    pub(super) step: f32,
    pub(super) cap: f32,
}

impl Kernel for Decoding<'_, '_> {
    type Output = Result<(), CodecError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { tables, reader, channel, rows, points, steps, step, cap } = self;
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
            walk::run(&mut side, channel, points, n, cap)?;
            let first = walk::ZERO + 1 - origin;
            let mut sum = 0.0_f32;
            let settled = &points[first..];
            // The origin is row 0 of the points.
            for (position, point) in positions[run].iter_mut().zip(settled) {
                *position = [point[0], point[1], point[2]];
                // Not a number for each that is not finite.
                sum += point[0] * 0.0 + point[1] * 0.0 + point[2] * 0.0;
            }
            if sum != 0.0 {
                return Err(CodecError::Corrupt("a position beyond every coordinate"));
            }
        }
        if end != present.len() {
            channel.known = 0;
        }
        Ok(())
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
        let mut i = 0;
        while i < steps.len() {
            let mut table = recent.class();
            if recent.is_quiet() {
                let zeros = reader.symbol(self.tables, QUIET)?;
                let quiet = zeros.min(steps.len() - i);
                steps[i..i + quiet].fill(Point::default());
                i += quiet;
                if zeros == QUIET_ROWS {
                    continue;
                }
                table = WAKE;
            }
            let slot = steps.get_mut(i).ok_or(CodecError::Corrupt("a row beyond its level"))?;
            let symbol = reader.symbol(self.tables, table)?;
            let magnitude = residual(&mut reader, symbol, table, slot)?;
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
    fn leave(&mut self, _level: usize, _rows: Rows, _activity: &mut Activity) {}
}
