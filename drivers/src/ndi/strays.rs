//! Tracking of stray markers, which a device lists in any order and without identity.
//!
//! The strays of a frame are matched to the numbers of the previous frame such that the sum of squared
//! distances to their extrapolated positions is least. When the host fetches every frame, that is the
//! nearest stray. When a slow line skips frames and everything has moved by more than the distance between
//! markers, the match is still right, because a motion that all strays share changes no optimal pairing: it
//! adds the same amount to every pairing.
//! No match is farther than a marker can move in the time between the two frames. The number of a
//! stray that disappears is held for half a second, in case the stray reappears near the same place; then it
//! goes to the next stray that appears.
//!
//! The assignment problem is solved by the method of Kuhn and Munkres, with one shortest augmenting path per row; rows
//! whose column is free, as most are, cost one pass over the columns. 63
//! markers of a person over a slow line take 0.1 ms a frame; 255 placed at random in a cube of 60 cm in
//! every frame, the worst case found, take 16 to 32 ms, while their reply takes 34 ms on the fastest line.

use super::frame::{FrameData, STRAYS_MAX};
use crate::device::MarkerSample;

/// First id of strays; lower ids are port handles.
pub(super) const FIRST_ID: u16 = 0x100;

/// Largest speed of a newly seen marker, and largest change of velocity from one frame to the next, in
/// millimetres per second. A limb that hits the ground stays below.
const SPEED_MAX_MM_S: f32 = 6_000.0;

/// Smallest gate in millimetres: no optical system separates two strays that are nearer to each other.
const GATE_MIN_MM: f32 = 10.0;

/// Largest gate in millimetres, for any number of skipped frames: the greatest speed for 75 ms. A hand
/// farther away could as well be the other hand.
const GATE_MAX_MM: f32 = 450.0;

/// Damping of the extrapolation over skipped frames: the value between 0.6 and 1 that assigns the fewest
/// new numbers in recorded motions over slow lines.
const VELOCITY_KEPT: f32 = 0.8;

/// Time for which the number of a missing stray is held, in seconds.
const HOLD_S: f64 = 0.5;

/// Numbers to use up before held ones are reassigned: the number of unannounced markers that the
/// recorder can store.
const NUMBERS_PREFERRED: usize = 64;

#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    position_mm: [f32; 3],
    /// Displacement per frame, in millimetres.
    step_mm: [f32; 3],
    /// Device frames for which the number is still held; 0 when free.
    held: u32,
}

/// Predicted position of a numbered stray, with the square of its gate.
#[derive(Debug, Clone, Copy)]
struct Prediction {
    slot: usize,
    position_mm: [f32; 3],
    gate2: f32,
}

/// Assigns persistent numbers to strays.
#[derive(Debug)]
pub(super) struct StrayTracker {
    slots: [Slot; STRAYS_MAX],
    predictions: Vec<Prediction>,
    assignment: Assignment,
    gate_mm: f32,
    hold_frames: u32,
}

impl StrayTracker {
    pub(super) fn new() -> Self {
        Self {
            slots: [Slot::default(); STRAYS_MAX],
            predictions: Vec::with_capacity(STRAYS_MAX),
            assignment: Assignment::new(STRAYS_MAX, STRAYS_MAX),
            gate_mm: 0.0,
            hold_frames: 1,
        }
    }

    /// Forgets all strays, and sets the frame rate.
    pub(super) fn restart(&mut self, rate_hz: f64) {
        self.slots = [Slot::default(); STRAYS_MAX];
        self.gate_mm = (SPEED_MAX_MM_S / rate_hz as f32).max(GATE_MIN_MM);
        self.hold_frames = (HOLD_S * rate_hz).ceil().max(1.0) as u32;
    }

