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
    if !positions.contains(&ORIGIN) {
        return missing;
    }
    let moves: Vec<bool> = (0..n_markers).map(|i| is_moving(positions, n_markers, i)).collect();
    let n_moving = moves.iter().filter(|&&moves| moves).count();
    for (marker, &moves) in moves.iter().enumerate() {
        let others_move = n_moving > usize::from(moves);
        // A single marker has no others to compare with: its own motion decides.
        if others_move || (n_markers == 1 && moves) {
            mark_missing(positions, n_markers, marker, &mut missing);
        }
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
    let zeros = positions.iter().filter(|&&p| p == [0.0; 3]).count() as u64;
    if zeros == 0 {
        return;
    }
    if missing(positions, n_markers).contains(&true) {
        notes.ambiguous(Ambiguity::Origin { samples: zeros, gaps: false });
    } else {
        let present = positions.iter().filter(|&&p| !is_gap(p)).count();
        notes.warnings.push(format!(
            "At the origin and not marked as missing, kept as positions: {zeros} of {present} samples."
        ));
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

/// Whether a marker has two different positions other than the origin.
fn is_moving(positions: &[Position], n_markers: usize, marker: usize) -> bool {
    let mut elsewhere = samples(positions, n_markers, marker).filter(|(_, at)| *at != ORIGIN);
    let first = elsewhere.next().map(|(_, at)| at);
    elsewhere.any(|(_, at)| Some(at) != first)
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
