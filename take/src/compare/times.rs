//! Compares the time lines of two recordings.

use std::{
    io::{Read, Seek},
    ops::Range,
    vec,
};

use serde::Serialize;

use crate::{
    TakeError, TakeMap, TakeTraversal,
    timeline::{LossCauses, RowTime, Timeline},
    traversal::Decode,
};

/// How the times of two recordings differ.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct TimesDifference {
    /// Frames with different device ticks.
    pub ticks_differing: u64,
    /// Frames with different arrivals.
    pub arrivals_differing: u64,
    /// Frames with different timecodes.
    pub timecodes_differing: u64,
    /// Frames that only one of the two lost, or with different causes.
    pub losses_differing: u64,
    /// The first frame with any of these differences.
    pub first_frame: Option<u64>,
}

impl TimesDifference {
    /// Whether nothing differs.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    fn add(&mut self, rows: &Range<u64>, a: RowOutcome, b: RowOutcome) {
        if a == b {
            return;
        }
        self.first_frame.get_or_insert(rows.start);
        let n = rows.end - rows.start;
        match (a, b) {
            (RowOutcome::Recorded(a), RowOutcome::Recorded(b)) => {
                self.ticks_differing += u64::from(a.device_ticks != b.device_ticks);
                self.arrivals_differing += u64::from(a.arrival_10us != b.arrival_10us);
                self.timecodes_differing += u64::from(a.timecode != b.timecode);
            }
            _ => self.losses_differing = self.losses_differing.saturating_add(n),
        }
    }
}

/// The outcome of a row: recorded or lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RowOutcome {
    Recorded(RowTime),
    Lost(LossCauses),
}

/// Compares the times of the frames that both recordings have. Each comes with its map.
///
/// # Errors
/// Those of [`TakeTraversal::next_stretch`].
pub fn compare_times<R: Read + Seek, S: Read + Seek>(
    a: (R, &TakeMap),
    b: (S, &TakeMap),
) -> Result<TimesDifference, TakeError> {
    let (mut a, mut b) = (RowOutcomes::new(a.0, a.1)?, RowOutcomes::new(b.0, b.1)?);
    let mut difference = TimesDifference::default();
    while let (Some((rows, outcome)), Some((others, other))) = (a.next()?, b.next()?) {
        // A damaged take lacks rows.
        let start = rows.start.max(others.start);
        let end = rows.end.min(others.end);
        if start < end {
            difference.add(&(start..end), outcome, other);
        }
        a.pass(end.max(start.min(rows.end)));
        b.pass(end.max(start.min(others.end)));
    }
    Ok(difference)
}

/// Consecutive rows with one outcome: a row that was recorded, or lost ones.
pub(super) type OutcomeRun = (Range<u64>, RowOutcome);

/// The outcomes of a recording's rows, in order.
pub(super) struct RowOutcomes<R> {
    traversal: TakeTraversal<R>,
    /// The rest of the current run.
    current: Option<OutcomeRun>,
    /// The runs after it in its stretch.
    waiting: vec::IntoIter<OutcomeRun>,
}

impl<R: Read + Seek> RowOutcomes<R> {
    pub(super) fn new(input: R, map: &TakeMap) -> Result<Self, TakeError> {
        let traversal = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        Ok(Self { traversal, current: None, waiting: Vec::new().into_iter() })
    }

    /// The next run, which stays the next until its rows are [passed](Self::pass).
    pub(super) fn next(&mut self) -> Result<Option<OutcomeRun>, TakeError> {
        while self.current.is_none() {
            self.current = self.waiting.next();
            if self.current.is_none() {
                if self.traversal.next_stretch()?.is_none() {
                    return Ok(None);
                }
                self.waiting = self.traversal.timeline().map(runs).unwrap_or_default().into_iter();
            }
        }
        Ok(self.current.clone())
    }

    /// Passes the rows before `row`.
    pub(super) fn pass(&mut self, row: u64) {
        if let Some((rows, _)) = &mut self.current {
            rows.start = rows.start.max(row);
        }
        self.current.take_if(|(rows, _)| rows.is_empty());
    }
}

