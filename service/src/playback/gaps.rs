//! Where samples are missing, for a time axis: counts in bins of equal length.

use std::{
    io::{self, Read, Seek},
    ops::Range,
};

use mocapd_take::{
    TakeError, TakeMap, TakeTraversal, stretch::Span, timeline::Timeline, traversal::Decode,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{GAPS_SAMPLES_MAX, window::frame_at};

/// Maximum number of bins of a take: about one per pixel of a time axis.
pub const BINS: u64 = 1024;

/// Missing samples and lost frames of a part of a take.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct GapBins {
    /// The first frame of the part.
    pub first_frame: u64,
    /// One past its last frame: the next request begins here, unless it is the end of the take.
    pub end_frame: u64,
    /// Number of frames in the whole take.
    pub frames: u64,
    /// Number of frames in a bin. Bin 0 begins at the first frame of the take.
    pub bin_frames: u64,
    /// The bin that `first_frame` belongs to; the counts begin with it.
    pub first_bin: u64,
    /// By bin, the number of samples that are missing in frames of the part that are not lost.
    pub missing_samples: Vec<u64>,
    /// By bin, the number of frames of the part that are lost: on the link, in the device, in the host, or to damage.
    pub lost_frames: Vec<u64>,
    /// Whether anything damaged was found in the part.
    pub is_damaged: bool,
}

/// Counts what is missing from a time in seconds on, in as many frames as one call may decode. Lost frames, which are not
/// decoded, do not count among these.
///
/// # Errors
/// Those of the reader. Nothing is counted from the end of the take on.
pub fn read_gaps(
    input: &mut (impl Read + Seek),
    map: &TakeMap,
    from_s: f64,
) -> Result<GapBins, TakeError> {
    let n_markers = map.channels.len() as u64;
    let rows = frame_at(from_s, map.header.rate_hz).min(map.n_rows)..map.n_rows;
    let bin_frames = map.n_rows.div_ceil(BINS).max(1);
    let first_bin = rows.start / bin_frames;
    let n_bins = (rows.end.div_ceil(bin_frames) - first_bin) as usize;
    let mut bins = GapBins {
        first_frame: rows.start,
        end_frame: rows.end,
        frames: map.n_rows,
        bin_frames,
        first_bin,
        missing_samples: vec![0; n_bins],
        lost_frames: vec![0; n_bins],
        is_damaged: map.damaged,
    };
    if rows.is_empty() {
        return Ok(bins);
    }
    let mut take = TakeTraversal::from_map(input, map, Decode::All)?;
    let (mut next_row, mut decoded) = (rows.start, 0);
    let read = take.read_rows(&rows, |take, part, offset| {
        // Rows in no stretch.
        bins.lose(next_row..part.start);
        bins.add_stretch(take, part.clone(), offset, n_markers);
        next_row = part.end;
        decoded += (part.end - part.start).saturating_mul(n_markers.max(1));
        if decoded < GAPS_SAMPLES_MAX { Ok(()) } else { Err(enough()) }
    });
    if decoded >= GAPS_SAMPLES_MAX {
        bins.end_at(next_row);
    } else {
        read?;
        bins.lose(next_row..rows.end);
    }
    bins.is_damaged |= !take.is_intact();
    Ok(bins)
}

/// Ends a traversal that has decoded as much as one call may.
fn enough() -> TakeError {
    io::Error::from(io::ErrorKind::Interrupted).into()
}

/// The frames of a take that are lost, as ranges in order. Nothing is decoded.
///
/// # Errors
/// Those of the reader.
pub fn lost_runs(input: &mut (impl Read + Seek)) -> Result<Vec<Range<u64>>, TakeError> {
    let map = TakeMap::open(input)?;
    let mut take = TakeTraversal::from_map(input, &map, Decode::Groups(Vec::new()))?;
    let mut runs: Vec<Range<u64>> = Vec::new();
    let mut add = |run: Range<u64>| match runs.last_mut() {
        Some(last) if last.end >= run.start => last.end = last.end.max(run.end),
        _ if run.start < run.end => runs.push(run),
        _ => {}
    };
    let mut next_row = 0;
    while let Some(span) = take.next_stretch()? {
        if span.n_rows > 0 {
            add(next_row..span.first_row);
            lost_rows(take.timeline(), span).into_iter().for_each(&mut add);
            next_row = span.end_row();
        }
    }
    add(next_row..map.n_rows);
    Ok(runs)
}

