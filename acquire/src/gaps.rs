//! The gaps of a take, one by one, with their causes.

use std::{
    io::{Read, Seek, SeekFrom},
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use mocapd_codec::DecodedRows;
use mocapd_take::{
    TakeError, TakeEvent, TakeMap, TakeTraversal,
    motion::{FrameSource, GAP, is_gap},
    stretch::Span,
    timeline::{LossCauses, Timeline},
    traversal::Decode,
};

/// Why rows have no sample of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GapCause {
    /// The frame was recorded without a position of the marker; in an import, the file has none.
    Occluded,
    /// The marker appeared later.
    NotAnnounced,
    /// The frame never arrived: it was lost on the link, or dropped by the device.
    LostOnLink,
    /// The frame arrived while a ring was full.
    LostInHost,
    /// The device was disconnected.
    Disconnected,
    /// The frame was recorded, but is damaged in this file, or was in the one that this take was recovered from.
    Damaged,
}

impl GapCause {
    /// All causes.
    pub const ALL: [Self; 6] = [
        Self::Occluded,
        Self::NotAnnounced,
        Self::LostOnLink,
        Self::LostInHost,
        Self::Disconnected,
        Self::Damaged,
    ];

    /// A name for people and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Occluded => "occluded",
            Self::NotAnnounced => "not announced",
            Self::LostOnLink => "lost on link",
            Self::LostInHost => "lost in host",
            Self::Disconnected => "disconnected",
            Self::Damaged => "damaged",
        }
    }
}

/// A set of causes: a gap may begin with an occlusion and continue with lost frames, and a run of lost frames may have
/// several causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GapCauses(u8);

impl GapCauses {
    /// Whether the cause is in the set.
    #[must_use]
    pub fn contains(self, cause: GapCause) -> bool {
        self.0 >> cause as u8 & 1 == 1
    }

    /// The causes, in the order of [`GapCause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = GapCause> {
        GapCause::ALL.into_iter().filter(move |&cause| self.contains(cause))
    }

    fn add(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// The causes that the time line states for lost rows.
    fn of_loss(causes: LossCauses) -> Self {
        let pairs = [
            (LossCauses::NOT_RECEIVED, GapCause::LostOnLink),
            (LossCauses::RING_FULL, GapCause::LostInHost),
            (LossCauses::DISCONNECTED, GapCause::Disconnected),
            (LossCauses::DAMAGED, GapCause::Damaged),
        ];
        let mut found = Self::default();
        for (loss, cause) in pairs {
            if causes.contains(loss) {
                found.add(cause.into());
            }
        }
        // A cause of a later version: the row has no sample, and more is not known.
        if found == Self::default() { GapCause::LostInHost.into() } else { found }
    }
}

impl From<GapCause> for GapCauses {
    fn from(cause: GapCause) -> Self {
        Self(1 << cause as u8)
    }
}

/// Consecutive rows without a sample of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// The marker's column.
    pub column: usize,
    /// The first row, from 0.
    pub first_row: u64,
    /// Number of rows, at least 1.
    pub rows: u64,
    /// Why the samples are missing.
    pub causes: GapCauses,
}

/// The gaps of one marker.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MarkerGaps {
    /// Rows with a sample.
    pub samples: u64,
    /// Number of gaps, including those at the ends.
    pub gaps: u64,
    /// Rows in gaps.
    pub rows: u64,
    /// The longest gap, the first one of that length.
    pub longest: Option<Gap>,
    /// Rows in gaps by cause, in the order of [`GapCause::ALL`]; a row with two causes counts for both.
    pub rows_by_cause: [u64; GapCause::ALL.len()],
}

/// The gaps of a take.
#[derive(Debug, Default)]
pub struct GapSummary {
    /// The take without its samples, with all problems found.
    pub take: TakeMap,
    /// By column.
    pub markers: Vec<MarkerGaps>,
}

/// A take whose gaps can be read.
#[derive(Debug)]
pub struct GapReader<R> {
    input: R,
    take: TakeMap,
    /// By column, the row from which on the marker is announced.
    announced_at: Vec<u64>,
}

