//! One channel of one block: choose, measure, and turn into bits.

use super::{
    MAX_STEPS,
    choose::{Choosing, ahead},
    isa::Kernel,
    tans::Tables,
    walk::{self, Channel, Point},
    writer::{Op, Writer},
};
use crate::Rows;

/// A count of zeros or low bits, a symbol and three larger magnitudes.
const OPS_PER_ROW: usize = 5;

/// Memory for one channel of one block.
#[derive(Debug, Default)]
pub(super) struct Work {
    points: Vec<Point>,
    targets: Vec<Point>,
    steps: Vec<Point>,
    pub(super) ops: Vec<Op>,
    pub(super) bytes: Vec<u8>,
}

impl Work {
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let room = walk::room(n_rows);
        let Work { points, targets, steps, ops, bytes } = self;
        if points.len() < room {
            for buffer in [points, targets, steps] {
                buffer.resize(room, Point::default());
            }
            ops.resize(OPS_PER_ROW * room, Op::default());
            bytes.resize(Op::MAX_BYTES * ops.len() + 8, 0);
        }
    }
}

pub(super) struct Emitting<'a> {
    pub(super) writer: &'a mut Writer,
    pub(super) tables: &'static Tables,
    pub(super) ops: &'a [Op],
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
    pub(super) n_ops: usize,
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
        let Self { channel, rows, work: Work { points, targets, steps, ops, .. }, .. } = self;
        // Less than the tolerance by more than the rounding of the distance in f32.
        let ball = (self.tolerance_mm * self.tolerance_mm * (1.0 - 1e-5)) as f32;
        let reach = (f64::from(self.step) * f64::from(MAX_STEPS)).powi(2) as f32;
        let cap = walk::error_cap(self.tolerance_mm);
        let (mut worst, mut kept, mut n_ops) = (0.0_f64, 0, 0);
        let mut end = 0;
        for run in rows.runs() {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let samples = &rows.positions()[run];
            let origin = usize::from(channel.known == 0);
            let n = samples.len() - origin;
            for (target, sample) in targets[1 - origin..].iter_mut().zip(samples) {
                *target = [sample[0], sample[1], sample[2], 0.0];
            }
            ahead(targets, n, origin);
            let mut side = Choosing {
                targets,
                steps,
                ops,
                n_ops,
                n,
                at: 0,
                finest: false,
                step: self.step,
                inverse: self.step.recip(),
                ball,
                reach,
                in_reach: true,
                kept: 0,
            };
            walk::run(&mut side, channel, points, samples.len(), cap).ok()?;
            kept += side.kept;
            n_ops = side.n_ops;
            if !side.in_reach {
                return None;
            }
            for (sample, point) in samples.iter().zip(&points[walk::ZERO + 1 - origin..]) {
                let square = |axis: usize| {
                    let d = f64::from(sample[axis]) - f64::from(point[axis]);
                    d * d
                };
                let distance = square(0) + square(1) + square(2);
                // Written so that not a number is worst of all.
                worst = if distance <= worst { worst } else { distance };
            }
        }
        if end != rows.len() {
            channel.known = 0;
        }
        let worst = worst.sqrt();
        let max_error_mm = if worst.is_nan() { f64::INFINITY } else { worst };
        Some(Outcome { max_error_mm, kept, n_ops })
    }
}
