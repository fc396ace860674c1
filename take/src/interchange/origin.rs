//! Samples exactly at the origin: some software writes `0 0 0` for an occluded marker. Which of them are missing ones?

use std::io;

use super::units::median;
use crate::motion::{Ambiguity, GAP, Notes, Position, is_gap};

/// The origin.
pub(super) const ORIGIN: Position = [0.0; 3];
/// Written instead of the origin in formats where `0 0 0` means, or may mean, a missing sample: one nanometre off.
const NEAR_ORIGIN: Position = [1e-6, 0.0, 0.0];
/// A marker whose neighbouring sample is within this many of its median steps from the origin passes through the
/// origin.
pub(super) const STEPS: f64 = 10.0;

/// The position to write in a format where `0 0 0` may mean a missing sample.
pub(super) fn off_origin(position: Position) -> Position {
    if position == ORIGIN { NEAR_ORIGIN } else { position }
}

/// Finds the samples at the origin, row by row.
///
/// A marker's samples at the origin are missing ones, rather than positions, if it is there for two frames or more, or
/// if it is far away before and after. "Far away" is relative to the median of its steps. Only a comparison with the
/// median is needed, so a second pass over the rows counts the shorter and the longer steps instead of sorting them.
#[derive(Debug)]
pub(super) struct OriginScan {
    markers: Vec<MarkerScan>,
    n_present: u64,
    n_at_origin: u64,
}

/// What is known of a marker.
#[derive(Debug, Clone, Copy, Default)]
struct MarkerScan {
    /// Its first position other than the origin.
    first: Option<Position>,
    /// Whether it has another one.
    moves: bool,
    last: Option<Position>,
    /// Number of its last samples that are all at the origin.
    run: u64,
    /// Distance from the origin of its sample before that run.
    before: Option<f64>,
    is_long: bool,
    /// The largest distance of a single sample at the origin to the nearer one of its neighbours; infinite if it
    /// has none.
    farthest_single: Option<f64>,
    last_of_steps: Option<Position>,
    n_steps: u64,
    /// Steps so short that the farthest single sample is not within the marker's path.
    n_short_steps: u64,
}

impl OriginScan {
    pub(super) fn new(n_markers: usize) -> Self {
        Self { markers: vec![MarkerScan::default(); n_markers], n_present: 0, n_at_origin: 0 }
    }

    /// Adds the positions of the next frame.
    pub(super) fn add_row(&mut self, row: &[Position]) {
        for (marker, &at) in self.markers.iter_mut().zip(row).filter(|(_, at)| !is_gap(**at)) {
            self.n_present += 1;
            self.n_at_origin += u64::from(at == ORIGIN);
            marker.add(at);
        }
    }

    /// The markers whose samples at the origin may be missing ones: another marker moves, or the only marker does.
    pub(super) fn suspects(&self) -> impl Iterator<Item = usize> {
        let n_moving = self.markers.iter().filter(|marker| marker.moves).count();
        let is_single = self.markers.len() == 1;
        let markers = self.markers.iter().enumerate();
        markers.filter_map(move |(index, marker)| {
            let others_move = n_moving > usize::from(marker.moves);
            let is_suspect = others_move || (is_single && marker.moves);
            (is_suspect && marker.is_at_origin()).then_some(index)
        })
    }

    /// Whether a marker has a single sample at the origin.
    pub(super) fn has_single(&self, marker: usize) -> bool {
        self.markers.get(marker).is_some_and(|marker| marker.farthest().is_some())
    }

    /// Whether [`note`](Self::note) depends on steps, for which all rows must be [added again](Self::add_steps).
    pub(super) fn needs_steps(&self) -> bool {
        let mut suspects = self.suspects().peekable();
        suspects.peek().is_some() && !suspects.any(|marker| self.markers[marker].is_long)
    }

    /// Adds the positions of the next frame once more.
    pub(super) fn add_steps(&mut self, row: &[Position]) {
        for (marker, &at) in self.markers.iter_mut().zip(row).filter(|(_, at)| !is_gap(**at)) {
            marker.add_step(at);
        }
    }

    /// Notes the samples at the origin.
    pub(super) fn note(&self, notes: &mut Notes) {
        let (samples, n_present) = (self.n_at_origin, self.n_present);
        if samples == 0 {
            return;
        }
        if self.suspects().any(|marker| self.markers[marker].has_missing()) {
            notes.ambiguous(Ambiguity::Origin { samples, gaps: false });
        } else {
            notes.warnings.push(format!(
                "At the origin and not marked as missing, kept as positions: {samples} of {n_present} samples."
            ));
        }
    }
}

