//! Compares a recording with the log of a simulated device: whether it has everything that arrived, and states the rest as
//! lost.
//!
//! A log has a row for each frame, or for each batch of samples, with its number and the device's time when it was taken.
//! A take has the times of its rows, and of some samples of each block. A time that both have tells how far the numbers of
//! the take are from those of the log; they stay as far apart until the device starts to count anew, unless something that
//! was sent is neither in the take nor stated as lost.

use std::{
    collections::BTreeMap,
    io::{BufRead, Read, Seek},
    ops::Range,
};

use serde::Serialize;

use super::times::{RowOutcome, RowOutcomes};
use crate::{TakeError, TakeMap, sampled::GroupSamples};

/// The first columns of a log of frames and of one of batches: `mocapd-sim serve --log` and `--batch-log`.
const FRAMES: [&str; 7] =
    ["run", "seq", "device_ticks", "present", "dropped", "host_ns", "unasked"];
const BATCHES: [&str; 9] =
    ["run", "group", "number", "first", "first_in_run", "n", "device_ticks", "dropped", "host_ns"];

/// The columns after them, if the device had faults; the last one counts frames or batches.
const FATES: [&str; 3] = ["fate", "again", "faults"];

/// The group that poses have in logs. Takes have them in groups from this number on.
const POSES: u32 = 16;

/// Largest number in a log: sums of two of them do not overflow.
const NUMBER_MAX: u64 = 1 << 53;

/// Most bytes of a line of a log.
const LINE_MAX: u64 = 4096;

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// The file is no log.
    #[error(
        "it does not begin as a log of frames or of batches does: give the file of mocapd-sim serve --log or --batch-log"
    )]
    NotALog,
    /// A line has another form than the first one says.
    #[error("line {line} is no row of the log: {why}")]
    BadRow {
        /// Its number, from 1.
        line: u64,
        /// What was expected.
        why: String,
    },
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// What became of something that was sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SentFate {
    Arrived,
    Dropped,
    Lost,
}

/// A frame, a batch of samples, or the poses of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SentRow {
    /// Number of its first sample; that of a frame is its own.
    first: u64,
    n: u64,
    device_ticks: u64,
    fate: SentFate,
    /// How often the device had begun to count anew.
    epoch: u32,
}

/// The log of a simulated device.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SentLog {
    is_of_frames: bool,
    /// By group, the frames alone in 0; in the order in which they were sent.
    series: BTreeMap<u32, Vec<SentRow>>,
}

impl SentLog {
    /// Whether a file that begins with these bytes is a log.
    #[must_use]
    pub fn is_one(begin: &[u8]) -> bool {
        let line = begin.split(|&byte| byte == b'\n').next().unwrap_or_default();
        std::str::from_utf8(line).is_ok_and(|line| {
            let columns: Vec<&str> = line.trim_end().split(',').collect();
            columns.starts_with(&FRAMES) || columns.starts_with(&BATCHES)
        })
    }

    /// Whether it is one of frames; else it is one of batches and poses.
    #[must_use]
    pub fn is_of_frames(&self) -> bool {
        self.is_of_frames
    }

