//! `fast`: the resampler with the shortest coding times. docs/codec.md specifies its bits.
//!
//! The adaptive asynchronous sampling of `dense` (after Shi et al. 2012) in float32, with fixed code tables and without
//! prediction between channels. Each run of samples is coded level by level: an anchor every 32 rows, extrapolated in
//! time; then the strides 16 to 1, each row predicted by a cubic through the four nearest rows of wider strides. A row
//! whose prediction lies inside the tolerance ball has a zero residual and costs next to nothing; runs of such rows
//! share one symbol. Other residuals are rounded to a cubic lattice whose cell lies inside the ball.
//!
//! The recent magnitude of a level's residuals selects one of 16 fixed distributions. Tables of asymmetric numeral
//! systems (tANS; Duda, arXiv 1311.2540) code the symbols; large magnitudes follow in Exp-Golomb code. The
//! distributions were counted on recorded takes, each with the same weight.
//!
//! Modules, each built on those before it: [`model`], the distributions and their choice; [`tans`], the entropy coder;
//! [`walk`], the order and prediction of rows; [`choice`], the encoder's choice of residuals; here, the choice of a mode
//! for every channel and the encoder of a group; [`decoder`], its decoder.

mod choice;
mod decoder;
mod model;
mod tans;
#[cfg(test)]
mod tests;
mod walk;

use self::{
    choice::{Quantiser, Residuals, RunEncoder, Targets},
    tans::{Ops, TABLES_OF_MODEL, Tables, Writer},
    walk::{Channel, RunPoints},
};
use crate::{
    BlockReport, CodecError, Result, Rows, Tolerance, block,
    coding::{
        Bytes,
        isa::{Isa, Kernel},
    },
    frame::{Payload, PayloadEncoder},
    lossless::{Histories, Raw},
};

/// Lattice step per tolerance: the cube with edge 2/sqrt(3) fits the ball of radius 1; 2^-9 is left for the float32
/// rounding of the reconstruction.
const STEP_PER_TOLERANCE: f64 = 2.0 / 1.732_050_807_568_877_2 * (1.0 - 1.0 / 512.0);

/// A channel with longer residuals, in steps, is stored raw. float32 represents these numbers and their sums exactly.
const MAX_STEPS: u32 = 1 << 22;

/// Maximum number of leading zeros of an Exp-Golomb code: those of the largest residual.
const MAX_ZEROS: u32 = 22;

/// How a channel of a block is coded: the number of times its step is halved (0 to 3), or raw (4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Mode(u8);

impl Mode {
    const RAW: Self = Self(4);

    fn read(input: &mut Bytes<'_>) -> Result<Self> {
        match input.byte("the mode of a channel")? {
            mode @ 0..=4 => Ok(Self(mode)),
            _ => Err(CodecError::Corrupt("an unknown channel mode")),
        }
    }

    /// The lattice step in millimetres.
    fn step(self, tolerance_mm: f64) -> f32 {
        (tolerance_mm * STEP_PER_TOLERANCE / f64::from(1_u32 << self.0)) as f32
    }
}

/// Encoder and decoder of a group of channels.
#[derive(Debug)]
pub(crate) struct Fast {
    tolerance_mm: f64,
    tables: &'static Tables,
    isa: Isa,
    channels: Vec<Channel>,
    /// Modes of the channels in the current block.
    modes: Vec<Mode>,
    raw: Raw,
    points: RunPoints,
    encode_buffers: EncodeBuffers,
    decode_buffers: decoder::DecodeBuffers,
}

impl Fast {
    /// A group in its initial state, with nothing allocated.
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self::with_isa(tolerance, Isa::detect())
    }

    fn with_isa(tolerance: Tolerance, isa: Isa) -> Self {
        Self {
            tolerance_mm: tolerance.mm(),
            tables: &TABLES_OF_MODEL,
            isa,
            channels: Vec::new(),
            modes: Vec::new(),
            raw: Raw::default(),
            points: RunPoints::default(),
            encode_buffers: EncodeBuffers::default(),
            decode_buffers: decoder::DecodeBuffers::default(),
        }
    }

    fn grow(&mut self, n_channels: usize, n_rows: usize) {
        if self.channels.len() < n_channels {
            self.channels.resize(n_channels, Channel::NEW);
            self.modes.resize(n_channels, Mode::default());
        }
        self.points.grow(walk::padded_len(n_rows));
    }
}

impl Payload for Fast {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels, n_rows);
        self.raw.reserve(n_rows);
        self.encode_buffers.grow(walk::padded_len(n_rows));
    }

    #[cfg(debug_assertions)]
    fn prepare_decoder(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels, n_rows);
        self.raw.reserve(n_rows);
        let bytes = <Self as PayloadEncoder>::max_payload_bytes(n_channels, n_rows);
        self.decode_buffers.grow(walk::padded_len(n_rows), bytes);
    }

    fn reset(&mut self) {
        self.channels.fill(Channel::NEW);
    }

    fn forget_rows(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.known = 0);
    }
}

/// Scratch memory for one channel of one block.
#[derive(Debug, Default)]
struct EncodeBuffers {
    targets: Targets,
    residuals: Residuals,
    ops: Ops,
    bytes: Vec<u8>,
    /// By row of the block: whether the channel keeps its sample.
    kept_rows: Vec<bool>,
    padded_len: usize,
}

impl EncodeBuffers {
    fn grow(&mut self, padded_len: usize) {
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
