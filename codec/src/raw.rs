//! A channel's samples bit by bit: packed differences of the float32 bit patterns.
//!
//! What `lossless` writes for every channel, and every other kind for one that it cannot code.

use crate::{
    CodecError, DecodedRows, Rows,
    coding::{
        bytes::Bytes,
        columns::{self, History},
    },
};

/// The last bit patterns of a channel, by axis.
pub(crate) type Histories = [History; 3];

/// Memory for the samples of one channel of one block.
#[derive(Debug, Default)]
pub(crate) struct Raw {
    columns: [Vec<i64>; 3],
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

impl Raw {
    /// Most bytes of so many samples.
    pub(crate) fn max_bytes(samples: usize) -> usize {
        columns::max_bytes_32(samples)
    }

    /// Room for so many samples.
    pub(crate) fn reserve(&mut self, n_rows: usize) {
        for column in &mut self.columns {
            column.reserve(n_rows.saturating_sub(column.len()));
        }
    }

    /// Appends a channel's samples.
    pub(crate) fn write(&mut self, rows: Rows<'_>, out: &mut Vec<u8>) {
        self.write_after(&mut Histories::default(), rows, out);
    }

    /// The same, as differences from what was written with this history before.
    pub(crate) fn write_after(
        &mut self,
        history: &mut Histories,
        rows: Rows<'_>,
        out: &mut Vec<u8>,
    ) {
        for (axis, column) in self.columns.iter_mut().enumerate() {
            column.clear();
            let samples =
                rows.positions().iter().zip(rows.present()).filter(|(_, present)| **present);
            column.extend(samples.map(|(position, _)| to_ordered(position[axis])));
        }
        columns::write(&self.columns, history, out);
    }

    /// Fills the present rows, and says that all of them were kept.
    pub(crate) fn read(
        &mut self,
        input: &mut Bytes<'_>,
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        self.read_after(&mut Histories::default(), input, rows)
    }

    /// The same, for what [`write_after`](Self::write_after) wrote.
    pub(crate) fn read_after(
        &mut self,
        history: &mut Histories,
        input: &mut Bytes<'_>,
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let n = rows.present.iter().filter(|&&p| p).count();
        columns::read(input, n, history, &mut self.columns)?;
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
