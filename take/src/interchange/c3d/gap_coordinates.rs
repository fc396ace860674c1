//! The coordinates of samples that are marked as missing: gaps to us, and given back to C3D as they were.
//!
//! They are kept in runs (`docs/foreign.md`): a file in which each marker is missing for a moment has few of them,
//! however long it is.

use super::columns::{Columns, ordered, push_wide, unordered};
use super::foreign::{GAP_COORDINATES, VERSION};
use crate::foreign::DATA_BYTES_MAX;
use crate::interchange::{notes::Notes, turn::Turn};
use crate::motion::{Ambiguity, Foreign, Position};

/// Bytes in front of the markers: version, number of the first frame, number of markers.
const HEAD_BYTES: usize = 13;
/// Bytes in front of a marker's runs: its index, and how many there are.
const MARKER_BYTES: usize = 12;
/// Bytes of a run: its first frame, counted from the first of all, and its frames.
const RUN_BYTES: usize = 16;
/// Words of a sample: coordinates in millimetres, and the fourth word.
const WORDS: usize = 4;

type Words = [f32; WORDS];

/// A sample: frame, counted from the first, marker and words.
type Sample = (usize, usize, Words);

/// Coordinates under gaps, in any order.
#[derive(Debug, Default)]
pub(super) struct GapCoordinates(Vec<Sample>);

impl GapCoordinates {
    /// Adds those of a frame and marker.
    pub(super) fn push(&mut self, frame: usize, marker: usize, [x, y, z]: Position, fourth: f32) {
        self.0.push((frame, marker, [x, y, z, fourth]));
    }

    /// Notes how many there are.
    pub(super) fn note(&self, notes: &mut Notes) {
        if !self.0.is_empty() {
            let samples = self.0.len() as u64;
            notes.ambiguous(Ambiguity::CoordinatesUnderGaps { samples });
        }
    }

    /// The part that keeps them, where there are any; left out with a warning where it would be too long for a take.
    pub(super) fn into_foreign(
        mut self,
        first_frame: u64,
        warnings: &mut Vec<String>,
    ) -> Option<Foreign> {
        if self.0.is_empty() {
            return None;
        }
        self.0.sort_unstable_by_key(|&(frame, marker, _)| (marker, frame));
        let n_bytes = self.n_bytes();
        if n_bytes as u64 > DATA_BYTES_MAX {
            warnings.push(format!(
                "The coordinates under gaps were left out: they would be {n_bytes} bytes, and a part of a take holds \
                 {DATA_BYTES_MAX}."
            ));
            return None;
        }
        Some(Foreign { kind: GAP_COORDINATES.to_owned(), data: self.encode(first_frame) })
    }

    /// Bytes of the part, of samples in order.
    fn n_bytes(&self) -> usize {
        let marker = |markers: &[Sample]| MARKER_BYTES + RUN_BYTES * runs(markers).count();
        let heads: usize = self.0.chunk_by(is_same_marker).map(marker).sum();
        HEAD_BYTES + heads + size_of::<Words>() * self.0.len()
    }

    /// The part, of samples in order.
    fn encode(&self, first_frame: u64) -> Vec<u8> {
        let mut data = Vec::with_capacity(self.n_bytes());
        data.push(VERSION);
        data.extend(first_frame.to_le_bytes());
        data.extend((self.0.chunk_by(is_same_marker).count() as u32).to_le_bytes());
        for samples in self.0.chunk_by(is_same_marker) {
            let marker = samples.first().map_or(0, |&(_, marker, _)| marker);
            data.extend((marker as u32).to_le_bytes());
            data.extend((runs(samples).count() as u64).to_le_bytes());
            for run in runs(samples) {
                data.extend((run.first().map_or(0, |&(frame, ..)| frame) as u64).to_le_bytes());
                data.extend((run.len() as u64).to_le_bytes());
            }
            for word in 0..WORDS {
                let column = samples.iter().map(|(_, _, words)| words.get(word).copied());
                push_wide(&mut data, column.map(|word| ordered(word.unwrap_or(0.0).to_bits())));
            }
        }
        data
    }
}

