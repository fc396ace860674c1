//! The clock of a recording's rows: which place among them a time of the device's clock has.
//!
//! Exports place row r at r / rate, whatever rate the device kept. A sample is therefore placed between the rows that were
//! taken around it, and not by the tick frequency: a sample that was taken with row r has the time of row r.

use std::io::{Read, Seek};

use super::SampleTime;
use crate::{TakeError, TakeMap, TakeTraversal, timeline::LossCauses, traversal::Decode};

/// Distance from the expected time, in seconds, from which on the next row does not continue a line. Frames come late by
/// milliseconds, and a clock that jumps by less moves samples by less than this.
const APART_S: f64 = 0.1;

/// A recorded row and its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Knot {
    row: u64,
    ticks: u64,
}

/// Rows between which the device's clock went on evenly: times between two knots lie on the line through them.
#[derive(Debug, Clone, PartialEq)]
struct Piece {
    /// The segment of the device's clock; `None` where the take does not tell.
    segment: Option<u32>,
    /// In ascending order of rows and ticks; at least one.
    knots: Vec<Knot>,
    /// Host time of arrival of the first one, in nanoseconds.
    arrival_ns: u64,
}

/// The times of a recording's rows by the device's clock.
#[derive(Debug, Clone, PartialEq)]
pub struct RowClock {
    pieces: Vec<Piece>,
    /// Rows in a tick, by the rate of the take.
    rows_per_tick: f64,
}

