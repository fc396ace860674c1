//! Marker trajectories in memory: importers produce them, exporters consume them and the simulator replays them; and the
//! ambiguities of imported files, and how they were resolved.

use std::{fmt, time::Duration};

pub use crate::{foreign::Foreign, up_axis::UpAxis};
use crate::{
    interchange::c3d::ANALOG,
    map::TakeMap,
    record::{Channel, EventKind, Subject},
    sampled::Recording,
};

/// A position in millimetres; a gap is [`GAP`].
pub type Position = [f32; 3];

/// The position of a missing sample. Compare with [`is_gap`]: NaN does not equal itself.
pub const GAP: Position = [f32::NAN; 3];

/// Whether a position marks a missing sample.
#[must_use]
pub fn is_gap(position: Position) -> bool {
    position.iter().any(|v| !v.is_finite())
}

/// The first frame at or after `time`, which is also the number of frames before it. A time within rounding error of a
/// frame's own time counts as that frame: 0.07 s at 100 Hz are 7.000000000000001 frames in binary.
#[must_use]
pub fn frame_at(time: Duration, rate_hz: f64) -> u64 {
    let frame = time.as_secs_f64() * rate_hz;
    let nearest = frame.round();
    let close = (frame - nearest).abs() <= 1e-9 * frame.max(1.0);
    if close { nearest as u64 } else { frame.ceil() as u64 }
}

/// A marker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Marker {
    /// Its label; `u001`... by column if it is unlabelled.
    pub label: String,
    /// Whether the label comes from the source (false: an unlabelled trajectory).
    pub labelled: bool,
}

/// The origin of trajectories and their conversion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Source {
    /// `c3d`, `trc`, `tsv`, `csv`, `generated`, or a driver's name.
    pub format: String,
    /// The source's unit of length, as written (`mm`, `cm`, `m`); empty if none is stated.
    pub unit: String,
    /// The factor that converted every coordinate to millimetres, in f64.
    pub factor: f64,
    /// Number of the source's first frame (C3D files often do not start at 1).
    pub first_frame: u64,
    /// Frames that the source announces but lacks, because the file is truncated.
    pub frames_missing: u64,
    /// Defects of the source and how they were read, one sentence each.
    pub warnings: Vec<String>,
    /// Warnings that allow another reading of the source.
    pub ambiguities: Vec<Ambiguity>,
}

/// An operator's mark, a trigger, a sync pulse, or a notice of the device or host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MotionEvent {
    /// The frame at that time, from 0; one past the last frame is the end.
    pub frame: u64,
    /// Its kind.
    pub kind: EventKind,
    /// A description; may be empty.
    pub text: String,
}

impl MotionEvent {
    /// A name for the event: its text, or its kind if the text is blank.
    #[must_use]
    pub fn label(&self) -> &str {
        if self.text.trim().is_empty() { self.kind.name() } else { &self.text }
    }
}

/// Everything about trajectories but the samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionInfo {
    /// Frames per second.
    pub rate_hz: f64,
    /// Number of frames.
    pub n_frames: u64,
    /// The markers, in column order.
    pub markers: Vec<Marker>,
    /// The vertical axis.
    pub up: UpAxis,
    /// The origin of the trajectories.
    pub source: Source,
    /// The captured subject, if known.
    pub subject: Option<Subject>,
    /// Parts of the source that a take does not model.
    pub foreign: Vec<Foreign>,
    /// The events, in order of frames.
    pub events: Vec<MotionEvent>,
    /// The sampled channels of a recording, if they were [opened](Recording::open).
    pub recording: Option<Recording>,
}

impl MotionInfo {
    /// Whether the file has analog samples.
    #[must_use]
    pub fn has_analog(&self) -> bool {
        self.foreign.iter().any(|part| part.kind == ANALOG)
    }

