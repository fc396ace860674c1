//! The anchors of a run: each predicted by the guess that did best lately.

use super::{
    model::ANCHOR,
    walk::{Channel, Point, Rows, SPAN, Side, ZERO, lanes},
};
use crate::CodecError;

/// (rows that the velocity is measured over, its weight).
pub(super) const GUESSES: [(usize, f32); 7] =
    [(1, 0.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.5), (32, 1.0), (32, 0.5)];

/// All anchors, up to row `end`. An error counts as `cap` at most.
#[inline(always)]
pub(super) fn anchors<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    points: &mut [Point],
    end: usize,
    cap: f32,
) -> Result<(), CodecError> {
    let count = end.div_ceil(SPAN);
    let rows = Rows { first: SPAN, step: SPAN, end, count };
    side.enter(ANCHOR, rows, &mut channel.activity[ANCHOR])?;
    let mut from = 0;
    while from < end {
        let row = (from + SPAN).min(end);
        let reach = (row - from) as f32;
        let last = points[ZERO + from];
        let mut guesses = [last; GUESSES.len()];
        for (guess, (window, weight)) in guesses.iter_mut().zip(GUESSES).skip(1) {
            // Between anchors of one run nothing is known yet.
            let window = match from {
                0 => window,
                SPAN => SPAN,
                _ if window == SPAN => 2 * SPAN,
                _ => SPAN,
            };
            if from > 0 || window < channel.known {
                let before = points[ZERO + from - window];
                let factor = reach * weight / window as f32;
                *guess = lanes(|i| last[i] + (last[i] - before[i]) * factor);
            }
        }
        let mut prediction = guesses[0];
        for i in 0..3 {
            let mut least = channel.errors[0][i];
            for (errors, guess) in channel.errors.iter().zip(&guesses).skip(1) {
                if errors[i] < least {
                    least = errors[i];
                    prediction[i] = guess[i];
                }
            }
        }
        let point = side.settle(row, prediction);
        points[ZERO + row] = point;
        for (errors, guess) in channel.errors.iter_mut().zip(&guesses) {
            *errors = lanes(|i| errors[i] * 0.875 + (guess[i] - point[i]).abs().min(cap));
        }
        from = row;
    }
    side.leave(ANCHOR, rows, &mut channel.activity[ANCHOR]);
    Ok(())
}
