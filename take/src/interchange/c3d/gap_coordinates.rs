//! Coordinates of samples that are marked as missing. Such samples are gaps in a take; an export to C3D restores their
//! coordinates.
//!
//! They are stored in runs of successive frames (`docs/foreign.md`), so the size of the part depends on the gaps and
//! not on the length of the file.

use std::io::{self, Read};

use super::{
    VERSION,
    columns::{self, ColumnReader, ColumnWriter, ordered},
};
use crate::{
    foreign::{
        DATA_BYTES_MAX,
        content::{Content, ContentSlice},
    },
    motion::{Ambiguity, Foreign, Notes, Position},
    stretch::CHANNELS_MAX,
    up_axis::Rotation,
};

/// Kind of the part.
pub(super) const KIND: &str = "c3d/gap-coordinates";
/// Bytes of the part's header: version, number of the first frame, number of markers.
const HEADER_BYTES: usize = 13;
/// Bytes before a marker's runs: its index and the number of runs.
const MARKER_BYTES: usize = 12;
/// Bytes of a run: its first frame, counted from the first of the file, and its number of frames.
const RUN_BYTES: usize = 16;
/// Size of the buffers of all markers together: for 64 markers 1024 samples each.
const BLOCK_BYTES: usize = 1 << 20;
/// Words of a point.
const WORDS: usize = 4;

/// The words of a point: three coordinates in millimetres, and the fourth word as stored.
type PointWords = [f32; WORDS];

/// A sample: frame counted from the first of the file, index of the marker, and words.
type Sample = (usize, usize, PointWords);

/// Samples to write at a time, 1 MiB of them.
const BATCH_SAMPLES: usize = 1 << 15;

/// Counts coordinates under gaps, frame by frame, from which the size of the part follows.
#[derive(Debug)]
pub(super) struct GapCounts(Vec<GapCount>);

/// The coordinates of a marker.
#[derive(Debug, Clone, Copy, Default)]
struct GapCount {
    n_samples: u64,
    n_runs: u64,
    /// The frame after the last one with coordinates.
    end: usize,
}

impl GapCounts {
    pub(super) fn new(n_markers: usize) -> Self {
        Self(vec![GapCount::default(); n_markers])
    }

    /// Adds a sample; those of a marker in order of frames.
    pub(super) fn add(&mut self, frame: usize, marker: usize) {
        let Some(count) = self.0.get_mut(marker) else { return };
        count.n_runs += u64::from(count.n_samples == 0 || count.end != frame);
        count.n_samples += 1;
        count.end = frame + 1;
    }

    /// Notes the number of samples as an ambiguity.
    pub(super) fn note(&self, notes: &mut Notes) {
        let samples = self.0.iter().map(|count| count.n_samples).sum();
        if samples > 0 {
            notes.ambiguous(Ambiguity::CoordinatesUnderGaps { samples });
        }
    }

    /// Size of the part in bytes; `None` without samples, or, with a warning, if it would be too long for a take.
    pub(super) fn part_bytes(&self, warnings: &mut Vec<String>) -> Option<u64> {
        let markers = || self.0.iter().filter(|count| count.n_samples > 0);
        markers().next()?;
        let n_bytes = HEADER_BYTES as u64 + markers().map(GapCount::n_bytes).sum::<u64>();
        if n_bytes > DATA_BYTES_MAX {
            warnings.push(format!(
                "Coordinates under gaps left out: they need {n_bytes} bytes, and a foreign part holds {DATA_BYTES_MAX}."
            ));
            return None;
        }
        Some(n_bytes)
    }
}

impl GapCount {
    fn n_bytes(&self) -> u64 {
        let words_bytes = size_of::<PointWords>() as u64 * self.n_samples;
        MARKER_BYTES as u64 + RUN_BYTES as u64 * self.n_runs + words_bytes
    }
}

/// Writes the samples that were counted, frame by frame, to their places in the part.
#[derive(Debug)]
pub(super) struct GapWriter {
    data: Content,
    /// `None` for a marker without samples.
    markers: Vec<Option<MarkerWriter>>,
    batch: Vec<Sample>,
}

/// The places of a marker's runs and words.
#[derive(Debug)]
struct MarkerWriter {
    next_run: u64,
    run: Option<GapRun>,
    words_from: u64,
    n_samples: usize,
    columns: [ColumnWriter; WORDS],
}

