//! Marker trajectories in memory: importers produce them, exporters consume them and the simulator replays them.

use std::time::Duration;

use crate::{
    map::TakeMap,
    record::{Channel, EventKind, Subject},
    sampled::Recording,
};

pub use crate::{
    ambiguity::{Ambiguity, FrameLayout},
    foreign::Foreign,
    up_axis::UpAxis,
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
