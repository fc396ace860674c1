//! The times of rows, and the rows that were lost.

use std::ops::Range;

use mocapd_take::{TakeMap, TakeTraversal, timeline::LossCauses, traversal::Decode};

use crate::{errors::Failure, source::Source};

/// The unit of arrival times in a take, in nanoseconds.
const ARRIVAL_NS: u64 = 10_000;

/// Maximum number of rows whose times are read at once: three days at 1000 Hz, 17 bytes for each row here and three
/// times as many in Python. A few bytes of a damaged take can claim years of lost rows.
const ROWS_MAX: u64 = 1 << 28;

/// The times of some rows.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The device's clock, in ticks; 0 if the row was not recorded.
    pub(crate) device_ticks: Vec<u64>,
    /// The host's monotonic clock at arrival, in nanoseconds; 0 if the row was not recorded.
    pub(crate) arrival_ns: Vec<u64>,
    /// Whether the row was recorded.
    pub(crate) recorded: Vec<bool>,
}

/// Reads the times of `rows`; empty for an import, which has none.
pub(crate) fn times(source: &Source, map: &TakeMap, rows: &Range<u64>) -> Result<Times, Failure> {
    if map.header.device.is_none() {
        return Ok(Times::default());
    }
    let n_rows = rows.end - rows.start;
    if n_rows > ROWS_MAX {
        return Err(Failure::Value(format!(
            "cannot read the times of {n_rows} frames at once, at most {ROWS_MAX}: give start_s and stop_s"
        )));
    }
    let n = n_rows as usize;
    let mut found =
        Times { device_ticks: vec![0; n], arrival_ns: vec![0; n], recorded: vec![false; n] };
    let mut stretches = TakeTraversal::from_map(source.reader(), map, Decode::Groups(Vec::new()))?;
    stretches.seek(rows.start)?;
    while let Some(span) = stretches.next_stretch()? {
        source.check()?;
        for (row, time) in stretches.timeline().iter().flat_map(|timeline| timeline.recorded()) {
            if let Some(i) = row.checked_sub(rows.start).map(|i| i as usize).filter(|&i| i < n) {
                found.device_ticks[i] = time.device_ticks;
                found.arrival_ns[i] = time.arrival_10us.saturating_mul(ARRIVAL_NS);
                found.recorded[i] = true;
            }
        }
        if span.end_row() >= rows.end {
            break;
        }
    }
    Ok(found)
}

/// Runs of lost rows: first row, number of rows, causes.
type LostRows = Vec<(u64, u64, LossCauses)>;

/// Reads the lost rows of a whole take as runs. The cost depends on the number of runs, not on their lengths.
pub(crate) fn lost(source: &Source, map: &TakeMap) -> Result<LostRows, Failure> {
    let mut lost = LostRows::new();
    let mut stretches = TakeTraversal::from_map(source.reader(), map, Decode::Groups(Vec::new()))?;
    let mut at = 0;
    while let Some(span) = stretches.next_stretch()? {
        source.check()?;
        let timeline = stretches.timeline();
        let from = timeline.map_or(span.first_row, |timeline| timeline.first_row);
        // The stretches of rows between two stretches are damaged.
        push_lost(&mut lost, map, at, from.saturating_sub(at), LossCauses::DAMAGED);
        let mut row = from;
        for run in timeline.map_or(&[][..], |timeline| &timeline.runs) {
            if let Some(causes) = run.lost {
                push_lost(&mut lost, map, row, run.rows, causes);
            }
            row = row.saturating_add(run.rows);
        }
        at = span.end_row();
    }
    push_lost(&mut lost, map, at, map.n_rows.saturating_sub(at), LossCauses::DAMAGED);
    Ok(lost)
}

/// Appends a run, cut off at the end of the take and merged with the previous run if that has the same causes and ends
/// here.
fn push_lost(lost: &mut LostRows, map: &TakeMap, first: u64, n: u64, causes: LossCauses) {
    let end = first.saturating_add(n).min(map.n_rows);
    if first >= end {
        return;
    }
    match lost.last_mut() {
        Some(last) if last.0 + last.1 == first && last.2 == causes => last.1 += end - first,
        _ => lost.push((first, end - first, causes)),
    }
}
