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
use mocapd::{outcome::UsageError, units::frame_at};
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
