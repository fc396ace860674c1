//! The poses of a take by row: which row each pose belongs to, and the poses of any rows of all bodies.
//!
//! `docs/poses.md` has the rule, under "Poses and rows". Everything that puts poses beside frames reads them from here.

use std::{
    cmp::Reverse,
    collections::BTreeMap,
    io::{Read, Seek},
    ops::Range,
};

use mocapd_codec::poses::POSE_CHANNELS;

use super::{Pose, PoseReader, PoseState};
use crate::{
    TakeError, TakeMap,
    sampled::{GroupReader, GroupSamples, RowClock, RowPiece, SampleAnchor, epochs_of},
};

/// Most rows with the time of an anchor that are remembered, in 96 MiB: a recorder writes two anchors in half a second, so
/// these are those of twelve days. The rows of later poses count on from these.
const ANCHORED_ROWS_MAX: usize = 1 << 22;

/// Rows beyond these are in no take: no recorder numbers as many, and sums with numbers of samples must not overflow.
const ROW_MAX: i64 = 1 << 53;

/// Most epochs of the clock in which rows with the time of an anchor are counted: a clock that begins again at equal times
/// does so a few times, and a few bytes can claim that it always does.
const EPOCHS_COUNTED: usize = 16;

/// Most anchors of a run whose rows are looked for where the clock stands all the time: a few minutes tell which they are.
const ANCHORS_COUNTED: usize = 1 << 10;

/// A rigid body of a take.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseBody {
    /// The driver's number of the body.
    pub number: u32,
    /// Its name, which may be empty or that of another one, too.
    pub name: String,
}

/// A recorded row that has the time of an anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct AnchoredRow {
    ticks: u64,
    epoch: usize,
    row: u64,
}

/// The rows of a take that have the times of anchors, in order of their ticks, and the clock of all rows.
struct RowTimes {
    anchored: Vec<AnchoredRow>,
    clock: RowClock,
    tick_hz: u64,
}

