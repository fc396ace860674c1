//! The decoder has no choices.

use super::{
    grid::{Grid, Point},
    walk::{Channel, Side},
};
use crate::{
    CodecError, DecodedRows, Position, Tolerance, block,
    coding::{bytes::Bytes, range::RangeDecoder},
    frame::PayloadDecoder,
    raw::Raw,
};

/// The decoder of one group.
#[derive(Debug)]
pub(crate) struct DenseDecoder {
    grid: Grid,
    channels: Vec<Channel>,
    raw: Raw,
}

impl DenseDecoder {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { grid: Grid::new(tolerance), channels: Vec::new(), raw: Raw::default() }
    }
}

impl PayloadDecoder for DenseDecoder {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.channels.resize_with(n_channels, Channel::default);
        self.channels.iter_mut().for_each(|channel| channel.prepare(n_rows));
        self.raw.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.channels.iter_mut().for_each(Channel::reset);
    }

    fn break_off(&mut self) {
        self.channels.iter_mut().for_each(Channel::break_off);
    }

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        if self.channels.len() < channels.len() {
            self.channels.resize_with(channels.len(), Channel::default);
        }
        let mut input = Bytes::new(payload);
        for (rows, channel) in channels.iter_mut().zip(&mut self.channels) {
            if !rows.has_samples() {
                channel.break_off();
                continue;
            }
            match input.byte("the mode of a channel")? {
                0 => {}
                1 => {
                    channel.break_off();
                    self.raw.read(&mut input, rows)?;
                    continue;
                }
                _ => return Err(CodecError::Corrupt("an unknown mode of a channel")),
            }
            let len = usize::try_from(input.varint("a length")?).unwrap_or(usize::MAX);
            let coded = input.take(len, "a coded channel")?;
            let DecodedRows { positions, present, kept, .. } = rows;
            let mut side =
                Decoding { grid: self.grid, positions, kept, coder: RangeDecoder::new(coded) };
            channel.block(&mut side, present.len(), block::runs(present))?;
            side.coder.finish()?;
        }
        input.finish()
    }
}

struct Decoding<'a> {
    grid: Grid,
    positions: &'a mut [Position],
    kept: &'a mut [bool],
    coder: RangeDecoder<'a>,
}

impl<'a> Side for Decoding<'a> {
    type Coder = RangeDecoder<'a>;

    fn coder(&mut self) -> &mut Self::Coder {
        &mut self.coder
    }

    fn choose(&mut self, _: usize, _: Point, _: bool) -> Result<Option<Point>, CodecError> {
        Ok(None)
    }

    fn settle(&mut self, row: usize, point: Point, kept: bool) {
        self.positions[row] = self.grid.position(point);
        self.kept[row] = kept;
    }
}