    /// Number of sampled channels whose samples are within a tolerance, and not exact.
    #[must_use]
    pub fn n_inexact_channels(&self) -> usize {
        self.foreign.iter().flat_map(|part| &part.bounds).filter(|bound| **bound > 0.0).count()
    }

    /// The labels, in column order.
    #[must_use]
    pub fn labels(&self) -> Vec<String> {
        self.markers.iter().map(|marker| marker.label.clone()).collect()
    }

    /// The rows of the recording that the frames are.
    #[must_use]
    pub fn rows(&self) -> std::ops::Range<u64> {
        let first_of_take = self.recording.as_ref().map_or(1, Recording::first_frame);
        let first = self.source.first_frame.saturating_sub(first_of_take);
        first..first.saturating_add(self.n_frames)
    }

    /// Restricts the description to frames `first..end`: their number, the number of the first, and their events.
    /// Events after the last frame stay if `end` reaches it.
    pub fn cut(&mut self, first: u64, end: u64) {
        let reaches_end = end >= self.n_frames;
        self.events.retain(|event| event.frame >= first && (event.frame < end || reaches_end));
        self.events.iter_mut().for_each(|event| event.frame -= first);
        self.source.first_frame = self.source.first_frame.saturating_add(first);
        self.n_frames = end.saturating_sub(first);
    }
}

/// Trajectories in memory, frame-major: `positions_mm[frame * n_markers + marker]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Motion {
    /// Everything but the samples.
    pub info: MotionInfo,
    /// `n_frames * markers.len()` positions, [`GAP`] where missing.
    pub positions_mm: Vec<Position>,
}

impl Motion {
    /// The positions of one frame, one per marker.
    #[must_use]
    pub fn frame(&self, index: usize) -> &[Position] {
        let n = self.info.markers.len();
        self.positions_mm.get(index * n..(index + 1) * n).unwrap_or(&[])
    }

    /// Number of frames in memory.
    #[must_use]
    pub fn n_frames(&self) -> usize {
        if self.info.markers.is_empty() {
            return usize::try_from(self.info.n_frames).unwrap_or(usize::MAX);
        }
        self.positions_mm.len() / self.info.markers.len()
    }
}

/// Reads frames one after another, so that a take of any length can be exported in bounded memory.
pub trait FrameSource {
    /// Everything but the samples; `n_frames` is the number of frames that follow.
    fn info(&self) -> &MotionInfo;

    /// Fills `row`, one position per marker ([`GAP`] where missing; a lost frame is all gaps). `false` at the end.
    ///
    /// # Errors
    /// Any error of reading the source.
    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool>;

    /// The largest error of a marker, in millimetres, that the source states for the part of the recording around the
    /// last frame; `None` if it states none.
    fn stated_error_mm(&self, _column: usize) -> Option<f64> {
        None
    }

    /// The take that the frames come from, without its samples; `None` for other sources.
    fn take(&self) -> Option<&TakeMap> {
        None
    }

    /// Whether the last frame was damaged in the file, so that its content is unknown.
    fn is_lost(&self) -> bool {
        false
    }

    /// Counts frames whose analog samples, or loads of force plates, were written in addition to the positions, for a
    /// display of progress.
    fn count_sampled(&self, _n_frames: u64) {}
}

impl<F: FrameSource + ?Sized> FrameSource for &mut F {
    fn info(&self) -> &MotionInfo {
        (**self).info()
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        (**self).next_frame(row)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        (**self).stated_error_mm(column)
    }

    fn take(&self) -> Option<&TakeMap> {
        (**self).take()
    }

    fn is_lost(&self) -> bool {
        (**self).is_lost()
    }

    fn count_sampled(&self, n_frames: u64) {
        (**self).count_sampled(n_frames);
    }
}

/// A [`FrameSource`] over trajectories in memory.
#[derive(Debug)]
pub struct MotionFrames<'a> {
    motion: &'a Motion,
    next: usize,
}

