//! The encoder of a group: the choices that the format leaves open.

use super::{
    Fast, Mode,
    choice::{Choosing, Residuals, Rule, Targets},
    tans::{Ops, Tables, Writer},
    walk::{self, Channel, Grid},
};
use crate::{
    BlockReport, Result, Rows,
    coding::{
        columns::{Histories, Raw},
        isa::Kernel,
    },
    frame::{Payload, PayloadEncoder},
};

/// Memory for one channel of one block.
#[derive(Debug, Default)]
pub(super) struct Work {
    targets: Targets,
    residuals: Residuals,
    ops: Ops,
    bytes: Vec<u8>,
    room: usize,
}

impl Work {
    pub(super) fn grow(&mut self, room: usize) {
        if self.room < room {
            self.room = room;
            self.targets.grow(room);
            self.residuals.grow(room);
            self.ops.grow(room);
            self.bytes.resize(self.ops.max_bytes() + 8, 0);
        }
    }
}

/// One channel of one block: fills `work.bytes`, if that is within the tolerance.
struct Coding<'a> {
    tables: &'static Tables,
    writer: &'a mut Writer,
    channel: &'a mut Channel,
    rows: Rows<'a>,
    grid: &'a mut Grid,
    work: &'a mut Work,
    tolerance_mm: f64,
    step: f32,
}

/// What became of it.
struct Outcome {
    max_error_mm: f64,
    kept: u32,
    n_bytes: usize,
}

impl Kernel for Coding<'_> {
    /// None when a residual is too large.
    type Output = Option<Outcome>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { channel, rows, grid, work, tolerance_mm, .. } = self;
        let Work { targets, residuals, ops, bytes, .. } = work;
        ops.clear();
        let rule = Rule::new(tolerance_mm, self.step);
        let cap = walk::error_cap(tolerance_mm);
        let mut side = Choosing::new(rule, targets, residuals, ops);
        let mut end = 0;
        for run in rows.runs() {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let samples = &rows.positions()[run];
            side.begin(samples, usize::from(channel.known == 0));
            walk::run(&mut side, channel, grid, samples.len(), cap).ok()?;
            if side.out_of_reach {
                return None;
            }
        }
        if end != rows.len() {
            channel.known = 0;
        }
        let (max_error_mm, kept) = (side.max_error_mm(), side.kept);
        let is_within = max_error_mm <= tolerance_mm;
        let n_bytes = if is_within { self.writer.ops(self.tables, ops, bytes) } else { 0 };
        Some(Outcome { max_error_mm, kept, n_bytes })
    }
}

impl Fast {
    /// Codes one channel; `false` leaves everything as it was.
    fn channel(
        &mut self,
        i: usize,
        rows: Rows<'_>,
        report: &mut BlockReport,
        writer: &mut Writer,
        out: &mut Vec<u8>,
    ) -> bool {
        let Self { isa, tables, grid, encoding: work, .. } = self;
        let tolerance_mm = self.tolerance_mm;
        // Coarsest first.
        for mode in (0..Mode::RAW.0).map(Mode) {
            let (mut channel, mut next) = (self.channels[i].clone(), *writer);
            let outcome = isa.run(Coding {
                tables,
                writer: &mut next,
                channel: &mut channel,
                rows,
                grid,
                work,
                tolerance_mm,
                step: mode.step(tolerance_mm),
            });
            let Some(Outcome { max_error_mm, kept, n_bytes }) = outcome else { return false };
            if max_error_mm <= tolerance_mm {
                if n_bytes > Raw::max_bytes(report.samples as usize) {
                    return false;
                }
                out.extend_from_slice(&work.bytes[..n_bytes]);
                *writer = next;
                self.channels[i] = channel;
                self.modes[i] = mode;
                report.kept = kept;
                report.max_error_mm = max_error_mm;
                return true;
            }
        }
        false
    }
}

impl PayloadEncoder for Fast {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        // Per channel the mode and the samples; then state, flag and end mark.
        n_channels * (1 + Raw::max_bytes(n_rows)) + 16
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<()> {
        self.prepare(channels.len(), channels.first().map_or(0, Rows::len));
        let start = out.len();
        let mut writer = Writer::NEW;
        let mut coded = false;
        // The decoder reads from the end: the first channel comes last.
        for (i, (rows, report)) in channels.iter().zip(reports.iter_mut()).enumerate().rev() {
            self.modes[i] = Mode::default();
            if report.samples == 0 {
                self.channels[i].known = 0;
                continue;
            }
            if self.channel(i, *rows, report, &mut writer, out) {
                coded = true;
            } else {
                self.modes[i] = Mode::RAW;
                self.channels[i].known = 0;
                report.keep_all();
            }
        }
        let Self { modes, raw, .. } = self;
        let plain = modes[..channels.len()].iter().all(|mode| *mode == Mode::default());
        writer.finish(coded, !plain, out);
        if !plain {
            let behind = out.len();
            let sampled =
                || channels.iter().zip(&*modes).zip(reports.iter()).filter(|(_, r)| r.samples > 0);
            out.extend(sampled().map(|((_, mode), _)| mode.0));
            for ((rows, _), _) in sampled().filter(|((_, mode), _)| **mode == Mode::RAW) {
                raw.write(*rows, &mut Histories::default(), out);
            }
            // Written last, read first.
            out[start..].rotate_left(behind - start);
        }
        Ok(())
    }
}
