//! One channel of one block: choose, measure, and turn into bits.

use super::{
    MAX_STEPS,
    choose::Rule,
    isa::Kernel,
    side::{Choosing, Residuals},
    tans::Tables,
    targets::Targets,
    walk::{self, Channel, Grid},
    writer::{Ops, Writer},
};
use crate::Rows;

/// Memory for one channel of one block.
#[derive(Debug, Default)]
pub(super) struct Work {
    grid: Grid,
    targets: Targets,
    residuals: Residuals,
    pub(super) ops: Ops,
    pub(super) bytes: Vec<u8>,
    room: usize,
}

impl Work {
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let room = walk::room(n_rows);
        if self.room < room {
            self.room = room;
            self.grid.grow(room);
            self.targets.grow(room);
            self.residuals.grow(room);
            self.ops.grow(room);
            self.bytes.resize(self.ops.max_bytes() + 8, 0);
        }
    }
}

pub(super) struct Emitting<'a> {
    pub(super) writer: &'a mut Writer,
    pub(super) tables: &'static Tables,
    pub(super) ops: &'a Ops,
    pub(super) bytes: &'a mut [u8],
}

impl Kernel for Emitting<'_> {
    /// Bytes written.
    type Output = usize;

    #[inline(always)]
    fn run(self) -> usize {
        self.writer.ops(self.tables, self.ops, self.bytes)
    }
}

/// What became of it.
pub(super) struct Outcome {
    pub(super) max_error_mm: f64,
    pub(super) kept: u32,
}

/// One channel of one block: fills `work.ops`.
pub(super) struct Coding<'a> {
    pub(super) channel: &'a mut Channel,
    pub(super) rows: Rows<'a>,
    pub(super) work: &'a mut Work,
    pub(super) tolerance_mm: f64,
    pub(super) step: f32,
}

impl Kernel for Coding<'_> {
    /// None when a residual is too large.
    type Output = Option<Outcome>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { channel, rows, work: Work { grid, targets, residuals, ops, .. }, .. } = self;
        let rule = Rule {
            step: self.step,
            inverse: self.step.recip(),
            // Less than the tolerance by more than the rounding of the distance in f32.
            ball: (self.tolerance_mm * self.tolerance_mm * (1.0 - 1e-5)) as f32,
            reach: (f64::from(self.step) * f64::from(MAX_STEPS)).powi(2) as f32,
        };
        let cap = walk::error_cap(self.tolerance_mm);
        let (mut worst, mut kept) = (0, 0);
        let mut end = 0;
        ops.clear();
        for run in rows.runs() {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let samples = &rows.positions()[run];
            let origin = usize::from(channel.known == 0);
            targets.take(samples, origin);
            let n = samples.len() - origin;
            let mut side = Choosing {
                rule,
                targets,
                residuals,
                ops,
                n,
                at: 0,
                out_of_reach: false,
                kept,
                worst,
            };
            walk::run(&mut side, channel, grid, samples.len(), cap).ok()?;
            if side.out_of_reach {
                return None;
            }
            (kept, worst) = (side.kept, side.worst);
        }
        if end != rows.len() {
            channel.known = 0;
        }
        let max_error_mm = f64::from_bits(worst).sqrt();
        Some(Outcome { max_error_mm, kept })
    }
}