impl RowTimes {
    fn read(
        input: impl Read + Seek,
        map: &TakeMap,
        groups: &[GroupSamples],
    ) -> Result<Self, TakeError> {
        let anchors = groups.iter().flat_map(GroupSamples::anchors);
        let mut wanted: Vec<u64> = anchors.map(|anchor| anchor.device_ticks).collect();
        wanted.sort_unstable();
        wanted.dedup();
        let mut anchored = Vec::new();
        let clock = RowClock::read_each(input, map, |epoch, row, ticks| {
            if wanted.binary_search(&ticks).is_ok() && anchored.len() < ANCHORED_ROWS_MAX {
                anchored.push(AnchoredRow { ticks, epoch, row });
            }
        })?;
        anchored.sort_unstable();
        let tick_hz = map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1));
        Ok(Self { anchored, clock, tick_hz })
    }

    /// The rows that have the time of an anchor, from an epoch on: one in each epoch at most.
    fn rows_from(&self, anchor: &SampleAnchor, epoch: usize) -> impl Iterator<Item = &AnchoredRow> {
        let ticks = anchor.device_ticks;
        let is_before = |found: &AnchoredRow| (found.ticks, found.epoch) < (ticks, epoch);
        let from = self.anchored.partition_point(is_before);
        let rest = self.anchored.get(from..).unwrap_or_default().iter();
        rest.take_while(move |found| found.ticks == ticks)
    }

    /// The row that has the time of an anchor in an epoch.
    fn row_in(&self, anchor: &SampleAnchor, epoch: usize) -> Option<u64> {
        self.rows_from(anchor, epoch).next().filter(|found| found.epoch == epoch).map(|of| of.row)
    }

    /// The epoch of a run, not before the epoch `from`: `nearest`, which the places of the blocks in the file tell, unless
    /// another one has rows with more than twice as many of its times. A clock may count alike before and after it began
    /// again, and rows are lost in either.
    fn epoch_of(&self, run: &[SampleAnchor], nearest: Option<usize>, from: usize) -> Option<usize> {
        let mut counts: Vec<(usize, u64)> = Vec::new();
        let of_nearest = nearest.filter(|nearest| *nearest >= from).map_or(0, |nearest| {
            run.iter().filter(|anchor| self.row_in(anchor, nearest).is_some()).count() as u64
        });
        for anchor in run {
            for found in self.rows_from(anchor, from).take(EPOCHS_COUNTED) {
                match counts.iter().position(|(epoch, _)| *epoch == found.epoch) {
                    Some(at) => counts[at].1 += 1,
                    None if counts.len() < EPOCHS_COUNTED => counts.push((found.epoch, 1)),
                    None => {}
                }
            }
        }
        let most = counts.iter().map(|(_, n)| *n).max().unwrap_or(0);
        if nearest.is_some_and(|nearest| nearest >= from) && 2 * of_nearest >= most {
            return nearest;
        }
        counts.iter().find(|(_, n)| *n == most).map(|(epoch, _)| *epoch)
    }

    /// The row of an anchor where those of its run have times at which the clock stood, so that several rows have them: of
    /// the rows near `known`, which is one of them, the one that leads to rows with the times of most other anchors.
    fn most_likely<'a>(
        &self,
        run: &'a [SampleAnchor],
        from: usize,
        known: (&'a SampleAnchor, i64),
    ) -> (&'a SampleAnchor, i64) {
        // Numbers count rows, so that both are apart by the same for all anchors.
        let apart = |anchor: &SampleAnchor, row: i64| {
            let number = i64::try_from(anchor.number).ok().filter(|number| *number <= ROW_MAX)?;
            Some(row - number)
        };
        let Some(of_known) = apart(known.0, known.1) else { return known };
        let mut counts: BTreeMap<i64, (u64, &SampleAnchor)> = BTreeMap::new();
        for anchor in run.iter().take(ANCHORS_COUNTED) {
            let rows = self.rows_from(anchor, from).take(EPOCHS_COUNTED);
            let rows = rows.filter_map(|found| apart(anchor, i64::try_from(found.row).ok()?));
            for by in rows.filter(|by| by.abs_diff(of_known) <= EPOCHS_COUNTED as u64) {
                counts.entry(by).or_insert((0, anchor)).0 += 1;
            }
        }
        let most =
            counts.into_iter().max_by_key(|(by, (n, _))| (*n, Reverse(by.abs_diff(of_known))));
        most.map_or(known, |(by, (_, anchor))| (anchor, anchor.number.cast_signed() + by))
    }

    /// The samples of a group whose rows are in the take.
    fn pieces(&self, samples: &GroupSamples, n_rows: u64) -> Vec<RowPiece> {
        let nearest = epochs_of(samples, &self.clock, self.tick_hz);
        let nearest_of = |start: u64| {
            let found = nearest.binary_search_by_key(&start, |(start, _)| *start).ok();
            found.and_then(|at| nearest.get(at)?.1)
        };
        let (mut pieces, mut from): (Vec<RowPiece>, usize) = (Vec::new(), 0);
        let mut runs = samples.anchors().chunk_by(|a, b| a.run_start == b.run_start).peekable();
        while let Some(run) = runs.next() {
            let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
            let next = runs.peek().and_then(|next| next.first()).map(|next| next.run_start);
            // Behind its last anchor a run goes on to the end of the block.
            let block = samples.block_of(last.number);
            let end = block.map_or(last.number + 1, |block| block.end);
            let end = next.map_or(end, |next| next.min(end));
            let nearest = nearest_of(first.run_start);
            let Some(epoch) = self.epoch_of(run, nearest, from) else { continue };
            self.add_run(samples, (run, end), (from, epoch), &mut pieces);
            from = epoch;
        }
        in_order(pieces, n_rows)
    }

    /// Adds the pieces of a run of an epoch, not before the epoch `from`, up to the sample `end`: in each, numbers count rows from an anchor on.
    fn add_run(
        &self,
        samples: &GroupSamples,
        (run, end): (&[SampleAnchor], u64),
        (from, epoch): (usize, usize),
        pieces: &mut Vec<RowPiece>,
    ) {
        let exact = run.iter().filter_map(|anchor| {
            let row = self.row_in(anchor, epoch)?;
            Some((anchor, i64::try_from(row).ok().filter(|row| *row <= ROW_MAX)?))
        });
        let mut known: Vec<(&SampleAnchor, i64)> = exact.collect();
        let is_doubtful =
            |(anchor, _): &(&SampleAnchor, i64)| self.clock.stands_at(epoch, anchor.device_ticks);
        match known.first() {
            Some(first) if known.iter().all(is_doubtful) => {
                known = vec![self.most_likely(run, from, *first)];
            }
            _ => known.retain(|found| !is_doubtful(found)),
        }
        let is_exact = !known.is_empty();
        if !is_exact {
            let clock = samples.clock(self.tick_hz);
            known.extend(run.iter().find_map(|anchor| {
                let at = self.clock.position(epoch, &clock.at(anchor.number)?)?;
                Some((anchor, (at.round() as i64).clamp(-ROW_MAX, ROW_MAX)))
            }));
        }
        let mut start = run.first().map_or(end, |first| first.run_start);
        let of_others = pieces.len();
        let ends = known.iter().skip(1).map(|(anchor, _)| anchor.number).chain([end]);
        for ((anchor, row), end) in known.iter().zip(ends) {
            let row_of_start = row - (anchor.number as i64 - start as i64);
            // Those before the first row belong to no row.
            let before = row_of_start.min(0).unsigned_abs().min(end.saturating_sub(start));
            let (numbers, first_row) = (start + before..end, row_of_start.max(0).cast_unsigned());
            start = end.max(start);
            match pieces.get_mut(of_others..).and_then(<[RowPiece]>::last_mut) {
                Some(last) if last.numbers.end == numbers.start && last.end_row() == first_row => {
                    last.numbers.end = numbers.end;
                }
                _ if numbers.is_empty() => {}
                _ => pieces.push(RowPiece { numbers, first_row, is_exact }),
            }
        }
    }
}

