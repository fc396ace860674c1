//! When rows were, and which were lost.

use std::ops::Range;

use mocapd_take::{TakeMap, TakeStretches, timeline::Causes};

use crate::{errors::Failure, source::Source};

/// One unit of an arrival, in nanoseconds.
const ARRIVAL_NS: u64 = 10_000;

/// Some rows' times, and what was lost among them.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// Device clock, in ticks; 0 where not recorded.
    pub(crate) device_ticks: Vec<u64>,
    /// Host's monotonic clock, in nanoseconds; 0 where not recorded.
    pub(crate) arrival_ns: Vec<u64>,
    /// Whether the frame was recorded.
    pub(crate) recorded: Vec<bool>,
    /// Rows that were lost: the first, how many, why.
    pub(crate) lost: Vec<(u64, u64, Causes)>,
}

/// Of `rows`. An import has no times, but may have lost rows.
pub(crate) fn times(source: &Source, map: &TakeMap, rows: &Range<u64>) -> Result<Times, Failure> {
    let n = if map.header.device.is_some() { (rows.end - rows.start) as usize } else { 0 };
    let mut found = Times {
        device_ticks: vec![0; n],
        arrival_ns: vec![0; n],
        recorded: vec![false; n],
        lost: Vec::new(),
    };
    let mut stretches = TakeStretches::new(source.reader(), map)?.with_groups(Vec::new())?;
    stretches.seek(rows.start)?;
    // Where reading began at a key, all rows before it are before `rows`, too.
    let mut at = 0;
    while let Some(span) = stretches.next_stretch()? {
        let timeline = stretches.timeline();
        let from = timeline.map_or(span.first_row, |timeline| timeline.first_row);
        // Between stretches are rows whose stretch is damaged.
        found.lose(rows, at, from.saturating_sub(at), Causes::DAMAGED);
        if let Some(timeline) = timeline {
            let mut row = from;
            for run in &timeline.runs {
                if let Some(causes) = run.lost {
                    found.lose(rows, row, run.rows, causes);
                }
                row = row.saturating_add(run.rows);
            }
            for (row, time) in timeline.recorded() {
                let place = row.checked_sub(rows.start).map(|i| i as usize).filter(|&i| i < n);
                if let Some(i) = place {
                    found.device_ticks[i] = time.device_ticks;
                    found.arrival_ns[i] = time.arrival_10us.saturating_mul(ARRIVAL_NS);
                    found.recorded[i] = true;
                }
            }
        }
        at = span.end_row();
        if span.end_row() >= rows.end {
            return Ok(found);
        }
    }
    found.lose(rows, at, map.n_rows.saturating_sub(at), Causes::DAMAGED);
    Ok(found)
}

impl Times {
    /// What of these is among `rows`; runs of one cause that meet become one.
    fn lose(&mut self, rows: &Range<u64>, first: u64, n: u64, causes: Causes) {
        let end = first.saturating_add(n).min(rows.end);
        let first = first.max(rows.start);
        if first >= end {
            return;
        }
        match self.lost.last_mut() {
            Some(last) if last.0 + last.1 == first && last.2 == causes => last.1 += end - first,
            _ => self.lost.push((first, end - first, causes)),
        }
    }
}
