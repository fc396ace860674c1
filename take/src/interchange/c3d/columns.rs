//! The column encoding of samples in foreign parts (`docs/foreign.md`), which a general compressor compresses well.
//!
//! A column is one signal from its first sample to its last; a sample is a word of 2 or 4 bytes. Floats are first
//! mapped to integers of the same order. Each sample is then replaced by its difference from the previous one (the
//! first one's difference from 0, modulo 2^16 or 2^32) in zigzag code, and the bytes of the differences are stored
//! plane by plane: the highest bytes of all samples first, then the next lower ones.

use std::{io, ops::Range};

use super::VERSION;
use crate::foreign::content::{Content, ContentSlice};

/// Maximum number of columns: four words for each of 65535 points, the maximum of a C3D frame. Analog channels are
/// fewer.
const COLUMNS_MAX: usize = 4 * u16::MAX as usize;

/// The kinds of the foreign parts that are blocks of columns.
pub(crate) const ANALOG: &str = "c3d/analog";
pub(crate) const RESIDUALS: &str = "c3d/residuals";
pub(crate) const MODEL_OUTPUTS: &str = "c3d/model-outputs";

/// The header of a block of columns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SampleHeader {
    /// Bytes of a sample: 2 or 4.
    pub(crate) width: usize,
    /// Number of channels, markers or points.
    pub(crate) n_signals: usize,
    /// Samples of a signal in a frame.
    pub(crate) ratio: usize,
    /// Number of the first frame.
    pub(crate) first_frame: u64,
    /// Number of frames.
    pub(crate) n_frames: usize,
}

impl SampleHeader {
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut data = vec![VERSION, self.width as u8];
        data.extend((self.n_signals as u32).to_le_bytes());
        data.extend((self.ratio as u32).to_le_bytes());
        data.extend(self.first_frame.to_le_bytes());
        data.extend((self.n_frames as u64).to_le_bytes());
        data
    }

    /// Samples of a column; `None` if they are too many for this machine.
    pub(crate) fn samples(&self) -> Option<usize> {
        self.n_frames.checked_mul(self.ratio)
    }

    /// `None` for an unknown version or width, and for more signals than a C3D file has.
    pub(crate) fn parse(header: &[u8; 26]) -> Option<Self> {
        let &[VERSION, width @ (2 | 4), ..] = header else { return None };
        let dword =
            |at: usize| Some(u32::from_le_bytes(header.get(at..at + 4)?.try_into().ok()?) as usize);
        let qword = |at: usize| Some(u64::from_le_bytes(header.get(at..at + 8)?.try_into().ok()?));
        Some(Self {
            width: usize::from(width),
            n_signals: dword(2).filter(|&n| n <= usize::from(u16::MAX))?,
            ratio: dword(6)?,
            first_frame: qword(10)?,
            n_frames: usize::try_from(qword(18)?).ok()?,
        })
    }

    /// The columns, `n` for each signal, read with a buffer of `buffer_bytes`; `None` if the data has another length.
    pub(crate) fn columns<'a>(
        &self,
        data: ContentSlice<'a>,
        n: usize,
        buffer_bytes: usize,
    ) -> Option<ColumnReader<'a>> {
        let n_columns = self.n_signals.checked_mul(n)?;
        let n_samples = self.samples()?;
        ColumnReader::new(data, self.width, n_columns, n_samples, buffer_bytes)
    }
}

