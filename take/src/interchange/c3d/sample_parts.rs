//! Foreign parts that hold samples frame by frame (`c3d/analog`, `c3d/residuals`, `c3d/model-outputs`), restricted to a
//! range of frames, or joined one after another. No sample changes.

use std::{io, ops::Range};

use super::{
    columns,
    foreign::{MODEL_OUTPUTS, SampleHeader},
};
use crate::{foreign::content::ContentSlice, motion::Foreign};

/// Columns of one signal in a part of this kind.
fn columns_of(kind: &str) -> usize {
    if kind == MODEL_OUTPUTS { 4 } else { 1 }
}

/// A part, split into its pieces.
struct SamplePart<'a> {
    header: SampleHeader,
    /// Indices of the points, which precede the columns of model outputs.
    indices: Vec<u8>,
    columns: ContentSlice<'a>,
    n_columns: usize,
}

impl<'a> SamplePart<'a> {
    /// `None` if the part is damaged.
    fn parse(part: &'a Foreign) -> io::Result<Option<Self>> {
        let per_signal = columns_of(&part.kind);
        let Some((header, rest)) = part.data.as_slice().split_array()? else { return Ok(None) };
        let Some(header) = SampleHeader::parse(&header) else { return Ok(None) };
        let index_bytes = if per_signal > 1 { 4 * header.n_signals } else { 0 };
        let Some((indices, columns)) = rest.split_at(index_bytes as u64) else { return Ok(None) };
        let n_columns = header.n_signals * per_signal;
        let column_bytes = header.samples().and_then(|n| n.checked_mul(header.width));
        let expected = column_bytes.and_then(|bytes| bytes.checked_mul(n_columns));
        if expected.is_none_or(|expected| expected as u64 != columns.len()) {
            return Ok(None);
        }
        let mut stored = vec![0; index_bytes];
        indices.read_at(0, &mut stored)?;
        Ok(Some(Self { header, indices: stored, columns, n_columns }))
    }

    /// The samples of one column, in the integers of the column encoding.
    fn column(&self, column: usize) -> io::Result<Vec<u32>> {
        let n_samples = self.header.samples().unwrap_or_default();
        let bytes = n_samples * self.header.width;
        let mut planes = vec![0; bytes];
        self.columns.read_at((column * bytes) as u64, &mut planes)?;
        Ok(columns::decode(&planes, self.header.width, n_samples))
    }

    /// Whether the samples of `other` can follow these.
    fn is_like(&self, other: &Self) -> bool {
        let shape = |part: &Self| (part.header.width, part.header.n_signals, part.header.ratio);
        shape(self) == shape(other) && self.indices == other.indices
    }

    /// Writes `header` and the columns, whose samples `column` returns.
    fn rewritten(
        &self,
        kind: &str,
        header: &SampleHeader,
        mut column: impl FnMut(usize) -> io::Result<Vec<u32>>,
    ) -> io::Result<Foreign> {
        let mut data = header.encode();
        data.extend_from_slice(&self.indices);
        for index in 0..self.n_columns {
            columns::push(&mut data, header.width, column(index)?.into_iter());
        }
        Ok(Foreign { kind: kind.to_owned(), data: data.into() })
    }
}

/// The samples of the frames with the numbers `frames`; `None` if the part is damaged.
///
/// # Errors
/// Those of reading the part.
pub(crate) fn cut(part: &Foreign, frames: &Range<u64>) -> io::Result<Option<Foreign>> {
    let Some(samples) = SamplePart::parse(part)? else { return Ok(None) };
    let SampleHeader { first_frame, n_frames, ratio, .. } = samples.header;
    // Numbers of the part's own frames within the range.
    let end = first_frame.saturating_add(n_frames as u64).min(frames.end);
    let first = first_frame.max(frames.start).min(end);
    let before = (first.saturating_sub(first_frame) as usize).min(n_frames);
    let n = ((end - first) as usize).min(n_frames - before);
    let header = SampleHeader { first_frame: first, n_frames: n, ..samples.header };
    let rewritten = samples.rewritten(&part.kind, &header, |index| {
        let column = samples.column(index)?;
        Ok(column.get(before * ratio..(before + n) * ratio).unwrap_or_default().to_vec())
    })?;
    Ok(Some(rewritten))
}

