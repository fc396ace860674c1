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
//! Modules, each built on those before it: [`model`], the distributions and their choice; [`planes`], rows by axis;
//! [`tans`], the entropy coder; [`walk`], the order and prediction of rows; [`choice`], the encoder's choice of
//! residuals; [`decoder`] and [`encoder`], blocks.

mod choice;
mod decoder;
mod encoder;
mod model;
mod planes;
mod tans;
#[cfg(test)]
mod tests;
mod walk;

use self::{
    tans::{TABLES_OF_MODEL, Tables},
    walk::{Channel, RunPoints},
};
use crate::{
    CodecError, Result, Tolerance,
    coding::{bytes::Bytes, columns::Raw, isa::Isa},
    frame::Payload,
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
    encode_buffers: encoder::EncodeBuffers,
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
            encode_buffers: encoder::EncodeBuffers::default(),
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
        let bytes = <Self as crate::frame::PayloadEncoder>::max_payload_bytes(n_channels, n_rows);
        self.decode_buffers.grow(walk::padded_len(n_rows), bytes);
    }

    fn reset(&mut self) {
        self.channels.fill(Channel::NEW);
    }

    fn forget_rows(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.known = 0);
    }
}