/// Maps the bits of a float to an integer of the same order, so that smooth signals have small differences.
pub(crate) fn ordered(bits: u32) -> u32 {
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// The inverse of [`ordered`].
fn unordered(value: u32) -> u32 {
    if value >> 31 == 1 { value & !(1 << 31) } else { !value }
}

/// The value of a sample of `width` bytes: a float mapped by [`ordered`] (4 bytes), or an integer (2 bytes).
pub(crate) fn value(width: usize, sample: u32, is_unsigned: bool) -> f32 {
    match width {
        4 => f32::from_bits(unordered(sample)),
        _ if is_unsigned => sample as f32,
        _ => f32::from(sample as i16),
    }
}

/// The inverse of [`value`]: a sample as a column of words of `width` bytes holds it.
pub(crate) fn word(width: usize, sample: f32) -> u32 {
    match width {
        4 => ordered(sample.to_bits()),
        // A number of 16 bits, signed or not.
        _ => u32::from(sample as i32 as u16),
    }
}

/// Writes a column to its place in a part, piece by piece.
#[derive(Debug, Clone)]
pub(crate) struct ColumnWriter {
    width: usize,
    previous: u32,
    written: usize,
}

impl ColumnWriter {
    /// A column of samples of `width` bytes (2 or 4).
    pub(crate) const fn new(width: usize) -> Self {
        Self { width, previous: 0, written: 0 }
    }

    /// The sample that was written last.
    pub(crate) fn last(&self) -> Option<u32> {
        (self.written > 0).then_some(self.previous)
    }

    /// Writes the next samples. The column has `length` samples and begins at byte `from` of `data`.
    pub(crate) fn write(
        &mut self,
        data: &mut Content,
        from: u64,
        length: usize,
        samples: impl ExactSizeIterator<Item = u32>,
    ) -> io::Result<()> {
        let n_samples = samples.len();
        let mut planes = vec![0; self.width * n_samples];
        for (index, sample) in samples.enumerate() {
            let zigzag = zigzag(self.previous, sample, self.width);
            self.previous = sample;
            let bytes = zigzag.to_be_bytes().into_iter().skip(size_of::<u32>() - self.width);
            for (plane, byte) in bytes.enumerate() {
                if let Some(place) = planes.get_mut(plane * n_samples + index) {
                    *place = byte;
                }
            }
        }
        for (plane, bytes) in planes.chunks_exact(n_samples.max(1)).enumerate() {
            data.write_at(from + (plane * length + self.written) as u64, bytes)?;
        }
        self.written += n_samples;
        Ok(())
    }

    /// Repeats the last sample `n_samples` times: all bytes are zeros, as they are in a new part.
    pub(crate) fn repeat(&mut self, n_samples: usize) {
        self.written += n_samples;
    }
}

/// The zigzag code of a sample of `width` bytes after `previous`.
fn zigzag(previous: u32, sample: u32, width: usize) -> u32 {
    let unused_bits = u32::BITS - 8 * width as u32;
    let difference = (sample.wrapping_sub(previous) << unused_bits) as i32 >> unused_bits;
    (difference << 1 ^ difference >> 31) as u32
}

/// Reads columns of equal length, one sample of each at a time.
#[derive(Debug)]
pub(crate) struct ColumnReader<'a> {
    data: ContentSlice<'a>,
    width: usize,
    n_samples: usize,
    next: usize,
    previous: Vec<u32>,
    block: Block,
}

/// Buffered samples: the same range of every plane of every column.
#[derive(Debug)]
struct Block {
    bytes: Vec<u8>,
    /// Capacity in samples.
    samples: usize,
    /// The buffered range of samples.
    buffered: Range<usize>,
}

impl<'a> ColumnReader<'a> {
    /// Reads `n_columns` columns of `n_samples` samples of `width` bytes (2 or 4), and buffers at most `buffer_bytes`
    /// bytes, but at least one sample. `None` if the data has another length, or more columns than a C3D frame has
    /// words.
    pub(crate) fn new(
        data: ContentSlice<'a>,
        width: usize,
        n_columns: usize,
        n_samples: usize,
        buffer_bytes: usize,
    ) -> Option<Self> {
        let expected = n_columns.checked_mul(n_samples)?.checked_mul(width)?;
        // A damaged part may claim any number of empty columns: they must not cost memory.
        let n_columns = if n_samples == 0 { 0 } else { n_columns };
        let n_planes = n_columns.checked_mul(width)?;
        let samples = (buffer_bytes / n_planes.max(1)).clamp(1, n_samples.max(1));
        (data.len() == expected as u64 && n_columns <= COLUMNS_MAX).then(|| Self {
            data,
            width,
            n_samples,
            next: 0,
            previous: vec![0; n_columns],
            block: Block { bytes: Vec::new(), samples, buffered: 0..0 },
        })
    }

    /// The next sample of every column; `None` after the last.
    pub(crate) fn next(&mut self) -> io::Result<Option<&[u32]>> {
        if self.next >= self.n_samples {
            return Ok(None);
        }
        if !self.block.buffered.contains(&self.next) {
            self.read_block()?;
        }
        let n_buffered = self.block.buffered.len();
        let place = self.next - self.block.buffered.start;
        let mask = if self.width == 2 { 0xFFFF } else { u32::MAX };
        let columns = self.block.bytes.chunks_exact(self.width * n_buffered);
        for (previous, planes) in self.previous.iter_mut().zip(columns) {
            let bytes = planes.iter().skip(place).step_by(n_buffered);
            let zigzag = bytes.fold(0u32, |word, &byte| word << 8 | u32::from(byte));
            let difference = zigzag >> 1 ^ (zigzag & 1).wrapping_neg();
            *previous = previous.wrapping_add(difference) & mask;
        }
        self.next += 1;
        Ok(Some(&self.previous))
    }

