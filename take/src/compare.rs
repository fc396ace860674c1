//! Compares two motions sample by sample, as `verify --against` does for a take and its original.

mod analog;
mod content;
mod log;
mod recorded;
mod times;

use std::{fmt, io};

pub use self::{
    analog::{AnalogDifference, ChannelDifference, compare_analog},
    content::{ContentDifference, EventDifference, FieldDifference},
    log::{LogError, SentAccount, SentComparison, SentLog, compare_log},
    recorded::{
        BodyDifference, PoseDifference, SampledDifference, compare_poses, compare_recorded,
        compare_samples,
    },
    times::{TimesDifference, compare_times},
};
use crate::motion::{FrameSource, GAP, MotionInfo, Position, is_gap};
use serde::Serialize;

/// How a take differs from its original.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Difference {
    /// Frames compared.
    pub frames: u64,
    /// Frames that only one of the two has.
    pub frames_missing: u64,
    /// Those of them that the original has after the take's last frame.
    #[serde(skip)]
    pub frames_after_take: u64,
    /// Frames of the original that the take lost to damage or truncation; these are not compared.
    pub frames_lost: u64,
    /// Markers whose label or column differs, or that only one of the two has.
    pub labels_differing: Vec<String>,
    /// Assumptions made to compare the two, such as frame alignment; one sentence each.
    pub notes: Vec<String>,
    /// Samples that both have.
    pub samples: u64,
    /// Samples that only one of the two has.
    pub gaps_differing: u64,
    /// Samples that are not bit-identical.
    pub bits_differing: u64,
    /// Samples whose error exceeds the bound stated by their block; `None` if the original is itself a lossy take.
    pub beyond_stated: Option<u64>,
    /// The largest Euclidean distance, in millimetres.
    pub max_error_mm: f64,
    /// Root mean square distance, in millimetres.
    pub rms_error_mm: f64,
    /// The frame of the largest distance, from 0 at the take's first frame.
    pub worst_frame: Option<u64>,
    /// The marker of the largest distance, by column.
    pub worst_marker: Option<usize>,
    /// The first sample that only one of the two has, or that is not bit-identical: its frame, counted likewise, and
    /// its marker.
    #[serde(skip)]
    pub first_differing: Option<(u64, usize)>,
    /// The largest distance of each marker, in millimetres.
    pub max_error_by_marker_mm: Vec<f64>,
}

/// Why two sources of frames could not be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// The two have no frame number in common.
    #[error(
        "nothing to compare: no frame in common (the take has {take}, the original has {original})"
    )]
    NoFrameInCommon {
        /// The take's frames.
        take: FrameNumbers,
        /// The original's frames.
        original: FrameNumbers,
    },
    /// Reading one of the two failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// A range of frame numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameNumbers {
    /// Number of the first frame.
    pub first: u64,
    /// Number of frames.
    pub n: u64,
}

impl FrameNumbers {
    fn of(info: &MotionInfo) -> Self {
        Self { first: info.source.first_frame, n: info.n_frames }
    }
}

impl fmt::Display for FrameNumbers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.n {
            0 => f.write_str("no frames"),
            n => write!(f, "frames {} to {}", self.first, self.first.saturating_add(n - 1)),
        }
    }
}

