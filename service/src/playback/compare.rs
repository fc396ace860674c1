//! How far apart the samples of two takes are, for a player: the largest distance in bins of equal length.

use std::{
    collections::HashMap,
    io::{Read, Seek},
    ops::Range,
};

use mocapd_take::{
    TakeError, TakeMap,
    motion::{GAP, Position, is_gap},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    GAPS_SAMPLES_MAX,
    gaps::BINS,
    window::{decode_rows, frame_at},
};

/// Largest relative difference of two rates that are the same: devices state theirs in thousandths of a hertz.
const RATE_TOLERANCE: f64 = 1e-6;

/// The differences of a part of a take from another take.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeDifference {
    /// Name of the other take.
    pub against: String,
    /// The first frame of the part.
    pub first_frame: u64,
    /// One past its last frame: the next request begins here, unless it is the end of the take.
    pub end_frame: u64,
    /// Number of frames in the whole take.
    pub frames: u64,
    /// Number of frames in a bin. Bin 0 begins at the first frame of the take.
    pub bin_frames: u64,
    /// The bin that `first_frame` belongs to; the distances begin with it.
    pub first_bin: u64,
    /// Frame of the other take that belongs to frame 0.
    pub other_first: i64,
    /// Whether frames are matched by their numbers in the sources: those of the same length are matched from their first
    /// frames on.
    pub is_by_number: bool,
    /// Number of the first frame in the source of the other take.
    pub other_first_number: u64,
    /// Number of frames that only this take has, and that only the other one has.
    pub frames_only_here: u64,
    /// See above.
    pub frames_only_there: u64,
    /// By marker, its index in the other take; null for a marker that only this take has.
    pub markers: Vec<Option<usize>>,
    /// Number of markers that only the other take has.
    pub markers_missing: usize,
    /// By bin, the largest distance of the part in millimetres; null where no sample is in both takes.
    pub max_error_mm: Vec<Option<f32>>,
    /// The largest distance of the part; null if no sample is in both takes.
    pub largest: Option<LargestError>,
    /// Number of samples of the part that are in both takes.
    pub samples: u64,
    /// Sum of their squared distances in square millimetres.
    pub sum_of_squares_mm2: f64,
    /// Number of samples of the part that only one of the two takes has.
    pub gaps_differing: u64,
    /// Whether anything damaged was found.
    pub is_damaged: bool,
}

/// The largest distance between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LargestError {
    /// The distance in millimetres.
    pub error_mm: f64,
    /// The frame.
    pub frame: u64,
    /// The index of the marker.
    pub marker: usize,
}

/// Why two takes cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// Their frames are not those of the same times.
    #[error("{ours} and {theirs} Hz: only takes of the same rate can be compared")]
    Rates {
        /// The rate of the take in Hz.
        ours: f64,
        /// The rate of the other take in Hz.
        theirs: f64,
    },
    /// They have no marker with the same label.
    #[error("no marker has the same label in both takes")]
    NoMarkerInCommon,
    /// They have no frame number in common.
    #[error("no frame number is in both takes")]
    NoFrameInCommon,
    /// One of the takes cannot be read.
    #[error(transparent)]
    Take(#[from] TakeError),
}

/// Which frames and markers of two takes belong together.
#[derive(Debug, Clone, PartialEq)]
struct Matching {
    other_first: i64,
    markers: Vec<Option<usize>>,
    markers_missing: usize,
    /// The frames that both have.
    common: Range<u64>,
    is_by_number: bool,
    other_first_number: u64,
    n_theirs: u64,
}

impl Matching {
    fn of(ours: &TakeMap, theirs: &TakeMap) -> Result<Self, CompareError> {
        let rates = [ours, theirs].map(|map| map.header.rate_hz);
        if (rates[0] - rates[1]).abs() > RATE_TOLERANCE * rates[1].abs() {
            return Err(CompareError::Rates { ours: rates[0], theirs: rates[1] });
        }
        let (markers, markers_missing) = match_markers(ours, theirs);
        if markers.iter().all(Option::is_none) {
            return Err(CompareError::NoMarkerInCommon);
        }
        let [first, other] = [ours, theirs].map(first_frame);
        // An excerpt keeps the frame numbers of its file; a recording begins with 1, as does a file that states none.
        let is_by_number = ours.n_rows != theirs.n_rows && first != other;
        let by = if is_by_number { i128::from(first) - i128::from(other) } else { 0 };
        let end = i128::from(ours.n_rows).min(i128::from(theirs.n_rows) - by);
        let start = (-by).max(0);
        if start >= end {
            return Err(CompareError::NoFrameInCommon);
        }
        let row = |row: i128| u64::try_from(row).unwrap_or_default();
        let other_first = i64::try_from(by).map_err(|_| CompareError::NoFrameInCommon)?;
        Ok(Self {
            other_first,
            markers,
            markers_missing,
            common: row(start)..row(end),
            is_by_number: is_by_number || first == other,
            other_first_number: other,
            n_theirs: theirs.n_rows,
        })
    }
}