    /// Appends the strays of a frame with their ids. `elapsed` is the number of frames since the previous one.
    pub(super) fn assign(&mut self, frame: &FrameData, elapsed: u32, out: &mut Vec<MarkerSample>) {
        let elapsed = elapsed.max(1);
        let strays = frame.strays.as_slice();
        self.match_strays(strays, elapsed);
        let mut has_number = [false; STRAYS_MAX];
        let mut taken = [false; STRAYS_MAX];
        for (stray, index) in self.assignment.pairs() {
            let slot = self.predictions[index].slot;
            fill_slot(&mut self.slots[slot], slot, strays[stray], elapsed, self.hold_frames, out);
            (has_number[stray], taken[slot]) = (true, true);
        }
        for (stray, _) in strays.iter().zip(has_number).filter(|(_, has_number)| !has_number) {
            match self.free_slot(&taken) {
                Some(slot) => {
                    self.slots[slot] = Slot::default();
                    fill_slot(&mut self.slots[slot], slot, *stray, elapsed, self.hold_frames, out);
                    taken[slot] = true;
                }
                None => push_unnumbered(*stray, out),
            }
        }
        for (slot, _) in self.slots.iter_mut().zip(taken).filter(|(_, taken)| !taken) {
            // Its motion is unknown: search at its last position.
            *slot = Slot { held: slot.held.saturating_sub(elapsed), step_mm: [0.0; 3], ..*slot };
        }
        for _ in 0..frame.strays_excess {
            push_unnumbered([0.0; 3], out);
        }
    }

    /// Chooses the lowest free number, or, rather than one that a recorder cannot store, the number that has
    /// been held longest.
    fn free_slot(&self, taken: &[bool; STRAYS_MAX]) -> Option<usize> {
        let free = (0..STRAYS_MAX).find(|slot| !taken[*slot] && self.slots[*slot].held == 0);
        if free.is_some_and(|slot| slot < NUMBERS_PREFERRED) {
            return free;
        }
        let held = (0..NUMBERS_PREFERRED).filter(|slot| !taken[*slot]);
        held.min_by_key(|slot| self.slots[*slot].held).or(free)
    }

    /// Matches strays to the numbers that they keep.
    fn match_strays(&mut self, strays: &[[f32; 3]], elapsed: u32) {
        let Self { slots, predictions, assignment, gate_mm, hold_frames } = self;
        let far_mm = (*gate_mm * elapsed as f32).min(GATE_MAX_MM).max(*gate_mm);
        predictions.clear();
        for (slot, known) in slots.iter().enumerate().filter(|(_, known)| known.held > 0) {
            // A stray that was hidden, or not polled for too long, is searched at its last position.
            let moves = known.held == *hold_frames && elapsed <= *hold_frames;
            let (ahead, gate_mm) = match (moves, elapsed) {
                (false, _) => (0.0, *gate_mm),
                (true, 1) => (1.0, *gate_mm),
                (true, _) => (elapsed as f32 * VELOCITY_KEPT, far_mm),
            };
            let position_mm =
                std::array::from_fn(|axis| known.position_mm[axis] + known.step_mm[axis] * ahead);
            predictions.push(Prediction { slot, position_mm, gate2: gate_mm * gate_mm });
        }
        // Prefer a new number to a match beyond the gate, and any match within it to a new number.
        let new_number_cost = f64::from(far_mm * far_mm);
        assignment.solve(strays.len(), predictions.len(), new_number_cost, |stray, index| {
            let Prediction { position_mm, gate2, .. } = predictions[index];
            let distance2: f32 =
                position_mm.iter().zip(strays[stray]).map(|(a, b)| (a - b) * (a - b)).sum();
            if distance2 <= gate2 { f64::from(distance2) } else { f64::INFINITY }
        });
    }
}

