//! The frames of a take from one time to another.

use std::{
    io,
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::ensure;
use mocapd::outcome::UsageError;
use mocapd_take::{
    TakeMap,
    motion::{FrameSource, MotionInfo, Position, frame_at},
};

/// Most lost frames that are written unasked into a file that has fewer others: four hours at 1000 Hz. The
/// few bytes that a loss takes can claim as many frames as fill a disk with gaps.
const LOST_UNASKED_MAX: u64 = 1 << 24;

/// What is left of a source between two times, counted as it is read.
pub(super) struct Part<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    left: u64,
    counter: Arc<AtomicU64>,
}

/// The frames of a take at or after `from` and before `to`; `n_held` of all lie in its stretches.
///
/// # Errors
/// That there are no frames at all; a usage error when there are none between the times, or, without `to`, hours of
/// lost ones and fewer others.
pub(super) fn range(
    info: &MotionInfo,
    n_held: u64,
    from: Option<Duration>,
    to: Option<Duration>,
) -> anyhow::Result<Range<u64>> {
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
    let lost = info.n_frames.saturating_sub(n_held);
    if to.is_none() && lost > LOST_UNASKED_MAX.max(n_held) {
        return Err(UsageError(format!(
            "{lost} of the {} frames hold nothing, and each would be a row of gaps: give a --to, the time up to which to write",
            info.n_frames
        ))
        .into());
    }
    Ok(first..end)
}

impl<'a> Part<'a> {
    /// The frames of a range, of a source that gives the first of them next.
    pub(super) fn new(
        frames: &'a mut dyn FrameSource,
        range: &Range<u64>,
        counter: Arc<AtomicU64>,
    ) -> Self {
        let mut info = frames.info().clone();
        info.cut(range.start, range.end);
        Self { frames, left: info.n_frames, info, counter }
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

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use mocapd_codec::{Settings, Tolerance};
    use mocapd_take::{
        TakeFrames, TakeWriter,
        record::{Header, Ledger},
        stretch::{FrontWriter, Span},
        timeline::Timeline,
    };

    use super::*;

    /// A take of 600 empty rows, and as many behind so many lost ones.
    fn take(lost: u64) -> Vec<u8> {
        let mut header = Header {
            software: String::new(),
            take_id: [0; 16],
            created_unix_ms: 0,
            resampler: String::new(),
            codec_version: 0,
            tolerance_mm: 1.0,
            rate_hz: 60.0,
            up_axis: mocapd_take::motion::UpAxis::Unknown,
            device: None,
            source: None,
            channels: Vec::new(),
            stretch_rows: 600,
            settings: Vec::new(),
        };
        let settings = Settings {
            kind: "dense".parse().unwrap(),
            tolerance: Tolerance::from_mm(1.0).unwrap(),
        };
        header.set_codec(&settings);
        let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
        let mut front = FrontWriter::new(600);
        for (first_row, number) in [(0, 0), (600 + lost, 1)] {
            let span = Span { first_row, n_rows: 600, key: true, number };
            let mut payload = Vec::new();
            front.put(span, &Timeline::default(), &[], true, &mut payload);
            take.stretch(span, &payload).unwrap();
        }
        take.finish(&Ledger::default()).unwrap().0
    }

    #[test]
    fn hours_of_nothing_are_written_when_asked_for() {
        let part = |lost: u64, to_s: Option<u64>| {
            let frames = TakeFrames::open(Cursor::new(take(lost))).unwrap();
            range(
                frames.info(),
                frames.map().n_held.unwrap_or_default(),
                None,
                to_s.map(Duration::from_secs),
            )
            .map(|range| range.end - range.start)
            .map_err(|error| error.to_string())
        };
        assert_eq!(part(LOST_UNASKED_MAX - 1200, None), Ok(LOST_UNASKED_MAX));
        let refused = part(1 << 31, None).unwrap_err();
        assert!(
            refused.starts_with("2147484848 of the 2147484848 frames hold nothing"),
            "{refused}"
        );
        assert_eq!(part(1 << 31, Some(10)), Ok(600));
        assert_eq!(part(1 << 31, Some(1_000_000)), Ok(60_000_000));
    }
}
