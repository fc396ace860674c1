//! The sampled channels of recordings in edited takes: copied as they are where whole groups are kept, encoded again in
//! a part; of poses and residuals, those of the part's rows.

use std::{
    io::{Read, Seek, SeekFrom, Write},
    ops::Range,
};

use mocapd_codec::sampled::SampledEncoder;

use super::{SourceTake, damaged};
use crate::{
    TakeError, TakeMap, TakeTraversal, TakeWriter,
    damage::Problem,
    poses::PosesByRow,
    record::{ClockLine, GroupLedger, SampleLedger, SampledGroup},
    sampled::{GroupSamples, RESIDUAL_GROUPS, SampleAnchor, SampleContent, SampleSpan},
    timeline::{LossCauses, RowTime, Timeline},
    traversal::Decode,
};

/// Most blocks from a key block to the next.
const KEY_BLOCKS: u32 = 8;

/// The longest time by which the ticks of a row may be away from a run of samples that lies where the row does by the
/// host's clock, in seconds: more than batches, queues and fits are.
const APART_S_MAX: f64 = 60.0;

/// The longest time by which the ticks of a row may be behind the last sample of a run without a line that has the row, in
/// seconds: more than a batch.
const BATCH_S_MAX: f64 = 1.0;

/// Writes the descriptions of the groups.
pub(super) fn write_groups<W: Write>(
    map: &TakeMap,
    take: &mut TakeWriter<W>,
) -> Result<(), TakeError> {
    map.sample_groups().try_for_each(|group| take.sampled_group(&group.group))
}

/// Copies all samples and times of a take, and its ledger.
pub(super) fn copy<W: Write>(
    map: &TakeMap,
    input: &mut (impl Read + Seek),
    take: &mut TakeWriter<W>,
) -> Result<(), TakeError> {
    for group in map.sample_groups() {
        copy_group(group, input, take, (0, 0))?;
    }
    map.sample_ledger.iter().try_for_each(|ledger| take.sample_ledger(ledger))
}

/// Copies the samples and times of a group, with numbers of samples and of segments that are higher by these.
fn copy_group<W: Write>(
    group: &GroupSamples,
    input: &mut (impl Read + Seek),
    take: &mut TakeWriter<W>,
    (by, by_segment): (u64, u32),
) -> Result<(), TakeError> {
    let number = group.group.number;
    let mut anchors = group.anchors().iter().peekable();
    let mut block = Vec::new();
    for (span, block_at, block_bytes) in group.stored() {
        while let Some(anchor) = anchors.next_if(|anchor| anchor.number < span.end()) {
            // Both anchors of a block are in one chunk, as a recorder writes them.
            let is_with = |next: &&SampleAnchor| {
                next.number < span.end()
                    && (next.run_start, next.segment) == (anchor.run_start, anchor.segment)
            };
            let later = anchors.next_if(is_with).map(|later| later.moved(by, by_segment));
            let later = later.map(|later| (later.number, later.device_ticks));
            take.sample_time(number, &anchor.moved(by, by_segment), later)?;
        }
        input.seek(SeekFrom::Start(block_at))?;
        block.clear();
        input.by_ref().take(block_bytes).read_to_end(&mut block)?;
        let first = span.first.saturating_add(by);
        take.samples(&SampleSpan { first, ..span }, &block)?;
    }
    anchors.try_for_each(|anchor| take.sample_time(number, &anchor.moved(by, by_segment), None))
}

/// The groups of joined takes: all of them, or those that are not residuals.
fn joined_groups(map: &TakeMap, residuals: bool) -> impl Iterator<Item = &GroupSamples> {
    map.sample_groups().filter(move |samples| residuals || !samples.group.has_residuals())
}

/// Whether the groups of two takes that are not residuals can follow each other.
fn are_alike(one: &TakeMap, other: &TakeMap) -> bool {
    let of = |map| joined_groups(map, false).map(|samples| &samples.group);
    // The header of the first take states the plates of all.
    of(one).eq(of(other)) && one.header.force_plates() == other.header.force_plates()
}

