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

/// One channel of one block: fills `work.ops`.
struct Coding<'a> {
    channel: &'a mut Channel,
    rows: Rows<'a>,
    grid: &'a mut Grid,
    work: &'a mut Work,
    tolerance_mm: f64,
    step: f32,
}

impl Kernel for Coding<'_> {
    /// None when a residual is too large.
    type Output = Option<Outcome>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { channel, rows, grid, work, .. } = self;
        let Work { targets, residuals, ops, .. } = work;
        ops.clear();
        let rule = Rule::new(self.tolerance_mm, self.step);
        let cap = walk::error_cap(self.tolerance_mm);
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
        Some(Outcome { max_error_mm: side.max_error_mm(), kept: side.kept })
    }
}

/// What became of a channel.
struct Outcome {
    max_error_mm: f64,
    kept: u32,
}

/// Writes what [`Coding`] found.
struct Emitting<'a> {
    writer: &'a mut Writer,
    tables: &'static Tables,
    ops: &'a Ops,
    bytes: &'a mut [u8],
}

impl Kernel for Emitting<'_> {
    /// Bytes written.
    type Output = usize;

    #[inline(always)]
    fn run(self) -> usize {
        self.writer.ops(self.tables, self.ops, self.bytes)
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
        let Self { isa, tables, tolerance_mm, grid, encoding: work, .. } = self;
        let tolerance_mm = *tolerance_mm;
        for mode in Mode::STEPS {
            let mut channel = self.channels[i].clone();
            let step = mode.step(tolerance_mm);
            let outcome =
                isa.run(Coding { channel: &mut channel, rows, grid, work, tolerance_mm, step });
            let Some(Outcome { max_error_mm, kept }) = outcome else { return false };
            if max_error_mm <= tolerance_mm {
                let mut next = *writer;
                let Work { ops, bytes, .. } = work;
                let length = isa.run(Emitting { writer: &mut next, tables, ops, bytes });
                if length > Raw::max_bytes(report.samples as usize) {
                    return false;
                }
                out.extend_from_slice(&work.bytes[..length]);
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
                report.kept = report.samples;
                report.max_error_mm = 0.0;
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