    /// Reads a log. An incomplete last line, of a simulator that was ended, is left out.
    ///
    /// # Errors
    /// `NotALog`, `BadRow` and `Io`.
    pub fn read(mut input: impl BufRead) -> Result<Self, LogError> {
        let mut text = Vec::new();
        let mut next_line = |text: &mut Vec<u8>| {
            text.clear();
            input.by_ref().take(LINE_MAX).read_until(b'\n', text)
        };
        next_line(&mut text)?;
        if !Self::is_one(&text) {
            return Err(LogError::NotALog);
        }
        let head = String::from_utf8_lossy(&text).trim_end().to_owned();
        let columns: Vec<&str> = head.split(',').collect();
        let is_of_frames = columns.starts_with(&FRAMES);
        let own = if is_of_frames { FRAMES.len() } else { BATCHES.len() };
        let has_fates = columns.get(own..own + FATES.len()) == Some(&FATES[..]);
        let mut log = Self { is_of_frames, ..Self::default() };
        let mut line = 1;
        while next_line(&mut text)? > 0 && text.ends_with(b"\n") {
            line += 1;
            let bad = |why: &str| LogError::BadRow { line, why: why.to_owned() };
            let row = std::str::from_utf8(&text).map_err(|_| bad("it is no text"))?;
            let cells: Vec<&str> = row.trim_end().split(',').collect();
            if cells.len() != columns.len() {
                return Err(bad(&format!("expected {} cells", columns.len())));
            }
            let cells = LogCells { cells, own: has_fates.then_some(own) };
            let (group, row) = cells.row(is_of_frames).map_err(|why| bad(&why))?;
            log.push(group, row);
        }
        if text.len() as u64 >= LINE_MAX {
            let why = format!("it has more than {LINE_MAX} bytes");
            return Err(LogError::BadRow { line: line + 1, why });
        }
        Ok(log)
    }

    fn push(&mut self, group: u32, mut row: SentRow) {
        let rows = self.series.entry(group).or_default();
        if let Some(last) = rows.last() {
            row.epoch = last.epoch + u32::from(row.first < last.first);
        }
        rows.push(row);
    }
}

/// The cells of a line, and after how many of them those of the fate follow.
struct LogCells<'a> {
    cells: Vec<&'a str>,
    own: Option<usize>,
}

impl LogCells<'_> {
    fn number(&self, column: usize) -> Result<u64, String> {
        let cell = self.cells.get(column).copied().unwrap_or_default();
        let number = cell.parse::<u64>().map_err(|_| format!("'{cell}' is no number"))?;
        if number > NUMBER_MAX { Err(format!("{number} is too large")) } else { Ok(number) }
    }

    fn row(&self, is_of_frames: bool) -> Result<(u32, SentRow), String> {
        let [first, n, ticks, dropped] = if is_of_frames { [1, 1, 2, 4] } else { [3, 5, 6, 7] };
        let group = if is_of_frames { 0 } else { self.number(1)? };
        let fate = match self.own.and_then(|own| self.cells.get(own)).copied() {
            None if self.number(dropped)? == 0 => SentFate::Arrived,
            None | Some("dropped") => SentFate::Dropped,
            Some("whole") => SentFate::Arrived,
            Some("late" | "unasked" | "damaged" | "lost" | "discarded" | "waiting") => {
                SentFate::Lost
            }
            Some(other) => return Err(format!("'{other}' is no fate")),
        };
        let together = self.own.map_or(Ok(1), |own| self.number(own + FATES.len()))?;
        let n = if is_of_frames { 1 } else { self.number(n)? };
        let n = n.saturating_mul(together).min(NUMBER_MAX);
        let row = SentRow {
            first: self.number(first)?,
            n,
            device_ticks: self.number(ticks)?,
            fate,
            epoch: 0,
        };
        Ok((u32::try_from(group).map_err(|_| "the group is too large".to_owned())?, row))
    }
}

/// How a recording accounts for what a device sent: frames, the samples of each channel of a group, or poses of all
/// bodies of a group in a frame.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct SentAccount {
    /// The number of the take's group; `None` for frames.
    pub group: Option<u32>,
    /// Sent from the first one that the take has to the last one.
    pub sent: u64,
    /// Of these, in the take.
    pub recorded: u64,
    /// Of these, those that never left the device.
    pub dropped: u64,
    /// Of these, those that did not arrive, or not in order and unchanged.
    pub lost: u64,
    /// Of these, those that arrived, or may have, and that the take does not have.
    pub arrived_lost: u64,
    /// Sent before the first one that the take has, or after the last one.
    pub outside: u64,
    /// In the take, but not sent, or sent and not arrived.
    pub unknown: u64,
    /// Neither in the take nor stated as lost: numbers that the take passes over.
    pub unaccounted: u64,
    /// Times in the take that the log does not have.
    pub times_unknown: u64,
    /// Times that both have.
    #[serde(skip)]
    times_known: u64,
}