/// Whether the residuals of a take can follow those of the one before it: those of markers that appeared since may be added, as
/// such markers may.
fn residuals_follow(before: &TakeMap, after: &TakeMap) -> bool {
    let of = |map: &TakeMap| -> Vec<SampledGroup> {
        let groups = map.sample_groups().map(|samples| &samples.group);
        groups.filter(|group| group.has_residuals()).cloned().collect()
    };
    let (before, after) = (of(before), of(after));
    before.is_empty() == after.is_empty() && after.starts_with(&before)
}

/// The sampled channels of joined takes.
#[derive(Debug, Default)]
pub(super) struct JoinedSamples {
    /// Whether all takes have the same groups, without those of residuals.
    are_joined: bool,
    /// Whether their residuals follow each other, too.
    has_residuals: bool,
    /// By group of the last take, the number of samples so far: those before it have the first ones of these.
    next: Vec<u64>,
    ledger: Option<SampleLedger>,
}

impl JoinedSamples {
    /// Writes the groups, if all takes have the same; else a phrase says what is left out.
    pub(super) fn begin<W: Write>(
        sources: &[SourceTake],
        take: &mut TakeWriter<W>,
    ) -> Result<(Self, Option<String>), TakeError> {
        let (Some(first), Some(last)) = (sources.first(), sources.last()) else {
            return Ok((Self::default(), None));
        };
        if !sources.iter().all(|source| are_alike(first.map(), source.map())) {
            let what = "the sampled channels, which are not the same in all takes".to_owned();
            return Ok((Self::default(), Some(what)));
        }
        let mut pairs = sources.iter().zip(sources.iter().skip(1));
        let has_residuals = pairs.all(|(one, next)| residuals_follow(one.map(), next.map()));
        let groups = || joined_groups(last.map(), has_residuals);
        groups().try_for_each(|samples| take.sampled_group(&samples.group))?;
        let next = groups().map(|_| 0).collect();
        let left_out = (!has_residuals).then(|| {
            "the residuals of the markers, which are not of the same markers in all takes"
                .to_owned()
        });
        Ok((Self { are_joined: true, has_residuals, next, ledger: None }, left_out))
    }

    /// Appends the samples of a take, the first segment of whose clock has the number `segment` in the new one.
    pub(super) fn add<W: Write>(
        &mut self,
        map: &TakeMap,
        input: &mut (impl Read + Seek),
        segment: u32,
        take: &mut TakeWriter<W>,
    ) -> Result<(), TakeError> {
        if !self.are_joined {
            return Ok(());
        }
        for (group, next) in joined_groups(map, self.has_residuals).zip(&mut self.next) {
            copy_group(group, input, take, (*next, segment))?;
            *next = next.saturating_add(group.n_samples());
        }
        if let Some(mut ledger) = map.sample_ledger.clone() {
            if !self.has_residuals {
                ledger.groups.retain(|group| !RESIDUAL_GROUPS.contains(&group.group));
            }
            match &mut self.ledger {
                Some(sum) => sum.add_counters(&ledger),
                None => self.ledger = Some(ledger),
            }
        }
        Ok(())
    }

    /// Writes the sum of the ledgers.
    pub(super) fn finish<W: Write>(self, take: &mut TakeWriter<W>) -> Result<(), TakeError> {
        self.ledger.iter().try_for_each(|ledger| take.sample_ledger(ledger))
    }
}

