//! `--from` and `--to`: the frames of a take within a range of time.

use std::{
    io,
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::{bail, ensure};
use mocapd::outcome::UsageError;
use mocapd_take::{
    TakeMap,
    motion::{FrameSource, MotionInfo, Position, frame_at},
};

/// Maximum number of lost frames that are exported without `--to` if the take has fewer recorded ones: four hours at
/// 1000 Hz. A loss takes a few bytes in a take, but may state more frames than the disk can hold as gaps.
const LOST_FRAMES_MAX: u64 = 1 << 24;

/// The next frames of a source, up to the end of a range; counts them as they are read.
pub(super) struct CroppedFrames<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    remaining: u64,
    counter: Arc<AtomicU64>,
}

/// The frames of a take at or after `from` and before `to`; its stretches hold `n_sampled_rows` frames.
///
/// # Errors
/// If the take has no frames; a usage error if none is in the range, or if `to` is missing and lost frames outnumber
/// both the recorded ones and [`LOST_FRAMES_MAX`].
pub(super) fn range(
    info: &MotionInfo,
    n_sampled_rows: u64,
    from: Option<Duration>,
    to: Option<Duration>,
) -> anyhow::Result<Range<u64>> {
    ensure!(info.n_frames > 0, "the take has no frames: nothing to export");
    let first = from.map_or(0, |time| frame_at(time, info.rate_hz));
    let end = to.map_or(info.n_frames, |time| frame_at(time, info.rate_hz)).min(info.n_frames);
    if first >= end {
        let length_s = info.n_frames as f64 / info.rate_hz;
        bail!(UsageError(format!(
            "no frames between --from and --to: the take is {length_s:.3} s long"
        )));
    }
    let lost = info.n_frames.saturating_sub(n_sampled_rows);
    if to.is_none() && lost > LOST_FRAMES_MAX.max(n_sampled_rows) {
        bail!(UsageError(format!(
            "{lost} of the {} frames are empty, and each would be a row of gaps: give --to to limit the export",
            info.n_frames
        )));
    }
    Ok(first..end)
}

impl<'a> CroppedFrames<'a> {
    /// The frames of `range`; the next frame of the source must be the first of them.
    pub(super) fn new(
        frames: &'a mut dyn FrameSource,
        range: &Range<u64>,
        counter: Arc<AtomicU64>,
    ) -> Self {
        let mut info = frames.info().clone();
        info.cut(range.start, range.end);
        Self { frames, remaining: info.n_frames, info, counter }
    }
}

impl FrameSource for CroppedFrames<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.remaining == 0 {
            return Ok(false);
        }
        self.remaining -= 1;
        self.counter.fetch_add(1, Ordering::Relaxed);
        self.frames.next_frame(row)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }

    fn is_lost(&self) -> bool {
        self.frames.is_lost()
    }

    fn count_sampled(&self, n_frames: u64) {
        self.counter.fetch_add(n_frames, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use mocapd_codec::{Settings, Tolerance};
    use mocapd_take::{
        TakeFrames, TakeWriter,
        record::{Header, Ledger},
        statistics::StretchTally,
        stretch::{Span, StretchHeaderWriter},
        timeline::Timeline,
    };

    use super::*;

    /// A take of 600 empty rows, `lost` lost ones, and 600 more empty rows.
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
        let mut front = StretchHeaderWriter::new(600);
        for (first_row, number) in [(0, 0), (600 + lost, 1)] {
            let span = Span { first_row, n_rows: 600, key: true, number };
            let mut payload = Vec::new();
            front.put(span, &Timeline::default(), &[], true, &mut payload);
            take.stretch(span, &payload, &StretchTally::default()).unwrap();
        }
        take.finish(&Ledger::default()).unwrap().0
    }

    #[test]
    fn hours_of_lost_frames_are_exported_only_with_an_end() {
        let part = |lost: u64, to_s: Option<u64>| {
            let frames = TakeFrames::open(Cursor::new(take(lost))).unwrap();
            range(
                frames.info(),
                frames.map().n_sampled_rows.unwrap_or_default(),
                None,
                to_s.map(Duration::from_secs),
            )
            .map(|range| range.end - range.start)
            .map_err(|error| error.to_string())
        };
        assert_eq!(part(LOST_FRAMES_MAX - 1200, None), Ok(LOST_FRAMES_MAX));
        let refused = part(1 << 31, None).unwrap_err();
        assert!(refused.starts_with("2147484848 of the 2147484848 frames are empty"), "{refused}");
        assert_eq!(part(1 << 31, Some(10)), Ok(600));
        assert_eq!(part(1 << 31, Some(1_000_000)), Ok(60_000_000));
    }
}
