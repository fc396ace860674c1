//! The coordinates of samples that are marked as missing: gaps to us, and given back to C3D as they were.

use super::columns::{ordered, push_wide, unordered};
use super::foreign::{GAP_COORDINATES, KeptSamples, sample_head};
use crate::interchange::{notes::Notes, turn::Turn};
use crate::motion::{Ambiguity, Foreign, Position};

/// Four words a sample: coordinates in millimetres, and the fourth word, which is 0 where there are none.
type Words = [f32; 4];

/// Coordinates under gaps, in the order of the frames.
#[derive(Debug, Default)]
pub(super) struct GapCoordinates(Vec<(usize, usize, Words)>);

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

    /// The part that keeps them, where there are any.
    pub(super) fn into_foreign(self, first_frame: u64, n_frames: usize) -> Option<Foreign> {
        let mut markers: Vec<usize> = self.0.iter().map(|&(_, marker, _)| marker).collect();
        markers.sort_unstable();
        markers.dedup();
        let mut by_marker: Vec<Vec<(usize, Words)>> = vec![Vec::new(); markers.len()];
        for (frame, marker, words) in self.0 {
            let place = markers.binary_search(&marker).ok()?;
            by_marker.get_mut(place)?.push((frame, words));
        }
        encode(&markers, &by_marker, first_frame, n_frames)
    }
}

/// A part of samples by marker: frames, counted from the first, and words.
fn encode(
    markers: &[usize],
    by_marker: &[Vec<(usize, Words)>],
    first_frame: u64,
    n_frames: usize,
) -> Option<Foreign> {
    if markers.is_empty() {
        return None;
    }
    let mut data = sample_head(4, markers.len(), 1, first_frame, n_frames);
    markers.iter().for_each(|&marker| data.extend((marker as u32).to_le_bytes()));
    for samples in by_marker {
        for word in 0..4 {
            let mut rest = samples.iter().peekable();
            let mut before = 0f32;
            let column: Vec<u32> = (0..n_frames)
                .map(|frame| {
                    match rest.next_if(|(at, _)| *at == frame) {
                        Some((_, words)) => before = words.get(word).copied().unwrap_or(0.0),
                        // A fourth word says of each frame whether there is something; coordinates stay as they were.
                        None if word == 3 => before = 0.0,
                        None => {}
                    }
                    ordered(before.to_bits())
                })
                .collect();
            push_wide(&mut data, column.into_iter());
        }
    }
    Some(Foreign { kind: GAP_COORDINATES.to_owned(), data })
}

/// The words of a kept sample; `None` where there is none.
pub(super) fn words(kept: &[u32], place: usize) -> Option<Words> {
    let words = kept.as_chunks::<4>().0.get(place)?.map(|word| f32::from_bits(unordered(word)));
    (words[3] != 0.0).then_some(words)
}

/// Turns what a part keeps; `None` for a part that cannot be read.
pub(super) fn turned(foreign: &[Foreign], turn: Turn) -> Option<Foreign> {
    let mut kept = KeptSamples::gap_coordinates(foreign, 0)?;
    let markers = kept.points.clone();
    let (first_frame, n_frames) = (kept.first_frame, kept.n_frames);
    let mut by_marker: Vec<Vec<(usize, Words)>> = vec![Vec::new(); markers.len()];
    for frame in 0..n_frames {
        let row = kept.next()?;
        for (place, samples) in by_marker.iter_mut().enumerate() {
            if let Some([x, y, z, fourth]) = words(row, place) {
                let [x, y, z] = turn.of([x, y, z]);
                samples.push((frame, [x, y, z, fourth]));
            }
        }
    }
    encode(&markers, &by_marker, first_frame, n_frames)
}