impl RowClock {
    /// Reads the times of all rows of a take.
    ///
    /// # Errors
    /// Those of [`TakeTraversal::next_stretch`].
    pub fn read(input: impl Read + Seek, map: &TakeMap) -> Result<Self, TakeError> {
        let tick_hz = map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1)) as f64;
        let mut clock = Self { pieces: Vec::new(), rows_per_tick: map.header.rate_hz / tick_hz };
        let mut stretches = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        let mut last: Option<Knot> = None;
        while stretches.next_stretch()?.is_some() {
            let Some(timeline) = stretches.timeline() else { continue };
            let disconnected = |run: &crate::timeline::RowRun| {
                run.lost.is_some_and(|causes| causes.contains(LossCauses::DISCONNECTED))
            };
            if timeline.runs.iter().any(disconnected) {
                // The device's clock may have begun again.
                clock.end_piece(last.take());
            }
            let mut is_first = true;
            for (row, time) in timeline.recorded() {
                let knot = Knot { row, ticks: time.device_ticks };
                let continues = last.is_some_and(|last| clock.continues(last, knot, tick_hz));
                if !continues {
                    clock.end_piece(last.take());
                    let arrival_ns = time.arrival_10us.saturating_mul(10_000);
                    clock.pieces.push(Piece { segment: None, knots: vec![knot], arrival_ns });
                } else if is_first && let Some(piece) = clock.pieces.last_mut() {
                    // One a stretch is enough: the device's clock is even over half a second.
                    piece.knots.push(knot);
                }
                (last, is_first) = (Some(knot), false);
            }
        }
        clock.end_piece(last);
        clock.find_segments(map, tick_hz);
        Ok(clock)
    }

    /// Whether a row was taken when it was due after the one before.
    fn continues(&self, last: Knot, next: Knot, tick_hz: f64) -> bool {
        let due_s = (next.row - last.row) as f64 / self.rows_per_tick / tick_hz;
        let passed = next.ticks.wrapping_sub(last.ticks).cast_signed();
        passed > 0 && (passed as f64 / tick_hz - due_s).abs() < APART_S
    }

    /// Ends the last piece at a row.
    fn end_piece(&mut self, last: Option<Knot>) {
        if let (Some(last), Some(piece)) = (last, self.pieces.last_mut())
            && piece.knots.last() != Some(&last)
        {
            piece.knots.push(last);
        }
    }

    /// Finds the segment of each piece: the one by whose line its first row arrived soonest after it was taken.
    fn find_segments(&mut self, map: &TakeMap, tick_hz: f64) {
        for piece in &mut self.pieces {
            let Some(first) = piece.knots.first() else { continue };
            let distance = |line: &crate::record::ClockLine| {
                let ticks = first.ticks.wrapping_sub(line.device_ticks).cast_signed() as f64;
                let passed_ns = ticks / tick_hz * 1e9 * (1.0 + line.drift_ppb as f64 * 1e-9);
                (line.host_ns as f64 + passed_ns - piece.arrival_ns as f64).abs()
            };
            let nearest =
                map.clock_lines.iter().min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)));
            piece.segment = nearest.map(|(segment, _)| *segment);
        }
    }

    /// The place of a time among the rows: row 3 was taken at 3.0. Before the first row and after the last one, time goes
    /// on at the rate of the take. `None` for a time in a segment of the device's clock that has no row, and between two
    /// rows that follow each other later than they are due.
    #[must_use]
    pub fn position(&self, time: &SampleTime) -> Option<f64> {
        let is_of = |piece: &&Piece| piece.segment.is_none_or(|segment| segment == time.segment);
        let mut before: Option<&Piece> = None;
        let mut after: Option<&Piece> = None;
        for piece in self.pieces.iter().filter(is_of) {
            let (first, last) = (piece.knots.first()?, piece.knots.last()?);
            if time.ticks_since(first.ticks) < 0.0 {
                after = after.or(Some(piece));
            } else if time.ticks_since(last.ticks) <= 0.0 {
                return Some(self.within(piece, time));
            } else {
                (before, after) = (Some(piece), None);
            }
        }
        let beyond =
            |knot: &Knot| knot.row as f64 + time.ticks_since(knot.ticks) * self.rows_per_tick;
        let from = before.and_then(|piece| piece.knots.last());
        let to = after.and_then(|piece| piece.knots.first());
        match (from, to) {
            (Some(from), Some(to)) => {
                let forwards = Some(beyond(from)).filter(|&at| at < to.row as f64);
                forwards.or_else(|| Some(beyond(to)).filter(|&at| at > from.row as f64))
            }
            (from, to) => from.or(to).map(beyond),
        }
    }

    /// The place of a time between the first and the last row of a piece.
    fn within(&self, piece: &Piece, time: &SampleTime) -> f64 {
        let at = piece.knots.partition_point(|knot| time.ticks_since(knot.ticks) >= 0.0);
        let from = at.saturating_sub(1).min(piece.knots.len().saturating_sub(2));
        match piece.knots.get(from..) {
            Some([a, b, ..]) => {
                let ticks = b.ticks.wrapping_sub(a.ticks) as f64;
                a.row as f64 + time.ticks_since(a.ticks) * ((b.row - a.row) as f64 / ticks)
            }
            Some([only]) => only.row as f64 + time.ticks_since(only.ticks) * self.rows_per_tick,
            _ => f64::NAN,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(segment: u32, knots: &[(u64, u64)]) -> Piece {
        let knots = knots.iter().map(|&(row, ticks)| Knot { row, ticks }).collect();
        Piece { segment: Some(segment), knots, arrival_ns: 0 }
    }

    fn at(clock: &RowClock, segment: u32, device_ticks: u64) -> Option<f64> {
        clock.position(&SampleTime { device_ticks, fraction: 0.0, segment, run_start: 0 })
    }

    /// 100 rows a second of a clock with 1000 ticks, which runs 1 % fast from row 100 on, is late by 3 s after row 200, and
    /// begins again with row 600.
    #[test]
    fn times_lie_between_the_rows_around_them() {
        let pieces = vec![
            piece(0, &[(0, 5000), (100, 6000), (200, 7010)]),
            piece(0, &[(201, 10_000), (300, 10_990)]),
            piece(1, &[(600, 70), (601, 80)]),
        ];
        let clock = RowClock { pieces, rows_per_tick: 0.1 };
        assert_eq!([at(&clock, 0, 5000), at(&clock, 0, 5505)], [Some(0.0), Some(50.5)]);
        assert_eq!(at(&clock, 0, 6505), Some(150.0));
        assert_eq!([at(&clock, 0, 4990), at(&clock, 0, 11_000)], [Some(-1.0), Some(301.0)]);
        // Less than a row after row 200 and before row 201; the time between them has no place.
        assert_eq!([at(&clock, 0, 7015), at(&clock, 0, 9995)], [Some(200.5), Some(200.5)]);
        assert_eq!(at(&clock, 0, 8000), None);
        assert_eq!([at(&clock, 1, 75), at(&clock, 1, 60)], [Some(600.5), Some(599.0)]);
        assert_eq!(at(&clock, 2, 75), None);
    }
}