impl SentAccount {
    /// Whether the take has nothing that was not sent, and states the rest as lost.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.unknown == 0 && self.unaccounted == 0 && self.times_unknown == 0
    }
}

/// How a recording accounts for what a device sent.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct SentComparison {
    /// The frames, or each group of the take that the log has.
    pub accounts: Vec<SentAccount>,
    /// Groups that only the take or the log has.
    pub groups_missing: Vec<u32>,
}

impl SentComparison {
    /// Whether the take has times, but none that the log has: of another recording, or of a system without a clock.
    #[must_use]
    pub fn is_of_another(&self) -> bool {
        self.accounts.iter().any(|account| account.times_unknown > 0)
            && self.accounts.iter().all(|account| account.times_known == 0)
    }

    /// Whether everything is accounted for.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.groups_missing.is_empty() && self.accounts.iter().all(SentAccount::is_complete)
    }
}

/// Compares a recording with the log of the device.
///
/// # Errors
/// Those of reading the take.
pub fn compare_log(
    map: &TakeMap,
    input: impl Read + Seek,
    log: &SentLog,
) -> Result<SentComparison, TakeError> {
    let mut found = SentComparison::default();
    if log.is_of_frames {
        let sent = log.series.get(&0).map_or(&[][..], Vec::as_slice);
        found.accounts.push(StoredSeries::of_rows(map, input)?.account(None, sent));
        return Ok(found);
    }
    // The log of frames has the residuals.
    for group in map.sample_groups().filter(|group| !group.group.has_residuals()) {
        let number = group.group.number;
        let of_log = if group.group.has_poses() { POSES } else { number };
        match log.series.get(&of_log) {
            Some(sent) => {
                found.accounts.push(StoredSeries::of_group(group).account(Some(number), sent));
            }
            None => found.groups_missing.push(number),
        }
    }
    let is_in_take = |number: u32| {
        map.sample_groups().any(|group| {
            if number == POSES { group.group.has_poses() } else { group.group.number == number }
        })
    };
    found.groups_missing.extend(log.series.keys().filter(|number| !is_in_take(**number)));
    Ok(found)
}

/// Whether a number is that of a sample after the first one of a batch. The log has no times of these; a take that was cut
/// there has one, between those of the samples around it.
fn is_inside_a_batch(sent: &[SentRow], places: &[(u64, Place)], number: u64) -> bool {
    let after = places.partition_point(|(from, _)| *from <= number);
    let Some((_, (epoch, shift))) = places.get(after.saturating_sub(1)) else { return false };
    let Some(of_log) = number.checked_add_signed(*shift) else { return false };
    let at = sent.partition_point(|row| (row.epoch, row.first) < (*epoch, of_log));
    let row = at.checked_sub(1).and_then(|index| sent.get(index));
    row.is_some_and(|row| row.epoch == *epoch && of_log < row.first.saturating_add(row.n))
}

/// A time that the take states.
#[derive(Debug, Clone, Copy)]
struct StatedTime {
    number: u64,
    run_start: u64,
    device_ticks: u64,
}

/// An epoch of the log, and what is added to numbers of the take to have those of the log.
type Place = (u32, i64);

/// Stored numbers, and their place; `None` where no time tells.
type PlacedNumbers = (Range<u64>, Option<Place>);

/// What the take has: the numbers of frames or samples, and times of some of them.
#[derive(Debug, Default)]
struct StoredSeries {
    stored: Vec<Range<u64>>,
    times: Vec<StatedTime>,
}