/// Writes the samples of the rows `rows` of a take, encoded again, with their times and their ledger: those from the
/// exposure of the first row on, and before that of the row after the last. At the ends of the take, those before its
/// first row and behind its last one belong to it.
pub(super) fn cut<W: Write>(
    source: &SourceTake,
    input: &mut (impl Read + Seek),
    rows: &Range<u64>,
    take: &mut TakeWriter<W>,
) -> Result<(), TakeError> {
    let map = source.map();
    if map.sample_groups().next().is_none() {
        return Ok(());
    }
    let ends = [rows.start, rows.end].map(|row| {
        let is_inside = row > 0 && row < map.n_rows;
        is_inside.then(|| time_of(map, input, row)).transpose()
    });
    let [start, end] = ends;
    let (start, end) = (start?.flatten(), end?.flatten());
    let stated = map.sample_ledger.clone().unwrap_or_default();
    let mut ledger = SampleLedger { finished: true, ..SampleLedger::default() };
    if *rows == (0..map.n_rows) {
        ledger.batches_refused = stated.batches_refused;
        // Groups whose description is lost, as in a recovered take.
        let is_known = |of: u32| map.sample_groups().any(|group| group.group.number == of);
        ledger.groups.extend(stated.groups.iter().filter(|group| !is_known(group.group)).copied());
    }
    let poses = PoseEnds::read(map, input, rows, tick_hz(map))?;
    for group in map.sample_groups() {
        let n = group.n_samples();
        let of_poses = poses.iter().find(|of| of.group == group.group.number);
        let numbers = match of_poses {
            Some(of_poses) => of_poses.numbers.clone(),
            None => {
                let at = |time: Option<RowTime>| time.map_or(n, |time| number_at(map, group, time));
                let first = if rows.start == 0 { 0 } else { at(start) };
                let last = if rows.end < map.n_rows { at(end) } else { n };
                first..last.max(first)
            }
        };
        let exact = of_poses.map_or(&[][..], |of_poses| &of_poses.anchors);
        let part = Part { group, numbers, tick_hz: tick_hz(map), exact };
        let is_of_group = |of: &&GroupLedger| of.group == group.group.number;
        let whole = stated.groups.iter().find(is_of_group).copied().unwrap_or_default();
        // A part has no larger errors than the whole.
        let errors = group.pose_errors(map.sample_ledger.as_ref());
        let of_part = GroupLedger { errors, ..part.write(input, take)? };
        ledger.groups.push(match part.numbers == (0..n) {
            true => GroupLedger { duplicates: whole.duplicates, jumps: whole.jumps, ..of_part },
            false => of_part,
        });
    }
    ledger.groups.sort_by_key(|group| group.group);
    take.sample_ledger(&ledger)
}

fn tick_hz(map: &TakeMap) -> u64 {
    map.header.device.as_ref().map_or(1, |device| device.tick_hz)
}

/// The times of the first recorded row from `row` on.
fn time_of(
    map: &TakeMap,
    input: &mut (impl Read + Seek),
    row: u64,
) -> Result<Option<RowTime>, TakeError> {
    let mut traversal = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
    traversal.seek(row)?;
    while traversal.next_stretch()?.is_some() {
        let times = traversal.timeline().into_iter().flat_map(Timeline::recorded);
        if let Some((_, time)) = times.into_iter().find(|(at, _)| *at >= row) {
            return Ok(Some(time));
        }
    }
    Ok(None)
}

/// The first sample that was not taken before a row, by the device's clock in the run that lies where the row does.
fn number_at(map: &TakeMap, group: &GroupSamples, row: RowTime) -> u64 {
    let (clock, tick_hz) = (group.clock(tick_hz(map)), tick_hz(map) as f64);
    let after_s = |number: u64| {
        let time = clock.at(number)?;
        let ticks = time.device_ticks.wrapping_sub(row.device_ticks).cast_signed() as f64;
        Some((ticks + time.fraction) / tick_hz)
    };
    let last_s = |run: &Range<u64>| {
        // The last samples may have lost their times.
        let anchors = group.anchors();
        let anchor = anchors.partition_point(|anchor| anchor.number < run.end).checked_sub(1);
        let anchor = anchor.and_then(|at| anchors.get(at));
        after_s(run.end.saturating_sub(1)).or_else(|| after_s(anchor?.number))
    };
    let lies_in = |run: &Range<u64>, behind_s: f64| {
        after_s(run.start).is_some_and(|s| s <= 0.0) && last_s(run).is_some_and(|s| s >= -behind_s)
    };
    // A run without a line in CLOCK may have its row only where its ticks do; others are compared by the host's clock, as
    // the device's may have begun again.
    let arrival_ns = row.arrival_10us as f64 * 1e4;
    let mut run = None;
    // The run found so far, if it has a line and the ticks of the row: a run without a line is not preferred to it.
    let mut is_certain = false;
    for found in runs(group) {
        match host_ns(map, group, found.start).map(|ns| ns > arrival_ns) {
            Some(true) => break,
            Some(false) => {
                is_certain = lies_in(&found, BATCH_S_MAX);
                run = Some(found);
            }
            None if is_certain => {}
            None if lies_in(&found, BATCH_S_MAX) => run = Some(found),
            // Behind its last sample, if no run before it may have the row.
            None if run.is_none() && lies_in(&found, APART_S_MAX) => run = Some(found),
            // Before all samples, if it is the first.
            None => run = run.or(Some(found.start..found.start)),
        }
    }
    let Some(run) = run else { return 0 };
    // A row in an outage lies in no run.
    if last_s(&run).is_none_or(|s| s < -APART_S_MAX) {
        return run.end;
    }
    let (mut low, mut high) = (run.start, run.end);
    while low < high {
        let middle = low + (high - low) / 2;
        if after_s(middle).is_some_and(|s| s < 0.0) { low = middle + 1 } else { high = middle }
    }
    low
}

