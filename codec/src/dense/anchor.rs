//! Where a span's last row will be: several guesses, of which the one that did best lately is taken.

use super::lattice::Point;

/// (rows that the velocity is measured over, its weight in quarters).
const GUESSES: [(usize, i64); 7] = [(1, 0), (2, 4), (4, 4), (8, 4), (8, 2), (32, 4), (32, 2)];

/// An error beyond this counts as this much: one jump must not decide for seconds.
const MAX_ERROR: u64 = 1 << 24;

/// How far each guess was off lately, per axis: an average that forgets an eighth a span.
#[derive(Debug, Clone, Default)]
pub(super) struct Anchor {
    errors: [[u64; GUESSES.len()]; 3],
}

/// The guesses for one span, to be scored once its anchor is known.
#[derive(Debug)]
pub(super) struct Guesses([[i64; GUESSES.len()]; 3]);

impl Anchor {
    /// `known` gives a row so far before row 0, up to `n_before`; `m` is the distance to the anchor.
    pub(super) fn guess(
        &self,
        known: impl Fn(usize) -> Point,
        n_before: usize,
        m: usize,
    ) -> (Point, Guesses) {
        let mut guesses = Guesses(Default::default());
        let mut best = Point::default();
        let last = known(0);
        for (i, (window, quarters)) in GUESSES.into_iter().enumerate() {
            let window = window.min(n_before);
            let before = known(window);
            for axis in 0..3 {
                let travelled = last[axis].wrapping_sub(before[axis]);
                let ahead = travelled.wrapping_mul(m as i64 * quarters);
                let ahead = match window {
                    0 => 0,
                    _ if window.is_power_of_two() => ahead >> (2 + window.ilog2()),
                    _ => ahead.div_euclid(4 * window as i64),
                };
                guesses.0[axis][i] = last[axis].wrapping_add(ahead);
            }
        }
        for (axis, best) in best.iter_mut().enumerate() {
            let pick = (0..GUESSES.len()).min_by_key(|&i| self.errors[axis][i]).unwrap_or(0);
            *best = guesses.0[axis][pick];
        }
        (best, guesses)
    }

    /// Remembers how far each guess was from the decoded anchor.
    pub(super) fn score(&mut self, guesses: &Guesses, anchor: Point) {
        for ((errors, guesses), anchor) in self.errors.iter_mut().zip(&guesses.0).zip(anchor) {
            for (error, guess) in errors.iter_mut().zip(guesses) {
                let off = guess.wrapping_sub(anchor).unsigned_abs().min(MAX_ERROR);
                // In eighths, so that the average does not stall above zero.
                *error = *error - *error / 8 + off;
            }
        }
    }
}