/// The samples of several parts of one kind one after another, each with its number of frames in the joined take;
/// `None` if one is damaged, lacks frames, or has other signals than the first.
///
/// # Errors
/// Those of reading the parts.
pub(crate) fn join(parts: &[(&Foreign, u64)]) -> io::Result<Option<Foreign>> {
    let mut all = Vec::new();
    for (part, n_frames) in parts {
        let Some(samples) = SamplePart::parse(part)? else { return Ok(None) };
        let is_whole = samples.header.n_frames as u64 == *n_frames;
        if !is_whole || all.first().is_some_and(|first: &SamplePart<'_>| !first.is_like(&samples)) {
            return Ok(None);
        }
        all.push(samples);
    }
    let (Some(first), Some((part, _))) = (all.first(), parts.first()) else { return Ok(None) };
    let n_frames = all.iter().map(|part| part.header.n_frames).sum();
    let header = SampleHeader { n_frames, ..first.header };
    let joined = first.rewritten(&part.kind, &header, |index| {
        let mut column = Vec::new();
        for part in &all {
            column.append(&mut part.column(index)?);
        }
        Ok(column)
    })?;
    Ok(Some(joined))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of 2 signals, `ratio` samples in a frame, with the frames from number 11 on.
    fn part(kind: &str, width: usize, ratio: usize, samples: &[Vec<u32>]) -> Foreign {
        let n_signals = samples.len() / columns_of(kind);
        let n_frames = samples[0].len() / ratio;
        let header = SampleHeader { width, n_signals, ratio, first_frame: 11, n_frames };
        let mut data = header.encode();
        if kind == MODEL_OUTPUTS {
            data.extend((0..n_signals as u32).flat_map(u32::to_le_bytes));
        }
        for column in samples {
            columns::push(&mut data, width, column.iter().copied());
        }
        Foreign { kind: kind.to_owned(), data: data.into() }
    }

    /// Columns whose samples differ in every byte that they have.
    fn signals(n: usize, width: usize, n_samples: usize) -> Vec<Vec<u32>> {
        let mask = if width == 2 { 0xffff } else { u32::MAX };
        let sample = |column: usize, i: usize| {
            (column as u32 + 3).wrapping_mul(0x9e37_79b9).wrapping_mul(i as u32 + 1) & mask
        };
        (0..n).map(|column| (0..n_samples).map(|i| sample(column, i)).collect()).collect()
    }

    #[test]
    fn cut_parts_have_the_samples_of_their_frames_and_join_to_the_whole() {
        for (kind, n, width, ratio) in [
            ("c3d/analog", 2, 2, 5),
            ("c3d/analog", 2, 4, 1),
            ("c3d/residuals", 3, 2, 1),
            (MODEL_OUTPUTS, 8, 4, 1),
        ] {
            let all = signals(n, width, 20 * ratio);
            let whole = part(kind, width, ratio, &all);
            let parts =
                [11..18, 18..19, 19..31].map(|frames| cut(&whole, &frames).unwrap().unwrap());
            let (from, to) = (7 * ratio, 8 * ratio);
            let second: Vec<_> = all.iter().map(|column| column[from..to].to_vec()).collect();
            let read = SamplePart::parse(&parts[1]).unwrap().unwrap();
            assert_eq!((read.header.first_frame, read.header.n_frames), (18, 1), "{kind}");
            for (column, expected) in second.iter().enumerate() {
                assert_eq!(&read.column(column).unwrap(), expected, "{kind}");
            }
            let lengths = [7, 1, 12];
            let joined = join(&std::array::from_fn::<_, 3, _>(|i| (&parts[i], lengths[i])));
            assert_eq!(joined.unwrap().unwrap(), whole, "{kind}");
            assert!(
                join(&[(&parts[0], 7), (&parts[2], 11)]).unwrap().is_none(),
                "a frame too many"
            );
            assert_eq!(cut(&whole, &(0..100)).unwrap().unwrap(), whole, "{kind}");
            let outside = cut(&whole, &(31..50)).unwrap().unwrap();
            let header = SamplePart::parse(&outside).unwrap().unwrap().header;
            assert_eq!(header.n_frames, 0, "{kind}");
        }
    }

    #[test]
    fn other_signals_do_not_follow_and_damage_is_not_read() {
        let one = part("c3d/analog", 2, 2, &signals(2, 2, 8));
        let more = part("c3d/analog", 2, 2, &signals(3, 2, 8));
        assert!(join(&[(&one, 4), (&more, 4)]).unwrap().is_none());
        let bytes = one.data.to_vec(1 << 20).unwrap().unwrap();
        for cut_at in 0..bytes.len() {
            let damaged = Foreign { kind: one.kind.clone(), data: bytes[..cut_at].to_vec().into() };
            assert!(cut(&damaged, &(11..12)).unwrap().is_none(), "{cut_at}");
        }
    }
}