impl StoredSeries {
    fn of_group(group: &GroupSamples) -> Self {
        let stored = group.stored_ranges();
        let times = group.anchors().iter().map(|anchor| StatedTime {
            number: anchor.number,
            run_start: anchor.run_start,
            device_ticks: anchor.device_ticks,
        });
        Self { stored, times: times.collect() }
    }

    fn of_rows(map: &TakeMap, input: impl Read + Seek) -> Result<Self, TakeError> {
        let mut series = Self::default();
        let mut outcomes = RowOutcomes::new(input, map)?;
        while let Some((rows, outcome)) = outcomes.next()? {
            outcomes.pass(rows.end);
            let RowOutcome::Recorded(time) = outcome else { continue };
            match series.stored.last_mut().filter(|last| last.end == rows.start) {
                Some(last) => last.end = rows.end,
                None => series.stored.push(rows.clone()),
            }
            series.times.push(StatedTime {
                number: rows.start,
                run_start: 0,
                device_ticks: time.device_ticks,
            });
        }
        Ok(series)
    }

    fn account(&self, group: Option<u32>, sent: &[SentRow]) -> SentAccount {
        let mut found = SentAccount { group, ..SentAccount::default() };
        let mut in_take = vec![0_u64; sent.len()];
        for (numbers, place) in self.places(sent, &mut found) {
            let n_unknown = match place {
                Some((epoch, shift)) => mark(sent, &mut in_take, (numbers, epoch, shift)),
                None => numbers.end - numbers.start,
            };
            found.unknown = found.unknown.saturating_add(n_unknown);
        }
        let has_some = |n: &u64| *n > 0;
        let first = in_take.iter().position(has_some);
        let last = in_take.iter().rposition(has_some);
        let inside = first.zip(last).map_or(0..0, |(first, last)| first..last + 1);
        for (index, (row, n)) in sent.iter().zip(&in_take).enumerate() {
            let add = |count: &mut u64, n: u64| *count = count.saturating_add(n);
            if !inside.contains(&index) {
                add(&mut found.outside, row.n);
                continue;
            }
            add(&mut found.sent, row.n);
            match row.fate {
                SentFate::Arrived => {
                    add(&mut found.recorded, *n);
                    add(&mut found.arrived_lost, row.n.saturating_sub(*n));
                }
                SentFate::Dropped => add(&mut found.dropped, row.n),
                SentFate::Lost => add(&mut found.lost, row.n),
            }
        }
        found
    }

    /// The stored numbers with their places.
    fn places(&self, sent: &[SentRow], found: &mut SentAccount) -> Vec<PlacedNumbers> {
        let mut by_ticks: Vec<(u64, usize)> =
            sent.iter().enumerate().map(|(index, row)| (row.device_ticks, index)).collect();
        by_ticks.sort_unstable();
        // From which number on which place holds.
        let mut places: Vec<(u64, Place)> = Vec::new();
        let (mut from, mut last_run) = (0, None);
        let mut unmatched = Vec::new();
        for time in &self.times {
            let at = by_ticks.partition_point(|row| *row < (time.device_ticks, from));
            let of_ticks = by_ticks.get(at..).unwrap_or_default().iter();
            let mut of_ticks =
                of_ticks.take_while(|(ticks, _)| *ticks == time.device_ticks).map(|(_, of)| *of);
            // Of several batches with a time, those without samples are not in the take.
            let row = of_ticks.find_map(|index| {
                let row = sent.get(index).filter(|row| row.n > 0)?;
                Some((index, row))
            });
            let Some((index, row)) = row else {
                unmatched.push(time.number);
                continue;
            };
            found.times_known += 1;
            from = index;
            let shift = row.first.cast_signed().saturating_sub(time.number.cast_signed());
            let is_first_of_run = last_run != Some(time.run_start);
            let start = if is_first_of_run { time.run_start } else { time.number };
            last_run = Some(time.run_start);
            match places.last() {
                Some((_, (epoch, before))) if *epoch == row.epoch => {
                    if *before == shift {
                        continue;
                    }
                    found.unaccounted = found.unaccounted.saturating_add(before.abs_diff(shift));
                }
                _ => {}
            }
            places.push((start, (row.epoch, shift)));
        }
        let is_unknown = |number: &&u64| !is_inside_a_batch(sent, &places, **number);
        found.times_unknown = unmatched.iter().filter(is_unknown).count() as u64;
        self.by_place(&places)
    }