fn is_same_marker(a: &Sample, b: &Sample) -> bool {
    a.1 == b.1
}

/// The samples of a marker that follow each other frame by frame.
fn runs(samples: &[Sample]) -> impl Iterator<Item = &[Sample]> {
    samples.chunk_by(|a, b| a.0.checked_add(1) == Some(b.0))
}

/// Coordinates under gaps that were kept, read frame after frame.
#[derive(Debug)]
pub(super) struct KeptCoordinates<'a> {
    /// Number of the first frame of all.
    first_frame: u64,
    /// Number of the frame to come.
    next: u64,
    markers: Vec<KeptMarker<'a>>,
}

/// Those of a marker.
#[derive(Debug)]
struct KeptMarker<'a> {
    index: usize,
    /// The runs to come, as they are stored, the one under way first.
    runs: &'a [[u8; RUN_BYTES]],
    columns: Columns<'a>,
}

impl<'a> KeptCoordinates<'a> {
    /// Those of a take, from frame number `from` on. `None` where there are none, or none that can be read.
    pub(super) fn parse(foreign: &'a [Foreign], from: u64) -> Option<Self> {
        let data = &foreign.iter().find(|part| part.kind == GAP_COORDINATES)?.data;
        let (&[VERSION], rest) = data.split_first_chunk()? else { return None };
        let (&first_frame, rest) = rest.split_first_chunk()?;
        let (&n_markers, mut rest) = rest.split_first_chunk()?;
        let first_frame = u64::from_le_bytes(first_frame);
        let mut markers = Vec::new();
        for _ in 0..u32::from_le_bytes(n_markers) {
            let (marker, after) = KeptMarker::parse(rest)?;
            markers.push(marker);
            rest = after;
        }
        let mut kept = Self { first_frame, next: from, markers };
        let before = from.saturating_sub(first_frame);
        kept.markers.iter_mut().for_each(|marker| marker.pass(before));
        rest.is_empty().then_some(kept)
    }

    /// Goes on to the next frame: for each marker that has any, its index and words.
    pub(super) fn next_frame(&mut self) -> impl Iterator<Item = (usize, Words)> {
        let frame = self.next.checked_sub(self.first_frame);
        self.next = self.next.saturating_add(1);
        self.markers.iter_mut().filter_map(move |marker| Some((marker.index, marker.at(frame?)?)))
    }
}

impl<'a> KeptMarker<'a> {
    /// A marker, and what follows it.
    fn parse(data: &'a [u8]) -> Option<(Self, &'a [u8])> {
        let (&index, rest) = data.split_first_chunk()?;
        let (&n_runs, rest) = rest.split_first_chunk()?;
        let n_runs = usize::try_from(u64::from_le_bytes(n_runs)).ok()?;
        let (runs, rest) = rest.split_at_checked(n_runs.checked_mul(RUN_BYTES)?)?;
        let runs = runs.as_chunks().0;
        let (mut n_samples, mut end) = (0usize, 0u64);
        for run in runs {
            let (first, n_frames) = run_of(run);
            if first < end {
                return None;
            }
            end = first.checked_add(n_frames)?;
            n_samples = n_samples.checked_add(usize::try_from(n_frames).ok()?)?;
        }
        let n_bytes = n_samples.checked_mul(size_of::<Words>())?;
        let (columns, rest) = rest.split_at_checked(n_bytes)?;
        let columns = Columns::new(columns, size_of::<f32>(), WORDS, n_samples)?;
        Some((Self { index: u32::from_le_bytes(index) as usize, runs, columns }, rest))
    }

    /// Leaves out what is before a frame, counted from the first.
    fn pass(&mut self, frame: u64) {
        for run in self.runs {
            let (first, n_frames) = run_of(run);
            let n_before = frame.saturating_sub(first).min(n_frames);
            self.columns.skip(usize::try_from(n_before).unwrap_or(usize::MAX));
        }
    }