/// Reads both motions to their ends and compares them frame by frame.
///
/// If their lengths and first frame numbers differ, frames are matched by number, else by position.
///
/// # Errors
/// `NoFrameInCommon` if no frame can be compared; `Io` if reading fails.
pub fn compare(
    mut take: impl FrameSource,
    mut original: impl FrameSource,
) -> Result<Difference, CompareError> {
    let (ours, theirs) = (take.info().clone(), original.info().clone());
    let n_markers = ours.markers.len().max(theirs.markers.len());
    let (our_labels, their_labels) = (ours.labels(), theirs.labels());
    let label = |i| their_labels.get(i).or_else(|| our_labels.get(i)).cloned();
    let mut difference = Difference {
        labels_differing: (0..n_markers)
            .filter(|&i| our_labels.get(i) != their_labels.get(i))
            .filter_map(label)
            .collect(),
        max_error_by_marker_mm: vec![0.0; n_markers],
        ..Difference::default()
    };
    let (our_hz, their_hz) = (ours.rate_hz, theirs.rate_hz);
    if (our_hz - their_hz).abs() > 1e-6 * their_hz.abs() {
        let note = "compared frame by frame, not by time";
        difference.notes.push(format!("the rates differ, {our_hz} and {their_hz} Hz: {note}"));
    }
    let mut row = vec![GAP; ours.markers.len()];
    let mut original_row = vec![GAP; theirs.markers.len()];
    let skipped = skip_to_common(&mut take, &mut original, &mut difference)?;
    let (mut sum_of_squares, mut beyond_stated) = (0.0, 0);
    while take.next_frame(&mut row)? && original.next_frame(&mut original_row)? {
        if take.is_lost() {
            difference.frames_lost += 1;
            difference.frames += 1;
            continue;
        }
        for marker in 0..n_markers {
            let a = row.get(marker).copied().unwrap_or(GAP);
            let b = original_row.get(marker).copied().unwrap_or(GAP);
            let (is_sample, is_other) = (!is_gap(a), !is_gap(b));
            let is_identical = a.map(f32::to_bits) == b.map(f32::to_bits);
            if is_sample != is_other || is_sample && !is_identical {
                difference
                    .first_differing
                    .get_or_insert((skipped.take + difference.frames, marker));
            }
            match (is_sample, is_other) {
                (false, false) => {}
                (true, true) => {
                    let error_mm = distance_mm(a, b);
                    difference.samples += 1;
                    let stated_mm = take.stated_error_mm(marker);
                    beyond_stated += u64::from(stated_mm.is_some_and(|mm| error_mm > mm));
                    difference.bits_differing += u64::from(!is_identical);
                    sum_of_squares += error_mm * error_mm;
                    let worst = &mut difference.max_error_by_marker_mm[marker];
                    *worst = worst.max(error_mm);
                    if error_mm > difference.max_error_mm {
                        difference.max_error_mm = error_mm;
                        difference.worst_frame = Some(skipped.take + difference.frames);
                        difference.worst_marker = Some(marker);
                    }
                }
                _ => difference.gaps_differing += 1,
            }
        }
        difference.frames += 1;
    }
    if difference.frames == 0 && (ours.n_frames > 0 || theirs.n_frames > 0) {
        let (take, original) = (FrameNumbers::of(&ours), FrameNumbers::of(&theirs));
        return Err(CompareError::NoFrameInCommon { take, original });
    }
    difference.frames_after_take =
        theirs.n_frames.saturating_sub(skipped.original + difference.frames);
    let only_one = |n: u64| n.saturating_sub(difference.frames);
    difference.frames_missing = only_one(ours.n_frames) + only_one(theirs.n_frames);
    difference.frames -= difference.frames_lost;
    difference.beyond_stated = Some(beyond_stated);
    difference.rms_error_mm = (sum_of_squares / difference.samples.max(1) as f64).sqrt();
    Ok(difference)
}

/// How many frames of each motion come before the first frame that is compared: those before the first frame number that
/// both have, unless the two are compared from their first frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skipped {
    /// Frames of the take.
    pub take: u64,
    /// Frames of the original.
    pub original: u64,
}

impl Skipped {
    /// The frames to skip in a take and in its original.
    #[must_use]
    pub fn of(take: &MotionInfo, original: &MotionInfo) -> Self {
        let [ours, theirs] = [take, original].map(FrameNumbers::of);
        // An excerpt keeps the frame numbers of its file; a recording of the whole begins with 1.
        if ours.n == theirs.n || ours.first == theirs.first {
            return Self { take: 0, original: 0 };
        }
        Self {
            take: theirs.first.saturating_sub(ours.first).min(ours.n),
            original: ours.first.saturating_sub(theirs.first).min(theirs.n),
        }
    }
}

fn skip_to_common(
    take: &mut impl FrameSource,
    original: &mut impl FrameSource,
    difference: &mut Difference,
) -> io::Result<Skipped> {
    let skipped = Skipped::of(take.info(), original.info());
    if skipped != (Skipped { take: 0, original: 0 }) {
        difference.notes.push(format!(
            "the first frames differ, {} and {}: compared by frame number",
            take.info().source.first_frame,
            original.info().source.first_frame
        ));
    }
    let mut row = vec![GAP; take.info().markers.len()];
    for _ in 0..skipped.take {
        take.next_frame(&mut row)?;
    }
    let mut row = vec![GAP; original.info().markers.len()];
    for _ in 0..skipped.original {
        original.next_frame(&mut row)?;
    }
    Ok(skipped)
}

fn distance_mm(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    squares.sum::<f64>().sqrt()
}

impl Difference {
    /// Whether both have the same markers and frames, and every sample is bit-identical.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.labels_differing.is_empty()
            && self.frames_missing == 0
            && self.frames_lost == 0
            && self.first_differing.is_none()
    }

    /// Whether frames, gaps and labels agree and every sample is within `tolerance_mm` (bit-identical if that is 0) and
    /// within the bound stated by its block.
    #[must_use]
    pub fn is_within(&self, tolerance_mm: f64) -> bool {
        let close = if tolerance_mm > 0.0 {
            self.max_error_mm <= tolerance_mm
        } else {
            self.bits_differing == 0
        };
        close
            && self.frames_missing == 0
            && self.gaps_differing == 0
            && self.beyond_stated.unwrap_or(0) == 0
            && self.labels_differing.is_empty()
    }
}