impl<'a> MotionFrames<'a> {
    /// Starts at the first frame.
    #[must_use]
    pub fn new(motion: &'a Motion) -> Self {
        Self { motion, next: 0 }
    }
}

impl FrameSource for MotionFrames<'_> {
    fn info(&self) -> &MotionInfo {
        &self.motion.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        if self.next >= self.motion.n_frames() {
            return Ok(false);
        }
        row.copy_from_slice(self.motion.frame(self.next));
        self.next += 1;
        Ok(true)
    }
}

impl From<&Channel> for Marker {
    fn from(channel: &Channel) -> Self {
        Self { label: channel.label.clone(), labelled: channel.labelled }
    }
}

/// The layout of frames in the data section of a C3D file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameLayout {
    /// Points per frame.
    pub points: u64,
    /// Analog samples per frame, over all channels.
    pub analog_per_frame: u64,
    /// Byte offset of the first frame in the file.
    pub data_offset: u64,
    /// Whether samples are 16-bit integers (else floats).
    pub integers: bool,
}

/// An ambiguity of a file, and how it was resolved. Comparing the take with the file cannot reveal a wrong resolution,
/// because it resolves the ambiguity in the same way.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Ambiguity {
    /// No unit of length is stated, or an unknown one; coordinates were read as millimetres.
    Unit {
        /// The unit as written; empty if none is stated.
        stated: String,
        /// The extent of the markers, in the file's unit: the median over frames, or the path length of a single
        /// marker. 0 if it cannot be measured.
        span: f64,
    },
    /// The stated unit of length gives the markers an implausibly small or large extent.
    StatedUnit {
        /// The unit as written.
        stated: String,
        /// The larger of the markers' extent and their distance from the origin, in millimetres.
        span_mm: f64,
    },
    /// Places in the file disagree about the layout of a frame.
    FrameLayout {
        /// What they state.
        stated: String,
        /// The layout that was used.
        taken: FrameLayout,
    },
    /// Every fourth word says "missing" although coordinates exist; they were read as samples.
    FourthWords {
        /// Number of samples concerned.
        samples: u64,
    },
    /// Some fourth words say "missing" although coordinates exist; these are gaps.
    CoordinatesUnderGaps {
        /// Number of samples left out.
        samples: u64,
    },
    /// Samples lie exactly at the origin and are not marked as missing.
    Origin {
        /// Number of samples.
        samples: u64,
        /// Whether they were read as gaps (else as positions).
        gaps: bool,
    },
}

/// Markers with a larger extent, in an unknown unit, are in millimetres: 500 cm are more than a body with its reach,
/// and so are 500 inches or feet. Half a metre is also the smallest marker set larger than a head.
const SPAN_OF_MILLIMETRES: f64 = 500.0;
/// Markers that are all this close to each other and to the origin are not in the stated unit: metres labelled as
/// millimetres are within 10, and a volume for fingers is calibrated with a wand of 50 mm or more.
const STATED_TOO_SMALL_MM: f64 = 25.0;
/// Markers that are this far away are not in the stated unit either: the largest outdoor volumes are about 100 m.
const STATED_TOO_LARGE_MM: f64 = 1e6;
/// Largest tolerance as a fraction of the markers' extent: 1.8 mm for a body of 1.8 m.
const TOLERANCE_OF_SPAN: f64 = 1e-3;

impl Ambiguity {
    /// Whether the unit is doubtful: the extent of the markers is implausible in it.
    #[must_use]
    pub fn is_in_doubt(&self) -> bool {
        match self {
            Self::Unit { span, .. } => *span > 0.0 && *span < SPAN_OF_MILLIMETRES,
            Self::StatedUnit { span_mm, .. } => {
                *span_mm > STATED_TOO_LARGE_MM || (*span_mm > 0.0 && *span_mm < STATED_TOO_SMALL_MM)
            }
            _ => false,
        }
    }

