//! The frames of a take from one time to another.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::ensure;
use mocapd::outcome::UsageError;
use mocapd_take::motion::{FrameSource, GAP, MotionInfo, Position};

/// What is left of a source between two times, counted as it is read.
pub(super) struct Part<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    left: u64,
    counter: Arc<AtomicU64>,
}

impl<'a> Part<'a> {
    /// The frames at or after `from` and before `to`.
    ///
    /// # Errors
    /// That there are no frames at all; a usage error when there are none between the times; whatever
    /// reading the source meets.
    pub(super) fn new(
        frames: &'a mut dyn FrameSource,
        from: Option<Duration>,
        to: Option<Duration>,
        counter: Arc<AtomicU64>,
    ) -> anyhow::Result<Self> {
        let mut info = frames.info().clone();
        ensure!(info.n_frames > 0, "the take holds no frames: there is nothing to export");
        let first = from.map_or(0, |time| frame_at(time, info.rate_hz));
        let end = to.map_or(info.n_frames, |time| frame_at(time, info.rate_hz)).min(info.n_frames);
        if first >= end {
            let length_s = info.n_frames as f64 / info.rate_hz;
            return Err(UsageError(format!(
                "no frames there: the take is {length_s:.3} s long, so give a --from below that and a --to above it"
            ))
            .into());
        }
        let mut row = vec![GAP; info.markers.len()];
        for _ in 0..first {
            frames.next_frame(&mut row)?;
        }
        info.source.first_frame += first;
        info.n_frames = end - first;
        Ok(Self { frames, left: info.n_frames, info, counter })
    }
}

/// The first frame at or after a time. A time that is a frame's own but for its last digits is that frame's.
fn frame_at(time: Duration, rate_hz: f64) -> u64 {
    let frame = time.as_secs_f64() * rate_hz;
    let nearest = frame.round();
    let close = (frame - nearest).abs() <= 1e-9 * frame.max(1.0);
    if close { nearest as u64 } else { frame.ceil() as u64 }
}

impl FrameSource for Part<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.left == 0 {
            return Ok(false);
        }
        self.left -= 1;
        self.counter.fetch_add(1, Ordering::Relaxed);
        self.frames.next_frame(row)
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