/// The number of the first frame in the source of a take.
fn first_frame(map: &TakeMap) -> u64 {
    map.header.source.as_ref().map_or(1, |source| source.first_frame)
}

/// By marker of the first take, the marker of the other with the same label; the second of a label that repeats belongs to
/// the second, and so on, also of markers without one. And how many only the other has.
fn match_markers(ours: &TakeMap, theirs: &TakeMap) -> (Vec<Option<usize>>, usize) {
    let mut known: HashMap<(&str, usize), usize> = HashMap::new();
    for (index, key) in numbered_labels(theirs).enumerate() {
        known.insert(key, index);
    }
    let n_theirs = known.len();
    let markers: Vec<_> = numbered_labels(ours).map(|key| known.get(&key).copied()).collect();
    let n_common = markers.iter().flatten().count();
    (markers, n_theirs - n_common)
}

/// The labels of a take, each with how often it came before.
fn numbered_labels(map: &TakeMap) -> impl Iterator<Item = (&str, usize)> {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    map.channels.iter().map(move |channel| {
        let count = counts.entry(&channel.label).or_default();
        *count += 1;
        (channel.label.as_str(), *count - 1)
    })
}

/// Compares a take with another from a time in seconds on, in as many frames as one call may decode.
///
/// # Errors
/// Those of [`CompareError`]. Nothing is compared from the end of the take on.
pub fn read_difference<A: Read + Seek, B: Read + Seek>(
    (input, map): (&mut A, &TakeMap),
    (other, other_map): (&mut B, &TakeMap),
    from_s: f64,
) -> Result<TakeDifference, CompareError> {
    let matching = Matching::of(map, other_map)?;
    let n_markers = map.channels.len().max(other_map.channels.len()).max(1) as u64;
    let start = frame_at(from_s, map.header.rate_hz).min(map.n_rows);
    // Two samples are decoded for each distance.
    let n_max = (GAPS_SAMPLES_MAX / 2 / n_markers).max(1);
    let rows = start..map.n_rows.min(start.saturating_add(n_max));
    let mut found = TakeDifference::new(map, &matching, rows.clone());
    let compared = rows.start.max(matching.common.start)..rows.end.min(matching.common.end);
    if compared.start < compared.end {
        let row = |row: u64| row.saturating_add_signed(matching.other_first);
        let theirs = row(compared.start)..row(compared.end);
        let (a, is_a_damaged) = decode_rows(input, map, &compared, 1)?;
        let (b, is_b_damaged) = decode_rows(other, other_map, &theirs, 1)?;
        found.is_damaged = is_a_damaged || is_b_damaged;
        let a = a.chunks_exact(map.channels.len().max(1));
        let b = b.chunks_exact(other_map.channels.len().max(1));
        for (frame, (a, b)) in compared.zip(a.zip(b)) {
            found.add(frame, a, b);
        }
    }
    Ok(found)
}

impl TakeDifference {
    fn new(map: &TakeMap, matching: &Matching, rows: Range<u64>) -> Self {
        let n_common = matching.common.end - matching.common.start;
        let bin_frames = map.n_rows.div_ceil(BINS).max(1);
        let first_bin = rows.start / bin_frames;
        let n_bins = rows.end.div_ceil(bin_frames).saturating_sub(first_bin);
        Self {
            first_frame: rows.start,
            end_frame: rows.end,
            frames: map.n_rows,
            bin_frames,
            first_bin,
            other_first: matching.other_first,
            is_by_number: matching.is_by_number,
            other_first_number: matching.other_first_number,
            frames_only_here: map.n_rows.saturating_sub(n_common),
            frames_only_there: matching.n_theirs.saturating_sub(n_common),
            markers: matching.markers.clone(),
            markers_missing: matching.markers_missing,
            max_error_mm: vec![None; n_bins as usize],
            ..Self::default()
        }
    }