    /// The words of a frame, counted from the first. Frames come in order.
    fn at(&mut self, frame: u64) -> Option<Words> {
        while let Some((run, after)) = self.runs.split_first() {
            let (first, n_frames) = run_of(run);
            if frame < first {
                return None;
            }
            if frame - first < n_frames {
                return self.next();
            }
            self.runs = after;
        }
        None
    }

    /// The words of the next sample.
    fn next(&mut self) -> Option<Words> {
        let words: &[u32; WORDS] = self.columns.next()?.first_chunk()?;
        Some(words.map(|word| f32::from_bits(unordered(word))))
    }
}

/// First frame and number of frames.
fn run_of(run: &[u8; RUN_BYTES]) -> (u64, u64) {
    let word = |at: usize| run.get(at..).and_then(<[u8]>::first_chunk).copied();
    (
        u64::from_le_bytes(word(0).unwrap_or_default()),
        u64::from_le_bytes(word(8).unwrap_or_default()),
    )
}

/// Turns what a part keeps; `None` for a part that cannot be read.
pub(super) fn turned(foreign: &[Foreign], turn: Turn) -> Option<Foreign> {
    let kept = KeptCoordinates::parse(foreign, 0)?;
    let mut turned = GapCoordinates::default();
    for mut marker in kept.markers {
        for run in marker.runs {
            let (first, n_frames) = run_of(run);
            for frame in first..first + n_frames {
                let [x, y, z, fourth] = marker.next()?;
                turned.push(usize::try_from(frame).ok()?, marker.index, turn.of([x, y, z]), fourth);
            }
        }
    }
    turned.into_foreign(kept.first_frame, &mut Vec::new())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(samples: &[Sample]) -> Foreign {
        let kept = GapCoordinates(samples.to_vec()).into_foreign(100, &mut Vec::new());
        kept.expect("samples, and not too many")
    }

    fn sample(frame: usize, marker: usize) -> Sample {
        (frame, marker, [frame as f32, marker as f32, 0.5, -1.0])
    }

    #[test]
    fn runs_come_back_from_any_frame_on() {
        let samples = [(0, 4), (1, 4), (2, 4), (2, 7), (5, 4), (6, 7), (7, 7), (9, 4)];
        let samples = samples.map(|(frame, marker)| sample(frame, marker));
        let foreign = [part(&samples)];
        for from in 95..115 {
            let mut kept = KeptCoordinates::parse(&foreign, from).expect("a part");
            for number in from..115 {
                let found: Vec<_> = kept.next_frame().collect();
                let here = samples.iter().filter(|&&(frame, ..)| frame as u64 + 100 == number);
                let expected: Vec<_> = here.map(|&(_, marker, words)| (marker, words)).collect();
                assert_eq!(found, expected, "frame {number}, from {from}");
            }
        }
    }

    #[test]
    fn a_part_that_is_damaged_is_not_read() {
        let whole = part(&[sample(0, 1), sample(1, 1), sample(5, 2)]);
        for n_bytes in 0..whole.data.len() {
            let cut = Foreign { data: whole.data[..n_bytes].to_vec(), ..whole.clone() };
            assert!(KeptCoordinates::parse(&[cut], 0).is_none(), "{n_bytes}");
        }
        for at in 0..whole.data.len() {
            for bits in [1, 0x80, 0xFF] {
                let mut foreign = [whole.clone()];
                foreign[0].data[at] ^= bits;
                if let Some(mut kept) = KeptCoordinates::parse(&foreign, 100) {
                    (0..9).for_each(|_| assert!(kept.next_frame().count() <= 2));
                }
                turned(&foreign, Turn::NONE);
            }
        }
    }

    #[test]
    fn the_length_of_a_part_is_known_before_it_is_made() {
        let kept = GapCoordinates(vec![sample(0, 1), sample(1, 1), sample(5, 1), sample(5, 2)]);
        assert_eq!(kept.encode(1).len(), kept.n_bytes());
    }
}