/// The runs of a group: numbers of samples.
fn runs(group: &GroupSamples) -> Vec<Range<u64>> {
    let mut starts: Vec<u64> = group.anchors().iter().map(|anchor| anchor.run_start).collect();
    starts.dedup();
    let ends = starts.iter().skip(1).copied().chain([group.n_samples()]);
    starts.iter().zip(ends).map(|(&start, end)| start..end).collect()
}

/// Host time of a sample in nanoseconds, by the line of its segment of the device's clock.
fn host_ns(map: &TakeMap, group: &GroupSamples, number: u64) -> Option<f64> {
    let time = group.clock(tick_hz(map)).at(number)?;
    let (_, line) = map.clock_lines.iter().find(|(segment, _)| *segment == time.segment)?;
    let ClockLine { device_ticks, host_ns, drift_ppb, .. } = *line;
    let ticks = time.device_ticks.wrapping_sub(device_ticks).cast_signed() as f64;
    let ns = ticks * 1e9 / tick_hz(map) as f64;
    Some(host_ns as f64 + ns + ns * drift_ppb as f64 * 1e-9)
}

/// Samples of a group that become a group of a new take.
struct Part<'a> {
    group: &'a GroupSamples,
    numbers: Range<u64>,
    tick_hz: u64,
    /// Times of its samples that are exactly those of recorded rows.
    exact: &'a [SampleAnchor],
}

