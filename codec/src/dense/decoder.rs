//! The decoder of a group.

use super::{
    Dense, P_CODED,
    level::RowCodec,
    level_prediction::Batch,
    points::{Fineness, Grid, Points},
    walk::SpanCodec,
};
use crate::{
    DecodedRows, GROUP_CHANNELS, Result,
    coding::range::{BinaryCoder, RangeDecoder},
    ensure,
    frame::{Payload, PayloadDecoder},
};

impl PayloadDecoder for Dense {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        let n_channels = channels.len().min(GROUP_CHANNELS);
        let coder = RangeDecoder::new(payload);
        let mut codec = RowDecoder { channels, grid: self.grid, coder };
        if codec.coder.split(P_CODED, false) {
            self.reset();
            for channel in 0..n_channels {
                codec.stored(channel)?;
            }
            return codec.coder.finish();
        }
        // The flags are moved out while the other fields of the rows are written.
        let mut flags = [const { Vec::new() }; GROUP_CHANNELS];
        let mut is_raw = [false; GROUP_CHANNELS];
        for channel in 0..n_channels {
            if codec.channels[channel].has_samples() {
                // A decoder ignores its argument and returns the encoder's choice.
                let fineness = self.storage(&mut codec.coder, channel, Some(Fineness::Normal));
                is_raw[channel] = fineness.is_none();
            }
            if is_raw[channel] {
                codec.stored(channel)?;
            }
            flags[channel] = std::mem::take(&mut codec.channels[channel].present);
        }
        let present: [Option<&[bool]>; GROUP_CHANNELS] =
            std::array::from_fn(|channel| (!is_raw[channel]).then_some(&flags[channel][..]));
        self.block(&mut codec, n_rows, &present[..n_channels])?;
        let RowDecoder { channels, coder, .. } = codec;
        for (rows, present) in channels.iter_mut().zip(flags) {
            rows.present = present;
        }
        coder.finish()
    }
}

/// The decoder of one block.
struct RowDecoder<'a> {
    channels: &'a mut [DecodedRows],
    grid: Grid,
    coder: RangeDecoder<'a>,
}

impl RowDecoder<'_> {
    /// Reads the samples of a channel that are stored as plain float32 bits.
    fn stored(&mut self, channel: usize) -> Result<()> {
        let rows = &mut self.channels[channel];
        for row in 0..rows.present.len() {
            if !rows.present[row] {
                continue;
            }
            for coordinate in &mut rows.positions[row] {
                *coordinate = f32::from_bits(self.coder.plain(0, 32) as u32);
                ensure(coordinate.is_finite(), "a stored coordinate is not finite")?;
            }
            rows.kept[row] = true;
        }
        Ok(())
    }
}

impl SpanCodec for RowDecoder<'_> {}

impl<'a> RowCodec for RowDecoder<'a> {
    type Coder = RangeDecoder<'a>;

    fn coder(&mut self) -> &mut RangeDecoder<'a> {
        &mut self.coder
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32) {
        let DecodedRows { positions, kept: flags, .. } = &mut self.channels[batch.channel];
        let [x, y, z] = self.grid.positions(points);
        for i in 0..batch.n.min(N) {
            let row = batch.row(i);
            positions[row] = [x[i], y[i], z[i]];
        }
        // All flags are false so far.
        let mut kept = kept;
        while kept != 0 {
            flags[batch.row(kept.trailing_zeros() as usize)] = true;
            kept &= kept - 1;
        }
    }
}