impl GapWriter {
    /// Writes the header of the part, and of each marker, to `data`, which is as long as the counts say.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn new(counts: &GapCounts, first_frame: u64, mut data: Content) -> io::Result<Self> {
        let n_stored = counts.0.iter().filter(|count| count.n_samples > 0).count();
        let mut header = vec![VERSION];
        header.extend(first_frame.to_le_bytes());
        header.extend((n_stored as u32).to_le_bytes());
        data.write_at(0, &header)?;
        let mut at = HEADER_BYTES as u64;
        let mut markers = Vec::with_capacity(counts.0.len());
        for (index, count) in counts.0.iter().enumerate() {
            if count.n_samples == 0 {
                markers.push(None);
                continue;
            }
            let mut header = (index as u32).to_le_bytes().to_vec();
            header.extend(count.n_runs.to_le_bytes());
            data.write_at(at, &header)?;
            let runs = at + MARKER_BYTES as u64;
            markers.push(Some(MarkerWriter {
                next_run: runs,
                run: None,
                words_from: runs + RUN_BYTES as u64 * count.n_runs,
                n_samples: count.n_samples as usize,
                columns: [const { ColumnWriter::new(size_of::<f32>()) }; WORDS],
            }));
            at += count.n_bytes();
        }
        Ok(Self { data, markers, batch: Vec::new() })
    }

    /// Adds the coordinates and the fourth word of a missing sample, in the order in which they were counted.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn push(
        &mut self,
        (frame, marker): (usize, usize),
        [x, y, z]: Position,
        fourth: f32,
    ) -> io::Result<()> {
        self.batch.push((frame, marker, [x, y, z, fourth]));
        if self.batch.len() < BATCH_SAMPLES { Ok(()) } else { self.write_batch() }
    }

    fn write_batch(&mut self) -> io::Result<()> {
        self.batch.sort_unstable_by_key(|&(frame, marker, _)| (marker, frame));
        for samples in self.batch.chunk_by(is_same_marker) {
            let marker = samples.first().and_then(|&(_, marker, _)| self.markers.get_mut(marker));
            if let Some(Some(marker)) = marker {
                marker.write(&mut self.data, samples)?;
            }
        }
        self.batch.clear();
        Ok(())
    }

    /// The part.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn into_foreign(mut self) -> io::Result<Foreign> {
        self.write_batch()?;
        for marker in self.markers.iter_mut().flatten() {
            if let Some(run) = marker.run {
                self.data.write_at(marker.next_run, &run.to_bytes())?;
            }
        }
        Ok(part(self.data))
    }
}

/// The part with this content.
pub(super) fn part(data: Content) -> Foreign {
    Foreign::exact(KIND, data)
}

impl MarkerWriter {
    /// Writes the next samples of the marker, in order of frames.
    fn write(&mut self, data: &mut Content, samples: &[Sample]) -> io::Result<()> {
        let mut ended = Vec::new();
        for run in runs(samples) {
            let first = run.first().map_or(0, |&(frame, ..)| frame as u64);
            let n_frames = run.len() as u64;
            match &mut self.run {
                Some(open) if open.first + open.n_frames == first => open.n_frames += n_frames,
                open => {
                    let before = open.replace(GapRun { first, n_frames });
                    ended.extend(before.into_iter().flat_map(GapRun::to_bytes));
                }
            }
        }
        data.write_at(self.next_run, &ended)?;
        self.next_run += ended.len() as u64;
        write_words(&mut self.columns, data, (self.words_from, self.n_samples), samples, |sample| {
            sample.2
        })
    }
}

/// Writes the next words of a marker, whose columns begin at byte `from` and have `length` samples each.
fn write_words<T>(
    columns: &mut [ColumnWriter; WORDS],
    data: &mut Content,
    (from, length): (u64, usize),
    samples: &[T],
    words: impl Fn(&T) -> PointWords,
) -> io::Result<()> {
    for (word, column) in columns.iter_mut().enumerate() {
        let from = from + (word * size_of::<f32>() * length) as u64;
        let samples = samples.iter().map(|sample| ordered(words(sample)[word].to_bits()));
        column.write(data, from, length, samples)?;
    }
    Ok(())
}