impl<R: Read + Seek> GapReader<R> {
    /// Reads the take once, without decoding it, for its channel table.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(mut input: R) -> Result<Self, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        let mut announced_at = Vec::new();
        let mut n_rows = 0;
        let undecoded = TakeTraversal::new(&mut input, Decode::Groups(Vec::new()));
        let progress = undecoded.run(|found, progress| {
            if let Some(lost) = found.lost_entries {
                let at = lost.first.min(announced_at.len());
                announced_at.splice(at..at, std::iter::repeat_n(n_rows, lost.inserted));
            }
            // The header announces from the first row on, further entries from the next one.
            let is_header = matches!(found.event, TakeEvent::Header(_));
            let from = if is_header { 0 } else { n_rows };
            announced_at.resize(progress.channels().len(), from);
            n_rows = progress.n_rows();
            Ok(())
        })?;
        announced_at.resize(progress.take.channels.len(), 0);
        Ok(Self { input, take: progress.take, announced_at })
    }

    /// The take without its samples.
    #[must_use]
    pub fn take(&self) -> &TakeMap {
        &self.take
    }

    /// Decodes the take and passes each gap to `each`, in the order of the rows in which they end, by column within a
    /// row. Stores the number of rows read so far in `counter`.
    ///
    /// # Errors
    /// `Unsupported`, `Io`, and any error of `each`.
    pub fn read(
        self,
        counter: &AtomicU64,
        each: impl FnMut(&Gap) -> Result<(), TakeError>,
    ) -> Result<GapSummary, TakeError> {
        let Self { mut input, mut take, announced_at } = self;
        let mut tracker = GapTracker::new(announced_at, each);
        let mut stretches = TakeTraversal::from_map(&mut input, &take, Decode::All)?;
        while let Some(span) = stretches.next_stretch()? {
            let rows: Vec<_> = stretches.rows().collect();
            tracker.add_stretch(span, stretches.timeline(), &rows)?;
            counter.store(tracker.next_row, Ordering::Relaxed);
        }
        take.problems.extend(stretches.take_problems());
        let markers = tracker.finish(take.n_rows)?;
        Ok(GapSummary { take, markers })
    }
}

/// Rows of a source that are passed on together: their flags take 64 kB for 64 markers.
const BLOCK_ROWS: usize = 1024;

/// Passes each gap of frames from a source other than a take to `each`, in the order of [`GapReader::read`]. `take`
/// describes them; a sample that is missing counts as occluded. Stores the number of rows read so far in `counter`.
///
/// # Errors
/// `Io`, and any error of `each`.
pub fn gaps_of_frames(
    frames: &mut dyn FrameSource,
    mut take: TakeMap,
    counter: &AtomicU64,
    each: impl FnMut(&Gap) -> Result<(), TakeError>,
) -> Result<GapSummary, TakeError> {
    let n_markers = frames.info().markers.len();
    let mut tracker = GapTracker::new(vec![0; n_markers], each);
    let mut row = vec![GAP; n_markers];
    let mut block = vec![DecodedRows::default(); n_markers];
    loop {
        block.iter_mut().for_each(|rows| rows.present.clear());
        let mut n_rows = 0;
        while n_rows < BLOCK_ROWS && frames.next_frame(&mut row)? {
            for (rows, at) in block.iter_mut().zip(&row) {
                rows.present.push(!is_gap(*at));
            }
            n_rows += 1;
        }
        if n_rows == 0 {
            break;
        }
        let span =
            Span { first_row: tracker.next_row, n_rows: n_rows as u32, key: true, number: 0 };
        tracker.add_stretch(span, None, &block.iter().map(Some).collect::<Vec<_>>())?;
        counter.store(tracker.next_row, Ordering::Relaxed);
    }
    take.n_rows = tracker.next_row;
    let markers = tracker.finish(take.n_rows)?;
    Ok(GapSummary { take, markers })
}

/// Follows the gaps of all markers from row to row.
struct GapTracker<F> {
    channels: Vec<ChannelState>,
    next_row: u64,
    /// Gaps that ended in the current stretch.
    ended: Vec<Gap>,
    each: F,
}

struct ChannelState {
    /// The row from which on the marker is announced.
    announced_at: u64,
    open: Option<(u64, GapCauses)>,
    found: MarkerGaps,
}

impl<F: FnMut(&Gap) -> Result<(), TakeError>> GapTracker<F> {
    fn new(announced_at: Vec<u64>, each: F) -> Self {
        let channel =
            |announced_at| ChannelState { announced_at, open: None, found: MarkerGaps::default() };
        let channels = announced_at.into_iter().map(channel).collect();
        Self { channels, next_row: 0, ended: Vec::new(), each }
    }