    /// Counts a frame.
    fn add(&mut self, frame: u64, ours: &[Position], theirs: &[Position]) {
        let bin = (frame / self.bin_frames.max(1)).saturating_sub(self.first_bin) as usize;
        for (marker, (a, other)) in ours.iter().zip(&self.markers).enumerate() {
            let Some(other) = other else { continue };
            let b = theirs.get(*other).copied().unwrap_or(GAP);
            match (is_gap(*a), is_gap(b)) {
                (true, true) => {}
                (false, false) => {
                    let error_mm = distance_mm(*a, b);
                    self.samples += 1;
                    self.sum_of_squares_mm2 += error_mm * error_mm;
                    if let Some(largest) = self.max_error_mm.get_mut(bin) {
                        *largest = Some(largest.unwrap_or_default().max(error_mm as f32));
                    }
                    if self.largest.is_none_or(|largest| error_mm > largest.error_mm) {
                        self.largest = Some(LargestError { error_mm, frame, marker });
                    }
                }
                _ => self.gaps_differing += 1,
            }
        }
    }
}

fn distance_mm(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use mocapd_take::record::{Channel, Header, ImportSource};

    use super::*;

    fn map(labels: &[&str], first_frame: u64, n_rows: u64) -> TakeMap {
        let source = ImportSource { first_frame, ..ImportSource::default() };
        let header = Header { rate_hz: 100.0, source: Some(source), ..Header::default() };
        let channel = |label: &&str| Channel {
            marker_id: 0,
            label: (*label).to_owned(),
            labelled: !label.is_empty(),
        };
        TakeMap {
            header,
            channels: labels.iter().map(channel).collect(),
            n_rows,
            ..TakeMap::default()
        }
    }

    #[test]
    fn markers_are_matched_by_label_and_frames_by_number() {
        let ours = map(&["b", "a", "", "a", ""], 1, 100);
        let theirs = map(&["a", "a", "b", "", "c"], 1, 100);
        let found = Matching::of(&ours, &theirs).unwrap();
        assert_eq!(found.markers, [Some(2), Some(0), Some(3), Some(1), None]);
        assert_eq!((found.markers_missing, found.other_first, found.common), (1, 0, 0..100));
        // An excerpt of frames 41 to 60.
        let part = map(&["a"], 41, 20);
        let found = Matching::of(&part, &ours).unwrap();
        assert_eq!((found.other_first, found.common), (40, 0..20));
        let found = Matching::of(&ours, &part).unwrap();
        assert_eq!((found.other_first, &found.common), (-40, &(40..60)));
        let difference = TakeDifference::new(&ours, &found, 0..10);
        assert_eq!((difference.frames_only_here, difference.frames_only_there), (80, 0));
        // Excerpts of the same length are compared from their first frames on, and the result says so.
        let other = map(&["a"], 101, 100);
        let found = Matching::of(&ours, &other).unwrap();
        assert_eq!(
            (found.other_first, found.is_by_number, found.other_first_number),
            (0, false, 101)
        );
        let late = map(&["a"], 500, 20);
        assert!(matches!(Matching::of(&ours, &late), Err(CompareError::NoFrameInCommon)));
        let other = map(&["x"], 1, 100);
        assert!(matches!(Matching::of(&ours, &other), Err(CompareError::NoMarkerInCommon)));
        let mut fast = map(&["a"], 1, 100);
        fast.header.rate_hz = 100.1;
        let message = Matching::of(&ours, &fast).unwrap_err().to_string();
        assert!(message.contains("100 and 100.1 Hz"), "{message}");
    }

    #[test]
    fn distances_of_a_part_are_counted_in_its_bins() {
        let ours = map(&["a", "b"], 1, 5 * BINS);
        let matching = Matching::of(&ours, &map(&["b", "a"], 1, 5 * BINS)).unwrap();
        let mut found = TakeDifference::new(&ours, &matching, 12..24);
        assert_eq!((found.bin_frames, found.first_bin, found.max_error_mm.len()), (5, 2, 3));
        found.add(12, &[[0.0; 3], [1.0; 3]], &[[1.0; 3], [3.0, 0.0, 4.0]]);
        found.add(16, &[GAP, [1.0; 3]], &[[1.0, 1.0, 1.5], [3.0, 0.0, 4.0]]);
        assert_eq!(found.max_error_mm, [Some(5.0), Some(0.5), None]);
        assert_eq!((found.samples, found.gaps_differing), (3, 1));
        let largest = LargestError { error_mm: 5.0, frame: 12, marker: 0 };
        assert_eq!(found.largest, Some(largest));
        assert!((found.sum_of_squares_mm2 - 25.25).abs() < 1e-12);
    }
}
