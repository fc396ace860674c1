//! Marker trajectories in memory: what importers produce, exporters consume and the simulator replays.

use std::time::Duration;

use crate::{
    map::TakeMap,
    record::{Channel, EventKind, Subject},
};

pub use crate::{
    ambiguity::{Ambiguity, FrameLayout},
    foreign::Foreign,
    up_axis::UpAxis,
};

/// A position in millimetres; a gap is [`GAP`].
pub type Position = [f32; 3];

/// What stands where a marker has no sample. Compare with [`is_gap`]: NaN is not equal to itself.
pub const GAP: Position = [f32::NAN; 3];

/// Whether a position stands for a missing sample.
#[must_use]
pub fn is_gap(position: Position) -> bool {
    position.iter().any(|v| !v.is_finite())
}

/// The first frame at or after `time`, and so the number of frames before it. A time that is a frame's own
/// but for its last digits is that frame's: 0.07 s at 100 Hz are 7.000000000000001 frames in binary.
#[must_use]
pub fn frame_at(time: Duration, rate_hz: f64) -> u64 {
    let frame = time.as_secs_f64() * rate_hz;
    let nearest = frame.round();
    let close = (frame - nearest).abs() <= 1e-9 * frame.max(1.0);
    if close { nearest as u64 } else { frame.ceil() as u64 }
}

/// One marker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Marker {
    /// Its name; for an unlabelled slot `u001`... by column.
    pub label: String,
    /// Whether the name came from the source (false: an unlabelled slot).
    pub labelled: bool,
}

/// Where trajectories came from and what was done to them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Source {
    /// `c3d`, `trc`, `tsv`, `csv`, `generated`, or a driver's name.
    pub format: String,
    /// The unit found there, as written (`mm`, `cm`, `m`); empty when none was stated.
    pub unit: String,
    /// What every coordinate was multiplied by, in f64, to become millimetres.
    pub factor: f64,
    /// Number of the source's first frame (C3D files often do not start at 1).
    pub first_frame: u64,
    /// Frames that the source announces and does not hold: a file that was cut short.
    pub frames_missing: u64,
    /// What was found wrong and how it was read all the same, one sentence each.
    pub warnings: Vec<String>,
    /// What of them can be read in another way.
    pub ambiguities: Vec<Ambiguity>,
}

/// Something that happened beside the motion: a mark, a trigger, a word of the device or the host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MotionEvent {
    /// The frame, counted from 0: the one that was recorded then. One past the last is the end.
    pub frame: u64,
    /// What kind.
    pub kind: EventKind,
    /// In words; may be empty.
    pub text: String,
}

impl MotionEvent {
    /// What to call it: its text, or the word for its kind where it has none.
    #[must_use]
    pub fn label(&self) -> &str {
        if self.text.trim().is_empty() { self.kind.word() } else { &self.text }
    }
}

/// Everything about trajectories but the samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionInfo {
    /// Frames a second.
    pub rate_hz: f64,
    /// Frames in all.
    pub n_frames: u64,
    /// The markers, in column order.
    pub markers: Vec<Marker>,
    /// Which way is up.
    pub up: UpAxis,
    /// Where they came from.
    pub source: Source,
    /// Who was captured, where that is known.
    pub subject: Option<Subject>,
    /// What else was there.
    pub foreign: Vec<Foreign>,
    /// What happened, in the order of the frames.
    pub events: Vec<MotionEvent>,
}

impl MotionInfo {
    /// The markers' labels, in the order of their columns.
    #[must_use]
    pub fn labels(&self) -> Vec<String> {
        self.markers.iter().map(|marker| marker.label.clone()).collect()
    }

    /// Turns this into what is true of the frames `first..end` alone: their number, the number of the first, and
    /// the events among them. What is noticed after the last frame belongs to a part that reaches it.
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
    /// All but the samples.
    pub info: MotionInfo,
    /// `n_frames * markers.len()` positions, [`GAP`] where missing.
    pub positions_mm: Vec<Position>,
}

impl Motion {
    /// One frame: a position a marker.
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

/// Frames one after another: what exporters read, so that a take of any length is exported in bounded memory.
pub trait FrameSource {
    /// All but the samples; `n_frames` is the number of frames that will come.
    fn info(&self) -> &MotionInfo;

    /// Fills `row`, one position a marker ([`GAP`] where missing; a lost frame is all gaps). `false` at the end.
    ///
    /// # Errors
    /// Whatever reading the source meets.
    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool>;

    /// The largest error in millimetres that the source states of a marker, by column, around the frame it gave
    /// last; `None` where it states none.
    fn stated_error_mm(&self, _column: usize) -> Option<f64> {
        None
    }

    /// The take that they are of, without its samples; `None` for frames of anything else.
    fn take(&self) -> Option<&TakeMap> {
        None
    }

    /// Whether the frame it gave last stands for one that was damaged in the file: nobody knows what was in it.
    fn is_lost(&self) -> bool {
        false
    }
}

/// A [`FrameSource`] over trajectories in memory.
#[derive(Debug)]
pub struct MotionFrames<'a> {
    motion: &'a Motion,
    next: usize,
}

impl<'a> MotionFrames<'a> {
    /// From the first frame.
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