/// Pieces whose rows ascend, and are in the take: of two that have the same rows the exact one keeps them, else the first.
fn in_order(pieces: Vec<RowPiece>, n_rows: u64) -> Vec<RowPiece> {
    let mut kept: Vec<RowPiece> = Vec::with_capacity(pieces.len());
    for mut piece in pieces {
        piece.end_before(n_rows);
        if piece.is_exact && !piece.is_empty() {
            while let Some(last) = kept.last_mut().filter(|last| !last.is_exact) {
                last.end_before(piece.first_row);
                if !last.is_empty() {
                    break;
                }
                kept.pop();
            }
        }
        piece.begin_at(kept.last().map_or(0, RowPiece::end_row));
        if !piece.is_empty() {
            kept.push(piece);
        }
    }
    kept
}

/// The samples of groups that have one in each row, and their rows.
///
/// # Errors
/// Those of [`RowClock::read`].
pub(crate) fn rows_of(
    input: impl Read + Seek,
    map: &TakeMap,
    groups: &[GroupSamples],
) -> Result<Vec<Vec<RowPiece>>, TakeError> {
    let times = RowTimes::read(input, map, groups)?;
    Ok(groups.iter().map(|samples| times.pieces(samples, map.n_rows)).collect())
}

#[derive(Debug, Clone)]
struct GroupByRow {
    samples: GroupSamples,
    /// In ascending order of numbers and rows.
    pieces: Vec<RowPiece>,
}

/// Where the poses of a take are among its rows: an index that is read once and then serves any rows.
#[derive(Debug, Clone)]
pub struct PosesByRow {
    groups: Vec<GroupByRow>,
    bodies: Vec<PoseBody>,
    n_rows: u64,
}

impl PosesByRow {
    /// Reads the times of a take's rows, whose file `input` reads; `None` if it has no poses. No pose is decoded.
    ///
    /// # Errors
    /// Those of [`RowClock::read`].
    pub fn read(input: impl Read + Seek, map: &TakeMap) -> Result<Option<Self>, TakeError> {
        Self::read_groups(input, map, |samples| samples.group.has_poses())
    }

    /// The same with the groups of residuals, which have a sample in each row, too, but no bodies.
    pub(crate) fn with_residuals(
        input: impl Read + Seek,
        map: &TakeMap,
    ) -> Result<Option<Self>, TakeError> {
        Self::read_groups(input, map, |samples| {
            samples.group.has_poses() || samples.group.has_residuals()
        })
    }

