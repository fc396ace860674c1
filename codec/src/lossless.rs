//! Bit-exact float32: packed differences of the bit patterns. Also the raw escape of every other kind.

use crate::{
    BlockReport, CodecError, DecodedRows, Rows,
    coding::{
        bytes::Bytes,
        columns::{self, History},
    },
    frame::{Outcome, PayloadDecoder, PayloadEncoder},
};

/// Encoder and decoder state: the last bit patterns of each axis.
#[derive(Debug, Default)]
pub(crate) struct Lossless {
    columns: [Vec<i64>; 3],
    history: [History; 3],
}

/// Order-preserving, so that neighbouring floats are neighbouring integers, across zero as well.
fn to_ordered(value: f32) -> i64 {
    let bits = value.to_bits() as i32;
    i64::from(bits ^ (bits >> 31 & i32::MAX))
}

fn from_ordered(ordered: i64) -> Option<f32> {
    let bits = i32::try_from(ordered).ok()?;
    let value = f32::from_bits((bits ^ (bits >> 31 & i32::MAX)) as u32);
    value.is_finite().then_some(value)
}

impl Lossless {
    pub(crate) fn max_payload_bytes(samples: usize) -> usize {
        columns::max_bytes_32(samples)
    }

    /// Room for so many samples.
    pub(crate) fn reserve(&mut self, n_rows: usize) {
        for column in &mut self.columns {
            column.reserve(n_rows.saturating_sub(column.len()));
        }
    }

    pub(crate) fn reset(&mut self) {
        self.history = Default::default();
    }

    /// Appends the payload of a block's samples.
    pub(crate) fn write(&mut self, rows: Rows<'_>, out: &mut Vec<u8>) {
        for (axis, column) in self.columns.iter_mut().enumerate() {
            column.clear();
            let samples =
                rows.positions().iter().zip(rows.present()).filter(|(_, present)| **present);
            column.extend(samples.map(|(position, _)| to_ordered(position[axis])));
        }
        let fits = columns::write(&self.columns, &mut self.history, 0, usize::MAX, out);
        debug_assert!(fits);
    }

    /// Fills the present rows.
    pub(crate) fn read(
        &mut self,
        payload: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let mut input = Bytes::new(payload);
        let n = rows.present.iter().filter(|&&p| p).count();
        let mut caller_bits = 0;
        let known = self.history;
        let take_bits = |bits| {
            caller_bits = bits;
            known
        };
        self.history = columns::read(&mut input, n, take_bits, &mut self.columns)?;
        if caller_bits != 0 {
            return Err(CodecError::Corrupt("unknown flags of a lossless payload"));
        }
        input.finish()?;
        let present = rows.positions.iter_mut().zip(&rows.present).filter(|(_, p)| **p);
        for (at, (position, _)) in present.enumerate() {
            for (value, column) in position.iter_mut().zip(&self.columns) {
                *value =
                    from_ordered(column[at]).ok_or(CodecError::Corrupt("a value not finite"))?;
            }
        }
        rows.kept.copy_from_slice(&rows.present);
        Ok(())
    }
}

impl PayloadEncoder for Lossless {
    type Decoder = Self;

    const EXACT: bool = true;

    fn prepare(&mut self, n_rows: usize) {
        self.reserve(n_rows);
    }

    fn reset(&mut self) {
        Self::reset(self);
    }

    fn break_off(&mut self) {
        Self::reset(self);
    }

    fn encode(
        &mut self,
        rows: Rows<'_>,
        _shared: &[u8],
        _limit: usize,
        out: &mut Vec<u8>,
    ) -> Result<Outcome, CodecError> {
        self.write(rows, out);
        let samples = self.columns[0].len() as u32;
        Ok(Outcome::Coded(BlockReport { samples, kept: samples, ..BlockReport::default() }))
    }
}

impl PayloadDecoder for Lossless {
    const EXACT: bool = true;

    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_rows: usize) {
        self.reserve(n_rows);
    }

    fn reset(&mut self) {
        Self::reset(self);
    }

    fn break_off(&mut self) {
        Self::reset(self);
    }

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        self.read(payload, rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_keeps_order_and_every_bit() {
        let values = [f32::MIN, -1.0, -f32::MIN_POSITIVE, -1e-45, -0.0, 0.0, 1e-45, 1.0, f32::MAX];
        for pair in values.windows(2) {
            assert!(to_ordered(pair[0]) < to_ordered(pair[1]), "{pair:?}");
        }
        assert_eq!(to_ordered(-0.0) + 1, to_ordered(0.0));
        for value in values {
            assert_eq!(from_ordered(to_ordered(value)).unwrap().to_bits(), value.to_bits());
        }
        for value in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert_eq!(from_ordered(to_ordered(value)), None);
        }
        assert_eq!(from_ordered(1 << 40), None);
    }
}