fn is_same_marker(a: &Sample, b: &Sample) -> bool {
    a.1 == b.1
}

/// The runs of successive frames in the samples of a marker.
fn runs(samples: &[Sample]) -> impl Iterator<Item = &[Sample]> {
    samples.chunk_by(|a, b| a.0.checked_add(1) == Some(b.0))
}

/// The coordinates under gaps in a part of a take, read frame by frame.
#[derive(Debug)]
pub(super) struct PartCoordinates<'a> {
    /// Number of the first frame of the source.
    first_frame: u64,
    /// Number of the next frame.
    next: u64,
    markers: Vec<PartMarker<'a>>,
    /// The index and words of each marker with coordinates in the current frame.
    current: Vec<(usize, PointWords)>,
}

/// The coordinates of one marker.
#[derive(Debug)]
struct PartMarker<'a> {
    index: usize,
    runs: GapRuns<'a>,
    /// The current run.
    run: Option<GapRun>,
    columns: ColumnReader<'a>,
    /// Offset of the marker's words in the part.
    words_offset: u64,
    n_samples: usize,
}

impl<'a> PartCoordinates<'a> {
    /// The part of a take with `n_markers` markers, positioned at frame number `from`. `None` if there is no such part
    /// or it is damaged.
    pub(super) fn parse(
        foreign: &'a [Foreign],
        n_markers: usize,
        from: u64,
    ) -> io::Result<Option<Self>> {
        let Some(part) = foreign.iter().find(|part| part.kind == KIND) else { return Ok(None) };
        let data = part.data.as_slice();
        let Some(([VERSION], rest)) = data.split_array()? else { return Ok(None) };
        let Some((first_frame, rest)) = rest.split_array()? else { return Ok(None) };
        let Some((n_stored, mut rest)) = rest.split_array()? else { return Ok(None) };
        let first_frame = u64::from_le_bytes(first_frame);
        let n_stored = u32::from_le_bytes(n_stored) as usize;
        if n_stored > n_markers {
            return Ok(None);
        }
        let buffer_bytes = BLOCK_BYTES / n_stored.max(1);
        let mut markers: Vec<PartMarker<'_>> = Vec::new();
        for _ in 0..n_stored {
            let parsed = PartMarker::parse(rest, buffer_bytes)?;
            let Some((marker, after)) = parsed else { return Ok(None) };
            let is_next = markers.last().is_none_or(|last| last.index < marker.index);
            if !is_next || marker.index >= n_markers {
                return Ok(None);
            }
            markers.push(marker);
            rest = after;
        }
        if rest.len() != 0 {
            return Ok(None);
        }
        let before = from.saturating_sub(first_frame);
        markers.iter_mut().try_for_each(|marker| marker.skip_before(before))?;
        Ok(Some(Self { first_frame, next: from, markers, current: Vec::new() }))
    }

    /// Advances to the next frame. Returns the index and words of each marker with coordinates in it.
    pub(super) fn next_frame(&mut self) -> io::Result<&[(usize, PointWords)]> {
        self.current.clear();
        let frame = self.next.checked_sub(self.first_frame);
        self.next = self.next.saturating_add(1);
        if let Some(frame) = frame {
            for marker in &mut self.markers {
                if let Some(words) = marker.at(frame)? {
                    self.current.push((marker.index, words));
                }
            }
        }
        Ok(&self.current)
    }
}

