//! The decoder of a group.

use super::{
    Mode,
    isa::Isa,
    read::Decoding,
    reader::Reader,
    step,
    tans::Tables,
    walk::{self, Channel, Grid, Point},
};
use crate::{
    CodecError, DecodedRows, Tolerance, coding::bytes::Bytes, frame::PayloadDecoder, raw::Raw,
};

/// The decoder of a group of channels.
#[derive(Debug)]
pub(crate) struct FastDecoder {
    tolerance_mm: f64,
    tables: &'static Tables,
    isa: Isa,
    channels: Vec<Channel>,
    grid: Grid,
    steps: Vec<Point>,
    padded: Vec<u8>,
    modes: Vec<Mode>,
    raw: Raw,
}

impl FastDecoder {
    /// Nothing is allocated yet.
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self::with_isa(tolerance, Isa::detect())
    }

    pub(super) fn with_isa(tolerance: Tolerance, isa: Isa) -> Self {
        Self {
            tolerance_mm: tolerance.mm(),
            tables: Tables::get(),
            isa,
            channels: Vec::new(),
            grid: Grid::default(),
            steps: Vec::new(),
            padded: Vec::new(),
            modes: Vec::new(),
            raw: Raw::default(),
        }
    }

    fn grow(&mut self, n_channels: usize, n_rows: usize) {
        if self.channels.len() < n_channels {
            self.channels.resize(n_channels, Channel::NEW);
            self.modes.resize(n_channels, Mode::default());
        }
        let room = walk::room(n_rows);
        if self.steps.len() < room {
            self.steps.resize(room, Point::default());
            self.grid.grow(room);
        }
    }
}

impl PayloadDecoder for FastDecoder {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.padded.reserve(super::reader::PAD + super::max_payload_bytes(n_channels, n_rows));
        self.raw.reserve(n_rows);
        self.grow(n_channels, n_rows);
    }

    fn reset(&mut self) {
        self.channels.fill(Channel::NEW);
    }

    fn break_off(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.known = 0);
    }

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        self.grow(channels.len(), n_rows);
        self.modes.fill(Mode::default());
        Reader::pad(payload, &mut self.padded);
        let mut reader = Reader::new(&self.padded)?;
        if reader.flag()? {
            let mut input = Bytes::new(payload);
            for (mode, rows) in self.modes.iter_mut().zip(channels.iter()) {
                if rows.has_samples() {
                    *mode = Mode::read(&mut input)?;
                }
            }
            for (mode, rows) in self.modes.iter().zip(channels.iter_mut()) {
                if *mode == Mode::RAW && rows.has_samples() {
                    self.raw.read(&mut input, rows)?;
                }
            }
            reader.leave(payload.len() - input.rest().len());
        }
        let coded = |(rows, mode): (&DecodedRows, &Mode)| *mode != Mode::RAW && rows.has_samples();
        if channels.iter().zip(&self.modes).any(coded) {
            reader.read_state()?;
        }
        for ((rows, channel), mode) in channels.iter_mut().zip(&mut self.channels).zip(&self.modes)
        {
            if *mode == Mode::RAW || !rows.has_samples() {
                channel.known = 0;
                continue;
            }
            self.isa.run(Decoding {
                tables: self.tables,
                reader: &mut reader,
                channel,
                rows,
                grid: &mut self.grid,
                steps: &mut self.steps,
                step: step(self.tolerance_mm, *mode),
                cap: walk::error_cap(self.tolerance_mm),
            })?;
        }
        reader.finish()
    }
}