    /// Adds the rows of a stretch, those that its time line states as lost, and those before it that no stretch has.
    fn add_stretch(
        &mut self,
        span: Span,
        timeline: Option<&Timeline>,
        rows: &[Option<&DecodedRows>],
    ) -> Result<(), TakeError> {
        let from = timeline.map_or(span.first_row, |timeline| timeline.first_row);
        self.lose_to(from, GapCause::Damaged.into());
        let mut runs: Vec<(Range<u64>, Option<GapCauses>)> = Vec::new();
        let mut at = from;
        for run in timeline.iter().flat_map(|timeline| &timeline.runs) {
            let end = at.saturating_add(run.rows);
            runs.push((at..end, run.lost.map(GapCauses::of_loss)));
            at = end;
        }
        if timeline.is_none() {
            runs.push((span.first_row..span.end_row(), None));
            at = span.end_row();
        }
        let rows = rows.iter().copied().chain(std::iter::repeat(None));
        for (column, (channel, rows)) in self.channels.iter_mut().zip(rows).enumerate() {
            let rows = rows.filter(|rows| rows.has_samples());
            for (run, lost) in &runs {
                let run = run.start.max(self.next_row)..run.end;
                match (lost, rows) {
                    (Some(causes), _) => channel.lose(run, *causes),
                    (None, None) => channel.lose(run, GapCause::Occluded.into()),
                    (None, Some(rows)) => {
                        channel.add_recorded(
                            run,
                            span,
                            &rows.present,
                            |first_row, rows, causes| {
                                self.ended.push(Gap { column, first_row, rows, causes });
                            },
                        );
                    }
                }
            }
        }
        self.next_row = self.next_row.max(at);
        self.report_ended()
    }

    /// Counts the rows up to `end` as missing in every channel.
    fn lose_to(&mut self, end: u64, causes: GapCauses) {
        for channel in &mut self.channels {
            channel.lose(self.next_row..end, causes);
        }
        self.next_row = self.next_row.max(end);
    }

    fn report_ended(&mut self) -> Result<(), TakeError> {
        self.ended.sort_by_key(|gap| (gap.first_row + gap.rows, gap.column));
        for gap in self.ended.drain(..) {
            if let Some(channel) = self.channels.get_mut(gap.column) {
                let found = &mut channel.found;
                found.gaps += 1;
                found.rows += gap.rows;
                if found.longest.is_none_or(|longest| longest.rows < gap.rows) {
                    found.longest = Some(gap);
                }
            }
            (self.each)(&gap)?;
        }
        Ok(())
    }

    /// Ends the take at `n_rows`.
    fn finish(mut self, n_rows: u64) -> Result<Vec<MarkerGaps>, TakeError> {
        self.lose_to(n_rows, GapCause::Damaged.into());
        let end = self.next_row;
        for (column, channel) in self.channels.iter_mut().enumerate() {
            if let Some((first_row, causes)) = channel.open.take() {
                self.ended.push(Gap { column, first_row, rows: end - first_row, causes });
            }
        }
        self.report_ended()?;
        Ok(self.channels.into_iter().map(|channel| channel.found).collect())
    }
}

impl ChannelState {
    /// Adds rows without a sample.
    fn lose(&mut self, rows: Range<u64>, causes: GapCauses) {
        let announced = self.announced_at.clamp(rows.start, rows.end.max(rows.start));
        for (part, causes) in
            [(rows.start..announced, GapCause::NotAnnounced.into()), (announced..rows.end, causes)]
        {
            let n = part.end.saturating_sub(part.start);
            if n == 0 {
                continue;
            }
            self.open.get_or_insert((part.start, GapCauses::default())).1.add(causes);
            for cause in causes.iter() {
                if let Some(rows) = self.found.rows_by_cause.get_mut(cause as usize) {
                    *rows += n;
                }
            }
        }
    }

