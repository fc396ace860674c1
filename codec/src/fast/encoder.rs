//! The encoder of a group: the choice of a mode for every channel.

use super::{
    Fast, Mode,
    choice::{Quantiser, Residuals, RunEncoder, Targets},
    tans::{Ops, Tables, Writer},
    walk::{self, Channel, RunPoints},
};
use crate::{
    BlockReport, Result, Rows, block,
    coding::{
        columns::{Histories, Raw},
        isa::Kernel,
    },
    frame::{Payload, PayloadEncoder},
};

/// Scratch memory for one channel of one block.
#[derive(Debug, Default)]
pub(super) struct EncodeBuffers {
    targets: Targets,
    residuals: Residuals,
    ops: Ops,
    bytes: Vec<u8>,
    /// By row of the block: whether the channel keeps its sample.
    kept_rows: Vec<bool>,
    padded_len: usize,
}

impl EncodeBuffers {
    pub(super) fn grow(&mut self, padded_len: usize) {
        if self.padded_len < padded_len {
            self.padded_len = padded_len;
            self.targets.grow(padded_len);
            self.residuals.grow(padded_len);
            self.ops.grow(padded_len);
            self.bytes.resize(self.ops.max_bytes() + 8, 0);
            self.kept_rows.resize(padded_len, false);
        }
    }
}

/// Codes one channel of one block into `buffers.bytes`, unless the error exceeds the tolerance.
struct EncodeChannel<'a> {
    tables: &'static Tables,
    writer: &'a mut Writer,
    channel: &'a mut Channel,
    rows: Rows<'a>,
    points: &'a mut RunPoints,
    buffers: &'a mut EncodeBuffers,
    tolerance_mm: f64,
    step: f32,
}

/// The result of coding a channel; it holds no bytes where the error exceeds the tolerance.
struct Outcome {
    max_error_mm: f64,
    kept: u32,
    n_bytes: usize,
}

impl Kernel for EncodeChannel<'_> {
    /// `None` when a residual is too large.
    type Output = Option<Outcome>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { channel, rows, points, buffers, tolerance_mm, .. } = self;
        let EncodeBuffers { targets, residuals, ops, bytes, kept_rows, .. } = buffers;
        kept_rows[..rows.len()].fill(false);
        ops.clear();
        let quantiser = Quantiser::new(tolerance_mm, self.step);
        let cap = walk::error_cap(tolerance_mm);
        let mut codec = RunEncoder::new(quantiser, targets, residuals, ops, kept_rows);
        let mut end = 0;
        for run in rows.runs() {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let samples = &rows.positions()[run.clone()];
            codec.begin(run.start, samples, usize::from(channel.known == 0));
            walk::run(&mut codec, channel, points, samples.len(), cap).ok()?;
            if codec.out_of_range {
                return None;
            }
        }
        if end != rows.len() {
            channel.known = 0;
        }
        let (max_error_mm, kept) = (codec.max_error_mm(), codec.kept);
        let is_within = max_error_mm <= tolerance_mm;
        let n_bytes = if is_within { self.writer.ops(self.tables, ops, bytes) } else { 0 };
        Some(Outcome { max_error_mm, kept, n_bytes })
    }
}

impl Fast {
    /// Codes one channel in the coarsest mode within the tolerance; `false`, with all state unchanged, when raw samples
    /// are needed or smaller.
    fn channel(
        &mut self,
        i: usize,
        rows: Rows<'_>,
        report: &mut BlockReport,
        writer: &mut Writer,
        out: &mut Vec<u8>,
    ) -> bool {
        let Self { isa, tables, points, encode_buffers: buffers, .. } = self;
        let tolerance_mm = self.tolerance_mm;
        // From the coarsest step to the finest.
        for mode in (0..Mode::RAW.0).map(Mode) {
            let (mut channel, mut next) = (self.channels[i].clone(), *writer);
            let outcome = isa.run(EncodeChannel {
                tables,
                writer: &mut next,
                channel: &mut channel,
                rows,
                points,
                buffers,
                tolerance_mm,
                step: mode.step(tolerance_mm),
            });
            let Some(Outcome { max_error_mm, kept, n_bytes }) = outcome else { return false };
            if max_error_mm <= tolerance_mm {
                if n_bytes > Raw::max_bytes(report.samples as usize) {
                    return false;
                }
                out.extend_from_slice(&buffers.bytes[..n_bytes]);
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

impl Fast {
    /// Appends the payload of a block; with `all_raw` every channel is raw.
    fn write(
        &mut self,
        channels: &[Rows<'_>],
        all_raw: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) {
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
            if !all_raw && self.channel(i, *rows, report, &mut writer, out) {
                coded = true;
                block::mark(kept_rows, &self.encode_buffers.kept_rows);
            } else {
                self.modes[i] = Mode::RAW;
                self.channels[i].known = 0;
                report.keep_all(*rows, kept_rows);
            }
        }
        let Self { modes, raw, .. } = self;
        let plain = modes[..channels.len()].iter().all(|mode| *mode == Mode::default());
        writer.finish(coded, !plain, out);
        if !plain {
            let channels_end = out.len();
            let sampled =
                || channels.iter().zip(&*modes).zip(reports.iter()).filter(|(_, r)| r.samples > 0);
            out.extend(sampled().map(|((_, mode), _)| mode.0));
            for ((rows, _), _) in sampled().filter(|((_, mode), _)| **mode == Mode::RAW) {
                raw.write(*rows, &mut Histories::default(), out);
            }
            // Modes and raw samples are written last, but read first.
            out[start..].rotate_left(channels_end - start);
        }
    }
}

impl PayloadEncoder for Fast {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        // Per channel its mode and its samples; then the state, the flag and the end mark.
        n_channels * (1 + Raw::max_bytes(n_rows)) + 16
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        self.write(channels, exact, out, reports, kept_rows);
        Ok(())
    }
}