    fn read_groups(
        input: impl Read + Seek,
        map: &TakeMap,
        is_wanted: impl Fn(&GroupSamples) -> bool,
    ) -> Result<Option<Self>, TakeError> {
        let groups: Vec<GroupSamples> =
            map.sample_groups().filter(|samples| is_wanted(samples)).cloned().collect();
        if groups.is_empty() {
            return Ok(None);
        }
        let times = RowTimes::read(input, map, &groups)?;
        let bodies = groups.iter().flat_map(|samples| samples.group.numbered_bodies());
        let bodies = bodies.map(|(number, name)| PoseBody { number, name: name.to_owned() });
        let bodies = bodies.collect();
        let groups = groups.into_iter().map(|samples| {
            let pieces = times.pieces(&samples, map.n_rows);
            GroupByRow { samples, pieces }
        });
        Ok(Some(Self { groups: groups.collect(), bodies, n_rows: map.n_rows }))
    }

    /// The bodies, in the order of the take's groups and their channels.
    #[must_use]
    pub fn bodies(&self) -> &[PoseBody] {
        &self.bodies
    }

    /// Number of rows of the take.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.n_rows
    }

    /// The groups of poses.
    pub fn groups(&self) -> impl Iterator<Item = &GroupSamples> {
        self.groups.iter().map(|group| &group.samples)
    }

    /// Entries that it holds in memory.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        let of_group = |group: &GroupByRow| {
            group.pieces.len() + 2 * group.samples.anchors().len() + group.samples.n_chunks()
        };
        self.groups.iter().map(of_group).sum()
    }

    /// The samples of a run of a group, by the group's place among those of poses, that belong to rows one after another of
    /// which `row` is one, and these rows; `None` if no sample belongs to it, or it is only the nearest one.
    pub(crate) fn piece_at(&self, group: usize, row: u64) -> Option<(Range<u64>, Range<u64>)> {
        let pieces = &self.groups.get(group)?.pieces;
        let at = pieces.partition_point(|piece| piece.end_row() <= row);
        let piece = pieces.get(at).filter(|piece| piece.first_row <= row && piece.is_exact)?;
        Some((piece.numbers.clone(), piece.first_row..piece.end_row()))
    }

    /// The first sample of a group that belongs to this row or to one after it; `None` behind the last one.
    #[must_use]
    pub fn number_at(&self, group: usize, row: u64) -> Option<u64> {
        let pieces = &self.groups.get(group)?.pieces;
        let at = pieces.partition_point(|piece| piece.end_row() <= row);
        let piece = pieces.get(at)?;
        Some(piece.numbers.start + row.saturating_sub(piece.first_row))
    }

    /// The poses of these rows, in order. Decoding begins at the last key blocks before them, at most a few seconds.
    #[must_use]
    pub fn rows(&self, rows: Range<u64>) -> RowPoses<'_> {
        let rows = rows.start.min(self.n_rows)..rows.end.min(self.n_rows);
        let groups = self.groups.iter().map(|group| GroupCursor::new(group, rows.start));
        RowPoses { groups: groups.collect(), n_bodies: self.bodies.len(), rows }
    }
}

/// A group that is read row by row.
struct GroupCursor<'a> {
    pieces: &'a [RowPiece],
    poses: PoseReader,
    n_bodies: usize,
    reader: GroupReader<'a>,
    /// The samples of the block that was decoded last, and where they are in it: channel after channel.
    numbers: Range<u64>,
    /// Empty if they are lost.
    samples: Vec<f32>,
    is_at_end: bool,
}

impl<'a> GroupCursor<'a> {
    fn new(group: &'a GroupByRow, row: u64) -> Self {
        let at = group.pieces.partition_point(|piece| piece.end_row() <= row);
        let pieces = group.pieces.get(at..).unwrap_or_default();
        let of_piece = |piece: &RowPiece| piece.numbers.start + row.saturating_sub(piece.first_row);
        Self {
            reader: group.samples.reader_from(pieces.first().map_or(0, of_piece)),
            poses: PoseReader::new(&group.samples.group),
            n_bodies: group.samples.group.bodies().count(),
            is_at_end: pieces.is_empty(),
            pieces,
            numbers: 0..0,
            samples: Vec::new(),
        }
    }