/// What precedes the markers of a part, and each of them with its index.
pub(super) type ByMarker<'a> = (ContentSlice<'a>, Vec<(usize, ContentSlice<'a>)>);

/// Divides a part into its markers, whose indices ascend; `None` for a damaged part.
pub(super) fn by_marker(data: &Content) -> io::Result<Option<ByMarker<'_>>> {
    let Some((front, mut rest)) = data.as_slice().split_at(HEADER_BYTES as u64) else {
        return Ok(None);
    };
    let mut header = [0; HEADER_BYTES];
    front.read_at(0, &mut header)?;
    if header.first() != Some(&VERSION) {
        return Ok(None);
    }
    let n_stored = header.last_chunk().map_or(0, |n| u32::from_le_bytes(*n)) as usize;
    let mut markers: Vec<(usize, ContentSlice<'_>)> = Vec::new();
    while rest.len() > 0 {
        let Some((marker, after)) = PartMarker::parse(rest, 0)? else { return Ok(None) };
        let is_next = markers.last().is_none_or(|(last, _)| *last < marker.index);
        if !is_next || marker.index >= CHANNELS_MAX || markers.len() >= n_stored {
            return Ok(None);
        }
        let Some((slice, _)) = rest.split_at(rest.len() - after.len()) else { return Ok(None) };
        markers.push((marker.index, slice));
        rest = after;
    }
    Ok(Some((front, markers)))
}

impl<'a> PartMarker<'a> {
    /// Parses a marker, with a buffer of `buffer_bytes` bytes for its words. Returns it and the data after it.
    fn parse(
        data: ContentSlice<'a>,
        buffer_bytes: usize,
    ) -> io::Result<Option<(Self, ContentSlice<'a>)>> {
        let Some((index, rest)) = data.split_array()? else { return Ok(None) };
        let Some((n_runs, rest)) = rest.split_array()? else { return Ok(None) };
        let n_bytes = u64::from_le_bytes(n_runs).checked_mul(RUN_BYTES as u64);
        let Some((runs, rest)) = n_bytes.and_then(|n| rest.split_at(n)) else { return Ok(None) };
        let runs = GapRuns { stored: runs };
        let Some(n_samples) = runs.n_samples()? else { return Ok(None) };
        let n_bytes = n_samples.checked_mul(size_of::<PointWords>());
        let Some((words, rest)) = n_bytes.and_then(|n| rest.split_at(n as u64)) else {
            return Ok(None);
        };
        let columns = ColumnReader::new(words, size_of::<f32>(), WORDS, n_samples, buffer_bytes);
        let Some(columns) = columns else { return Ok(None) };
        let index = u32::from_le_bytes(index) as usize;
        let words_offset = words.from();
        Ok(Some((Self { index, runs, run: None, columns, words_offset, n_samples }, rest)))
    }

    /// Skips all samples before a frame, counted from the first of the source.
    fn skip_before(&mut self, frame: u64) -> io::Result<()> {
        let mut n_before = 0;
        self.runs.for_each(|run| n_before += frame.saturating_sub(run.first).min(run.n_frames))?;
        self.columns.skip(usize::try_from(n_before).unwrap_or(usize::MAX))
    }

    /// The words of a frame, counted from the first of the source. Calls must be in order of frames.
    fn at(&mut self, frame: u64) -> io::Result<Option<PointWords>> {
        loop {
            if self.run.is_none() {
                self.run = self.runs.next()?;
            }
            let Some(run) = self.run else { return Ok(None) };
            if frame < run.first {
                return Ok(None);
            }
            if frame - run.first < run.n_frames {
                return self.next();
            }
            self.run = None;
        }
    }

    /// The words of the next sample.
    fn next(&mut self) -> io::Result<Option<PointWords>> {
        let words = self.columns.next()?.and_then(|words| words.first_chunk::<WORDS>());
        Ok(words.map(|words| words.map(|word| columns::value(size_of::<f32>(), word, false))))
    }
}

/// A run of successive frames of a marker.
#[derive(Debug, Clone, Copy)]
struct GapRun {
    /// First frame, counted from the first of the source.
    first: u64,
    n_frames: u64,
}

impl GapRun {
    fn parse(stored: &[u8; RUN_BYTES]) -> Self {
        let word = |at: usize| stored.get(at..).and_then(<[u8]>::first_chunk).copied();
        let word = |at: usize| u64::from_le_bytes(word(at).unwrap_or_default());
        Self { first: word(0), n_frames: word(8) }
    }

    fn to_bytes(self) -> [u8; RUN_BYTES] {
        let mut bytes = [0; RUN_BYTES];
        bytes[..8].copy_from_slice(&self.first.to_le_bytes());
        bytes[8..].copy_from_slice(&self.n_frames.to_le_bytes());
        bytes
    }
}

/// The stored runs of a marker.
#[derive(Debug, Clone, Copy)]
struct GapRuns<'a> {
    stored: ContentSlice<'a>,
}