fn runs(timeline: &Timeline) -> Vec<OutcomeRun> {
    let mut times = timeline.times.iter();
    let mut at = timeline.first_row;
    let mut runs = Vec::new();
    for run in &timeline.runs {
        let end = at.saturating_add(run.rows);
        match run.lost {
            Some(causes) => runs.push((at..end, RowOutcome::Lost(causes))),
            None => {
                let recorded =
                    |(row, time): (u64, &RowTime)| (row..row + 1, RowOutcome::Recorded(*time));
                runs.extend((at..end).zip(times.by_ref()).map(recorded));
            }
        }
        at = end;
    }
    runs
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use mocapd_codec::{Settings, Tolerance};

    use super::*;
    use crate::{
        TakeWriter,
        record::{Device, Header, Ledger},
        statistics::StretchTally,
        stretch::{Span, StretchHeaderWriter},
        timeline::TimelineEncoder,
    };

    const TICK_HZ: u64 = 100_000;

    /// A recording of these rows, in stretches of `stretch_rows`: the ticks of a recorded row, or the causes of a lost one.
    fn take(rows: &[Result<u64, LossCauses>], stretch_rows: u32) -> (Vec<u8>, TakeMap) {
        let device = Some(Device { tick_hz: TICK_HZ, ..Device::default() });
        let mut header = Header { rate_hz: 100.0, device, stretch_rows, ..Header::default() };
        let tolerance = Tolerance::from_mm(1.0).unwrap();
        header.set_codec(&Settings { kind: "dense".parse().unwrap(), tolerance });
        let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
        let times = TimelineEncoder::exact(TICK_HZ, 100.0);
        let mut front = StretchHeaderWriter::with_times(stretch_rows, times);
        for (i, part) in rows.chunks(stretch_rows as usize).enumerate() {
            let mut timeline = Timeline::default();
            let first_row = i as u64 * u64::from(stretch_rows);
            timeline.restart(first_row);
            for row in part {
                match row {
                    Ok(ticks) => timeline.push(RowTime {
                        device_ticks: *ticks,
                        arrival_10us: ticks + 70,
                        timecode: None,
                    }),
                    Err(causes) => timeline.push_lost(1, *causes),
                }
            }
            let (n_rows, key) = (part.len() as u32, i % 2 == 0);
            let span = Span { first_row, n_rows, key, number: (i % 32) as u8 };
            let mut payload = Vec::new();
            front.put(span, &timeline, &[], true, &mut payload);
            take.stretch(span, &payload, &StretchTally::default()).unwrap();
        }
        let (bytes, _) = take.finish(&Ledger::default()).unwrap();
        let map = TakeMap::scan(&mut Cursor::new(&bytes)).unwrap();
        (bytes, map)
    }

    fn compared(a: &(Vec<u8>, TakeMap), b: &(Vec<u8>, TakeMap)) -> TimesDifference {
        compare_times((Cursor::new(&a.0), &a.1), (Cursor::new(&b.0), &b.1)).unwrap()
    }

    #[test]
    fn frames_are_compared_across_different_stretches() {
        let mut rows: Vec<Result<u64, LossCauses>> = (0..40).map(|row| Ok(row * 1000)).collect();
        rows[7..12].fill(Err(LossCauses::NOT_RECEIVED));
        let (one, other) = (take(&rows, 10), take(&rows, 7));
        assert!(compared(&one, &other).is_none());
        assert!(compared(&one, &take(&rows[..20], 10)).is_none(), "the frames that both have");
        rows[9] = Err(LossCauses::RING_FULL);
        rows[11] = Ok(11_000);
        rows[30] = Ok(30_003);
        let found = compared(&one, &take(&rows, 7));
        let expected = TimesDifference {
            ticks_differing: 1,
            arrivals_differing: 1,
            timecodes_differing: 0,
            losses_differing: 2,
            first_frame: Some(9),
        };
        assert_eq!(found, expected);
        assert_eq!(compared(&take(&rows, 7), &one), expected);
    }
}
