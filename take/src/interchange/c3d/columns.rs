//! Samples column by column, so that a general compressor finds what repeats.
//!
//! A column is one signal from its first sample to its last. A sample is a word of 2 or 4 bytes. Floats are first
//! mapped to integers that keep their order. Each sample is then replaced by its difference to the one before
//! (the first to 0, modulo 2^16 or 2^32), zigzagged, and the bytes of the differences are stored plane by plane:
//! the highest bytes of all samples, then the next lower ones.

/// The bits of a float as an integer of the same order: smooth signals have small differences.
pub(super) fn ordered(bits: u32) -> u32 {
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// The reverse of [`ordered`].
pub(super) fn unordered(value: u32) -> u32 {
    if value >> 31 == 1 { value & !(1 << 31) } else { !value }
}

/// Appends a column of 32-bit samples.
pub(super) fn push_wide(out: &mut Vec<u8>, samples: impl ExactSizeIterator<Item = u32>) {
    let n_samples = samples.len();
    let start = out.len();
    out.resize(start + 4 * n_samples, 0);
    let mut before = 0u32;
    let (_, planes) = out.split_at_mut(start);
    for (index, sample) in samples.enumerate() {
        let difference = sample.wrapping_sub(before) as i32;
        before = sample;
        let zigzag = (difference << 1 ^ difference >> 31) as u32;
        for (plane, byte) in zigzag.to_be_bytes().into_iter().enumerate() {
            if let Some(place) = planes.get_mut(plane * n_samples + index) {
                *place = byte;
            }
        }
    }
}

/// Appends a column of 16-bit samples.
pub(super) fn push_narrow(out: &mut Vec<u8>, samples: impl ExactSizeIterator<Item = u16>) {
    let n_samples = samples.len();
    let start = out.len();
    out.resize(start + 2 * n_samples, 0);
    let mut before = 0u16;
    let (_, planes) = out.split_at_mut(start);
    for (index, sample) in samples.enumerate() {
        let difference = sample.wrapping_sub(before) as i16;
        before = sample;
        let zigzag = (difference << 1 ^ difference >> 15) as u16;
        for (plane, byte) in zigzag.to_be_bytes().into_iter().enumerate() {
            if let Some(place) = planes.get_mut(plane * n_samples + index) {
                *place = byte;
            }
        }
    }
}

/// Columns of equal length, read one sample of each at a time.
#[derive(Debug)]
pub(super) struct Columns<'a> {
    data: &'a [u8],
    width: usize,
    n_samples: usize,
    next: usize,
    before: Vec<u32>,
}

impl<'a> Columns<'a> {
    /// `n_columns` columns of `n_samples` samples of `width` bytes (2 or 4); `None` when the data is not that long.
    pub(super) fn new(
        data: &'a [u8],
        width: usize,
        n_columns: usize,
        n_samples: usize,
    ) -> Option<Self> {
        let expected = n_columns.checked_mul(n_samples)?.checked_mul(width)?;
        // Columns without samples would earn memory for `before` from nothing.
        let n_columns = if n_samples == 0 { 0 } else { n_columns };
        (data.len() == expected).then(|| Self {
            data,
            width,
            n_samples,
            next: 0,
            before: vec![0; n_columns],
        })
    }

    /// The next sample of every column; `None` after the last.
    pub(super) fn next(&mut self) -> Option<&[u32]> {
        if self.next >= self.n_samples {
            return None;
        }
        let mask = if self.width == 2 { 0xFFFF } else { u32::MAX };
        for (column, before) in self.before.iter_mut().enumerate() {
            let mut zigzag = 0u32;
            let first = column * self.width * self.n_samples + self.next;
            for plane in 0..self.width {
                zigzag = zigzag << 8 | u32::from(*self.data.get(first + plane * self.n_samples)?);
            }
            let difference = zigzag >> 1 ^ (zigzag & 1).wrapping_neg();
            *before = before.wrapping_add(difference) & mask;
        }
        self.next += 1;
        Some(&self.before)
    }

    /// Passes over samples.
    pub(super) fn skip(&mut self, n_samples: usize) {
        for _ in 0..n_samples {
            if self.next().is_none() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wide_columns_come_back(rows in proptest::collection::vec(any::<[u32; 3]>(), 0..40)) {
            let mut data = Vec::new();
            for column in 0..3 {
                push_wide(&mut data, rows.iter().map(|row| ordered(row[column])));
            }
            let mut columns = Columns::new(&data, 4, 3, rows.len()).expect("as long as announced");
            for row in &rows {
                let found: Vec<u32> = columns.next().expect("a row").iter().map(|&v| unordered(v)).collect();
                prop_assert_eq!(&found[..], &row[..]);
            }
            prop_assert!(columns.next().is_none());
        }

        #[test]
        fn narrow_columns_come_back(rows in proptest::collection::vec(any::<[u16; 2]>(), 1..40), skip in 0usize..3) {
            let mut data = Vec::new();
            for column in 0..2 {
                push_narrow(&mut data, rows.iter().map(|row| row[column]));
            }
            let mut columns = Columns::new(&data, 2, 2, rows.len()).expect("as long as announced");
            columns.skip(skip);
            for row in rows.iter().skip(skip) {
                let found: Vec<u16> = columns.next().expect("a row").iter().map(|&v| v as u16).collect();
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
        assert!(Columns::new(&[0; 7], 4, 1, 2).is_none());
        assert!(Columns::new(&[], 4, usize::MAX, 2).is_none());
    }
}
