//! Foreign parts that hold samples frame by frame (`c3d/analog`, `c3d/residuals`, `c3d/model-outputs`), restricted to a
//! range of frames, or joined one after another; and those that have something for each marker (residuals, and
//! coordinates under gaps) in another order of markers. No sample changes.

use std::{
    io::{self, Read},
    ops::Range,
};

use mocapd_codec::sampled::{ChannelProfile, SampleBound};

use super::{
    columns::{ColumnReader, ColumnWriter, MODEL_OUTPUTS, RESIDUALS, SampleHeader, value, word},
    gap_coordinates,
};
use crate::{
    ChannelOrder,
    foreign::content::{Content, ContentSlice, PartStore},
    motion::Foreign,
};

/// Size of the buffer for reading a column.
const BLOCK_BYTES: usize = 1 << 16;
/// Samples of a column that are written at once: 64 kB of each byte plane.
const PIECE_SAMPLES: usize = 1 << 16;

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

    /// The samples of one column.
    fn column(&self, column: usize) -> Option<ColumnReader<'a>> {
        let n_samples = self.header.samples()?;
        let bytes = n_samples as u64 * self.header.width as u64;
        let (_, rest) = self.columns.split_at(column as u64 * bytes)?;
        let (column, _) = rest.split_at(bytes)?;
        ColumnReader::new(column, self.header.width, 1, n_samples, BLOCK_BYTES)
    }

    /// Gives all samples of a column, piece by piece.
    fn pieces(
        &self,
        column: usize,
        is_unsigned: bool,
        mut each: impl FnMut(&mut [f32]) -> io::Result<()>,
    ) -> io::Result<()> {
        let Some(mut samples) = self.column(column) else { return Ok(()) };
        let mut piece = Vec::new();
        while let Some(&[sample]) = samples.next()? {
            piece.push(value(self.header.width, sample, is_unsigned));
            if piece.len() == PIECE_SAMPLES {
                each(&mut piece)?;
                piece.clear();
            }
        }
        each(&mut piece)
    }

    /// Whether the samples of `other` can follow these.
    fn is_like(&self, other: &Self) -> bool {
        let shape = |part: &Self| (part.header.width, part.header.n_signals, part.header.ratio);
        shape(self) == shape(other) && self.indices == other.indices
    }
}