    /// Adds recorded rows of a stretch; `present` states for each row of the stretch whether it has a sample. Passes the
    /// first row, the number of rows and the causes of gaps that end to `ended`.
    fn add_recorded(
        &mut self,
        rows: Range<u64>,
        span: Span,
        present: &[bool],
        mut ended: impl FnMut(u64, u64, GapCauses),
    ) {
        for row in rows {
            let is_present = row
                .checked_sub(span.first_row)
                .and_then(|i| present.get(usize::try_from(i).ok()?))
                .is_some_and(|&present| present);
            if !is_present {
                self.lose(row..row + 1, GapCause::Occluded.into());
                continue;
            }
            self.found.samples += 1;
            if let Some((first_row, causes)) = self.open.take() {
                ended(first_row, row - first_row, causes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_take::timeline::RowRun;

    use super::*;

    fn rows(present: &str) -> DecodedRows {
        let present = present.bytes().map(|b| b == b'x').collect();
        {
            let mut rows = DecodedRows::default();
            rows.present = present;
            rows
        }
    }

    fn span(first_row: u64, n_rows: u32) -> Span {
        Span { first_row, n_rows, key: true, number: 0 }
    }

    fn causes(all: &[GapCause]) -> GapCauses {
        let mut set = GapCauses::default();
        all.iter().for_each(|&cause| set.add(cause.into()));
        set
    }

    #[test]
    fn each_gap_has_its_rows_and_causes() {
        use GapCause::{Damaged, LostInHost, LostOnLink, NotAnnounced, Occluded};
        let mut gaps = Vec::new();
        let mut tracker = GapTracker::new(vec![0, 5], |gap: &Gap| {
            gaps.push(*gap);
            Ok(())
        });
        // Rows 0 to 9 of an import's stretch; the second marker is announced with row 5.
        let (a, b) = (rows("xx..xxxxx."), rows(".......xxx"));
        tracker.add_stretch(span(0, 10), None, &[Some(&a), Some(&b)]).unwrap();
        // Rows 10 and 11 are in no stretch. Rows 12 and 13 are lost, and so is row 15 within the stretch 14 to 17.
        let timeline = Timeline {
            first_row: 12,
            runs: vec![
                RowRun { rows: 2, lost: Some(LossCauses::NOT_RECEIVED) },
                RowRun { rows: 1, lost: None },
                RowRun { rows: 1, lost: Some(LossCauses::RING_FULL) },
                RowRun { rows: 2, lost: None },
            ],
            times: Vec::new(),
        };
        let a = rows("x.xx");
        tracker.add_stretch(span(14, 4), Some(&timeline), &[Some(&a), None]).unwrap();
        // The take ends with a lost row.
        let markers = tracker.finish(19).unwrap();
        let gap = |column, first_row, rows, all: &[GapCause]| Gap {
            column,
            first_row,
            rows,
            causes: causes(all),
        };
        assert_eq!(
            gaps,
            [
                gap(0, 2, 2, &[Occluded]),
                gap(1, 0, 7, &[NotAnnounced, Occluded]),
                gap(0, 9, 5, &[Occluded, Damaged, LostOnLink]),
                gap(0, 15, 1, &[LostInHost]),
                gap(0, 18, 1, &[Damaged]),
                gap(1, 10, 9, &[Damaged, LostOnLink, Occluded, LostInHost]),
            ]
        );
        assert_eq!((markers[0].samples, markers[0].gaps, markers[0].rows), (10, 4, 9));
        assert_eq!(markers[0].longest, Some(gap(0, 9, 5, &[Occluded, Damaged, LostOnLink])));
        assert_eq!(markers[0].rows_by_cause, [3, 0, 2, 1, 0, 3]);
        assert_eq!(markers[1].rows_by_cause, [2 + 3, 5, 2, 1, 0, 3]);
        assert_eq!(markers[1].rows + markers[1].samples, 19);
    }

    #[test]
    fn a_take_without_samples_is_one_gap_of_each_marker() {
        let mut n = 0;
        let mut tracker = GapTracker::new(vec![0, 0], |gap: &Gap| {
            assert_eq!((gap.first_row, gap.rows), (0, 7));
            n += 1;
            Ok(())
        });
        tracker.add_stretch(span(0, 7), None, &[]).unwrap();
        let markers = tracker.finish(7).unwrap();
        assert_eq!((n, markers[1].gaps, markers[1].rows_by_cause[0]), (2, 1, 7));
        assert!(GapTracker::new(vec![0], |_: &Gap| Ok(())).finish(0).unwrap()[0].longest.is_none());
    }
}