/// Assigns the number of a slot to a stray, and appends its sample.
fn fill_slot(
    slot: &mut Slot,
    index: usize,
    position_mm: [f32; 3],
    elapsed: u32,
    hold_frames: u32,
    out: &mut Vec<MarkerSample>,
) {
    let Slot { position_mm: previous_mm, held, .. } = *slot;
    // The velocity of a stray that the previous frame did not show is unknown.
    let was_seen = held == hold_frames;
    let step = |axis: usize| {
        if was_seen { (position_mm[axis] - previous_mm[axis]) / elapsed as f32 } else { 0.0 }
    };
    *slot = Slot { position_mm, step_mm: std::array::from_fn(step), held: hold_frames };
    out.push(MarkerSample { id: FIRST_ID + index as u16, position_mm, ..Default::default() });
}

/// Appends a stray without a number: they all share one id, so that the recorder counts them as dropped.
fn push_unnumbered(position_mm: [f32; 3], out: &mut Vec<MarkerSample>) {
    let id = FIRST_ID + STRAYS_MAX as u16;
    out.push(MarkerSample { id, position_mm, ..MarkerSample::default() });
}

/// A column and its state in the current search.
#[derive(Debug, Clone, Copy, Default)]
struct Column {
    /// The row assigned to it, counted from 1; 0 when free.
    row: usize,
    potential: f64,
    /// The minimum reduced cost of reaching it, and the column before it on that path.
    min_cost: f64,
    from: usize,
    visited: bool,
}

/// Solver with reusable memory.
#[derive(Debug)]
struct Assignment {
    potentials: Vec<f64>,
    columns: Vec<Column>,
}

impl Assignment {
    /// Makes a solver that does not allocate for up to this many rows and columns.
    pub(super) fn new(rows_max: usize, columns_max: usize) -> Self {
        Self {
            potentials: Vec::with_capacity(rows_max + 1),
            columns: Vec::with_capacity(columns_max + rows_max + 1),
        }
    }

    /// Assigns rows to columns. `cost` is infinite for pairs that are not allowed; a row without a column costs
    /// `unassigned_cost`.
    fn solve(
        &mut self,
        n_rows: usize,
        n_columns: usize,
        unassigned_cost: f64,
        cost: impl Fn(usize, usize) -> f64,
    ) {
        self.potentials.clear();
        self.potentials.resize(n_rows + 1, 0.0);
        // Column 0 is the root of a search; after the given columns each row has a private one.
        self.columns.clear();
        self.columns.resize(1 + n_columns + n_rows, Column::default());
        for row in 1..=n_rows {
            self.augment(row, &|row, column| {
                if column <= n_columns {
                    cost(row - 1, column - 1)
                } else if column == n_columns + row {
                    unassigned_cost
                } else {
                    f64::INFINITY
                }
            });
        }
        self.columns.truncate(1 + n_columns);
    }

