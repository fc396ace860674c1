//! One channel of one block: from bits to points.

use super::{
    isa::Kernel,
    levels::LEAD,
    model::{Activity, QUIET_ROWS},
    places::{Fourfold, QUIET_PLACE, WAKE_PLACE, cut},
    planes::{Planes, gather, settle},
    reader::{Reader, SYMBOLS_FILLED},
    residual::{RESIDUALS, residual},
    tans::{MAGNITUDE, MORE, Tables},
    walk::{self, Channel, Grid, Point, Rows, Side},
};
use crate::{CodecError, DecodedRows, block};

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
        let mut recent = Fourfold::from(*activity);
        let steps = &mut self.steps[..rows.count];
        steps.fill(Point::default());
        let mut i = 0;
        while i < steps.len() {
            reader.refill()?;
            // Rows that what is there suffices for.
            let mut filled_to = i + SYMBOLS_FILLED;
            let mut place = recent.place();
            if recent.is_quiet() {
                let zeros = reader.entry(self.tables, QUIET_PLACE)? as usize % 64;
                i = (i + zeros).min(steps.len());
                if zeros == QUIET_ROWS {
                    continue;
                }
                place = WAKE_PLACE;
                filled_to = i + 1;
            }
            loop {
                let slot = steps.get_mut(i).ok_or(CodecError::Corrupt("a row beyond its level"))?;
                let entry = reader.entry(self.tables, place)?;
                let symbol = entry as usize % 64;
                *slot = RESIDUALS[symbol];
                // Not looked up: what is read next waits for it.
                let mut magnitude = entry & MAGNITUDE;
                if entry & MORE != 0 {
                    magnitude = cut(residual(&mut reader, symbol, place, slot)?);
                    filled_to = i + 1;
                }
                recent.push(magnitude);
                // The last anchor may lie beyond the samples.
                if let Some(kept) = self.kept.get_mut(rows.row(i) + self.origin - 1) {
                    *kept = magnitude != 0;
                }
                i += 1;
                if i >= filled_to || i >= steps.len() || recent.is_quiet() {
                    break;
                }
                place = recent.place();
            }
        }
        *self.reader = reader;
        *activity = recent.into();
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