impl GapRuns<'_> {
    /// The next run.
    fn next(&mut self) -> io::Result<Option<GapRun>> {
        let Some((run, rest)) = self.stored.split_array()? else { return Ok(None) };
        self.stored = rest;
        Ok(Some(GapRun::parse(&run)))
    }

    /// Calls `visit` for every remaining run.
    fn for_each(&self, mut visit: impl FnMut(GapRun)) -> io::Result<()> {
        let mut stored = self.stored.reader();
        let mut run = [0; RUN_BYTES];
        for _ in 0..self.stored.len() / RUN_BYTES as u64 {
            stored.read_exact(&mut run)?;
            visit(GapRun::parse(&run));
        }
        Ok(())
    }

    /// The number of frames in all runs; `None` if the runs are not in ascending order or overlap.
    fn n_samples(&self) -> io::Result<Option<usize>> {
        let mut counted = Some((0usize, 0u64));
        self.for_each(|GapRun { first, n_frames }| {
            counted = counted.filter(|&(_, end)| first >= end).and_then(|(n_samples, _)| {
                let n_samples = n_samples.checked_add(usize::try_from(n_frames).ok()?)?;
                Some((n_samples, first.checked_add(n_frames)?))
            });
        })?;
        Ok(counted.map(|(n_samples, _)| n_samples))
    }
}

