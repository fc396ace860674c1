//! Dyadic interpolation with a skip inside the tolerance ball, and table-driven entropy coding: the
//! error bound at bus speed.
//!
//! A block is a group of channels over one stretch. Each run of samples is coded level by level: an
//! anchor every 32 rows, then halving strides, each row predicted from the four nearest rows of the
//! wider strides. A row whose prediction lies inside the ball costs next to nothing.
//!
//! From the ground up: [`model`], the distributions and their choice; [`planes`], rows by axis; [`tans`], from
//! symbols to bits and back; [`walk`], the order of the rows and what each is expected from; [`choice`], what
//! an encoder makes of a row; [`decoder`] and [`encoder`].

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
    walk::{Channel, Grid},
};
use crate::{
    CodecError, Result, Tolerance,
    coding::{bytes::Bytes, columns::Raw, isa::Isa},
    frame::Payload,
};

/// 2/sqrt(3), less 2^-9 for the float32 rounding of the reconstruction: the step's cube lies inside
/// the tolerance ball.
const STEP_PER_TOLERANCE: f64 = 2.0 / 1.732_050_807_568_877_2 * (1.0 - 1.0 / 512.0);

/// Residuals beyond so many steps are left to the raw samples; float32 holds them and their sums.
const MAX_STEPS: u32 = 1 << 22;

/// Leading zeros of the code of the largest residual.
const MAX_ZEROS: u32 = 22;

/// How one channel of one block is coded: how often the step is halved (0 to 3), or raw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Mode(u8);

impl Mode {
    const RAW: Self = Self(4);

    fn read(input: &mut Bytes<'_>) -> Result<Self> {
        match input.byte("the mode of a channel")? {
            mode @ 0..=4 => Ok(Self(mode)),
            _ => Err(CodecError::Corrupt("an unknown mode of a channel")),
        }
    }

    /// The step, in millimetres.
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
    /// Of the block.
    modes: Vec<Mode>,
    raw: Raw,
    grid: Grid,
    encoding: encoder::Work,
    decoding: decoder::Work,
}

impl Fast {
    /// Nothing is allocated yet.
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
            grid: Grid::default(),
            encoding: encoder::Work::default(),
            decoding: decoder::Work::default(),
        }
    }

    fn grow(&mut self, n_channels: usize, n_rows: usize) {
        if self.channels.len() < n_channels {
            self.channels.resize(n_channels, Channel::NEW);
            self.modes.resize(n_channels, Mode::default());
        }
        self.grid.grow(walk::room(n_rows));
    }
}

impl Payload for Fast {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels, n_rows);
        self.raw.reserve(n_rows);
        self.encoding.grow(walk::room(n_rows));
    }

    #[cfg(debug_assertions)]
    fn prepare_decoder(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels, n_rows);
        self.raw.reserve(n_rows);
        let bytes = <Self as crate::frame::PayloadEncoder>::max_payload_bytes(n_channels, n_rows);
        self.decoding.grow(walk::room(n_rows), bytes);
    }

    fn reset(&mut self) {
        self.channels.fill(Channel::NEW);
    }

    fn forget_rows(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.known = 0);
    }
}