    /// Divides the stored numbers where their places change.
    fn by_place(&self, places: &[(u64, Place)]) -> Vec<PlacedNumbers> {
        let mut all = Vec::new();
        for stored in &self.stored {
            let mut start = stored.start;
            while start < stored.end {
                let after = places.partition_point(|(from, _)| *from <= start);
                let next = places.get(after).map_or(stored.end, |(from, _)| *from);
                let end = next.min(stored.end);
                let before = after.checked_sub(1).and_then(|index| places.get(index));
                all.push((start..end, before.map(|(_, place)| *place)));
                start = end;
            }
        }
        all
    }
}

/// Counts samples of the take for the rows that have them. Returns how many no row has that arrived.
fn mark(
    sent: &[SentRow],
    in_take: &mut [u64],
    (numbers, epoch, shift): (Range<u64>, u32, i64),
) -> u64 {
    let to_log = |number: u64| u64::try_from(number.cast_signed().saturating_add(shift));
    let all = numbers.end - numbers.start;
    let (Ok(start), Ok(end)) = (to_log(numbers.start), to_log(numbers.end)) else { return all };
    let mut n_known = 0;
    let from =
        sent.partition_point(|row| (row.epoch, row.first.saturating_add(row.n)) <= (epoch, start));
    for (row, n) in sent.iter().zip(in_take).skip(from) {
        if row.epoch != epoch || row.first >= end {
            break;
        }
        if row.fate == SentFate::Arrived {
            let inside =
                row.first.saturating_add(row.n).min(end).saturating_sub(row.first.max(start));
            *n += inside;
            n_known += inside;
        }
    }
    all.saturating_sub(n_known)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A log of ten batches of four samples, a thousand ticks apart, and these changes of its lines.
    fn log(change: impl Fn(usize, &mut Vec<String>)) -> Vec<SentRow> {
        let mut text = format!("{},{},batches\n", BATCHES.join(","), FATES.join(","));
        for i in 0..10_usize {
            let numbers = [1, 0, i, 100 + 4 * i, 4 * i, 4, 1000 * i, 0, 7];
            let mut cells: Vec<String> = numbers.map(|number| number.to_string()).to_vec();
            cells.extend(["whole", "0", "", "1"].map(str::to_owned));
            change(i, &mut cells);
            text += &format!("{}\n", cells.join(","));
        }
        SentLog::read(text.as_bytes()).unwrap().series.remove(&0).unwrap()
    }

    fn time(number: u64, run_start: u64, device_ticks: u64) -> StatedTime {
        StatedTime { number, run_start, device_ticks }
    }

    /// The first samples, without a gap.
    fn first(n: u64) -> Vec<Range<u64>> {
        std::iter::once(0..n).collect()
    }

    #[test]
    fn what_was_sent_is_in_the_take_or_lost() {
        let sent = log(|_, _| {});
        // The recording began with the third batch, and ended before the last one.
        let series =
            StoredSeries { stored: first(28), times: vec![time(0, 0, 2000), time(24, 0, 8000)] };
        let account = series.account(Some(0), &sent);
        let whole = SentAccount {
            group: Some(0),
            sent: 28,
            recorded: 28,
            outside: 12,
            times_known: 2,
            ..SentAccount::default()
        };
        assert_eq!(account, whole);
        // One batch is lost on its way, and one in the host.
        let sent = log(|i, cells| {
            if i == 4 {
                cells[9] = "damaged".to_owned();
            }
        });
        let stored = vec![0..8, 12..16, 20..28];
        let series = StoredSeries { stored, ..series };
        let account = series.account(Some(0), &sent);
        assert_eq!(account, SentAccount { recorded: 20, lost: 4, arrived_lost: 4, ..whole });
        assert!(account.is_complete());
    }

    #[test]
    fn what_is_not_accounted_for_is_found() {
        let sent = log(|_, _| {});
        let times = || vec![time(0, 0, 2000), time(24, 0, 8000)];
        // Four samples are passed over.
        let passed = vec![time(0, 0, 2000), time(20, 0, 8000)];
        let series = StoredSeries { stored: vec![0..12, 20..24], times: passed };
        assert_eq!(series.account(None, &sent).unaccounted, 4);
        // Samples that were not sent.
        let series = StoredSeries { stored: first(40), times: times() };
        assert_eq!(series.account(None, &sent).unknown, 8);
        // Samples that did not arrive.
        let lost = log(|i, cells| {
            if i == 4 {
                cells[9] = "lost".to_owned();
            }
        });
        let series = StoredSeries { stored: first(28), times: times() };
        assert_eq!(series.account(None, &lost).unknown, 4);
        // A time that the log does not have.
        let other = vec![time(0, 0, 2000), time(24, 0, 8001)];
        let series = StoredSeries { stored: first(28), times: other };
        assert_eq!(series.account(None, &sent).times_unknown, 1);
        let nothing = StoredSeries { stored: first(28), times: Vec::new() };
        assert_eq!(nothing.account(None, &sent).unknown, 28);
        let empty = StoredSeries::default().account(None, &sent);
        assert!(empty.is_complete() && empty.outside == 40 && empty.sent == 0);
    }

    #[test]
    fn a_device_that_counts_anew_begins_another_epoch() {
        // It lost its power after five batches.
        let sent = log(|i, cells| {
            if i >= 5 {
                cells[0] = "2".to_owned();
                cells[3] = (4 * (i - 5)).to_string();
                cells[6] = (1000 * (i - 5) + 3).to_string();
            }
        });
        // The take states 9 samples as lost, by the host's clock.
        let series = StoredSeries {
            stored: vec![0..20, 29..49],
            times: vec![time(0, 0, 0), time(16, 0, 4000), time(29, 29, 3), time(45, 29, 4003)],
        };
        let account = series.account(None, &sent);
        assert!(account.is_complete(), "{account:?}");
        assert_eq!((account.sent, account.recorded), (40, 40));
    }

    #[test]
    fn bad_logs_are_refused_with_their_line() {
        let head = FRAMES.join(",");
        assert!(SentLog::is_one(head.as_bytes()) && !SentLog::is_one(b"time,head_x,head_y"));
        let read = |text: &str| SentLog::read(text.as_bytes());
        assert!(read("").is_err() && read("frame,time_s\n1,2\n").is_err());
        let why = |text: &str| read(text).unwrap_err().to_string();
        assert!(why(&format!("{head}\n1,2\n")).contains("line 2"));
        assert!(why(&format!("{head}\n1,-2,3,4,0,6,0\n")).contains("'-2'"));
        assert!(
            why(&format!("{head}\n1,2,3,4,0,6,0\n1,18446744073709551615,3,4,0,6,0\n"))
                .contains("line 3")
        );
        assert!(why(&format!("{head}\n{}\n", "9".repeat(9000))).contains("line 2"));
        let fates = format!("{head},{},frames\n1,2,3,4,0,6,0,gone,0,,1\n", FATES.join(","));
        assert!(why(&fates).contains("'gone'"));
        // The simulator was ended while it wrote.
        let log = read(&format!("{head}\n1,2,3,4,0,6,0\n1,3,4")).unwrap();
        assert_eq!(log.series[&0].len(), 1);
    }
}
