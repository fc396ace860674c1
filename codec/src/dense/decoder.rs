//! The decoder has no choices.

use super::{
    grid::{Grid, Point},
    walk::{Channel, Side},
};
use crate::{
    CodecError, DecodedRows, Position, Tolerance, block, coding::range::RangeDecoder,
    frame::PayloadDecoder,
};

/// The decoder of one channel.
#[derive(Debug)]
pub(crate) struct DenseDecoder {
    grid: Grid,
    channel: Channel,
}

impl DenseDecoder {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { grid: Grid::new(tolerance), channel: Channel::default() }
    }
}

impl PayloadDecoder for DenseDecoder {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_rows: usize) {
        self.channel.prepare(n_rows);
    }

    fn reset(&mut self) {
        self.channel.reset();
    }

    fn break_off(&mut self) {
        self.channel.break_off();
    }

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let DecodedRows { positions, present, kept, .. } = rows;
        let mut side =
            Decoding { grid: self.grid, positions, kept, coder: RangeDecoder::new(payload) };
        self.channel.block(&mut side, present.len(), block::runs(present))?;
        side.coder.finish()
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