impl MarkerScan {
    fn is_at_origin(&self) -> bool {
        self.run > 0 || self.is_long || self.farthest_single.is_some()
    }

    #[inline]
    fn add(&mut self, at: Position) {
        if self.moves && self.run == 0 && at != ORIGIN {
            // Nearly all samples.
            self.last = Some(at);
        } else if at == ORIGIN {
            if self.run == 0 {
                self.before = self.last.map(|last| distance(last, ORIGIN));
            }
            self.run += 1;
            self.is_long |= self.run > 1;
        } else {
            if self.run > 0 {
                self.end_run(Some(distance(at, ORIGIN)));
            }
            match self.first {
                None => self.first = Some(at),
                Some(first) => self.moves |= at != first,
            }
        }
        self.last = Some(at);
    }

    /// Ends a run at the origin. The sample after it is at the distance `after`.
    fn end_run(&mut self, after: Option<f64>) {
        if self.run == 1 {
            let nearer = [self.before, after].into_iter().flatten().fold(f64::INFINITY, f64::min);
            let before = self.farthest_single.unwrap_or(0.0);
            self.farthest_single = Some(nearer.max(before));
        }
        self.run = 0;
    }

    /// The largest distance of a single sample at the origin to the nearer one of its neighbours.
    fn farthest(&self) -> Option<f64> {
        let mut ended = *self;
        ended.end_run(None);
        ended.farthest_single
    }

    fn add_step(&mut self, at: Position) {
        let before = self.last_of_steps.replace(at);
        if let (Some(before), Some(farthest)) = (before.filter(|&at| at != ORIGIN), self.farthest())
            && at != ORIGIN
        {
            self.n_steps += 1;
            self.n_short_steps += u64::from(farthest > STEPS * distance(before, at));
        }
    }

    /// Whether some of its samples at the origin are missing ones: the same as `OriginGaps` finds.
    fn has_missing(&self) -> bool {
        // The (upper) median is too short if more than half of the steps are too short.
        let median_is_short = self.n_steps == 0 || self.n_short_steps > self.n_steps / 2;
        self.is_long || self.farthest().is_some_and(|farthest| farthest > 0.0 && median_is_short)
    }
}