    /// Fills the buffer from the next sample on.
    fn read_block(&mut self) -> io::Result<()> {
        let n_buffered = self.block.samples.min(self.n_samples - self.next);
        let n_planes = self.previous.len() * self.width;
        self.block.bytes.resize(n_planes * n_buffered, 0);
        for (plane, bytes) in self.block.bytes.chunks_exact_mut(n_buffered).enumerate() {
            self.data.read_at((plane * self.n_samples + self.next) as u64, bytes)?;
        }
        self.block.buffered = self.next..self.next + n_buffered;
        Ok(())
    }

    /// Skips samples.
    pub(crate) fn skip(&mut self, n_samples: usize) -> io::Result<()> {
        // A damaged part without columns may state any number of samples.
        if self.previous.is_empty() {
            return Ok(());
        }
        for _ in 0..n_samples {
            if self.next()?.is_none() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Columns of samples of `width` bytes, written in pieces.
    fn written(
        width: usize,
        n_rows: usize,
        piece: usize,
        sample: impl Fn(usize, usize) -> u32,
        n_columns: usize,
    ) -> Content {
        let mut data = Content::from(vec![0; n_columns * width * n_rows]);
        for column in 0..n_columns {
            let mut writer = ColumnWriter::new(width);
            let from = (column * width * n_rows) as u64;
            for first in (0..n_rows).step_by(piece) {
                let rows = first..n_rows.min(first + piece);
                let samples = rows.map(|row| sample(column, row));
                writer.write(&mut data, from, n_rows, samples).unwrap();
            }
        }
        data
    }

    #[test]
    fn repeated_samples_are_written_like_others() {
        let samples = [7, 7, 7, 7, 9, 9];
        let [mut whole, mut repeated] = [(); 2].map(|()| Content::from(vec![0; 24]));
        ColumnWriter::new(4).write(&mut whole, 0, 6, samples.into_iter()).unwrap();
        let mut writer = ColumnWriter::new(4);
        assert_eq!(writer.last(), None);
        writer.write(&mut repeated, 0, 6, std::iter::once(7)).unwrap();
        writer.repeat(3);
        writer.write(&mut repeated, 0, 6, std::iter::once(9)).unwrap();
        assert_eq!(writer.last(), Some(9));
        writer.repeat(1);
        assert_eq!(repeated, whole);
    }

    proptest! {
        #[test]
        fn wide_columns_round_trip(rows in proptest::collection::vec(any::<[u32; 3]>(), 0..40), piece in 1usize..50, buffer_bytes in 0usize..100) {
            let data = written(4, rows.len(), piece, |column, row| ordered(rows[row][column]), 3);
            let mut columns = ColumnReader::new(data.as_slice(), 4, 3, rows.len(), buffer_bytes).expect("as long as announced");
            for row in &rows {
                let found: Vec<u32> = columns.next().unwrap().expect("a row").iter().map(|&v| unordered(v)).collect();
                prop_assert_eq!(&found[..], &row[..]);
            }
            prop_assert!(columns.next().unwrap().is_none());
        }

        #[test]
        fn narrow_columns_round_trip(rows in proptest::collection::vec(any::<[u16; 2]>(), 1..40), piece in 1usize..50, skip in 0usize..3, buffer_bytes in 0usize..100) {
            let data = written(2, rows.len(), piece, |column, row| u32::from(rows[row][column]), 2);
            let mut columns = ColumnReader::new(data.as_slice(), 2, 2, rows.len(), buffer_bytes).expect("as long as announced");
            columns.skip(skip).unwrap();
            for row in rows.iter().skip(skip) {
                let found: Vec<u16> = columns.next().unwrap().expect("a row").iter().map(|&v| v as u16).collect();
                prop_assert_eq!(&found[..], &row[..]);
            }
        }
    }

    #[test]
    fn floats_keep_their_order() {
        let values = [-1e30f32, -1.0, -1e-30, -0.0, 0.0, 1e-30, 1.0, 1e30];
        assert!(values.windows(2).all(|w| ordered(w[0].to_bits()) < ordered(w[1].to_bits())));
    }

    #[test]
    fn a_wrong_length_is_refused() {
        let data = Content::from(vec![0; 7]);
        assert!(ColumnReader::new(data.as_slice(), 4, 1, 2, 8).is_none());
        assert!(ColumnReader::new(Content::default().as_slice(), 4, usize::MAX, 2, 8).is_none());
    }
}