/// The part with rotated coordinates, in the same layout; `None` if there is no such part or it is damaged.
///
/// # Errors
/// Those of reading and rewriting the part.
pub(super) fn rotated(
    foreign: &[Foreign],
    n_markers: usize,
    rotation: Rotation,
) -> io::Result<Option<Foreign>> {
    let Some(stored) = PartCoordinates::parse(foreign, n_markers, 0)? else { return Ok(None) };
    let Some(found) = foreign.iter().find(|part| part.kind == KIND) else { return Ok(None) };
    let mut data = found.data.copy()?;
    for mut marker in stored.markers {
        let mut columns = [const { ColumnWriter::new(size_of::<f32>()) }; WORDS];
        let place = (marker.words_offset, marker.n_samples);
        let mut batch = Vec::new();
        for sample in 0..marker.n_samples {
            let Some([x, y, z, fourth]) = marker.next()? else { return Ok(None) };
            let [x, y, z] = rotation.apply([x, y, z]);
            batch.push([x, y, z, fourth]);
            if batch.len() == BATCH_SAMPLES || sample + 1 == marker.n_samples {
                write_words(&mut columns, &mut data, place, &batch, |words| *words)?;
                batch.clear();
            }
        }
    }
    Ok(Some(part(data)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::UpAxis;

    fn part_of(samples: &[Sample]) -> Foreign {
        let mut counts = GapCounts::new(8);
        samples.iter().for_each(|&(frame, marker, _)| counts.add(frame, marker));
        let n_bytes = counts.part_bytes(&mut Vec::new()).expect("samples, and not too many");
        let data = vec![0; n_bytes as usize].into();
        let mut writer = GapWriter::new(&counts, 100, data).unwrap();
        for &(frame, marker, [x, y, z, fourth]) in samples {
            writer.push((frame, marker), [x, y, z], fourth).unwrap();
        }
        writer.into_foreign().unwrap()
    }

    fn sample(frame: usize, marker: usize) -> Sample {
        (frame, marker, [frame as f32, marker as f32, 0.5, -1.0])
    }

    #[test]
    fn no_more_markers_are_held_than_a_part_states() {
        let part = part_of(&[sample(0, 4), sample(0, 7)]);
        let mut stored = Vec::new();
        part.data.as_slice().reader().read_to_end(&mut stored).unwrap();
        let n_markers = |stored: &[u8]| {
            let data = Content::from(stored.to_vec());
            by_marker(&data).unwrap().map(|(_, markers)| markers.len())
        };
        assert_eq!(n_markers(&stored), Some(2));
        let empty_marker = |index: u32| {
            [&stored[..], &index.to_le_bytes(), &[0; MARKER_BYTES - size_of::<u32>()]].concat()
        };
        assert_eq!(n_markers(&empty_marker(8)), None, "a third of two");
        let stated_at = HEADER_BYTES - size_of::<u32>();
        let three = |index| {
            let mut stored = empty_marker(index);
            stored[stated_at] = 3;
            n_markers(&stored)
        };
        assert_eq!([three(8), three(7), three(CHANNELS_MAX as u32)], [Some(3), None, None]);
    }

    #[test]
    fn runs_are_restored_from_any_frame_on() {
        let samples = [(0, 4), (1, 4), (2, 4), (2, 7), (5, 4), (6, 7), (7, 7), (9, 4)];
        let samples = samples.map(|(frame, marker)| sample(frame, marker));
        let foreign = [part_of(&samples)];
        for from in 95..115 {
            let mut stored = PartCoordinates::parse(&foreign, 8, from).unwrap().expect("a part");
            for number in from..115 {
                let found = stored.next_frame().unwrap();
                let here = samples.iter().filter(|&&(frame, ..)| frame as u64 + 100 == number);
                let expected: Vec<_> = here.map(|&(_, marker, words)| (marker, words)).collect();
                assert_eq!(found, expected, "frame {number}, from {from}");
            }
        }
    }

    #[test]
    fn a_damaged_part_is_not_read() {
        let whole = part_of(&[sample(0, 1), sample(1, 1), sample(5, 2)]);
        let bytes = whole.data.to_vec(u64::MAX).unwrap().expect("few");
        for n_bytes in 0..bytes.len() {
            let cut = Foreign { data: bytes[..n_bytes].to_vec().into(), ..whole.clone() };
            assert!(PartCoordinates::parse(&[cut], 8, 0).unwrap().is_none(), "{n_bytes}");
        }
        for at in 0..bytes.len() {
            for bits in [1, 0x80, 0xFF] {
                let mut damaged = bytes.clone();
                damaged[at] ^= bits;
                let foreign = [Foreign { data: damaged.into(), ..whole.clone() }];
                if let Some(mut stored) = PartCoordinates::parse(&foreign, 8, 100).unwrap() {
                    (0..9).for_each(|_| assert!(stored.next_frame().unwrap().len() <= 2));
                }
                rotated(&foreign, 8, Rotation::IDENTITY).unwrap();
            }
        }
    }

    #[test]
    fn a_part_of_more_markers_than_the_take_has_is_not_read() {
        let foreign = [part_of(&[sample(0, 1), sample(0, 4)])];
        assert!(PartCoordinates::parse(&foreign, 5, 0).unwrap().is_some());
        assert!(PartCoordinates::parse(&foreign, 4, 0).unwrap().is_none());
        assert!(PartCoordinates::parse(&foreign, 1, 0).unwrap().is_none());
    }

    #[test]
    fn a_rotated_part_has_the_same_layout() {
        let samples: Vec<_> = (0..3000).map(|i| sample(i + i / 7, i % 2)).collect();
        let quarter = Rotation::between(UpAxis::Y, UpAxis::Z).expect("two axes");
        let rotated_samples: Vec<_> = samples
            .iter()
            .map(|&(frame, marker, [x, y, z, fourth])| {
                let [x, y, z] = quarter.apply([x, y, z]);
                (frame, marker, [x, y, z, fourth])
            })
            .collect();
        assert_ne!(part_of(&samples), part_of(&rotated_samples));
        let found = rotated(&[part_of(&samples)], 2, quarter).unwrap().expect("a part");
        assert_eq!(found, part_of(&rotated_samples));
    }

    #[test]
    fn batches_do_not_change_the_documented_bytes() {
        // Marker 1 has a run across a batch and one after it.
        let n = BATCH_SAMPLES as u64 + 7;
        let samples: Vec<_> = (0..n).map(|i| sample((i + i / (n - 2)) as usize, 1)).collect();
        let bytes = part_of(&samples).data.to_vec(u64::MAX).unwrap().expect("few");
        let mut expected = vec![VERSION];
        expected.extend(100_u64.to_le_bytes());
        expected.extend(1_u32.to_le_bytes());
        expected.extend(1_u32.to_le_bytes());
        for number in [2, 0, n - 2, n - 1, 2] {
            expected.extend(number.to_le_bytes());
        }
        assert_eq!(bytes[..expected.len()], expected);
        let words =
            ContentSlice::split_at(part_of(&samples).data.as_slice(), expected.len() as u64)
                .map(|(_, words)| words.len());
        assert_eq!(words, Some(16 * n));
        let mut whole = Content::from(vec![0; 16 * n as usize]);
        let mut columns = [const { ColumnWriter::new(4) }; WORDS];
        write_words(&mut columns, &mut whole, (0, n as usize), &samples, |sample| sample.2)
            .unwrap();
        assert_eq!(Content::from(bytes[expected.len()..].to_vec()), whole);
    }
}