/// The distance of two positions in millimetres.
pub(super) fn distance(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Bytes of the steps that are held at a time to find their medians; the rows are read again for each part of them.
const STEPS_BYTES_MAX: usize = 1 << 25;

/// Which samples at the origin are missing ones: a sample that is exactly at the origin while other markers move
/// elsewhere, and whose own marker does not approach the origin. If the marker passes through the origin, the sample is
/// a position.
///
/// Takes one bit for each of these samples, in the order of frames.
#[derive(Debug)]
pub(super) struct OriginGaps {
    suspects: Vec<Suspect>,
    /// For each sample of the suspects at the origin whether it is missing.
    missing: Bits,
    /// Index in `missing` of the next sample.
    next: usize,
}

/// A marker whose samples at the origin may be missing ones.
#[derive(Debug)]
struct Suspect {
    marker: usize,
    /// A single sample at the origin is a position if the one before or after it is within this distance.
    near: f64,
    last: Option<Position>,
    /// Whether the sample before the origin is near.
    is_near_before: bool,
    /// The samples in a row at the origin, and the index of the first.
    run: (u64, usize),
}

/// Passes all rows to a function.
type EachRow<'a> = &'a mut dyn FnMut(&mut dyn FnMut(&[Position])) -> io::Result<()>;

impl OriginGaps {
    /// Finds the missing samples in the rows that were scanned.
    ///
    /// # Errors
    /// Those of reading the rows.
    pub(super) fn find(
        scan: &OriginScan,
        n_frames: usize,
        for_each_row: EachRow<'_>,
    ) -> io::Result<Self> {
        let suspect =
            |marker| Suspect { marker, near: 0.0, last: None, is_near_before: false, run: (0, 0) };
        let mut suspects: Vec<Suspect> = scan.suspects().map(suspect).collect();
        let singles = suspects.iter_mut().filter(|suspect| scan.has_single(suspect.marker));
        let mut singles: Vec<&mut Suspect> = singles.collect();
        let n_held = (STEPS_BYTES_MAX / size_of::<f64>() / n_frames.max(1)).max(1);
        for part in singles.chunks_mut(n_held) {
            let mut steps: Vec<Vec<f64>> = vec![Vec::new(); part.len()];
            for_each_row(&mut |row| {
                part.iter_mut().zip(&mut steps).for_each(|(suspect, steps)| {
                    steps.extend(suspect.step(row));
                });
            })?;
            for (suspect, steps) in part.iter_mut().zip(&mut steps) {
                suspect.near = STEPS * median(steps).unwrap_or(0.0);
            }
        }
        suspects.iter_mut().for_each(|suspect| suspect.last = None);
        let mut missing = Bits::default();
        for_each_row(&mut |row| {
            suspects.iter_mut().for_each(|suspect| suspect.mark(row, &mut missing));
        })?;
        suspects.iter_mut().for_each(|suspect| suspect.end_run(false, &mut missing));
        Ok(Self { suspects, missing, next: 0 })
    }

    /// The number of missing samples.
    pub(super) fn n_missing(&self) -> u64 {
        self.missing.n_set()
    }

    /// Turns the missing samples of the next row into gaps.
    pub(super) fn apply(&mut self, row: &mut [Position]) {
        for suspect in &self.suspects {
            if let Some(at) = row.get_mut(suspect.marker).filter(|at| **at == ORIGIN) {
                if self.missing.is_set(self.next) {
                    *at = GAP;
                }
                self.next += 1;
            }
        }
    }

    /// Returns to the first row.
    pub(super) fn rewind(&mut self) {
        self.next = 0;
    }
}

/// Bits, eight per byte.
#[derive(Debug, Default)]
struct Bits {
    bytes: Vec<u8>,
    len: usize,
}

impl Bits {
    fn push_set(&mut self) {
        if self.len.is_multiple_of(8) {
            self.bytes.push(0);
        }
        if let Some(last) = self.bytes.last_mut() {
            *last |= 1 << (self.len % 8);
        }
        self.len += 1;
    }

    fn clear(&mut self, at: usize) {
        if let Some(byte) = self.bytes.get_mut(at / 8) {
            *byte &= !(1 << (at % 8));
        }
    }

    fn is_set(&self, at: usize) -> bool {
        self.bytes.get(at / 8).is_some_and(|byte| byte >> (at % 8) & 1 == 1)
    }

    fn n_set(&self) -> u64 {
        self.bytes.iter().map(|byte| u64::from(byte.count_ones())).sum()
    }
}

impl Suspect {
    fn sample(&self, row: &[Position]) -> Option<Position> {
        row.get(self.marker).copied().filter(|&at| !is_gap(at))
    }

    /// The length of a step from its last sample to one in this row, neither at the origin.
    fn step(&mut self, row: &[Position]) -> Option<f64> {
        let at = self.sample(row)?;
        let last = self.last.replace(at).filter(|&last| last != ORIGIN && at != ORIGIN)?;
        Some(distance(last, at))
    }

    /// Marks the samples that are missing: its runs at the origin, except single frames on its path.
    fn mark(&mut self, row: &[Position], missing: &mut Bits) {
        let Some(at) = self.sample(row) else { return };
        if at == ORIGIN {
            if self.run.0 == 0 {
                self.run.1 = missing.len;
                self.is_near_before = self.last.is_some_and(|last| self.is_near(last));
            }
            self.run.0 += 1;
            // A moving marker is at the origin for one frame at most.
            missing.push_set();
        } else {
            self.end_run(self.is_near(at), missing);
            self.last = Some(at);
        }
    }

    fn end_run(&mut self, is_near_after: bool, missing: &mut Bits) {
        let (n, first) = std::mem::take(&mut self.run);
        if n == 1 && (self.is_near_before || is_near_after) {
            missing.clear(first);
        }
    }

    fn is_near(&self, at: Position) -> bool {
        distance(at, ORIGIN) <= self.near
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Ambiguity, Notes};

    /// Marker 0 moves; marker 1 is `second`.
    fn with(second: &[Position]) -> Vec<Position> {
        second.iter().enumerate().flat_map(|(i, &at)| [[100.0 + i as f32, 5.0, 9.0], at]).collect()
    }

    fn scanned(positions: &[Position], n_markers: usize) -> OriginScan {
        let mut scan = OriginScan::new(n_markers);
        positions.chunks_exact(n_markers).for_each(|row| scan.add_row(row));
        if scan.needs_steps() {
            positions.chunks_exact(n_markers).for_each(|row| scan.add_steps(row));
        }
        scan
    }

    fn replace_with_gaps(positions: &mut [Position], n_markers: usize) -> u64 {
        let scan = scanned(positions, n_markers);
        let gaps = OriginGaps::find(&scan, positions.len() / n_markers, &mut |visit| {
            positions.chunks_exact(n_markers).for_each(visit);
            Ok(())
        });
        let mut gaps = gaps.unwrap();
        let n_gaps = |positions: &[Position]| positions.iter().filter(|&&at| is_gap(at)).count();
        let n_before = n_gaps(positions);
        positions.chunks_exact_mut(n_markers).for_each(|row| gaps.apply(row));
        assert_eq!(gaps.n_missing(), (n_gaps(positions) - n_before) as u64);
        gaps.n_missing()
    }

    fn removed(second: &[Position]) -> u64 {
        replace_with_gaps(&mut with(second), 2)
    }

    #[test]
    fn a_marker_at_the_origin_while_others_move_is_missing() {
        let far = |x: f32| [500.0 + x, 1.0, 2.0];
        assert_eq!(removed(&[far(0.0), ORIGIN, far(2.0), far(3.0)]), 1);
        assert_eq!(removed(&[ORIGIN, ORIGIN, far(2.0), far(3.0)]), 2);
        assert_eq!(removed(&[ORIGIN; 5]), 5);
        assert_eq!(removed(&[far(0.0), far(1.0)]), 0);
    }

    #[test]
    fn a_marker_that_passes_through_the_origin_has_a_position_there() {
        let at = |x: f32| [x, 0.0, 0.0];
        assert_eq!(removed(&[at(-2.0), at(-1.0), at(0.0), at(1.0), at(2.0)]), 0);
        // Nothing moves, so nothing shows that a sample is missing.
        assert_eq!(replace_with_gaps(&mut [ORIGIN, [1.0; 3], ORIGIN, [1.0; 3]], 2), 0);
    }

    #[test]
    fn a_single_marker_that_jumps_to_the_origin_is_missing() {
        let mut path: Vec<Position> = (0..9).map(|i| [900.0 + i as f32, 0.0, 0.0]).collect();
        path[4] = ORIGIN;
        assert_eq!(replace_with_gaps(&mut path, 1), 1);
    }

    #[test]
    fn a_scan_finds_missing_samples_where_they_are_marked() {
        // Few different positions, so that samples at the origin, single ones and runs, are near and far.
        let mut state = 1_u64;
        let mut number = |n: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) % n
        };
        let (mut n_missing, mut n_kept) = (0, 0);
        for _ in 0..20_000 {
            let n_markers = 1 + number(3) as usize;
            let n_frames = number(9) as usize;
            let far = [1.0, 9.0, 12.0, 500.0][number(4) as usize];
            let mut position = |_| match number(6) {
                0 => GAP,
                1 => ORIGIN,
                n => [far + n as f32 / 2.0, 0.0, 0.0],
            };
            let positions: Vec<Position> = (0..n_frames * n_markers).map(&mut position).collect();
            let is_missing = replace_with_gaps(&mut positions.clone(), n_markers) > 0;
            let mut notes = Notes::default();
            scanned(&positions, n_markers).note(&mut notes);
            let n_at_origin = positions.iter().filter(|&&at| at == ORIGIN).count() as u64;
            let noted = Ambiguity::Origin { samples: n_at_origin, gaps: false };
            let expected = if is_missing { vec![noted] } else { vec![] };
            assert_eq!(notes.ambiguities, expected, "{n_markers}: {positions:?}");
            assert_eq!(notes.warnings.len(), usize::from(n_at_origin > 0));
            n_missing += u64::from(is_missing);
            n_kept += u64::from(!is_missing && n_at_origin > 0);
        }
        assert!(n_missing > 1000 && n_kept > 1000, "{n_missing} and {n_kept}");
    }

    #[test]
    fn the_time_is_linear_in_the_number_of_markers() {
        // A pass over all markers for each marker would take hours.
        let n_markers = 1_000_000;
        let mut positions: Vec<Position> = vec![[1.0; 3]; 2 * n_markers];
        positions[7] = ORIGIN;
        assert_eq!(replace_with_gaps(&mut positions, n_markers), 0);
        positions[n_markers - 1] = [2.0; 3];
        assert_eq!(replace_with_gaps(&mut positions, n_markers), 1);
    }
}
