//! The half that only follows.

use super::{
    ahead::Sites,
    code::Points,
    encoder::STORED,
    lattice::{Fineness, Grid, Point},
    walk::{Batch, Group, Question, Side},
};
use crate::{
    CodecError, DecodedRows, GROUP_CHANNELS, Tolerance,
    coding::range::{BinaryCoder, RangeDecoder},
    frame::{Payload, PayloadDecoder},
};

/// The decoder of one group.
#[derive(Debug)]
pub(crate) struct DenseDecoder {
    group: Group,
    /// The presence of the block's channels: the walk reads it while the rows are filled.
    present: Vec<bool>,
}

impl DenseDecoder {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { group: Group::new(Grid::new(tolerance)), present: Vec::new() }
    }
}

impl Payload for DenseDecoder {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels, n_rows);
        self.present.reserve((n_channels * n_rows).saturating_sub(self.present.len()));
    }

    fn reset(&mut self) {
        self.group.reset();
    }

    fn break_off(&mut self) {
        self.group.break_off();
    }
}

impl PayloadDecoder for DenseDecoder {
    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        self.present.clear();
        channels.iter().for_each(|rows| self.present.extend_from_slice(&rows.present));
        let n_channels = channels.len().min(GROUP_CHANNELS);
        let mut side =
            Decoding { channels, grid: self.group.grid, coder: RangeDecoder::new(payload) };
        if side.coder.split(STORED, false) {
            self.group.reset();
            for channel in 0..n_channels {
                side.stored(channel)?;
            }
            return side.coder.finish();
        }
        let mut present: [Option<&[bool]>; GROUP_CHANNELS] = [None; GROUP_CHANNELS];
        for (channel, rows) in self.present.chunks_exact(n_rows.max(1)).enumerate().take(n_channels)
        {
            present[channel] = Some(rows);
            if rows.contains(&true) {
                let fineness: Option<Fineness> = Some(Fineness::Normal);
                if self.group.storage(&mut side.coder, channel, fineness).is_none() {
                    side.stored(channel)?;
                    present[channel] = None;
                }
            }
        }
        self.group.block(&mut side, n_rows, &present[..n_channels])?;
        side.coder.finish()
    }
}

struct Decoding<'a> {
    channels: &'a mut [DecodedRows],
    grid: Grid,
    coder: RangeDecoder<'a>,
}

impl Decoding<'_> {
    /// A channel bit by bit.
    fn stored(&mut self, channel: usize) -> Result<(), CodecError> {
        let rows = &mut self.channels[channel];
        for row in 0..rows.present.len() {
            if !rows.present[row] {
                continue;
            }
            for coordinate in &mut rows.positions[row] {
                *coordinate = f32::from_bits(self.coder.plain(0, 32) as u32);
                if !coordinate.is_finite() {
                    return Err(CodecError::Corrupt("a stored coordinate is not finite"));
                }
            }
            rows.kept[row] = true;
        }
        Ok(())
    }
}

impl<'a> Side for Decoding<'a> {
    type Coder = RangeDecoder<'a>;

    fn coder(&mut self) -> &mut RangeDecoder<'a> {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, _question: Question) -> Point {
        [0; 3]
    }

    fn start(
        &mut self,
        _channel: usize,
        _row: usize,
        _step: i64,
        _ways: &[Point],
    ) -> (usize, Point) {
        (0, [0; 3])
    }

    #[inline(always)]
    fn ahead(&mut self, _channel: usize, _sites: &Sites) {}

    #[inline(always)]
    fn outside<const N: usize>(
        &mut self,
        _channel: usize,
        _batch: Batch,
        _predictions: &Points<N>,
    ) -> u32 {
        0
    }

    #[inline(always)]
    fn settle<const N: usize>(
        &mut self,
        channel: usize,
        batch: Batch,
        points: &Points<N>,
        kept: u32,
    ) {
        let DecodedRows { positions, kept: flags, .. } = &mut self.channels[channel];
        let [x, y, z] = self.grid.positions(points);
        for i in 0..batch.n.min(N) {
            let row = batch.row(i);
            positions[row] = [x[i], y[i], z[i]];
        }
        // No row is kept until it is said.
        let mut kept = kept;
        while kept != 0 {
            flags[batch.row(kept.trailing_zeros() as usize)] = true;
            kept &= kept - 1;
        }
    }
}