/// A part with a range of frames of each of the `sources`, one after another. `None` if they are too long for a take,
/// or one is damaged.
fn write(
    kind: &str,
    header: &SampleHeader,
    sources: &[(SamplePart<'_>, Range<usize>)],
    store: &mut PartStore<'_>,
) -> io::Result<Option<Foreign>> {
    let (Some((first, _)), Some(length)) = (sources.first(), header.samples()) else {
        return Ok(None);
    };
    let front = [&header.encode()[..], &first.indices].concat();
    let Some(column_bytes) = (length as u64).checked_mul(header.width as u64) else {
        return Ok(None);
    };
    let all_bytes = column_bytes.saturating_mul(first.n_columns as u64);
    let mut data = store.zeros(all_bytes.saturating_add(front.len() as u64))?;
    if data.is_omitted() {
        return Ok(None);
    }
    data.write_at(0, &front)?;
    let mut piece = Vec::new();
    for column in 0..first.n_columns {
        let from = front.len() as u64 + column as u64 * column_bytes;
        let mut writer = ColumnWriter::new(header.width);
        for (part, frames) in sources {
            let Some(mut samples) = part.column(column) else { return Ok(None) };
            samples.skip(frames.start * header.ratio)?;
            let mut left = frames.len() * header.ratio;
            while left > 0 {
                piece.clear();
                while piece.len() < left.min(PIECE_SAMPLES) {
                    let Some(&[sample]) = samples.next()? else { return Ok(None) };
                    piece.push(sample);
                }
                writer.write(&mut data, from, length, piece.iter().copied())?;
                left -= piece.len();
            }
        }
    }
    Ok(Some(Foreign { kind: kind.to_owned(), data, bounds: Vec::new() }))
}

/// The samples of the frames with the numbers `frames`, and their range among those of the part; `None` if it is damaged.
///
/// # Errors
/// Those of reading the part, and of the scratch file.
pub(crate) fn cut(
    part: &Foreign,
    frames: &Range<u64>,
    store: &mut PartStore<'_>,
) -> io::Result<Option<(Foreign, Range<u64>)>> {
    let Some(samples) = SamplePart::parse(part)? else { return Ok(None) };
    let SampleHeader { first_frame, n_frames, ratio, .. } = samples.header;
    // Numbers of the part's own frames within the range.
    let end = first_frame.saturating_add(n_frames as u64).min(frames.end);
    let first = first_frame.max(frames.start).min(end);
    let before = (first.saturating_sub(first_frame) as usize).min(n_frames);
    let n = ((end - first) as usize).min(n_frames - before);
    let header = SampleHeader { first_frame: first, n_frames: n, ..samples.header };
    let range = (before * ratio) as u64..((before + n) * ratio) as u64;
    let kept = write(&part.kind, &header, &[(samples, before..before + n)], store)?;
    let bounds = part.bounds.clone();
    Ok(kept.map(|kept| (Foreign { bounds, ..kept }, range)))
}

/// The samples of several parts of one kind one after another, each with its number of frames in the joined take;
/// `None` if one is damaged, lacks frames, or has other signals than the first, and if a take cannot hold all.
///
/// # Errors
/// Those of reading the parts, and of the scratch file.
pub(crate) fn join(
    parts: &[(&Foreign, u64)],
    store: &mut PartStore<'_>,
) -> io::Result<Option<Foreign>> {
    let mut all: Vec<(SamplePart<'_>, Range<usize>)> = Vec::new();
    for (part, n_frames) in parts {
        let Some(samples) = SamplePart::parse(part)? else { return Ok(None) };
        let is_whole = samples.header.n_frames as u64 == *n_frames;
        if !is_whole || all.first().is_some_and(|(first, _)| !first.is_like(&samples)) {
            return Ok(None);
        }
        let frames = 0..samples.header.n_frames;
        all.push((samples, frames));
    }
    let (Some((first, _)), Some((part, _))) = (all.first(), parts.first()) else {
        return Ok(None);
    };
    let n_frames = all.iter().map(|(_, frames)| frames.len()).sum();
    let header = SampleHeader { n_frames, ..first.header };
    let joined = write(&part.kind, &header, &all, store)?;
    let n_bounds = parts.iter().map(|(part, _)| part.bounds.len()).max().unwrap_or(0);
    let of_column = |column: usize| {
        let bounds = parts.iter().filter_map(|(part, _)| part.bounds.get(column));
        bounds.fold(0.0, |largest: f64, &bound| largest.max(bound))
    };
    let bounds = (0..n_bounds).map(of_column).collect();
    Ok(joined.map(|joined| Foreign { bounds, ..joined }))
}

/// Number of signals of a part; 0 if it is damaged.
///
/// # Errors
/// Those of the scratch file.
pub(crate) fn n_signals(part: &Foreign) -> io::Result<usize> {
    Ok(SamplePart::parse(part)?.map_or(0, |samples| samples.header.n_signals))
}

/// The part with the samples of columns replaced by others within a bound: `bound_of` gives it for a column, in stored
/// samples; `None` and 0 mean exact ones. `None` if no sample is replaced, or the part is damaged.
///
/// # Errors
/// Those of reading the part, and of the scratch file.
pub(crate) fn bounded(
    part: &Foreign,
    is_unsigned: bool,
    store: &mut PartStore<'_>,
    mut bound_of: impl FnMut(usize, &ChannelProfile) -> Option<f64>,
) -> io::Result<Option<Foreign>> {
    let Some(samples) = SamplePart::parse(part)? else { return Ok(None) };
    let (width, length) = (samples.header.width, samples.header.samples().unwrap_or(0));
    let column_bytes = (width * length) as u64;
    let front_bytes = part.data.len() - column_bytes * samples.n_columns as u64;
    let (mut bounds, mut data) = (vec![0.0_f64; samples.n_columns], None);
    for (column, stated) in bounds.iter_mut().enumerate() {
        let mut profile = match (width, is_unsigned) {
            (4, _) => ChannelProfile::default(),
            (_, false) => ChannelProfile::of_integers([i16::MIN.into(), i16::MAX.into()]),
            (_, true) => ChannelProfile::of_integers([0.0, u16::MAX.into()]),
        };
        samples.pieces(column, is_unsigned, |piece| {
            profile.add(piece);
            Ok(())
        })?;
        let bound = bound_of(column, &profile).unwrap_or(0.0);
        let Some(replacing) = SampleBound::new(&profile, bound) else { continue };
        let data = match &mut data {
            Some(data) => data,
            none => none.insert(copy_of(part, store)?),
        };
        let from = front_bytes + column as u64 * column_bytes;
        let mut writer = ColumnWriter::new(width);
        samples.pieces(column, is_unsigned, |piece| {
            *stated = stated.max(replacing.apply(piece));
            let words = piece.iter().map(|&sample| word(width, sample));
            writer.write(data, from, length, words)
        })?;
    }
    Ok(data.map(|data| Foreign { kind: part.kind.clone(), data, bounds }))
}

/// A copy of the content of a part, which can be written.
fn copy_of(part: &Foreign, store: &mut PartStore<'_>) -> io::Result<Content> {
    let mut copy = store.zeros(part.data.len())?;
    let (mut input, mut at) = (part.data.reader(), 0);
    let mut bytes = Vec::new();
    while input.by_ref().take(BLOCK_BYTES as u64).read_to_end(&mut bytes)? > 0 {
        copy.write_at(at, &bytes)?;
        at += bytes.len() as u64;
        bytes.clear();
    }
    Ok(copy)
}

/// Size of a marker's index in a part.
const INDEX_BYTES: u64 = 4;

/// A part with its markers in another order: at each place what is at its column in `order` now. `None` for a part that
/// does not belong to markers, or that is damaged.
///
/// # Errors
/// Those of the scratch file that the part may be in.
pub(crate) fn reordered(part: &Foreign, order: &ChannelOrder) -> io::Result<Option<Foreign>> {
    if order.is_identity() {
        return Ok(None);
    }
    let data = match part.kind.as_str() {
        RESIDUALS => residuals(&part.data, order)?,
        gap_coordinates::KIND => coordinates(&part.data, order)?,
        _ => None,
    };
    let Some(data) = data else { return Ok(None) };
    let mut bounds = part.bounds.clone();
    order.apply(&mut bounds);
    Ok(Some(Foreign { kind: part.kind.clone(), data, bounds }))
}

/// Whether a part has something for each marker.
pub(crate) fn is_by_marker(part: &Foreign) -> bool {
    [RESIDUALS, gap_coordinates::KIND].contains(&part.kind.as_str())
}

/// Columns of the same length.
fn residuals(data: &Content, order: &ChannelOrder) -> io::Result<Option<Content>> {
    let Some((header, columns)) = data.as_slice().split_array()? else { return Ok(None) };
    let Some(parsed) = SampleHeader::parse(&header) else { return Ok(None) };
    if parsed.columns(columns, 1, 0).is_none() || parsed.n_signals == 0 {
        return Ok(None);
    }
    let column_bytes = columns.len() / parsed.n_signals as u64;
    let column = |at: usize| {
        let (_, rest) = columns.split_at(at as u64 * column_bytes)?;
        Some(rest.split_at(column_bytes)?.0)
    };
    let moved: Option<Vec<_>> =
        (0..parsed.n_signals).map(|row| column(order.column_of(row))).collect();
    let Some(moved) = moved else { return Ok(None) };
    let written = data.converted(data.len(), |out| {
        out.write_all(&header)?;
        moved.iter().try_for_each(|column| copy(*column, out))
    })?;
    Ok(Some(written))
}

/// Markers of different lengths, each behind its index.
fn coordinates(data: &Content, order: &ChannelOrder) -> io::Result<Option<Content>> {
    let Some((front, mut markers)) = gap_coordinates::by_marker(data)? else { return Ok(None) };
    markers.iter_mut().for_each(|(index, _)| *index = order.row_of(*index));
    markers.sort_by_key(|(index, _)| *index);
    let written = data.converted(data.len(), |out| {
        copy(front, out)?;
        for &(index, marker) in &markers {
            out.write_all(&(index as u32).to_le_bytes())?;
            let rest = marker.split_at(INDEX_BYTES).ok_or(io::ErrorKind::UnexpectedEof)?.1;
            copy(rest, out)?;
        }
        Ok(())
    })?;
    Ok(Some(written))
}

fn copy(slice: ContentSlice<'_>, out: &mut dyn io::Write) -> io::Result<()> {
    io::copy(&mut slice.reader(), out).map(|_| ())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::foreign::content::MemoryScratch;

    fn with_store<T>(act: impl FnOnce(&mut PartStore<'_>) -> io::Result<T>) -> T {
        act(&mut PartStore::new(true, &|| Ok(Arc::new(MemoryScratch::default())))).unwrap()
    }

    fn cut(part: &Foreign, frames: &Range<u64>) -> Option<Foreign> {
        with_store(|store| super::cut(part, frames, store)).map(|(part, _)| part)
    }

    fn join(parts: &[(&Foreign, u64)]) -> Option<Foreign> {
        with_store(|store| super::join(parts, store))
    }

    /// A part of 2 signals, `ratio` samples in a frame, with the frames from number 11 on.
    fn part(kind: &str, width: usize, ratio: usize, samples: &[Vec<u32>]) -> Foreign {
        let n_signals = samples.len() / columns_of(kind);
        let n_frames = samples[0].len() / ratio;
        let header = SampleHeader { width, n_signals, ratio, first_frame: 11, n_frames };
        let mut data = header.encode();
        if kind == MODEL_OUTPUTS {
            data.extend((0..n_signals as u32).flat_map(u32::to_le_bytes));
        }
        let (from, length) = (data.len(), samples[0].len());
        data.resize(from + samples.len() * width * length, 0);
        let mut data = Content::from(data);
        for (i, column) in samples.iter().enumerate() {
            let from = (from + i * width * length) as u64;
            let mut writer = ColumnWriter::new(width);
            writer.write(&mut data, from, length, column.iter().copied()).unwrap();
        }
        Foreign::exact(kind, data)
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
            let parts = [11..18, 18..19, 19..31].map(|frames| cut(&whole, &frames).unwrap());
            let (from, to) = (7 * ratio, 8 * ratio);
            let second: Vec<_> = all.iter().map(|column| column[from..to].to_vec()).collect();
            let read = SamplePart::parse(&parts[1]).unwrap().unwrap();
            assert_eq!((read.header.first_frame, read.header.n_frames), (18, 1), "{kind}");
            for (column, expected) in second.iter().enumerate() {
                let mut samples = read.column(column).unwrap();
                for expected in expected {
                    assert_eq!(samples.next().unwrap(), Some(&[*expected][..]), "{kind}");
                }
                assert_eq!(samples.next().unwrap(), None, "{kind}");
            }
            let lengths = [7, 1, 12];
            let joined = join(&std::array::from_fn::<_, 3, _>(|i| (&parts[i], lengths[i])));
            assert_eq!(joined.unwrap(), whole, "{kind}");
            assert!(join(&[(&parts[0], 7), (&parts[2], 11)]).is_none(), "a frame too many");
            assert_eq!(cut(&whole, &(0..100)).unwrap(), whole, "{kind}");
            let outside = cut(&whole, &(31..50)).unwrap();
            let header = SamplePart::parse(&outside).unwrap().unwrap().header;
            assert_eq!(header.n_frames, 0, "{kind}");
        }
    }

    #[test]
    fn other_signals_do_not_follow_and_damage_is_not_read() {
        let one = part("c3d/analog", 2, 2, &signals(2, 2, 8));
        let more = part("c3d/analog", 2, 2, &signals(3, 2, 8));
        assert!(join(&[(&one, 4), (&more, 4)]).is_none());
        let bytes = one.data.to_vec(1 << 20).unwrap().unwrap();
        for cut_at in 0..bytes.len() {
            let damaged = Foreign::exact(one.kind.clone(), bytes[..cut_at].to_vec());
            assert!(cut(&damaged, &(11..12)).is_none(), "{cut_at}");
        }
    }
}