impl Part<'_> {
    fn write<W: Write>(
        &self,
        input: &mut (impl Read + Seek),
        take: &mut TakeWriter<W>,
    ) -> Result<GroupLedger, TakeError> {
        let number = self.group.group.number;
        for anchor in self.anchors() {
            take.sample_time(number, &anchor, None)?;
        }
        let lost = self.group.lost();
        let causes_at = |first: u64| {
            let found = lost.iter().find(|lost| (lost.first..lost.first + lost.n).contains(&first));
            found.and_then(|lost| lost.causes).unwrap_or(LossCauses::DAMAGED)
        };
        let mut encoder = SampledEncoder::new();
        let (mut since_key, mut needs_key) = (0, true);
        let mut ledger = GroupLedger { group: number, ..GroupLedger::default() };
        let mut outcome = Ok(());
        let undecodable = self.group.read(input, |first, n, decoded| {
            let kept = first.max(self.numbers.start)..(first + n).min(self.numbers.end);
            if kept.start >= kept.end || outcome.is_err() {
                return Ok(());
            }
            let (at, n_kept) = (kept.start - self.numbers.start, kept.end - kept.start);
            let mut block = Vec::new();
            let content = match decoded {
                None => SampleContent::Lost(causes_at(kept.start)),
                Some(samples) => {
                    let here = (kept.start - first) as usize..(kept.end - first) as usize;
                    let columns = samples.chunks_exact(n as usize);
                    let columns: Vec<&[f32]> =
                        columns.filter_map(|column| column.get(here.clone())).collect();
                    let is_key = needs_key || since_key + 1 >= KEY_BLOCKS;
                    since_key = if is_key { 0 } else { since_key + 1 };
                    outcome = encoder.encode(&columns, is_key, &mut block).map_err(Into::into);
                    if is_key { SampleContent::Key } else { SampleContent::Continued }
                }
            };
            needs_key = decoded.is_none();
            let span = SampleSpan { group: number, first: at, n: n_kept, content };
            if outcome.is_ok() {
                outcome = take.samples(&span, &block);
            }
            ledger.count(content, n_kept);
            Ok(())
        })?;
        if let Some(found) = undecodable.first() {
            return Err(damaged(&Problem::of_samples(&self.group.group.kind, found)));
        }
        outcome.map(|()| ledger)
    }

    /// The anchors in the part, and the times of its ends, which lie on the lines that they lay on.
    fn anchors(&self) -> Vec<SampleAnchor> {
        let Range { start, end } = self.numbers;
        let clock = self.group.clock(self.tick_hz);
        let at = |number: u64| {
            let time = clock.at(number)?;
            let device_ticks = time.device_ticks.wrapping_add(u64::from(time.fraction >= 0.5));
            let (run_start, segment) = (time.run_start, time.segment);
            Some(SampleAnchor { number, run_start, device_ticks, segment })
        };
        let inside = self.group.anchors().iter().copied();
        let mut anchors: Vec<SampleAnchor> =
            inside.filter(|anchor| (start..end).contains(&anchor.number)).collect();
        // The last sample of each run, too: the line of the whole run may lead elsewhere without what is left out.
        let ends = runs(self.group).into_iter().map(|run| run.end).chain([end]);
        let last = ends.filter(|run_end| *run_end > start && *run_end <= end).map(|e| e - 1);
        anchors.extend(self.exact);
        // A row that was not recorded has no time of its own, and a pose none but that of its row.
        let is_timed = |number: &u64| {
            let run_of = |number: u64| clock.at(number).map(|time| time.run_start);
            let of_run = |run| self.exact.binary_search_by_key(&run, |exact| exact.run_start);
            run_of(*number).is_none_or(|run| of_run(run).is_err())
        };
        let ends = [start].into_iter().filter(|_| start < end).chain(last);
        anchors.extend(ends.filter(is_timed).filter_map(at));
        anchors.sort_by_key(|anchor| anchor.number);
        anchors.dedup_by_key(|anchor| anchor.number);
        for anchor in &mut anchors {
            anchor.number -= start;
            anchor.run_start = anchor.run_start.saturating_sub(start);
        }
        anchors
    }
}

/// Which poses or residuals of a group are in a part, and times of theirs.
pub(super) struct PoseEnds {
    /// Number of the group.
    pub group: u32,
    /// The samples.
    pub numbers: Range<u64>,
    /// Of the samples of each run that are in rows one after another the first and the last one whose row was recorded, with
    /// the time of this row.
    pub anchors: Vec<SampleAnchor>,
    /// The rows of the last anchors, and the number of the sample in the first of them.
    rows: Range<u64>,
    first: u64,
    /// Whether the last anchor is the first of those rows.
    is_first: bool,
}

impl PoseEnds {
    /// Those of all groups of poses and of residuals. At the ends of the take, samples before its first row and behind its
    /// last one belong to the part.
    pub(super) fn read(
        map: &TakeMap,
        input: &mut (impl Read + Seek),
        rows: &Range<u64>,
        tick_hz: u64,
    ) -> Result<Vec<Self>, TakeError> {
        let Some(by_row) = PosesByRow::with_residuals(&mut *input, map)? else {
            return Ok(Vec::new());
        };
        let mut all: Vec<Self> = Vec::new();
        for (index, group) in by_row.groups().enumerate() {
            let n = group.n_samples();
            let at = |row: u64| by_row.number_at(index, row).unwrap_or(n);
            let first = if rows.start == 0 { 0 } else { at(rows.start) };
            let last = if rows.end < map.n_rows { at(rows.end) } else { n };
            all.push(Self {
                group: group.group.number,
                numbers: first..last.max(first),
                anchors: Vec::new(),
                rows: 0..0,
                first: 0,
                is_first: false,
            });
        }
        let mut stretches = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        stretches.seek(rows.start)?;
        while stretches.next_stretch()?.is_some_and(|span| span.first_row < rows.end) {
            let times = stretches.timeline().into_iter().flat_map(Timeline::recorded);
            for (row, time) in times.filter(|(row, _)| rows.contains(row)) {
                for (index, ends) in all.iter_mut().enumerate() {
                    ends.add(&by_row, index, (row, time.device_ticks), tick_hz);
                }
            }
        }
        Ok(all)
    }