impl GapBins {
    /// Bins for so many frames, in which nothing is missing yet.
    #[must_use]
    pub fn new(frames: u64) -> Self {
        let bin_frames = frames.div_ceil(BINS).max(1);
        let n_bins = frames.div_ceil(bin_frames) as usize;
        Self {
            end_frame: frames,
            frames,
            bin_frames,
            missing_samples: vec![0; n_bins],
            lost_frames: vec![0; n_bins],
            ..Self::default()
        }
    }

    /// Counts a frame in which so many samples are missing, or that is lost.
    pub fn add_frame(&mut self, frame: u64, missing: u64, is_lost: bool) {
        let bin = (frame / self.bin_frames.max(1)) as usize;
        let (bins, n) =
            if is_lost { (&mut self.lost_frames, 1) } else { (&mut self.missing_samples, missing) };
        if let Some(count) = bins.get_mut(bin) {
            *count += n;
        }
    }

    /// Ends the part at a frame.
    fn end_at(&mut self, frame: u64) {
        self.end_frame = frame;
        let n_bins = (frame.div_ceil(self.bin_frames) - self.first_bin) as usize;
        self.missing_samples.truncate(n_bins);
        self.lost_frames.truncate(n_bins);
    }

    /// Counts frames as lost.
    fn lose(&mut self, rows: Range<u64>) {
        add(&mut self.lost_frames, self.first_bin, self.bin_frames, rows);
    }

    /// Counts the rows `part` of the last stretch; the first of them has the index `offset` in it.
    fn add_stretch<R: Read + Seek>(
        &mut self,
        take: &TakeTraversal<R>,
        part: Range<u64>,
        offset: usize,
        n_markers: u64,
    ) {
        let n_rows = (part.end - part.start) as usize;
        let mut present = vec![0_u64; n_rows];
        for rows in take.rows().flatten() {
            let found = rows.present.iter().skip(offset);
            present.iter_mut().zip(found).for_each(|(n, &found)| *n += u64::from(found));
        }
        let span = Span {
            first_row: part.start - offset as u64,
            n_rows: u32::try_from(offset + n_rows).unwrap_or(u32::MAX),
            key: false,
            number: 0,
        };
        let lost = lost_rows(take.timeline(), span);
        let mut lost = lost.iter().peekable();
        for (row, n) in (part.start..).zip(present) {
            while lost.next_if(|run| run.end <= row).is_some() {}
            let bin = (row / self.bin_frames - self.first_bin) as usize;
            if lost.peek().is_some_and(|run| run.contains(&row)) {
                self.lost_frames[bin] += 1;
            } else {
                self.missing_samples[bin] += n_markers.saturating_sub(n);
            }
        }
    }
}

/// Adds each of the rows to its bin.
fn add(bins: &mut [u64], first_bin: u64, bin_frames: u64, mut rows: Range<u64>) {
    while rows.start < rows.end {
        let bin = rows.start / bin_frames;
        let end = rows.end.min((bin + 1) * bin_frames);
        if let Some(n) = bins.get_mut((bin - first_bin) as usize) {
            *n += end - rows.start;
        }
        rows.start = end;
    }
}

/// The runs of lost rows that a time line states within the rows of its stretch.
fn lost_rows(timeline: Option<&Timeline>, span: Span) -> Vec<Range<u64>> {
    let mut lost = Vec::new();
    let Some(timeline) = timeline else { return lost };
    let mut at = timeline.first_row;
    for run in &timeline.runs {
        let end = at.saturating_add(run.rows);
        if run.lost.is_some() && end > span.first_row {
            lost.push(at..end);
        }
        at = end;
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_counted_in_their_bins() {
        let mut bins = [0; 4];
        add(&mut bins, 2, 10, 25..47);
        assert_eq!(bins, [5, 10, 7, 0]);
        add(&mut bins, 2, 10, 59..59);
        add(&mut bins, 2, 10, 59..60);
        assert_eq!(bins, [5, 10, 7, 1]);
    }
}