    /// Whether encoding with this tolerance would destroy the samples if the unit were not millimetres.
    #[must_use]
    pub fn is_destroyed_by(&self, tolerance_mm: f64) -> bool {
        let (Self::Unit { span, .. } | Self::StatedUnit { span_mm: span, .. }) = self else {
            return false;
        };
        self.is_in_doubt() && tolerance_mm > TOLERANCE_OF_SPAN * span
    }

    /// The name in JSON documents.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Unit { .. } => "unit",
            Self::StatedUnit { .. } => "stated_unit",
            Self::FrameLayout { .. } => "frame_layout",
            Self::FourthWords { .. } => "fourth_words",
            Self::CoordinatesUnderGaps { .. } => "coordinates_under_gaps",
            Self::Origin { .. } => "origin",
        }
    }
}

impl fmt::Display for Ambiguity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unit { stated, span } => {
                match stated.as_str() {
                    "" => f.write_str("The file states no unit of length")?,
                    unit => write!(f, "The unit of length `{unit}` is unknown")?,
                }
                write!(
                    f,
                    "; positions were read as millimetres; the markers then span {span:.4} mm."
                )
            }
            Self::StatedUnit { stated, span_mm } => write!(
                f,
                "The stated unit of length, `{stated}`, places all markers within {span_mm:.4} mm, which is implausible; \
                 if the unit is another one, give it with --unit."
            ),
            Self::FrameLayout { stated, taken } => {
                let FrameLayout { points, analog_per_frame, data_offset, integers } = taken;
                let kind = if *integers { "integers" } else { "floats" };
                write!(
                    f,
                    "The file contradicts itself about the layout of frames ({stated}); {points} points and {analog_per_frame} \
                     analog samples, {kind} from byte {data_offset} on, fit its size and motion best and were read."
                )
            }
            Self::FourthWords { samples } => write!(
                f,
                "Every sample is marked as missing (negative fourth word), but {samples} have coordinates; those were read as \
                 samples."
            ),
            Self::CoordinatesUnderGaps { samples } => write!(
                f,
                "{} marked as missing (negative fourth word) in spite of coordinates; read as gaps, with the coordinates kept \
                 as c3d/gap-coordinates.",
                samples_are(*samples)
            ),
            Self::Origin { samples, gaps: true } => write!(
                f,
                "{} exactly at the origin while other markers move; read as missing.",
                samples_are(*samples)
            ),
            Self::Origin { samples, gaps: false } => write!(
                f,
                "{} exactly at the origin and not marked as missing; kept as positions.",
                samples_are(*samples)
            ),
        }
    }
}

fn samples_are(n: u64) -> String {
    if n == 1 { "1 sample is".to_owned() } else { format!("{n} samples are") }
}

/// Warnings that an importer collects.
#[derive(Debug, Default)]
pub(crate) struct Notes {
    /// One sentence each.
    pub(crate) warnings: Vec<String>,
    /// Ambiguities; each is also among the warnings.
    pub(crate) ambiguities: Vec<Ambiguity>,
}

impl Notes {
    /// Adds an ambiguity and its warning.
    pub(crate) fn ambiguous(&mut self, ambiguity: Ambiguity) {
        self.warnings.push(ambiguity.to_string());
        self.ambiguities.push(ambiguity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frames_own_time_is_that_frame() {
        // 0.07 * 100 is 7.000000000000001 in binary.
        for (ms, rate_hz, frame) in [
            (0, 120.0, 0),
            (70, 100.0, 7),
            (71, 100.0, 8),
            (1, 59.94, 1),
            (3_600_000, 120.0, 432_000),
        ] {
            assert_eq!(frame_at(Duration::from_millis(ms), rate_hz), frame, "{ms} ms");
        }
        for frame in 0..1000 {
            let time = Duration::from_secs_f64(f64::from(frame) / 59.94);
            assert_eq!(frame_at(time, 59.94), u64::from(frame as u32));
        }
    }
}