    /// Adds a recorded row and its time.
    fn add(&mut self, by_row: &PosesByRow, index: usize, (row, ticks): (u64, u64), tick_hz: u64) {
        if self.rows.contains(&row) {
            let number = self.first + (row - self.rows.start);
            if let Some(&last) = self.anchors.last().filter(|_| self.numbers.contains(&number)) {
                if !std::mem::take(&mut self.is_first) {
                    self.anchors.pop();
                }
                self.anchors.push(SampleAnchor { number, device_ticks: ticks, ..last });
            }
            return;
        }
        let Some((numbers, rows)) = by_row.piece_at(index, row) else { return };
        let number = numbers.start + (row - rows.start);
        let Some(group) = by_row.groups().nth(index) else { return };
        let time = group.clock(tick_hz).at(number).filter(|_| self.numbers.contains(&number));
        let Some(time) = time else { return };
        let (run_start, segment) = (time.run_start, time.segment);
        self.anchors.push(SampleAnchor { number, run_start, device_ticks: ticks, segment });
        (self.rows, self.first, self.is_first) = (rows, numbers.start, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        TakeEvent,
        record::{Clock, Device, Header, SampledChannel, SampledGroup},
        sampled::{SampleTimes, SamplesChunk},
    };

    /// A group at 100 Hz by a clock of 1000 Hz: by run the number of its samples, its first ticks, and the host time at 0
    /// ticks in seconds if its segment has a line.
    fn take_of(runs: &[(u64, u64, Option<u64>)]) -> TakeMap {
        let device = Some(Device { tick_hz: 1000, ..Device::default() });
        let mut map =
            TakeMap { header: Header { device, ..Header::default() }, ..TakeMap::default() };
        let channels = vec![SampledChannel::default()];
        let group = SampledGroup { rate_hz: 100.0, channels, ..SampledGroup::default() };
        map.add_content(TakeEvent::SampledGroup(Box::new(group)), 0, 0);
        let mut first = 0;
        for (segment, &(n, device_ticks, host_s)) in (0..).zip(runs) {
            let anchors =
                vec![SampleAnchor { number: first, run_start: first, device_ticks, segment }];
            map.add_content(TakeEvent::SampleTimes(SampleTimes { group: 0, anchors }), 0, 0);
            let mut payload = Vec::new();
            SampleSpan { group: 0, first, n, content: SampleContent::Key }.put(&mut payload);
            payload.push(0);
            let chunk = SamplesChunk::from_payload(&payload, 0, 0).unwrap();
            map.add_content(TakeEvent::Samples(chunk), 0, 0);
            if let Some(host_s) = host_s {
                let host_ns = host_s * 1_000_000_000;
                let line = Some(ClockLine { host_ns, ..ClockLine::default() });
                let clock = Clock { segment, line, ..Clock::default() };
                map.add_content(TakeEvent::Clock(Box::new(clock)), 0, 0);
            }
            first += n;
        }
        map
    }

    #[test]
    fn a_run_without_a_line_has_a_row_only_where_its_ticks_are() {
        // 35 s; power lost, half a second; and once more, ten seconds.
        let map = take_of(&[(3500, 5000, Some(100)), (50, 0, None), (1000, 0, Some(150))]);
        let group = map.sample_groups().next().unwrap();
        let at = |device_ticks, host_s: u64| {
            let arrival_10us = host_s * 100_000;
            number_at(&map, group, RowTime { device_ticks, arrival_10us, timecode: None })
        };
        assert_eq!(
            at(30_000, 130),
            2500,
            "in the first run, though behind all ticks of the second"
        );
        assert_eq!(at(300, 145), 3530, "in the run without a line");
        assert_eq!(at(4000, 154), 3950, "in the last run");
        assert_eq!(at(5000, 105), 0);
    }
}