    /// Decodes up to the block that has a sample, or to the first one behind it.
    fn load(&mut self, input: &mut (impl Read + Seek), number: u64) -> Result<(), TakeError> {
        while !self.is_at_end && self.numbers.end <= number {
            self.samples.clear();
            match self.reader.next(input)? {
                None => self.is_at_end = true,
                Some((span, samples)) => {
                    self.samples.extend_from_slice(samples.unwrap_or_default());
                    self.numbers = span.first..span.end();
                }
            }
        }
        Ok(())
    }

    /// Puts the poses of these rows where `each` says: it receives the row, and the poses of the group's bodies.
    fn read(
        &mut self,
        input: &mut (impl Read + Seek),
        rows: &Range<u64>,
        mut each: impl FnMut(u64, &[Pose]),
    ) -> Result<(), TakeError> {
        let mut of_row = vec![Pose::without(PoseState::Missing); self.n_bodies];
        while let Some(piece) = self.pieces.first().filter(|piece| piece.first_row < rows.end) {
            let mut wanted = piece.clone();
            wanted.begin_at(rows.start);
            wanted.end_before(rows.end);
            while !wanted.is_empty() && !self.is_at_end {
                self.load(input, wanted.numbers.start)?;
                let inside = wanted.numbers.end.min(self.numbers.end);
                for number in wanted.numbers.start.max(self.numbers.start)..inside {
                    if self.poses_of(number, &mut of_row) {
                        let row = wanted.first_row + (number - wanted.numbers.start);
                        each(row, &of_row);
                    }
                }
                wanted.begin_at(wanted.first_row + inside.saturating_sub(wanted.numbers.start));
            }
            if piece.end_row() > rows.end {
                break;
            }
            self.pieces = self.pieces.get(1..).unwrap_or_default();
        }
        Ok(())
    }

    /// The poses of a sample in the block that was decoded last; `false` if they are lost.
    fn poses_of(&self, number: u64, poses: &mut [Pose]) -> bool {
        let n = (self.numbers.end - self.numbers.start) as usize;
        let at = (number - self.numbers.start) as usize;
        for (body, pose) in poses.iter_mut().enumerate() {
            let mut numbers = [0.0; POSE_CHANNELS];
            for (channel, stored) in numbers.iter_mut().enumerate() {
                let found = self.samples.get((body * POSE_CHANNELS + channel) * n + at);
                let Some(&found) = found else { return false };
                *stored = found;
            }
            *pose = self.poses.pose(&numbers);
        }
        true
    }
}

/// The poses of some rows, one range after another.
pub struct RowPoses<'a> {
    groups: Vec<GroupCursor<'a>>,
    n_bodies: usize,
    /// Those that were not returned yet.
    rows: Range<u64>,
}

impl std::fmt::Debug for RowPoses<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RowPoses").field("rows", &self.rows).finish_non_exhaustive()
    }
}

impl RowPoses<'_> {
    /// Rows of 128 bodies that fill 1.2 MB.
    pub const ROWS_AT_ONCE: u64 = 256;

    /// Replaces `poses` by those of the next rows, at most `n`: row after row, and in each all bodies in order. Returns the
    /// rows; `None` at the end. [`PoseState::Missing`] is the state in rows for which the take has none.
    ///
    /// # Errors
    /// `Io`.
    pub fn next(
        &mut self,
        input: &mut (impl Read + Seek),
        n: u64,
        poses: &mut Vec<Pose>,
    ) -> Result<Option<Range<u64>>, TakeError> {
        poses.clear();
        let rows = self.rows.start..self.rows.end.min(self.rows.start.saturating_add(n));
        if rows.is_empty() {
            return Ok(None);
        }
        self.rows.start = rows.end;
        let n_bodies = self.n_bodies;
        let n_poses = (rows.end - rows.start) as usize * n_bodies;
        poses.resize(n_poses, Pose::without(PoseState::Missing));
        let mut first = 0;
        for group in &mut self.groups {
            group.read(input, &rows, |row, of_row| {
                let at = (row - rows.start) as usize * n_bodies + first;
                if let Some(place) = poses.get_mut(at..at + of_row.len()) {
                    place.copy_from_slice(of_row);
                }
            })?;
            first += group.n_bodies;
        }
        Ok(Some(rows))
    }
}
