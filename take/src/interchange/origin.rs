//! Samples exactly at the origin: some software writes `0 0 0` for an occluded marker.

use super::units::median;
use crate::{
    ambiguity::{Ambiguity, Notes},
    motion::{GAP, Position, is_gap},
};

const ORIGIN: Position = [0.0; 3];
/// Written instead of the origin in formats where `0 0 0` means, or may mean, a missing sample: one nanometre off.
const NEAR_ORIGIN: Position = [1e-6, 0.0, 0.0];
/// A marker whose neighbouring sample is within this many of its median steps from the origin passes through the
/// origin.
const STEPS: f64 = 10.0;

/// For each sample whether it is a missing one: it is exactly at the origin while other markers move elsewhere, and its
/// own marker does not approach the origin. If the marker passes through the origin, the sample is a position.
pub(super) fn missing(positions: &[Position], n_markers: usize) -> Vec<bool> {
    let mut missing = vec![false; positions.len()];
    let mut scan = OriginScan::new(n_markers);
    positions.chunks_exact(n_markers.max(1)).for_each(|row| scan.add_row(row));
    for marker in scan.suspects() {
        mark_missing(positions, n_markers, marker, &mut missing);
    }
    missing
}

/// The position to write in a format where `0 0 0` may mean a missing sample.
pub(super) fn off_origin(position: Position) -> Position {
    if position == ORIGIN { NEAR_ORIGIN } else { position }
}

/// Replaces missing samples at the origin with gaps. Returns how many.
pub(super) fn replace_with_gaps(positions: &mut [Position], n_markers: usize) -> u64 {
    let missing = missing(positions, n_markers);
    let mut n_removed = 0;
    for (position, _) in positions.iter_mut().zip(missing).filter(|(_, missing)| *missing) {
        *position = GAP;
        n_removed += 1;
    }
    n_removed
}

/// Notes samples at the origin in a format with its own mark for missing samples. Other readers take them for
/// positions, so they stay positions, but the program that wrote the file may have meant missing samples.
pub(super) fn note_samples_at_origin(positions: &[Position], n_markers: usize, notes: &mut Notes) {
    let rows = || positions.chunks_exact(n_markers.max(1));
    let mut scan = OriginScan::new(n_markers);
    rows().for_each(|row| scan.add_row(row));
    if scan.needs_steps() {
        rows().for_each(|row| scan.add_steps(row));
    }
    scan.note(notes);
}

/// Finds the samples at the origin, row by row.
///
/// A marker's samples at the origin are missing ones, rather than positions, if it is there for two frames or more, or
/// if it is far away before and after. What is far depends on the median of its steps; as only a comparison with it
/// counts, the rows are read again to count the steps on either side.
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
    /// Of its single samples at the origin, the largest distance to the nearer one of their neighbours; infinite if
    /// there are none.
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

    /// The markers whose samples at the origin may be missing ones: others move, or a single one does itself.
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

    /// Whether some of its samples at the origin are missing ones: the same as [`mark_missing`], which marks them.
    fn has_missing(&self) -> bool {
        // The median, the upper one for an even count, is too short if at least as many steps are too short as come
        // before it and itself.
        let median_is_short = self.n_steps == 0 || self.n_short_steps > self.n_steps / 2;
        self.is_long || self.farthest().is_some_and(|farthest| farthest > 0.0 && median_is_short)
    }
}

/// The frame and position of each sample of a marker.
fn samples(
    positions: &[Position],
    n_markers: usize,
    marker: usize,
) -> impl Iterator<Item = (usize, Position)> {
    let column = positions.iter().skip(marker).step_by(n_markers.max(1)).copied();
    column.enumerate().filter(|&(_, at)| !is_gap(at))
}

/// Marks the samples of one marker that are missing: its runs at the origin, except single frames on its path.
fn mark_missing(positions: &[Position], n_markers: usize, marker: usize, missing: &mut [bool]) {
    let all: Vec<(usize, Position)> = samples(positions, n_markers, marker).collect();
    let pairs = all.windows(2).filter(|pair| pair.iter().all(|(_, at)| *at != ORIGIN));
    let steps = pairs.filter_map(|pair| Some(distance(pair.first()?.1, pair.last()?.1)));
    let usual = median(&mut steps.collect::<Vec<f64>>()).unwrap_or(0.0);
    let is_near = |at: Option<&(usize, Position)>| {
        at.is_some_and(|&(_, at)| distance(at, ORIGIN) <= STEPS * usual)
    };
    let mut runs = all.chunk_by(|(_, a), (_, b)| (*a == ORIGIN) == (*b == ORIGIN)).peekable();
    let mut before = None;
    while let Some(run) = runs.next() {
        let after = runs.peek().and_then(|next| next.first());
        // A moving marker is at the origin for one frame at most.
        let passes = run.len() == 1 && (is_near(before) || is_near(after));
        for &(frame, _) in run.iter().filter(|(_, at)| *at == ORIGIN && !passes) {
            if let Some(place) = missing.get_mut(frame * n_markers + marker) {
                *place = true;
            }
        }
        before = run.last();
    }
}

fn distance(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Marker 0 moves; marker 1 is `second`.
    fn with(second: &[Position]) -> Vec<Position> {
        second.iter().enumerate().flat_map(|(i, &at)| [[100.0 + i as f32, 5.0, 9.0], at]).collect()
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
            let is_missing = missing(&positions, n_markers).contains(&true);
            let mut notes = Notes::default();
            note_samples_at_origin(&positions, n_markers, &mut notes);
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