    /// Row and column of every pair, in the order of columns.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        let columns = self.columns.iter().skip(1).enumerate();
        columns.filter(|(_, column)| column.row > 0).map(|(index, column)| (column.row - 1, index))
    }

    /// Assigns a column to this row along the shortest augmenting path, reassigning other rows where cheaper.
    fn augment(&mut self, row: usize, cost: &dyn Fn(usize, usize) -> f64) {
        let Self { potentials, columns } = self;
        for column in columns.iter_mut() {
            (column.min_cost, column.visited) = (f64::INFINITY, false);
        }
        columns[0].row = row;
        let mut current = 0;
        loop {
            columns[current].visited = true;
            let row = columns[current].row;
            let (mut step, mut next) = (f64::INFINITY, 0);
            for (index, column) in columns.iter_mut().enumerate().skip(1) {
                if column.visited {
                    continue;
                }
                let reduced = cost(row, index) - potentials[row] - column.potential;
                if reduced < column.min_cost {
                    (column.min_cost, column.from) = (reduced, current);
                }
                if column.min_cost < step {
                    (step, next) = (column.min_cost, index);
                }
            }
            for column in columns.iter_mut() {
                if column.visited {
                    potentials[column.row] += step;
                    column.potential -= step;
                } else {
                    column.min_cost -= step;
                }
            }
            current = next;
            // A free column always exists: the row's private one.
            if columns[current].row == 0 {
                break;
            }
        }
        while current != 0 {
            let from = columns[current].from;
            columns[current].row = columns[from].row;
            current = from;
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    fn ids(strays: &mut StrayTracker, positions: &[[f32; 3]]) -> Vec<u16> {
        ids_after(strays, 1, positions)
    }

    fn ids_after(strays: &mut StrayTracker, elapsed: u32, positions: &[[f32; 3]]) -> Vec<u16> {
        let mut frame = FrameData::new();
        positions.iter().for_each(|position| frame.push_stray(*position));
        let mut out = Vec::new();
        strays.assign(&frame, elapsed, &mut out);
        // In the order of `positions`.
        positions
            .iter()
            .map(|p| out.iter().find(|sample| sample.position_mm == *p).unwrap().id - FIRST_ID)
            .collect()
    }

    #[test]
    fn numbers_stay_with_their_strays() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        let (a, b, c) = ([0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [0.0, 300.0, 0.0]);
        assert_eq!(ids(&mut strays, &[a, b, c]), [0, 1, 2]);
        assert_eq!(ids(&mut strays, &[c, a, b]), [2, 0, 1], "another order");
        assert_eq!(ids(&mut strays, &[c, b]), [2, 1], "one is hidden");
        let near_a = [20.0, 10.0, 0.0];
        assert_eq!(ids(&mut strays, &[near_a, c, b]), [0, 2, 1], "and comes back");
        let far = [900.0; 3];
        assert_eq!(ids(&mut strays, &[far, c, b]), [3, 2, 1], "one too far away is another");
        for _ in 0..30 {
            ids(&mut strays, &[c, b]);
        }
        assert_eq!(ids(&mut strays, &[far, near_a, b]), [0, 3, 1], "numbers are used again");
    }

    #[test]
    fn passing_strays_keep_their_numbers_when_they_move_little() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        for frame in 0..100_u8 {
            let x = f32::from(frame) * 10.0;
            let numbers = ids(&mut strays, &[[x, 0.0, 0.0], [1000.0 - x, 40.0, 0.0]]);
            assert_eq!(numbers, [0, 1], "frame {frame}");
        }
    }

    #[test]
    fn strays_beyond_the_numbers_share_one_id() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        let mut frame = FrameData::new();
        for i in 0..300_u16 {
            frame.push_stray([f32::from(i) * 50.0, 0.0, 0.0]);
        }
        let mut out = Vec::new();
        strays.assign(&frame, 1, &mut out);
        assert_eq!(out.len(), 300);
        assert_eq!(out.iter().filter(|s| usize::from(s.id - FIRST_ID) == STRAYS_MAX).count(), 45);
    }

    /// Six markers in a row, 100 mm apart.
    fn row(from_mm: f32) -> Vec<[f32; 3]> {
        (0..6_u8).map(|i| [from_mm + 100.0 * f32::from(i), 0.0, 0.0]).collect()
    }

    #[test]
    fn a_shared_motion_over_skipped_frames_changes_no_number() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        let all: Vec<u16> = (0..6).collect();
        // 2.4 m/s: 200 mm from one fetched frame to the next, twice the distance between two markers; no
        // velocity is known at the first.
        for (fetched, from_mm) in [0.0, 200.0, 400.0, 600.0].into_iter().enumerate() {
            assert_eq!(ids_after(&mut strays, 5, &row(from_mm)), all, "frame {fetched}");
        }
        // They stop abruptly.
        assert_eq!(ids_after(&mut strays, 5, &row(600.0)), all);
        // The last one is hidden, and the others move on.
        assert_eq!(ids_after(&mut strays, 4, &row(650.0)[..5]), all[..5]);
    }

    #[test]
    fn skipped_frames_do_not_merge_two_strays() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        let (a, b) = ([0.0, 0.0, 0.0], [2000.0, 0.0, 0.0]);
        assert_eq!(ids(&mut strays, &[a, b]), [0, 1]);
        // After any number of skipped frames: one stray is gone, and another has appeared.
        for elapsed in [5, 20, 30] {
            let mut strays = StrayTracker { slots: strays.slots, ..StrayTracker::new() };
            (strays.gate_mm, strays.hold_frames) = (100.0, 30);
            let other = [GATE_MAX_MM + 1.0, 0.0, 0.0];
            assert_eq!(ids_after(&mut strays, elapsed, &[other, b]), [2, 1], "{elapsed}");
        }
        // After more than half a second it is the same only at its last position.
        let near = [150.0, 0.0, 0.0];
        let mut later = StrayTracker { slots: strays.slots, ..StrayTracker::new() };
        (later.gate_mm, later.hold_frames) = (100.0, 30);
        assert_eq!(ids_after(&mut later, 31, &[near, b]), [2, 1]);
        // A stray that was hidden in the last fetched frame is not searched farther away than before.
        assert_eq!(ids_after(&mut strays, 5, &[b]), [1]);
        assert_eq!(ids_after(&mut strays, 5, &[near, b]), [2, 1]);
    }

    #[test]
    fn a_number_is_held_for_half_a_second_of_the_device() {
        let mut strays = StrayTracker::new();
        strays.restart(60.0);
        let (a, b, far) = ([0.0; 3], [2000.0, 0.0, 0.0], [900.0; 3]);
        assert_eq!(ids(&mut strays, &[a, b]), [0, 1]);
        assert_eq!(ids_after(&mut strays, 15, &[b]), [1]);
        assert_eq!(ids_after(&mut strays, 14, &[far, b]), [2, 1], "29 frames: it is held");
        let other = [-900.0; 3];
        assert_eq!(ids_after(&mut strays, 1, &[far, b]), [2, 1]);
        assert_eq!(ids_after(&mut strays, 1, &[other, far, b]), [0, 2, 1], "free after 30");
    }

    /// The minimum sum of costs, by exhaustive search.
    fn least_cost(row: usize, costs: &[Vec<f64>], alone: f64, taken: &mut Vec<bool>) -> f64 {
        let Some(of_row) = costs.get(row) else { return 0.0 };
        let mut best = alone + least_cost(row + 1, costs, alone, taken);
        for (column, cost) in of_row.iter().enumerate() {
            if !taken[column] && cost.is_finite() {
                taken[column] = true;
                best = best.min(cost + least_cost(row + 1, costs, alone, taken));
                taken[column] = false;
            }
        }
        best
    }

    #[test]
    fn the_sum_of_costs_is_minimal() {
        let mut random = Random::new(0x5EED);
        let mut assignment = Assignment::new(5, 6);
        for _ in 0..2000 {
            let (n_rows, n_columns) = (random.below(6), random.below(7));
            let mut cost =
                || if random.one_in(4) { f64::INFINITY } else { random.below(50) as f64 };
            let costs: Vec<Vec<f64>> =
                (0..n_rows).map(|_| (0..n_columns).map(|_| cost()).collect()).collect();
            let alone = 30.0;
            assignment.solve(n_rows, n_columns, alone, |row, column| costs[row][column]);
            let pairs: Vec<_> = assignment.pairs().collect();
            let sum: f64 = pairs.iter().map(|(row, column)| costs[*row][*column]).sum();
            let sum = sum + alone * (n_rows - pairs.len()) as f64;
            assert_eq!(sum, least_cost(0, &costs, alone, &mut vec![false; n_columns]), "{costs:?}");
            let mut rows: Vec<_> = pairs.iter().map(|(row, _)| *row).collect();
            rows.sort_unstable();
            rows.dedup();
            assert_eq!(rows.len(), pairs.len(), "a row has one column");
        }
    }
}
